"""Causes without a signature: outliers, and a calibration that was too short."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import ndtri

from thermaltool.diagnosis.evidence import DECISIVE_EVIDENCE
from thermaltool.diagnosis.gain import Gain, compare
from thermaltool.diagnosis.held_out import held_out_gains
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.readings import hidden_noise
from thermaltool.diagnosis.residual_budget import reading_noise
from thermaltool.diagnosis.result import Cause
from thermaltool.diagnosis.simulation import Mask, Series, SimulatedLogs
from thermaltool.effects import effect_class
from thermaltool.effects.effect import Effect, Float
from thermaltool.fitting.discrepancy import calibration_error
from thermaltool.model import Model
from thermaltool.record import Record
from thermaltool.signals.robust import robust_std

# Neighbours on either side with which a reading is compared, rows that are compared at least, and
# the chance to call one of a clean log an outlier.
NEIGHBOURS, MIN_ROWS, FALSE_ALARMS = 3, 50, 0.01
# Readings come in bursts where a pause is so many times the usual step, and a burst has so many
# readings on average.
MIN_PAUSE, MIN_BURST = 3.0, 2.0
# A reading stands alone from so many times the range of its neighbours.
MIN_RANGES_ALONE = 10.0
# Logarithm of any size or share in the mixture, at most.
MAX_LOG = 50.0
# Fewer outliers than this are all left out of more than one in forty draws of a block bootstrap.
MIN_OUTLIERS_DRAWN = 4
# A drive that changes by this share of its range between two rows is switched.
MIN_SWITCH = 0.05
# A calibration that covers fewer of the slowest time constants has not seen the steady state.
MIN_COVERED = 2.0
# ... and of fewer than this one it is not sure: after three, 5 % of a step are still to come.
MIN_SETTLED = 3.0
# ... and one that is not sure says nothing of a log that is so many times longer.
MAX_BEYOND = 2.0
# ... and setting its parameters free has to bring the RMS of unseen rows below this share; where a
# calibration that covers so much may be long enough, in logs that go no further, to this multiple
# of what is left of that, too.
MAX_RMS_LEFT, MAX_RMS_WITHIN, MAYBE_COVERED = 0.8, 1.5, 1.0


@dataclass(frozen=True)
class OutlierMask:
    """Outliers of all logs, and the cause that they are."""

    masked: Mask
    cause: Cause

    @property
    def matter(self) -> bool:
        """Whether leaving them out is of practical use."""
        return any(g.useful for g in self.cause.gain.values())


def find_outliers(hypothesis: Hypothesis) -> OutlierMask | None:
    """Readings that stand out of their neighbours, where heavy tails are decisive.

    Evidence is that of a Gaussian with a wider one mixed in against a Gaussian alone, for the
    deviations from the running median of the residual.

    Parameters
    ----------
    hypothesis : Hypothesis
    """
    noise = {o: reading_noise(hypothesis, o) for o in hypothesis.groups}
    return outliers_of(hypothesis.simulation, noise, hypothesis.unexplained)


def outliers_of(
    simulation: SimulatedLogs,
    noise: Mapping[str, float],
    left: Callable[[str], Series] | None = None,
) -> OutlierMask | None:
    """Readings that stand out of their neighbours beside a model; see `find_outliers`.

    Parameters
    ----------
    simulation : SimulatedLogs
    noise : mapping of output to float [unit of the output]
        Of a reading.
    left : callable, optional
        What is left of an output in each log; by default what the model leaves.
    """
    left = left or simulation.residual
    masked, evidence, worst, share, amplitude = {}, 0.0, "", 0.0, 0.0
    total, model, outputs = 0.0, simulation.model, len(simulation.groups)
    for output in simulation.groups:
        white = noise[output]
        for log, residual in zip(simulation.logs, left(output), strict=True):
            rows = np.flatnonzero(np.isfinite(residual))
            if len(rows) < MIN_ROWS:
                continue
            deviation = _from_neighbours(residual[rows])
            spread = max(robust_std(deviation), white)
            limit = -float(ndtri(FALSE_ALARMS / 2 / len(rows)))
            out = np.abs(_from_both_sides(residual[rows])) > limit * spread
            out |= _bursts_off(log.time[rows], residual[rows], white)
            out &= ~after_a_switch(model, log)[rows] | _alone(residual[rows])
            if not out.any():
                continue
            # A step or a ramp stands out of its neighbours too, on one side: it is left alone.
            moved = ~out & (np.abs(deviation) > limit * spread)
            found = _heavy_tails(deviation[~moved] / spread) - 2 * np.log(outputs)
            if found < DECISIVE_EVIDENCE:
                continue
            mask = np.zeros(len(residual), bool)
            mask[rows[out]] = True
            masked[log.digest, output] = mask
            total += found
            if found > evidence:
                evidence, worst = found, output
                share = float(np.mean(out))
                amplitude = float(np.median(np.abs(deviation[out])))
    if not masked:
        return None
    effect = effect_class("outliers")(worst, {"share": share, "amplitude": amplitude})
    gains = _masked_gains(simulation, left, masked)
    # Whether a bootstrap draws a few bad readings at all is a matter of chance.
    few = sum(int(mask.sum()) for mask in masked.values()) < MIN_OUTLIERS_DRAWN
    if not any(g.claimed or (few and g.useful) for g in gains.values()):
        return None
    return OutlierMask(masked, Cause(effect, total, {}, gains, 0.0))


def _masked_gains(
    simulation: SimulatedLogs, left: Callable[[str], Series], masked: Mask
) -> dict[str, Gain]:
    """Residual, beyond what the calibration allows for, of all rows and of those that stay."""
    result = {}
    for output in dict.fromkeys(o for _, o in masked):
        groups, residuals = simulation.groups[output], left(output)
        kept = [
            np.where(masked.get((log.digest, output), np.zeros(len(log), bool)), 0.0, residual)
            for log, residual in zip(simulation.logs, residuals, strict=True)
        ]
        before, after = groups.joined(residuals), groups.joined(kept)
        hidden = hidden_noise(simulation, output)
        result[output] = compare(simulation.measured_rows(output), before, after, 0, hidden)
    return result


def after_a_switch(model: Model, log: Record) -> NDArray[np.bool_]:
    """Rows just after a drive jumped: what stands out there is the response's start.

    Parameters
    ----------
    model : Model
    log : Record

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    near = np.zeros(len(log.time), bool)
    for drive in model.drives:
        u = log.columns[drive.channel]
        jumps = np.flatnonzero(np.abs(np.diff(u)) > MIN_SWITCH * float(np.ptp(u)))
        for after in range(2 * NEIGHBOURS + 1):
            near[np.minimum(jumps + after, len(near) - 1)] = True
    return near


