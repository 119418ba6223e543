"""Parameters of laws: searched one after another, all outputs fitted anew at every trial."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import minimize_scalar

from thermaltool.effects.effect import Effect
from thermaltool.fitting.hold_choice import ChosenKinds
from thermaltool.fitting.laws import Law, LawName, acting_records
from thermaltool.fitting.projection import GridStates
from thermaltool.fitting.response_search import FittedKinds, KindSearch
from thermaltool.fitting.sound_kinds import DECISIVE
from thermaltool.model import Drive
from thermaltool.record import Record
from thermaltool.responses.modes import Float

# A small step to both sides, from which the gain within so many of them is predicted; no squared
# error is predicted to fall below this share.
TRIAL_STEP, TRIAL_STEPS, LEAST_SHARE = 0.02, 10.0, 1e-3
# Around a value that is known: where it is searched once more.
NEAR = 0.1
# Steps to both sides from which the standard error is taken.
ERROR_STEP = 0.01
# A search goes on from another minimum of the rates that has more evidence by so much.
MIN_FALL = 1.0
# Where a search ends, in the parameter or its logarithm; trials at most. Several drives are
# searched in turn, at most so often, until none moves by more than this of its standard error.
TOLERANCE, MAX_TRIALS = 1e-4, 25
MAX_TURNS, SETTLED = 8, 0.3


@dataclass(frozen=True)
class _Trial:
    """A value of a parameter (or its logarithm), and every output fitted with it."""

    x: float
    fits: list[FittedKinds]

    def fall(self, before: Sequence[FittedKinds], rows: Float) -> float:
        """Fall of the criterion of all outputs, each of so many independent rows."""
        return float(rows @ np.log(_sizes(before) / _sizes(self.fits)))


@dataclass
class LawSearch:
    """Laws of several channels, all outputs fitted anew at every trial."""

    records: Sequence[Record]
    drives: Sequence[Drive]
    chosen: Sequence[ChosenKinds]
    tasks: Sequence[KindSearch]
    laws: Sequence[Law]
    _settled: dict[str, tuple[tuple[Effect, ...], GridStates]] = field(default_factory=dict)
    _bases: dict[str, list[FittedKinds] | None] = field(default_factory=dict)

    def in_turn(self, known: Sequence[Effect]) -> list[Effect]:
        """Each law beside what is known of the others, until none of them moves.

        Parameters
        ----------
        known : sequence of Effect
        """
        order, first = list(self.laws), None
        names = {law.name for law in order}
        found = {name: e for e in known if (name := (e.name, e.channel)) in names}
        if not found:
            alone = {law.name: best for law in order if (best := self._best(law, (), None))}
            if not alone or len(order) == 1:
                return [effect for _, effect in alone.values()]
            # The strongest first: what comes near to it is nothing beside it.
            order.sort(key=lambda law: -alone[law.name][0] if law.name in alone else 0.0)
            first = order[0].name
            found = {first: alone[first][1]}
        beside: dict[LawName, set[LawName]] = {}
        for turn in range(MAX_TURNS):
            before = dict(found)
            for law in order:
                if law.name == first and not turn:
                    continue
                others = {name: effect for name, effect in found.items() if name != law.name}
                # Near its last value where it was found beside the same others.
                near = found.get(law.name) if beside.get(law.name) == set(others) else None
                beside[law.name] = set(others)
                best = self._best(law, tuple(others.values()), near)
                found.pop(law.name, None)
                if best is not None:
                    found[law.name] = best[1]
            if _alike(before, found):
                break
            # What says nothing beside the first ones is not asked again.
            order = [law for law in order if law.name in found]
        return list(found.values())

    def _best(
        self, law: Law, others: tuple[Effect, ...], near: Effect | None
    ) -> tuple[float, Effect] | None:
        """A law that decides, and its evidence, beside others; None for none."""
        base = self._base(others)
        if base is None:
            return None
        best: tuple[float, Effect] | None = None
        for form in law.forms if near is None else [n for n in law.forms if n in near.parameters]:

            def at(x: float, close: Sequence[FittedKinds] | None, form: str = form) -> _Trial:
                fits = self._fits((*others, law.at(form, x)), close, base)
                return _Trial(float(x), base if fits is None else fits)

            start = None if near is None else law.place(form, near.parameters[form])
            found = _searched(at, base, law.places(form), start)
            if found is None:
                continue
            trial, error = found
            rows = _independent(trial.fits)
            evidence = trial.fall(base, rows) - float(np.log(np.sum(rows)))
            if evidence > DECISIVE and (best is None or evidence > best[0]):
                best = evidence, law.known(form, trial.x, error)
        return best

    def _base(self, others: tuple[Effect, ...]) -> list[FittedKinds] | None:
        """Every output fitted with these laws alone; each set of them once."""
        key = repr([(e.name, e.channel, dict(e.parameters)) for e in others])
        if key not in self._bases:
            self._bases[key] = self._fits(others)
        return self._bases[key]

    def _fits(
        self,
        effects: tuple[Effect, ...],
        near: Sequence[FittedKinds] | None = None,
        base: Sequence[FittedKinds] | None = None,
    ) -> list[FittedKinds] | None:
        """Every output fitted with these nonlinearities; None where one cannot be.

        Where the last of them bends a reading, the others are as in `base`.
        """
        # What acts on a drive, and the clock on which it acts.
        own = {
            d.channel: tuple(e for e in effects if e.side == "state" or e.channel == d.channel)
            for d in self.drives
        }
        states: GridStates = {}
        for channel, (acted, kept) in self._settled.items():
            if own[channel] == acted:
                states.update(kept)
        records, drives = acting_records(self.records, self.drives, effects, comparable=True)
        thetas = [None] * len(self.chosen) if near is None else [each.theta for each in near]
        alone = effects[-1].channel if base is not None and effects[-1].side == "sensor" else None
        fits = [
            each.fitted(
                task.driven_by([drives[d] for d in each.drives], states, records), thetas[k]
            )
            if base is None or alone is None or each.output == alone
            else base[k]
            for k, (each, task) in enumerate(zip(self.chosen, self.tasks, strict=True))
        ]
        for drive in self.drives:
            mine = {key: value for key, value in states.items() if key[1] == drive.channel}
            self._settled[drive.channel] = own[drive.channel], mine
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
    if start is not None and min(best.x - low, high - best.x) < ERROR_STEP:
        # Farther away than where it was looked for.
        return _searched(at, base, ends, None)
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


def _alike(before: Mapping[LawName, Effect], after: Mapping[LawName, Effect]) -> bool:
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
