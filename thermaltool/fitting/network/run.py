"""All outputs from their records to a network that is validated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.network.choose import (
    NetworkCandidate,
    choose_delays,
    choose_modes,
    started,
)
from thermaltool.fitting.network.identify import identify_network
from thermaltool.fitting.network.model import Network
from thermaltool.fitting.network.residuals import network_tests
from thermaltool.fitting.selection import first_that_fits
from thermaltool.fitting.transfer.continuation import Continued
from thermaltool.fitting.transfer.residuals import ResidualTests
from thermaltool.fitting.transfer.structure import Initial
from thermaltool.fitting.validation import validate, validation_zero
from thermaltool.signals.agreement import Agreement


@dataclass(frozen=True)
class NetworkPlan:
    """What is wanted.

    Attributes
    ----------
    modes : int or None
        None: chosen by held-out data.
    delay : float [s] or "auto"
        Dead time of every input and output; "auto" finds each.
    initial, split
        As in `thermaltool.fitting.transfer.run.Plan`.
    """

    modes: int | None = None
    delay: float | Literal["auto"] = 0.0
    initial: Initial = "auto"
    split: float | None = None


@dataclass(frozen=True)
class IdentifiedNetwork:
    """A network, identified and judged.

    Attributes
    ----------
    network : Network
    data : TrainingData
        What it was fitted to.
    training, validation : tuple of Agreement, one for each output
        Of free runs; `validation` is None where no data were kept for it.
    improvement : tuple of float, or None
        As in `Identified`, of each output [%].
    tests : tuple of ResidualTests
    candidates : tuple of NetworkCandidate, or None
        Where the number of modes was chosen.
    """

    network: Network
    data: TrainingData
    training: tuple[Agreement, ...]
    validation: tuple[Agreement, ...] | None
    improvement: tuple[float, ...] | None
    tests: tuple[ResidualTests, ...]
    candidates: tuple[NetworkCandidate, ...] | None

    def continuous_terms(self, k: int) -> tuple[Continued, ...]:
        """Responses of output k to every input, as a model document takes them."""
        output = self.network.outputs[k]
        return tuple(
            Continued(output.response(i), 0.0, *output.response_covariance(i))
            for i in range(len(output.names))
        )


def run_network(
    data: TrainingData, plan: NetworkPlan, fresh: TrainingData | None = None
) -> IdentifiedNetwork:
    """Fit and judge one network for all outputs.

    Parameters
    ----------
    data : TrainingData
    plan : NetworkPlan
    fresh : TrainingData, optional
        Of another log, for validation.

    Raises
    ------
    FitError
        As `identify_network` and `validate`; no number of modes fits.
    """
    held = fresh
    if plan.split is not None:
        data, held = data.split(plan.split)
    if plan.initial != "free":
        data = data.from_rest() if plan.initial == "rest" else started(data)
    network, candidates = _fitted(data, plan)
    validation = gained = None
    if held is not None:
        validation, gained = _validated(network, held, fresh is not None)
    return IdentifiedNetwork(network, data, tuple(network.fit(data)), validation, gained,
                  tuple(network_tests(network, data)), candidates)  # fmt: skip


def _fitted(
    data: TrainingData, plan: NetworkPlan
) -> tuple[Network, tuple[NetworkCandidate, ...] | None]:
    data.check()
    if plan.delay == "auto":
        delays = choose_delays(data)
    else:
        delays = tuple((plan.delay,) * len(data.inputs) for _ in data.outputs)
    if plan.modes is not None:
        return identify_network(data, plan.modes, delays), None
    candidates = choose_modes(data, delays)
    modes = (c.modes for c in candidates)
    return first_that_fits(modes, lambda n: identify_network(data, n, delays)), candidates


def _validated(
    network: Network, held: TrainingData, other_log: bool
) -> tuple[tuple[Agreement, ...], tuple[float, ...]]:
    zeros = tuple(validation_zero(target, other_log) for target in held.outputs)
    runs = network.run(held, zeros)
    found = [
        validate(held, k, runs[k], zeros[k], output.offsets, output.modes)
        for k, output in enumerate(network.outputs)
    ]
    return tuple(fit for fit, _ in found), tuple(gain for _, gain in found)