def _from_neighbours(values: Float) -> Float:
    """Deviation of every value from the median of its neighbours, itself left out."""
    return values - np.median(_neighbours(values), axis=1)


def _neighbours(values: Float) -> Float:
    """The values on either side of every one, shape (n, 6)."""
    padded = np.pad(values, NEIGHBOURS, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1)
    return np.delete(windows, NEIGHBOURS, axis=1)


def _from_both_sides(values: Float) -> Float:
    """Deviation from the medians before and after, the smaller one; 0 where they disagree."""
    padded = np.pad(values, NEIGHBOURS, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1)
    before = values - np.median(windows[:, :NEIGHBOURS], axis=1)
    after = values - np.median(windows[:, NEIGHBOURS + 1 :], axis=1)
    smaller = np.minimum(np.abs(before), np.abs(after))
    return np.where(np.sign(before) == np.sign(after), np.sign(before) * smaller, 0.0)


def _alone(values: Float) -> NDArray[np.bool_]:
    """Readings that are far from neighbours which agree, be it just after a switch."""
    others = _neighbours(values)
    far = np.abs(values - np.median(others, axis=1))
    return np.asarray(far > MIN_RANGES_ALONE * np.ptp(others, axis=1))


def _bursts_off(time: Float, values: Float, white: float) -> NDArray[np.bool_]:
    """Readings of bursts that stand out of the bursts beside them; none without bursts."""
    steps = np.diff(time)
    burst = np.append(0, np.cumsum(steps > MIN_PAUSE * np.median(steps)))
    count = int(burst[-1]) + 1
    if count < MIN_ROWS or len(time) < MIN_BURST * count:
        return np.zeros(len(time), bool)
    medians = np.array(
        [np.median(part) for part in np.split(values, np.flatnonzero(np.diff(burst)) + 1)]
    )
    deviation = _from_both_sides(medians)
    spread = max(robust_std(deviation), white)
    limit = -float(ndtri(FALSE_ALARMS / 2 / count))
    return np.asarray((np.abs(deviation) > limit * spread)[burst])


def _heavy_tails(z: Float) -> float:
    """Fall of BIC from a Gaussian to one with a wider one mixed in."""

    def negative(point: Float) -> float:
        point = np.clip(point, -MAX_LOG, MAX_LOG)
        share = 0.3 / (1 + np.exp(-point[0]))
        narrow = np.exp(point[2])
        wide = narrow * (1 + np.exp(point[1]))
        usual = np.log((1 - share) / narrow) - 0.5 * (z / narrow) ** 2
        rare = np.log(share / wide) - 0.5 * (z / wide) ** 2
        return -float(np.sum(np.logaddexp(usual, rare)))

    plain = 0.5 * len(z) * (1 + np.log(np.mean(z**2)))
    # From tails that are hardly wider, and from such as hold the largest.
    starts = (1.0, float(np.log(max(np.max(np.abs(z)), np.e))))
    best = min(
        (
            minimize(negative, [-3.0, wide, 0.0], method="Nelder-Mead", options={"maxfev": 200})
            for wide in starts
        ),
        key=lambda found: found.fun,
    )
    return float(2 * (plain - best.fun) - 2 * np.log(len(z)))


