"""Noise of an operating state, or beyond that of the calibration: no misfit, and yet a fault."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermaltool.diagnosis.evidence import DECISIVE_EVIDENCE
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.no_signature import after_a_switch
from thermaltool.diagnosis.readings import reading_step
from thermaltool.diagnosis.result import Cause
from thermaltool.diagnosis.severity import Severity
from thermaltool.diagnosis.simulation import Series
from thermaltool.effects.effect import Float
from thermaltool.effects.noise_state import NoiseState
from thermaltool.fitting.averaging import row_noise
from thermaltool.record import Record
from thermaltool.signals.row_groups import Index
from thermaltool.units import is_displacement, is_temperature

# A state is off below, and on above, these shares of its range; rows between say nothing.
OFF, ON = 0.1, 0.4
# Pairs of readings that are compared in each state, and by how much the noise has to differ.
MIN_PAIRS, MIN_RATIO = 30, 1.5
# ... and from that at the calibration: another filter in a logger changes it, too.
MIN_SINCE = 4.0
# No difference counts as smaller than this share of the usual one.
LEAST_SHARE = 0.05
# Mean and variance of the logarithm of |z|, z a standard normal variable.
MEAN_LOG, VARIANCE_LOG = -0.6352, 1.2337
TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class _Noise:
    """Noise of a reading in two states, its largest deviation, and evidence that they differ.

    `state` is what acts while it is loud; None where it was quiet at the calibration.
    """

    state: str | None
    quiet: float
    loud: float
    largest: float
    evidence: float


def noisy_states(hypothesis: Hypothesis) -> list[Cause]:
    """Outputs that are noisier while a logged state acts, or than at the calibration.

    The surest first. Differences of neighbouring readings are compared by their mean logarithm, so
    that single wrong readings count little.

    Parameters
    ----------
    hypothesis : Hypothesis
        With the named causes.
    """
    states = _states(hypothesis)
    price = 2 * float(np.log(max((len(states) + 1) * len(hypothesis.groups), 1)))
    switched = [after_a_switch(hypothesis.model, log) for log in hypothesis.logs]
    found = []
    for output in hypothesis.groups:
        residual = hypothesis.unexplained(output)
        tried = [_compared(hypothesis, residual, switched, state) for state in states]
        tried.append(_since_calibration(hypothesis, output, residual, switched))
        # Readings on a coarse lattice scatter where they move, and not at all where they rest; what
        # is left of a frozen sensor is rounding.
        logs = _logs(hypothesis, output)
        steps = [reading_step(log, output) for log in logs]
        rounding = [np.spacing(np.nanmax(np.abs(log.columns[output]))) for log in logs]
        least = max(*steps, *rounding)
        sure = [
            each
            for each in tried
            if each and each.evidence - price >= DECISIVE_EVIDENCE and each.loud >= least
        ]
        if sure:
            # A state that it follows says more.
            best = max(sure, key=lambda each: (each.state is not None, each.evidence))
            sizes = {"quiet": best.quiet, "loud": best.loud}
            effect = NoiseState(output, sizes, partner=best.state)
            severity = {output: Severity(best.largest, best.loud)}
            found.append(Cause(effect, best.evidence - price, {}, {}, 0.0, severity=severity))
    return sorted(found, key=lambda cause: -cause.evidence)


def _logs(hypothesis: Hypothesis, output: str) -> list[Record]:
    return [log for log in hypothesis.logs if output in log.columns]


def _states(hypothesis: Hypothesis) -> list[str]:
    """Drives and logged states that come and go; no readings of the machine's temperature."""
    outputs = {o.channel for o in hypothesis.model.outputs}
    names = dict.fromkeys(name for log in hypothesis.logs for name in log.columns)
    return [
        name
        for name in names
        if name not in outputs and not is_temperature(name) and not is_displacement(name)
    ]


