"""Whether what acts is a static nonlinearity of a drive: a power law or a parabola of it.

Heat goes with the square of a voltage, friction with a power of the speed, a motor's loss with
more than its load; the same for every output (Hammerstein). A linear model leaves of that an error
of structure that every later log shows again. As with kinds of response, evidence and rows held out
decide.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize_scalar

from thermaltool.effects.drive_nonlinearity import DriveNonlinearity
from thermaltool.effects.effect import Effect
from thermaltool.fitting.hold_choice import ChosenKinds
from thermaltool.fitting.projection import GridStates
from thermaltool.fitting.response_choice import DECISIVE, MIN_ROWS
from thermaltool.fitting.response_search import FittedKinds, KindSearch
from thermaltool.model import Drive, relative
from thermaltool.record import Record
from thermaltool.responses.modes import Float
from thermaltool.signals.resolution import reading_sigma
from thermaltool.units import parse_channel

# Parameters of `DriveNonlinearity` that are tried, one at a time.
FORMS = ("exponent", "curvature")
# A small step to both sides, from which the gain within so many of them is predicted; no squared
# error is predicted to fall below this share.
TRIAL_STEP, TRIAL_STEPS, LEAST_SHARE = 0.02, 10.0, 1e-3
# Around a value that is known: where it is searched once more.
NEAR = 0.1
# Steps to both sides from which the standard error is taken.
ERROR_STEP = 0.01
# Levels beside rest and the largest that count as one [of the largest].
SAME_LEVEL = 0.02
# Of the squared error beyond the noise, where that is larger than the noise, a nonlinearity leaves
# at most this share: what merely comes near to another error of structure leaves half, and predicts
# other logs no better. No output's error on held-out rows may be larger by this factor [squared].
MAX_LEFT, MAX_WORSE = 0.25, 1.05
# A search goes on from another minimum of the rates that has more evidence by so much.
MIN_FALL = 1.0
# Where a search ends, in the parameter or its logarithm; trials at most. Several drives are
# searched in turn, at most so often, until none moves by more than this of its standard error.
TOLERANCE, MAX_TRIALS = 1e-4, 25
MAX_TURNS, SETTLED = 8, 0.3


def acting_records(
    records: Sequence[Record], drives: Sequence[Drive], effects: Sequence[Effect]
) -> tuple[list[Record], list[Drive]]:
    """Records with what acts in place of nonlinear drives, and drives that count it from zero.

    Parameters
    ----------
    records : sequence of Record
    drives : sequence of Drive
    effects : sequence of Effect
        Of the drives, one each at most.

    Returns
    -------
    list of Record [unit of the drive, relative to its reference]
    list of Drive
    """
    own = {effect.channel: effect for effect in effects}
    result = []
    for record in records:
        changed = {}
        for drive in drives:
            if drive.channel in own:
                u = relative(record.column(drive.channel), drive.reference, drive.hold)
                changed[drive.channel] = own[drive.channel].drive(record, u)
        result.append(record.with_columns(changed))
    return result, [replace(d, reference=0.0) if d.channel in own else d for d in drives]


def nonlinear_drives(
    records: Sequence[Record],
    drives: Sequence[Drive],
    chosen: Sequence[ChosenKinds],
    known: Sequence[Effect],
    fixed: Mapping[str, float],
    free_start: bool,
) -> tuple[Effect, ...]:
    """Nonlinearities of drives with which the records are described decisively better.

    Measured temperatures are taken as they are: they are no commands.

    Parameters
    ----------
    records : sequence of Record
    drives : sequence of Drive
    chosen : sequence of ChosenKinds
        Of every output.
    known : sequence of Effect
        As they were found with other kinds.
    fixed : mapping of parameter name to value
    free_start : bool
        See `fit_output`.

    Returns
    -------
    tuple of DriveNonlinearity
        One for a drive at most, with their standard errors.
    """
    if sum(len(record) for record in records) < MIN_ROWS * len(drives):
        return ()
    levels = {d.channel: _level(records, d) for k, d in enumerate(drives) if _drives(chosen, k)}
    seen = {channel: level for channel, level in levels.items() if level}
    if not seen:
        return ()
    # Rows that a known nonlinearity explains are no outliers.
    acting, zeroed = acting_records(records, drives, known)
    states: GridStates = {}
    tasks = [
        KindSearch(acting, [zeroed[d] for d in each.drives], each.output, free_start, fixed, states)
        for each in chosen
    ]
    search = _NonlinearitySearch(records, drives, chosen, tasks)
    found = tuple(search.in_turn(seen, known).values())
    return found if found and search.explains(found) else ()


def _drives(chosen: Sequence[ChosenKinds], drive: int) -> bool:
    return any(drive in each.drives for each in chosen)


def _level(records: Sequence[Record], drive: Drive) -> float:
    """Largest level of a drive of which a nonlinearity could be seen; 0 where there is none."""
    if parse_channel(drive.channel).dimension.startswith("temperature"):
        return 0.0
    u = [relative(r.column(drive.channel), drive.reference, drive.hold) for r in records]
    size = np.abs(np.concatenate(u))
    level = float(np.max(size))
    between = (size > SAME_LEVEL * level) & (size < (1 - SAME_LEVEL) * level)
    return level if between.any() else 0.0


@dataclass(frozen=True)
class _Trial:
    """A value of a parameter (or its logarithm), and every output fitted with it."""

    x: float
    fits: list[FittedKinds]

    def fall(self, before: Sequence[FittedKinds], rows: Float) -> float:
        """Fall of the criterion of all outputs, each of so many independent rows."""
        return float(rows @ np.log(_sizes(before) / _sizes(self.fits)))


@dataclass
class _NonlinearitySearch:
    """Nonlinearities of drives, all outputs fitted anew at every trial."""

    records: Sequence[Record]
    drives: Sequence[Drive]
    chosen: Sequence[ChosenKinds]
    tasks: Sequence[KindSearch]
    _settled: dict[str, tuple[Effect | None, GridStates]] = field(default_factory=dict)

    def in_turn(self, levels: Mapping[str, float], known: Sequence[Effect]) -> dict[str, Effect]:
        """Each drive beside what is known of the others, until none of them moves.

        Parameters
        ----------
        levels : mapping of channel to float [unit of the drive]
            At which what acts and the drive agree.
        known : sequence of Effect
        """
        found = {effect.channel: effect for effect in known if effect.channel in levels}
        for turn in range(MAX_TURNS):
            before = dict(found)
            for channel, level in levels.items():
                others = tuple(effect for c, effect in found.items() if c != channel)
                near = found.get(channel) if turn else None
                best = self._best(channel, level, others, near)
                found.pop(channel, None)
                if best is not None:
                    found[channel] = best
            if len(levels) == 1 or _alike(before, found):
                break
        return found

    def explains(self, effects: tuple[Effect, ...]) -> bool:
        """Whether they leave little beyond the noise, and predict held-out rows no worse.

        Parameters
        ----------
        effects : tuple of Effect
        """
        plain, fits = self._fits(()), self._fits(effects)
        if plain is None or fits is None:
            return False
        noise = np.array(
            [
                max(reading_sigma(r.column(each.output)) for r in self.records) ** 2
                * len(fit.residual)
                for each, fit in zip(self.chosen, plain, strict=True)
            ]
        )
        large = _sizes(plain) > 2 * noise
        left = (_sizes(fits) - noise)[large] / (_sizes(plain) - noise)[large]
        unseen = np.array([np.sum(f.held_out**2) for f in fits])
        usual = np.array([np.sum(f.held_out**2) for f in plain])
        return bool(np.any(left < MAX_LEFT) and np.all(unseen <= MAX_WORSE * usual))

    def _best(
        self, channel: str, level: float, others: tuple[Effect, ...], near: Effect | None
    ) -> Effect | None:
        """The nonlinearity of one drive that decides, beside those of others; None for none."""
        base = self._fits(others)
        if base is None:
            return None
        best: tuple[float, Effect] | None = None
        for form in FORMS if near is None else [n for n in FORMS if n in near.parameters]:

            def effect(x: float, form: str = form) -> Effect:
                value = np.exp(x) if DriveNonlinearity.known[form].log else x
                return DriveNonlinearity(channel, {form: float(value), "level": level})

            def at(
                x: float,
                close: Sequence[FittedKinds] | None,
                of: Callable[[float], Effect] = effect,
            ) -> _Trial:
                fits = self._fits((*others, of(x)), close)
                return _Trial(float(x), base if fits is None else fits)

            known = DriveNonlinearity.known[form]
            ends = _place(form, known.low), _place(form, known.high)
            start = None if near is None else _place(form, near.parameters[form])
            found = _searched(at, base, ends, start)
            if found is None:
                continue
            trial, error = found
            rows = _independent(trial.fits)
            evidence = trial.fall(base, rows) - float(np.log(np.sum(rows)))
            if evidence > DECISIVE and (best is None or evidence > best[0]):
                chosen = effect(trial.x)
                error *= chosen.parameters[form] if known.log else 1.0
                covariance = np.diag([error**2, 0.0])
                best = evidence, replace(chosen, covariance=covariance)
        return None if best is None else best[1]

    def _fits(
        self, effects: tuple[Effect, ...], near: Sequence[FittedKinds] | None = None
    ) -> list[FittedKinds] | None:
        """Every output fitted with these nonlinearities; None where one cannot be."""
        own = {effect.channel: effect for effect in effects}
        states: GridStates = {}
        for channel, (effect, kept) in self._settled.items():
            if own.get(channel) == effect:
                states.update(kept)
        records, drives = acting_records(self.records, self.drives, effects)
        thetas = [None] * len(self.chosen) if near is None else [each.theta for each in near]
        fits = [
            task.driven_by([drives[d] for d in each.drives], states, records).fit(
                each.kinds, each.delays, theta
            )
            for each, task, theta in zip(self.chosen, self.tasks, thetas, strict=True)
        ]
        for drive in self.drives:
            mine = {key: value for key, value in states.items() if key[1] == drive.channel}
            self._settled[drive.channel] = own.get(drive.channel), mine
        kept_fits = [fit for fit in fits if fit is not None]
        return kept_fits if len(kept_fits) == len(fits) else None


def _searched(
    at: Callable[[float, Sequence[FittedKinds] | None], _Trial],
    base: Sequence[FittedKinds],
    ends: tuple[float, float],
    start: float | None,
) -> tuple[_Trial, float] | None:
    """The best trial of one form and its standard error; None where small steps promise none."""
    low, high = ends
    if start is None:
        behind, ahead = at(-TRIAL_STEP, base), at(TRIAL_STEP, base)
        side = _predicted_side(base, behind.fits, ahead.fits)
        if not side:
            return None
        low, high = (0.0, high) if side > 0 else (low, 0.0)
    else:
        low, high = max(low, start - NEAR), min(high, start + NEAR)
        ahead = at(start, None)
    rows = _independent(base)
    best = _least(at, base, ahead, (low, high), rows, 10 * TOLERANCE)
    # Trials follow one minimum of the rates; where another is better the search goes on in it.
    fresh = at(best.x, None)
    if fresh.fall(best.fits, rows) > MIN_FALL:
        best = _least(at, base, fresh, (low, high), rows, 10 * TOLERANCE)
    # Rows are as independent as the best trial leaves them.
    rows = _independent(best.fits)
    close = max(low, best.x - TRIAL_STEP), min(high, best.x + TRIAL_STEP)
    best = _least(at, base, best, close, rows, TOLERANCE)
    if min(best.x - ends[0], ends[1] - best.x) < ERROR_STEP:
        # At the end of what is tried the records want another law than this one.
        return None
    sides = [at(best.x + step, best.fits) for step in (-ERROR_STEP, ERROR_STEP)]
    bend = sum(best.fall(each.fits, rows) for each in sides)
    return best, ERROR_STEP * float(np.sqrt(2 / bend)) if bend > 0 else abs(best.x)


def _least(
    at: Callable[[float, Sequence[FittedKinds] | None], _Trial],
    base: Sequence[FittedKinds],
    first: _Trial,
    bounds: tuple[float, float],
    rows: Float,
    tolerance: float,
) -> _Trial:
    """The trial with the largest fall of the criterion within bounds."""
    best = first

    def loss(x: float) -> float:
        nonlocal best
        trial = at(float(x), best.fits)
        if trial.fall(base, rows) > best.fall(base, rows):
            best = trial
        return -trial.fall(base, rows)

    minimize_scalar(
        loss,
        bounds=bounds,
        method="bounded",
        options={"xatol": tolerance, "maxiter": MAX_TRIALS},
    )
    return best


def _predicted_side(
    base: Sequence[FittedKinds], behind: Sequence[FittedKinds], ahead: Sequence[FittedKinds]
) -> float:
    """Side on which parabolas of the squared errors predict a decisive gain; 0 for none."""
    here, before, after = _sizes(base), _sizes(behind), _sizes(ahead)
    rows = _independent(base)
    side = 1.0 if rows @ np.log(before / after) > 0 else -1.0
    slope, bend = (after - before) / 2, (after + before) / 2 - here
    steps = side * np.linspace(0.0, TRIAL_STEPS, 101)[:, None]
    share = np.maximum((here + slope * steps + bend * steps**2) / here, LEAST_SHARE)
    return side if np.max(-np.log(share) @ rows) > DECISIVE else 0.0


def _place(form: str, value: float) -> float:
    """Where a search has a value: at its logarithm where the parameter is searched by that."""
    return float(np.log(value)) if DriveNonlinearity.known[form].log else value


def _alike(before: Mapping[str, Effect], after: Mapping[str, Effect]) -> bool:
    """Whether no nonlinearity moved by what its standard error shows."""
    if before.keys() != after.keys():
        return False
    for channel, effect in after.items():
        name = next(iter(effect.parameters))
        was, now = before[channel].parameters.get(name), effect.parameters[name]
        error = 0.0 if effect.covariance is None else float(effect.covariance[0, 0]) ** 0.5
        if was is None or abs(now - was) > SETTLED * error:
            return False
    return True


def _sizes(fits: Sequence[FittedKinds]) -> Float:
    """Sum of squares of every output, shape (outputs,)."""
    return np.array([max(fit.size, np.finfo(float).tiny) for fit in fits])


def _independent(fits: Sequence[FittedKinds]) -> Float:
    """Rows of every output that count as independent, shape (outputs,)."""
    return np.array([fit.independent for fit in fits])