def unsettled(model: Model) -> dict[str, float]:
    """Length of the calibration [s] of every output whose steady state it has not seen for sure.

    Parameters
    ----------
    model : Model
    """
    found = {}
    for o in model.outputs:
        covered = o.fit.get("covered")
        if covered is not None and covered < MIN_SETTLED:
            slowest = max(t.response.slowest() for t in model.terms if t.output == o.channel)
            found[o.channel] = float(covered * slowest)
    return found


def beyond_calibration(model: Model, logs: Sequence[Record]) -> dict[str, float]:
    """Those of `unsettled` of which logs are so much longer that the calibration says nothing.

    Parameters
    ----------
    model : Model
    logs : sequence of Record
    """
    longest = max(log.duration for log in logs)
    return {o: length for o, length in unsettled(model).items() if longest > MAX_BEYOND * length}


def is_trend(effect: Effect, model: Model, logs: Sequence[Record]) -> bool:
    """Whether a cause could be the model's own slow part, which the calibration has not seen.

    In logs `beyond_calibration`: a drift, or what no channel tells of and is slower than the
    calibration was long.

    Parameters
    ----------
    effect : Effect
    model : Model
    logs : sequence of Record
    """
    lengths = beyond_calibration(model, logs)
    drifts = effect.name == "sensor_drift" and effect.channel in lengths
    return drifts or (not effect.channel and effect.course > min(lengths.values(), default=np.inf))


def uncovered(model: Model) -> dict[str, float]:
    """Slowest time constants covered of every output whose steady state no one can know.

    Parameters
    ----------
    model : Model
    """
    every = {o.channel: o.fit.get("covered") for o in model.outputs}
    return {o: float(each) for o, each in every.items() if each is not None and each < MIN_COVERED}


def too_short(calibrated: Model, before: Hypothesis, after: Hypothesis) -> Cause | None:
    """The cause, where the calibration had not seen the steady state of an output that moved.

    Parameters
    ----------
    calibrated : Model
    before, after : Hypothesis
        Within the calibration, and with the model's own parameters free.
    """
    short = uncovered(calibrated)
    if not short:
        return None
    # As the model stands: what so short a calibration leaves open would do as well.
    gain = held_out_gains(replace(before, assumptions=before.assumptions - {"tight"}), after)
    # Something slow besides bends a model that is free, too, but does not come to be part of it.
    further = {o for o, covered in short.items() if covered < MAYBE_COVERED}
    further |= beyond_calibration(calibrated, before.logs).keys()
    left = {o: _left_by_calibration(calibrated, before, o) for o in gain}
    helped = [
        o
        for o, g in gain.items()
        if o in short
        and g.claimed
        and g.rms_after < MAX_RMS_LEFT * g.rms_before
        and (o in further or g.rms_after < MAX_RMS_WITHIN * left[o])
        # The state in which a warm machine was found explains as much: no model has to change.
        and g.rms_after < _left_by_start(before, o)
    ]
    worse = [o for o, g in gain.items() if g.spoiled]
    if not helped or worse:
        return None
    output = max(helped, key=lambda o: gain[o].rms_before / gain[o].rms_after)
    effect = effect_class("record_too_short")(output, {"covered": short[output]})
    return Cause(effect, _evidence(before, after), {}, gain, 0.0)


def _evidence(before: Hypothesis, after: Hypothesis) -> float:
    """Fall of BIC from one hypothesis to another, whose own parameters count beside their prior."""
    null = {o: each.null(before.assumptions) for o, each in before.evidence.items()}
    freed = {o: each.null(after.assumptions) for o, each in after.evidence.items()}
    rise = {o: null[o].best - freed[o].best for o in null}
    return 2 * sum(before.evidence[o].independence * each for o, each in rise.items())


def _left_by_calibration(calibrated: Model, hypothesis: Hypothesis, output: str) -> float:
    """RMS that the calibration left of an output, no less than the noise of its readings."""
    fit = next(o.fit for o in calibrated.outputs if o.channel == output)
    return max(calibration_error(fit), hypothesis.nuisance[output].white)


def _left_by_start(hypothesis: Hypothesis, output: str) -> float:
    """RMS of an output's residual as `simulate` counts, with its start; infinite from rest."""
    simulation = hypothesis.simulation
    if not simulation.warm_logs:
        return np.inf
    left = np.concatenate([y - computed for y, computed in simulation.as_simulated(output)])
    return float(np.sqrt(np.nanmean(left**2)))
