"""Held-out judgement: the verdict on a cause, by what it is worth on data that no fit has seen.

Each log is cut into blocks of time; every block is predicted, free running, by a fit to all other
rows (`held_out`). Places that were found by scanning (the instant of a step) stay where they are.
The interval of the gain is that of a bootstrap over shorter blocks, so that slow errors count in
full.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from thermaltool.diagnosis.balance import MAX_SLIGHT, SLIGHT
from thermaltool.diagnosis.effect_intervals import intervals_of
from thermaltool.diagnosis.fit import CauseCandidate
from thermaltool.diagnosis.gain import MIN_LOSS, Gain
from thermaltool.diagnosis.held_out import held_out_gains
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.joint_fit import fitted_together
from thermaltool.diagnosis.residual_budget import MAX_TIMES_CALIBRATED
from thermaltool.diagnosis.result import Cause
from thermaltool.diagnosis.select import fit_candidate
from thermaltool.diagnosis.simulation import without
from thermaltool.diagnosis.written import cannot_run, explained, gains_of
from thermaltool.effects.effect import Effect
from thermaltool.errors import ModelError
from thermaltool.model import Model
from thermaltool.record import Record

# A cause has to explain this many times the slow discrepancy of a clean log, or, where that is
# large, this share of what is wrong now.
MIN_FLOORS, MAX_SHARE_OF_MISFIT = 1.0, 0.7
# Change of an output by a cause, over the range in which it was measured, at most.
MAX_OF_MEASURED = 2.0
# What follows any slow course of one log, or what parts of the logs do not confirm, has to explain
# this share of what is wrong; it is slow with fewer periods or time constants in the log.
MIN_SHARE_OF_DOUBTFUL, MAX_PERIODS_OF_COURSE = 0.5, 8.0
# Turns between the model's own parameters and those of a cause.
MAX_TURNS = 2


@dataclass(frozen=True)
class AcceptedCause:
    """A cause that was accepted, and what led there.

    Attributes
    ----------
    cause : Cause
    candidate : CauseCandidate
        As fitted together with the model's own parameters.
    rivals : sequence of CauseCandidate
        All that were fitted, the accepted one among them.
    before, after : Hypothesis
        Without the cause and with it.
    """

    cause: Cause
    candidate: CauseCandidate
    rivals: Sequence[CauseCandidate]
    before: Hypothesis
    after: Hypothesis


def judge(
    hypothesis: Hypothesis,
    candidate: CauseCandidate,
    rivals: Sequence[CauseCandidate],
    calibrated: Model,
    unseen: Sequence[Record] = (),
    calibrated_misfit: Mapping[str, float] = MappingProxyType({}),
    faint: bool = False,
) -> AcceptedCause | None:
    """Verdict on a candidate; None where it is worth nothing on unseen data.

    Its signature has given it its evidence (`fit.evaluate`). It is fitted together with the model's
    own parameters, where these are free; every block of the logs is predicted from the others,
    with it and without; and what it gains there has to be sure, of practical size, and larger than
    what the calibration got wrong. With `unseen` logs it has to be so there too.

    Parameters
    ----------
    hypothesis : Hypothesis
        Without it; it is judged under its own assumptions.
    candidate : CauseCandidate
    rivals : sequence of CauseCandidate
        All that were fitted, the candidate among them.
    calibrated : Model
        As the calibration left it.
    unseen : sequence of Record
        Logs to validate on.
    calibrated_misfit : mapping of output to float [unit of the output]
        What the model left of its calibration beside noise.
    faint : bool
        The logs show too little of it for their parts to confirm it: unseen logs do, or nothing.
    """
    before = hypothesis.under(candidate.assumptions, calibrated)
    try:
        after, candidate = _fitted_jointly(before, candidate)
        alone = before.fitted()
        gains = {} if faint else held_out_gains(alone, after)
        if not (faint or is_practical(before, gains, calibrated_misfit)):
            return None
        if len(after.model.effects) > len(calibrated.effects) + 1:
            # The causes before it stood for a part of it.
            after = fitted_together(after)
            candidate = replace(candidate, effect=after.model.effects[-1])
            gains = {} if faint else held_out_gains(alone, after)
        new = after.written(calibrated)
        unseen = [log for log in unseen if cannot_run(new.model, log) is None]
        if faint and not unseen:
            return None
        if unseen:
            # What fitting the model anew does for itself is no merit of the cause. Zeros are those
            # of every log: they hang on how it begins.
            old = alone.written(calibrated).with_logs(unseen)
            one, other = old.simulation, new.with_logs(unseen).simulation
            # A wrong model may hide that a log begins warm.
            warm = {*one.warm_logs, *other.warm_logs}
            there = gains_of(one, other, lambda output: True, warm)
            # What happened in one log does nothing for another, but may not do harm there.
            if candidate.effect.log is None:
                gains = there
                if not holds(before, gains):
                    return None
                if faint and not is_practical(before, gains, calibrated_misfit):
                    return None
            elif any(gain.spoiled for gain in there.values()):
                return None
        noise = {o: before.white(o) for o in before.groups}
        intervals = intervals_of(after, len(after.model.effects) - 1)
        if not _sure(candidate.effect, intervals) or _too_large(after, candidate.effect):
            return None
        share = explained(noise, gains)
        doubtful = faint or _any_slow_course(candidate.effect, after)
        if doubtful and share < MIN_SHARE_OF_DOUBTFUL:
            return None
    except ModelError:  # the effect runs away with the parameters that go with it
        return None
    cause = Cause(
        candidate.effect,
        candidate.evidence,
        intervals,
        gains,
        share,
        gains,
        tuple((c.effect, c.evidence) for c in rivals if candidate.has_other_form(c)),
    )
    return AcceptedCause(cause, candidate, rivals, before, after)


def _sure(effect: Effect, intervals: Mapping[str, tuple[float, float]]) -> bool:
    """Whether some amplitude is sure not to be what it is without the effect.

    What is not linear in an effect has an interval of small moves, which says little of the way
    back to none. One that stands without amplitudes is told by it all the same.
    """
    told = effect.searched() if effect.stands else effect.linear()
    given = {n: ends for n, ends in intervals.items() if n in told}
    neutral = {n: effect.parameter(n).neutral for n in given}
    return not given or any(not low <= neutral[n] <= high for n, (low, high) in given.items())


def _any_slow_course(effect: Effect, hypothesis: Hypothesis) -> bool:
    """Whether an effect of one log is slow enough there to follow whatever is slow."""
    duration = hypothesis.simulation.duration_of(effect)
    return effect.log is not None and effect.course > duration / MAX_PERIODS_OF_COURSE


def _too_large(hypothesis: Hypothesis, effect: Effect) -> bool:
    """Whether an effect moves an output by more than all that was measured of it.

    Two large changes that cancel are no cause, but what the logs do not tell apart.
    """
    # Nothing of it is fitted, so that nothing cancels: swapped sensors move by what they differ by,
    # a frozen one by all that it should have shown.
    if all(effect.parameter(name).fixed for name in effect.parameters):
        return False
    simulation = hypothesis.simulation
    bare = replace(simulation, model=without(simulation.model, effect))
    for output, change in bare.displacement(effect).items():
        groups = hypothesis.groups[output]
        moved = float(np.ptp(groups.joined(change)))
        if moved > MAX_OF_MEASURED * float(np.ptp(simulation.measured_rows(output))):
            return True
    return False


def _fitted_jointly(
    hypothesis: Hypothesis, candidate: CauseCandidate
) -> tuple[Hypothesis, CauseCandidate]:
    """The model's own parameters and a cause, in turns until they agree."""

    def with_cause(model: Model, effect: Effect) -> Hypothesis:
        effects = (*hypothesis.model.effects, effect)
        return hypothesis.with_model(replace(model, effects=effects)).fitted()

    after = with_cause(hypothesis.model, candidate.effect)
    for _ in range(MAX_TURNS if "released" in hypothesis.assumptions else 0):
        rest = replace(after.model, effects=hypothesis.model.effects)
        again = fit_candidate(hypothesis.with_model(rest), candidate)
        if not np.isfinite(again.gain):
            break
        candidate = replace(candidate, effect=again.effect)
        after = with_cause(rest, again.effect)
    return after, candidate


