"""Plan of one network for all outputs: how many modes, and which dead times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.identification import Plan
from thermaltool.fitting.network.choose import choose_delays, choose_modes, undelayed_errors
from thermaltool.fitting.network.identify import identify_network
from thermaltool.fitting.network.model import Network, NetworkOutput
from thermaltool.fitting.selection import Candidate, first_that_fits
from thermaltool.fitting.start_state import with_start


@dataclass(frozen=True, kw_only=True)
class NetworkPlan(Plan):
    """Modes that all outputs share.

    Attributes
    ----------
    modes : int or None
        None: chosen by held-out data.
    delay : float [s] or "auto"
        Dead time of every input and output; "auto" finds each.
    """

    joint: ClassVar[bool] = True

    modes: int | None = None
    delay: float | Literal["auto"] = 0.0

    def start(self, data: TrainingData) -> TrainingData:
        return with_start(data, self.initial, undelayed_errors)

    def fit(
        self, data: TrainingData
    ) -> tuple[tuple[NetworkOutput, ...], tuple[Candidate[Network], ...]]:
        data.check()
        if self.delay == "auto":
            delays = choose_delays(data)
        else:
            delays = tuple((self.delay,) * len(data.inputs) for _ in data.outputs)
        if self.modes is not None:
            return identify_network(data, self.modes, delays).outputs, ()
        candidates = choose_modes(data, delays, self.budget)
        network = first_that_fits(
            ((c.model.modes, c.model.has_direct) for c in candidates),
            lambda tried: identify_network(data, tried[0], delays, tried[1]),
        )
        return network.outputs, candidates
