"""Noise that depends on an operating state: no misfit of a model, and a fault all the same."""

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
from thermaltool.record import Record
from thermaltool.units import is_displacement, is_temperature

# A state is off below, and on above, these shares of its range; rows between say nothing.
OFF, ON = 0.1, 0.4
# Pairs of readings that are compared in each state, and by how much the noise has to differ.
MIN_PAIRS, MIN_RATIO = 30, 1.5
# No difference counts as smaller than this share of the usual one.
LEAST_SHARE = 0.05
# Mean and variance of the logarithm of |z|, z a standard normal variable.
MEAN_LOG, VARIANCE_LOG = -0.6352, 1.2337


@dataclass(frozen=True)
class _Noise:
    """Noise of a reading in two states, its largest deviation, and evidence that they differ."""

    quiet: float
    loud: float
    largest: float
    evidence: float


def noisy_states(hypothesis: Hypothesis) -> list[Cause]:
    """Outputs that are noisier while a drive or another logged state acts, the surest first.

    Differences of neighbouring readings are compared by their mean logarithm, so that single wrong
    readings count little.

    Parameters
    ----------
    hypothesis : Hypothesis
        With the named causes.
    """
    states = _states(hypothesis)
    tests = max(len(states) * len(hypothesis.groups), 1)
    switched = [after_a_switch(hypothesis.model, log) for log in hypothesis.logs]
    found = []
    for output in hypothesis.groups:
        residual = hypothesis.unexplained(output)
        tried = [(state, _compared(hypothesis, residual, switched, state)) for state in states]
        known = [(state, each) for state, each in tried if each is not None]
        if not known:
            continue
        state, best = max(known, key=lambda one: one[1].evidence)
        evidence = best.evidence - 2 * float(np.log(tests))
        # Readings on a coarse lattice scatter where they move, and not at all where they rest; what
        # is left of a frozen sensor is rounding.
        logs = _logs(hypothesis, output)
        steps = [reading_step(log, output) for log in logs]
        rounding = [np.spacing(np.nanmax(np.abs(log.columns[output]))) for log in logs]
        if evidence < DECISIVE_EVIDENCE or best.loud < max(*steps, *rounding):
            continue
        if best.loud > MIN_RATIO * best.quiet:
            effect = NoiseState(output, {"quiet": best.quiet, "loud": best.loud}, partner=state)
            severity = {output: Severity(best.largest, best.loud)}
            found.append(Cause(effect, evidence, {}, {}, 0.0, severity=severity))
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
        still = np.isfinite(residual) & np.isfinite(share)
        still &= ~jumps
        # Pairs that share no reading are independent.
        pairs = np.arange(0, len(residual) - 1, 2)
        pairs = pairs[still[pairs] & still[pairs + 1]]
        off = np.abs(residual[pairs + 1] - residual[pairs]) / np.sqrt(2 / log.row_readings)
        for on in (False, True):
            in_state = share > ON if on else share < OFF
            apart[on].append(off[in_state[pairs] & in_state[pairs + 1]])
    quiet, loud = (np.concatenate(apart[on]) for on in (False, True))
    if min(len(quiet), len(loud)) < MIN_PAIRS:
        return None
    # Readings that happen to agree say as little as those that stand out.
    least = max(LEAST_SHARE * float(np.median(np.concatenate([quiet, loud]))), np.finfo(float).tiny)
    means = [float(np.mean(np.log(np.maximum(each, least)))) for each in (quiet, loud)]
    variance = VARIANCE_LOG * (1 / len(quiet) + 1 / len(loud))
    evidence = (means[1] - means[0]) ** 2 / variance - float(np.log(len(quiet) + len(loud)))
    one, other = (float(np.exp(mean - MEAN_LOG)) for mean in means)
    return _Noise(one, other, float(np.max(loud)), evidence)