def is_practical(
    hypothesis: Hypothesis,
    gains: Mapping[str, Gain],
    calibrated_misfit: Mapping[str, float] = MappingProxyType({}),
) -> bool:
    """Whether gains are sure and large enough on some output, and no other output is spoiled.

    Parameters
    ----------
    hypothesis : Hypothesis
        Before the cause.
    gains : mapping of output to Gain
    calibrated_misfit : mapping of output to float [unit of the output]
        What the model left of its calibration beside noise.
    """
    if _harms(hypothesis, gains):
        return False
    for output, g in gains.items():
        if output not in hypothesis.groups:  # measured in unseen logs alone
            continue
        white = hypothesis.white(output)
        removed = max(g.rms_before**2 - g.rms_after**2, 0.0)
        misfit = max(g.rms_before**2 - white**2, 0.0)
        tight = "tight" in hypothesis.assumptions
        floor = hypothesis.nuisance[output].floor() if tight else white
        least = max(
            min(MIN_FLOORS * floor, MAX_SHARE_OF_MISFIT * np.sqrt(misfit)),
            MAX_TIMES_CALIBRATED * calibrated_misfit.get(output, 0.0),
        )
        if g.claimed and g.useful and removed >= least**2:
            return True
    return False


def _changes(hypothesis: Hypothesis, gains: Mapping[str, Gain]) -> dict[str, float]:
    """What each output of the hypothesis loses (> 0) or gains: mean squares over that of noise."""
    return {
        output: (g.rms_after**2 - g.rms_before**2) / hypothesis.white(output) ** 2
        for output, g in gains.items()
        if output in hypothesis.groups
    }


def _harms(hypothesis: Hypothesis, gains: Mapping[str, Gain]) -> bool:
    """Whether gains spoil an output: what helps one and spoils another is no cause.

    A slight loss says nothing against what explains much: the model is a little off there, too.
    """
    harmful = {output for output, g in gains.items() if g.harmful}
    if not harmful:
        return False
    if harmful - set(hypothesis.groups):  # measured in unseen logs alone
        return True
    changes = _changes(hypothesis, gains).values()
    gained, lost = (sum(max(sign * each, 0.0) for each in changes) for sign in (-1, 1))
    return lost >= min(SLIGHT * gained, MAX_SLIGHT)


def holds(hypothesis: Hypothesis, gains: Mapping[str, Gain]) -> bool:
    """Whether a cause that held-out rows confirm holds on unseen logs, which may show little of it.

    No output is spoiled, all together are no worse, and one is better, surely or by a practical
    share, or none changes by more than a part of its noise.

    Parameters
    ----------
    hypothesis : Hypothesis
        Before the cause.
    gains : mapping of output to Gain
        On the unseen logs.
    """
    change = _changes(hypothesis, gains)
    if _harms(hypothesis, gains) or sum(change.values()) > 0:
        return False
    unseen = all(abs(each) < MIN_LOSS for each in change.values())
    return unseen or any(gains[output].useful or gains[output].claimed for output in change)