def _compared(
    hypothesis: Hypothesis,
    residuals: Series,
    switched: Sequence[NDArray[np.bool_]],
    state: str,
) -> _Noise | None:
    """The noise of a residual while a state is off and on; None where either is too rare."""
    logs = hypothesis.logs
    there = [np.abs(log.columns[state]) for log in logs if state in log.columns]
    values = np.concatenate(there)
    values = values[np.isfinite(values)]
    if not len(values) or not np.ptp(values):
        return None
    low, span = float(np.min(values)), float(np.ptp(values))
    apart: dict[bool, list[Float]] = {False: [], True: []}
    for log, residual, jumps in zip(logs, residuals, switched, strict=True):
        if state not in log.columns:
            continue
        share = (np.abs(log.columns[state]) - low) / span
        pairs, off = _differences(log, residual, jumps | ~np.isfinite(share))
        for on in (False, True):
            in_state = share > ON if on else share < OFF
            apart[on].append(off[in_state[pairs] & in_state[pairs + 1]])
    quiet, loud = (np.concatenate(apart[on]) for on in (False, True))
    if min(len(quiet), len(loud)) < MIN_PAIRS:
        return None
    both = np.concatenate([quiet, loud])
    one, other = (_mean_log(each, both) for each in (quiet, loud))
    if other <= one + np.log(MIN_RATIO):
        return None
    variance = VARIANCE_LOG * (1 / len(quiet) + 1 / len(loud))
    evidence = (other - one) ** 2 / variance - float(np.log(len(both)))
    return _Noise(state, float(np.exp(one)), float(np.exp(other)), float(np.max(loud)), evidence)


def _since_calibration(
    hypothesis: Hypothesis,
    output: str,
    residuals: Series,
    switched: Sequence[NDArray[np.bool_]],
) -> _Noise | None:
    """The noise of the loudest log beside that of the readings of the calibration.

    None where it is not known, or much the same.
    """
    model, found = hypothesis.model, []
    quiet = next(o.fit for o in model.outputs if o.channel == output).get("noise", 0.0)
    for log, residual, jumps in zip(hypothesis.logs, residuals, switched, strict=True):
        loud = _differences(log, residual, jumps)[1]
        if not quiet or len(loud) < MIN_PAIRS:
            continue
        mean = _mean_log(loud, loud)
        # A misfit that is steep, and what a filter leaves of noise from reading to reading, are in
        # the residual alone.
        scatter = row_noise(log, output) * float(np.sqrt(log.row_readings))
        if scatter > 0:
            mean = min(mean, float(np.log(scatter)))
        # Readings on another clock may be means of fewer, or have more of slow noise between them.
        clock = model.sample_period * log.row_readings / log.period
        over = mean - float(np.log(quiet))
        if over > np.log(MIN_SINCE * np.sqrt(max(clock, 1 / clock))):
            price = float(np.log(len(loud))) + 2 * float(np.log(len(hypothesis.logs)))
            evidence = over**2 / (VARIANCE_LOG / len(loud)) - price
            found.append(_Noise(None, quiet, float(np.exp(mean)), float(np.max(loud)), evidence))
    return max(found, key=lambda each: each.loud, default=None)


def _differences(log: Record, residual: Float, left_out: NDArray[np.bool_]) -> tuple[Index, Float]:
    """Pairs of neighbours that share no reading, and by how much they differ, as noise of one.

    The first row of each, and the size.
    """
    still = np.isfinite(residual) & ~left_out
    pairs = np.arange(0, len(residual) - 1, 2)
    pairs = pairs[still[pairs] & still[pairs + 1]]
    return pairs, np.abs(residual[pairs + 1] - residual[pairs]) / np.sqrt(2 / log.row_readings)


def _mean_log(sizes: Float, usual: Float) -> float:
    """Logarithm of a standard deviation by the mean one of `sizes`.

    Readings that happen to agree say as little as those that stand out.
    """
    least = max(LEAST_SHARE * float(np.median(usual)), TINY)
    return float(np.mean(np.log(np.maximum(sizes, least)))) - MEAN_LOG
