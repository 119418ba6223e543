"""Whether what acts is a curve of a drive: a power law or a parabola, the same for every output.

Heat goes with the square of a voltage, friction with a power of the speed, a motor's loss with
more than its load. A linear model leaves of that an error of structure that every later log shows
again. As with kinds of response, evidence and rows held out decide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from thermaltool.effects.drive_nonlinearity import DriveNonlinearity
from thermaltool.effects.effect import Effect
from thermaltool.fitting.hold_choice import ChosenKinds
from thermaltool.fitting.projection import GridStates
from thermaltool.fitting.response_choice import DECISIVE
from thermaltool.fitting.response_search import FittedKinds, KindSearch
from thermaltool.model import Drive, relative
from thermaltool.record import Record
from thermaltool.responses.modes import Float
from thermaltool.units import parse_channel

# Every form: its parameter, where it is neutral, its ends; an exponent counts by its logarithm.
FORMS = {"exponent": (1.0, 0.2, 5.0), "curvature": (0.0, -0.45, 5.0)}
# A small step to both sides, from which the gain within so many of them is foretold; no squared
# error is foretold to fall below this share.
TRIAL_STEP, TRIAL_STEPS, LEAST_SHARE = 0.02, 10.0, 1e-3
# Steps to both sides from which the standard error is taken.
ERROR_STEP = 0.01
# Levels beside rest and the largest that count as one [of the largest].
SAME_LEVEL = 0.02
# Of the squared error beyond the noise a law leaves at most this share: what merely bends towards
# another error of structure leaves half, and predicts other logs no better.
MAX_LEFT = 0.25
# Where a search ends, in the parameter or its logarithm; trials at most.
TOLERANCE, MAX_TRIALS = 1e-4, 25


def bent(
    records: Sequence[Record], drives: Sequence[Drive], effects: Sequence[Effect]
) -> list[Record]:
    """Records with what acts in place of the drives.

    Parameters
    ----------
    records : sequence of Record
    drives : sequence of Drive
    effects : sequence of Effect
        Of the drives, one each at most.
    """
    result = []
    for record in records:
        changed = {}
        for effect in effects:
            drive = next(d for d in drives if d.channel == effect.channel)
            values = record.column(drive.channel)
            u = relative(values, drive.reference, drive.hold)
            changed[drive.channel] = values - u + effect.drive(record, u)
        result.append(record.with_columns(changed))
    return result


def nonlinear_drives(
    records: Sequence[Record],
    drives: Sequence[Drive],
    chosen: Sequence[ChosenKinds],
    fixed: Mapping[str, float],
    free_start: bool,
) -> tuple[Effect, ...]:
    """Curves of drives that describe the records decisively better than the drives as logged.

    Measured temperatures are taken as they are: they are no commands.

    Parameters
    ----------
    records : sequence of Record
    drives : sequence of Drive
    chosen : sequence of ChosenKinds
        Of every output.
    fixed : mapping of parameter name to value
    free_start : bool
        See `fit_output`.

    Returns
    -------
    tuple of DriveNonlinearity
        One for a drive at most.
    """
    found: list[Effect] = []
    for d, drive in enumerate(drives):
        own = [each for each in chosen if d in each.drives]
        level = _level(records, drive)
        if own and level:
            search = _CurveSearch(records, drives, drive, level, own, fixed, free_start, found)
            best = search.best()
            found += [best] if best is not None else []
    return tuple(found)


def _level(records: Sequence[Record], drive: Drive) -> float:
    """Largest level of a drive of which a curve could be seen; 0 where there is none."""
    if parse_channel(drive.channel).dimension.startswith("temperature"):
        return 0.0
    u = [relative(r.column(drive.channel), drive.reference, drive.hold) for r in records]
    size = np.abs(np.concatenate(u))
    level = float(np.max(size))
    between = (size > SAME_LEVEL * level) & (size < (1 - SAME_LEVEL) * level)
    return level if between.any() else 0.0


@dataclass(frozen=True)
class _FittedCurve:
    """A curve, the outputs fitted behind it, and its evidence over the drive as logged."""

    effect: Effect
    fits: list[FittedKinds]
    evidence: float

    def fall(self, before: Sequence[Float], after: Sequence[Float]) -> float:
        """Fall of the criterion of all outputs, each with the rows that are independent here."""
        floor = np.finfo(float).tiny
        return sum(
            fit.independent * float(np.log(max(np.sum(a**2), floor) / max(np.sum(b**2), floor)))
            for a, b, fit in zip(before, after, self.fits, strict=True)
        )


@dataclass
class _CurveSearch:
    """Curves of one drive, fitted to every output that it drives."""

    records: Sequence[Record]
    drives: Sequence[Drive]
    drive: Drive
    level: float
    chosen: Sequence[ChosenKinds]
    fixed: Mapping[str, float]
    free_start: bool
    others: Sequence[Effect]

    def __post_init__(self) -> None:
        records, states = bent(self.records, self.drives, self.others), GridStates()
        self.tasks = [
            KindSearch(
                records, [self.drives[d] for d in each.drives], each.output, self.free_start,
                self.fixed, states,
            )
            for each in self.chosen
        ]  # fmt: skip

    def best(self) -> Effect | None:
        """The curve that decides; None where none does."""
        plain = self._fits((), [None] * len(self.chosen))
        if plain is None:
            return None
        found = [self._searched(form, plain) for form in FORMS]
        best = max(
            (each for each in found if each is not None), key=lambda e: e.evidence, default=None
        )
        if best is None or best.evidence < DECISIVE:
            return None
        left = _beyond_noise(best.fits) / _beyond_noise(plain)
        unseen = best.fall([a.held_out for a in plain], [b.held_out for b in best.fits])
        return best.effect if left < MAX_LEFT and unseen > 0 else None

    def _searched(self, form: str, plain: list[FittedKinds]) -> _FittedCurve | None:
        """The best curve of one form; None where small steps promise nothing decisive."""
        neutral, low, high = FORMS[form]
        log = neutral > 0
        ends = (float(np.log(low)), float(np.log(high))) if log else (low, high)
        tried: dict[float, _FittedCurve] = {}

        def at(x: float) -> _FittedCurve:
            value = float(np.exp(x)) if log else x
            effect = DriveNonlinearity(self.drive.channel, {form: value, "level": self.level})
            near = max(tried.values(), key=lambda e: e.evidence).fits if tried else plain
            tried[x] = self._fitted(effect, plain, near)
            return tried[x]

        direction = _foretold(plain, at(-TRIAL_STEP).fits, at(TRIAL_STEP).fits)
        if not direction:
            return None
        minimize_scalar(
            lambda x: -at(float(x)).evidence,
            bounds=(0.0, ends[1]) if direction > 0 else (ends[0], 0.0),
            method="bounded",
            options={"xatol": TOLERANCE, "maxiter": MAX_TRIALS},
        )
        x = max(tried, key=lambda each: tried[each].evidence)
        best = tried[x]
        if min(x - ends[0], ends[1] - x) < ERROR_STEP:
            # At the end of what is tried the records want another law than this one.
            return None
        sides = [at(x + step) for step in (-ERROR_STEP, ERROR_STEP)]
        there = [each.residual for each in best.fits]
        bend = sum(best.fall([f.residual for f in side.fits], there) for side in sides)
        error = ERROR_STEP * float(np.sqrt(2 / bend)) if bend > 0 else float(abs(x))
        error *= best.effect.parameters[form] if log else 1.0
        return replace(best, effect=replace(best.effect, covariance=np.diag([error**2, 0.0])))

    def _fitted(
        self, effect: Effect, plain: list[FittedKinds], near: list[FittedKinds]
    ) -> _FittedCurve:
        fits = self._fits((effect,), [each.theta for each in near])
        if fits is None:
            return _FittedCurve(effect, plain, -np.inf)
        curve = _FittedCurve(effect, fits, 0.0)
        fall = curve.fall([a.residual for a in plain], [b.residual for b in fits])
        rows = sum(fit.independent for fit in fits)
        return replace(curve, evidence=fall - float(np.log(rows)))

    def _fits(
        self, effects: tuple[Effect, ...], thetas: Sequence[Float | None]
    ) -> list[FittedKinds] | None:
        """Every output fitted behind these curves; None where one cannot be."""
        records = bent(self.records, self.drives, (*self.others, *effects))
        states: GridStates = {}
        fits = [
            task.driven_by(task.drives, states, records).fit(each.kinds, each.delays, theta)
            for each, task, theta in zip(self.chosen, self.tasks, thetas, strict=True)
        ]
        kept = [fit for fit in fits if fit is not None]
        return kept if len(kept) == len(fits) else None


def _beyond_noise(fits: Sequence[FittedKinds]) -> float:
    """Squared errors beyond the noise, in its variances, summed over the outputs."""
    tiny = np.finfo(float).tiny
    return sum(
        max(fit.size / (len(fit.residual) * fit.data.noise**2 + tiny) - 1, tiny) for fit in fits
    )


def _foretold(
    plain: Sequence[FittedKinds], behind: Sequence[FittedKinds], ahead: Sequence[FittedKinds]
) -> float:
    """Side on which parabolas of the squared errors see a decisive gain; 0 for none."""
    here, before, after = (
        np.array([max(fit.size, np.finfo(float).tiny) for fit in fits])
        for fits in (plain, behind, ahead)
    )
    slope, bend = (after - before) / 2, (after + before) / 2 - here
    steps = np.linspace(-TRIAL_STEPS, TRIAL_STEPS, 201)[:, None]
    share = np.maximum((here + slope * steps + bend * steps**2) / here, LEAST_SHARE)
    gains = -np.log(share) @ np.array([fit.independent for fit in plain])
    best = int(np.argmax(gains))
    return float(steps[best, 0]) if gains[best] > DECISIVE else 0.0
