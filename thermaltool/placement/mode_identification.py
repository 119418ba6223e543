"""Thermal modes from measured logs alone: time constants that all channels share.

Every channel is a sum of exponentials with the time constants of the machine (Zhu, Ni, Shih 2008,
(17)); heating and cooling are the responses of one network to what drives it, so that both are
fitted together, by variable projection (`thermaltool.fitting.network`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import FitError
from thermaltool.fitting.data import TrainingData, training_data
from thermaltool.fitting.network.identify import MAX_MODES, identify_network
from thermaltool.fitting.network.model import Network, NetworkOutput
from thermaltool.fitting.network.plan import NetworkPlan
from thermaltool.fitting.start_state import Initial
from thermaltool.record import Record
from thermaltool.signals.intervals import NORMAL_95, Estimate, normal_estimate

Array = NDArray[np.float64]
# Twice the gain of log-likelihood beyond its cost in BIC from which a further mode is there.
MIN_EVIDENCE = 10.0
# Standard error of a time constant, over it, above which a mode is none of the log [1].
MAX_RELATIVE_ERROR = 1.0
# Lengths of the log beyond which a mode is a straight line in it, such as a drift of the room.
MAX_LENGTHS = 3.0


@dataclass(frozen=True)
class ModeCandidate:
    """One number of modes.

    Attributes
    ----------
    modes : int
    bic : float
    """

    modes: int
    bic: float


@dataclass(frozen=True)
class IdentifiedModes:
    """Modes that all channels of logs share.

    Attributes
    ----------
    network : Network
    candidates : tuple of ModeCandidate
        What was compared; empty where the number was given.
    limit : str
        Why no further mode was taken; empty where it was given.
    duration : float
        Of the longest record [s].
    at_rest : bool
        Whether every record begins settled.
    drifts : bool
        Whether a further mode has evidence that is slower than the log is long.
    """

    network: Network
    candidates: tuple[ModeCandidate, ...]
    limit: str
    duration: float
    at_rest: bool
    drifts: bool = False

    @property
    def time_constants(self) -> tuple[Estimate, ...]:
        """The slowest first [s]."""
        return self.network.outputs[0].time_constant_estimates()

    def relative_weight_estimates(self, output: int, drive: int) -> tuple[Estimate, ...]:
        """Weight |w| of every mode as part of their sum, with first-order intervals."""
        return _relative_weights(self.network.outputs[output], drive)


def identify_modes(
    logs: Sequence[Record],
    drives: Sequence[str],
    outputs: Sequence[str],
    modes: int | None = None,
    initial: Initial = "auto",
) -> IdentifiedModes:
    """Time constants that all channels share, and the weight of each in every channel.

    Parameters
    ----------
    logs : sequence of Record
    drives : sequence of str
        What heats: a power, a speed, a temperature around.
    outputs : sequence of str
        Temperatures and deflections that follow.
    modes : int, optional
        Number of modes. Default: one more as long as BIC gains `MIN_EVIDENCE`
        and the log identifies its time constant.
    initial : {"auto", "rest", "free"}
        State at the first row.

    Raises
    ------
    FitError
        A channel that is constant or a drive that never moves; rows too few for one mode, or for
        as many as are asked for; two modes that fall together; a number that is not given, and
        nothing that follows the drives.
    """
    plan = NetworkPlan(modes=modes, initial=initial)
    data = training_data(logs, drives, outputs)
    data.check()
    data = plan.start(data)
    delays = tuple((0.0,) * len(drives) for _ in outputs)
    found, candidates, limit, drifts = None, [], "", False
    for count in (modes,) if modes is not None else range(1, MAX_MODES + 1):
        try:
            tried = identify_network(data, count, delays)
        except FitError as error:
            if found is None:
                raise
            limit = f"{count} modes: {error}"
            break
        if modes is None:
            candidates.append(ModeCandidate(count, tried.criteria.bic))
        if found is not None and tried.criteria.bic > found.criteria.bic - MIN_EVIDENCE:
            limit = f"{count} modes have no evidence beside {count - 1}"
            break
        doubtful = _not_identified(tried, data.duration)
        if modes is None and found is not None and doubtful is not None:
            drifts = doubtful > MAX_LENGTHS * data.duration
            limit = (
                f"{count} modes: that of {doubtful:.3g} s is not identified by a log of "
                f"{data.duration:.3g} s"
            )
            break
        if modes is None and found is None and (gain := _evidence_of_any(tried)) < MIN_EVIDENCE:
            raise FitError(
                f"nothing follows {', '.join(drives)}: a first mode has no evidence "
                f"({gain:.3g}, decisive from {MIN_EVIDENCE:g})"
            )
        found = tried
    assert found is not None
    return IdentifiedModes(
        found, tuple(candidates), limit, data.duration, _is_at_rest(data), drifts
    )


def _evidence_of_any(network: Network) -> float:
    """The fall of BIC by the weights of all outputs together, by Wald's statistic of each."""
    size, count = 0.0, network.modes
    for output in network.outputs:
        weights = np.ravel(output.weights)
        own = slice(output.modes, output.modes + weights.size)
        size += float(weights @ np.linalg.pinv(output.covariance[own, own]) @ weights)
        count += weights.size
    return size - count * float(np.log(sum(output.rows for output in network.outputs)))


def _not_identified(network: Network, duration: float) -> float | None:
    """The slowest time constant that the log cannot identify [s]."""
    wide = 2 * NORMAL_95 * MAX_RELATIVE_ERROR
    return max(
        (e.value for e in network.outputs[0].time_constant_estimates()
         if e.value > MAX_LENGTHS * duration or np.log(e.high) - np.log(e.low) > wide),
        default=None,
    )  # fmt: skip


def _is_at_rest(data: TrainingData) -> bool:
    return all(record.at_rest for record in data.records)


def _relative_weights(output: NetworkOutput, drive: int) -> tuple[Estimate, ...]:
    """p_j = |w_j| / Σ|w|, and dp_j = (δ_jk − p_j) sign(w_k) dw_k / Σ|w|."""
    n = output.modes
    weights, at = output.weights[drive], slice(n * (1 + drive), n * (2 + drive))
    total = float(np.abs(weights).sum()) or 1.0
    parts = np.abs(weights) / total
    slopes = (np.eye(n) - parts[:, None]) * np.sign(weights) / total
    variances = np.diag(slopes @ output.covariance[at, at] @ slopes.T)
    return tuple(
        normal_estimate(float(part), float(np.sqrt(max(variance, 0.0))))
        for part, variance in zip(parts, variances, strict=True)
    )
