"""Parameters of laws: the laws that decide taken up one after another, all of them moved together.

Every trial fits all outputs anew. A step is that of Gauss and Newton (Levenberg-Marquardt) on what
the outputs' own parameters leave: laws that stand in for each other, as radiation and natural
convection do, find their common optimum in a few of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from thermaltool.effects.effect import Effect
from thermaltool.fitting.acting_record import acting_records
from thermaltool.fitting.hold_choice import ChosenKinds
from thermaltool.fitting.laws import Law
from thermaltool.fitting.projection import MIN_DIRECTION, GridStates, linear_least_squares
from thermaltool.fitting.response_search import FittedKinds, KindSearch
from thermaltool.fitting.sound_kinds import DECISIVE
from thermaltool.model import Drive
from thermaltool.record import Record
from thermaltool.responses.modes import Float

# A small step to both sides, from which the gain within so many of them is predicted; no squared
# error is predicted to fall below this share.
TRIAL_STEP, TRIAL_STEPS, LEAST_SHARE, PLACES = 0.02, 10.0, 1e-3, 201
# Places, with both ends, from which a law that is known in one parameter is tried in another.
FORM_PLACES = 12
# A law takes at least this share of the squared error of some output: with less of it the error is
# at most 3 % larger, which is not worth one.
MIN_SHARE = 0.06
# From which slopes are taken, and within which of its end a law wants to be another one.
ERROR_STEP = 0.01
# A search goes on from another minimum of the rates that has more evidence by so much.
MIN_FALL = 1.0
# Steps of a search at most; it ends where one promises less evidence than this. Damping at first,
# how it changes, and where nothing is gained any more.
MAX_STEPS, LEAST_GAIN = 12, 0.05
DAMPING, SOFTER, STIFFER, STIFFEST = 1e-3, 0.2, 8.0, 1e3


class LawForm(NamedTuple):
    """A law in one of its parameters."""

    law: Law
    name: str


@dataclass(frozen=True)
class _Trial:
    """Values of the laws' parameters as they are searched, and every output fitted with them."""

    forms: tuple[LawForm, ...]
    x: Float
    fits: list[FittedKinds]

    @property
    def ends(self) -> Float:
        """Where the search of every parameter ends, shape (2, parameters)."""
        return _ends(self.forms)

    def fall(self, before: Sequence[FittedKinds], rows: Float) -> float:
        """Fall of the criterion of all outputs, each of so many independent rows."""
        return float(rows @ np.log(_sizes(before) / _sizes(self.fits)))

    def evidence(self, before: Sequence[FittedKinds]) -> float:
        """The same of one parameter more, rows as independent as this trial leaves them.

        None of what is not worth a parameter.
        """
        if np.min(_sizes(self.fits) / _sizes(before)) > 1 - MIN_SHARE:
            return 0.0
        rows = _independent(self.fits)
        return self.fall(before, rows) - float(np.log(np.sum(rows)))

    def residual(self, rows: Float) -> Float:
        """What is left of all outputs, shape (groups of all,); of squared size `rows`, each."""
        sizes = _sizes(self.fits)
        parts = [
            np.sqrt(n / s) * f.residual for f, n, s in zip(self.fits, rows, sizes, strict=True)
        ]
        return np.concatenate(parts)

    def change(self, one: _Trial, other: _Trial, rows: Float) -> Float:
        """Of that residual, from one trial to another near by, shape (groups of all,)."""
        roots, pairs = np.sqrt(rows / _sizes(self.fits)), zip(one.fits, other.fits, strict=True)
        changes = [b.residual - a.residual for a, b in pairs]
        return np.concatenate([r * each for r, each in zip(roots, changes, strict=True)])

    def by_output(self, values: Float) -> Float:
        """Sums over the groups of each output, shape (outputs,)."""
        starts = np.cumsum([0, *(len(fit.residual) for fit in self.fits[:-1])])
        return np.asarray(np.add.reduceat(values, starts))


@dataclass
class LawSearch:
    """Laws of several channels, all outputs fitted anew at every trial."""

    records: Sequence[Record]
    drives: Sequence[Drive]
    chosen: Sequence[ChosenKinds]
    tasks: Sequence[KindSearch]
    laws: Sequence[Law]
    _settled: dict[str, tuple[tuple[Effect, ...], GridStates]] = field(default_factory=dict)

    def found(self, known: Sequence[Effect]) -> list[Effect]:
        """The laws that decide, each beside all others, with their standard errors.

        Parameters
        ----------
        known : sequence of Effect
            From where the search goes on.
        """
        here = self._from(known)
        if here is None:
            return []
        for law in [form.law for form in here.forms if len(form.law.forms) > 1]:
            here = self._best_form(here, law)
        left = [law for law in self.laws if law not in {form.law for form in here.forms}]
        passed = list[Law]()
        while left:
            slopes = self._slopes(here, _independent(here.fits))
            further = {
                law: each for law in left if (each := self._beside(here, law, slopes)) is not None
            }
            if further:
                # The strongest first: what comes near to it is nothing beside it.
                before = here.fits
                best = max(further, key=lambda law: further[law].evidence(before))
                here = further.pop(best)
                passed += [law for law in left if law != best and law not in further]
            # What said nothing is asked again once the laws that said something are taken.
            left = list(further)
            if not left:
                left, passed = passed, []
        here = self._needed(here)
        errors = self._errors(here)
        return [
            form.law.known(form.name, float(x), float(error))
            for form, x, error in zip(here.forms, here.x, errors, strict=True)
        ]

    def _from(self, known: Sequence[Effect]) -> _Trial | None:
        """The laws that are known, moved to where the records have them; None without a fit."""
        forms, x = list[LawForm](), list[float]()
        for law in self.laws:
            for effect in known:
                if (effect.name, effect.channel) == law.name:
                    name = next(name for name in law.forms if name in effect.parameters)
                    forms.append(LawForm(law, name))
                    x.append(law.place(name, effect.parameters[name]))
        inside = [np.clip(v, *f.law.places(f.name)) for f, v in zip(forms, x, strict=True)]
        start = self._trial(tuple(forms), np.array(inside))
        return None if start is None else self._moved(start)

    def _best_form(self, here: _Trial, law: Law) -> _Trial:
        """A known law in the parameter that the records want now; other kinds may want another."""
        k = next(k for k, form in enumerate(here.forms) if form.law == law)
        rows, best = _independent(here.fits), here
        for name in law.forms:
            form = LawForm(law, name)
            if form == here.forms[k]:
                continue
            forms = (*here.forms[:k], form, *here.forms[k + 1 :])
            # Beside kinds that can bend with the others a small step promises nothing.
            low, high = law.places(name)
            starts = [
                self._trial(forms, np.where(np.arange(len(forms)) == k, place, here.x), here.fits)
                for place in np.linspace(low, high, FORM_PLACES)[1:-1]
            ]
            sound = [each for each in starts if each is not None]
            if not sound:
                continue
            there = self._moved(max(sound, key=lambda each: each.fall(here.fits, rows)))
            if there.fall(best.fits, rows) > 0:
                best = there
        return best

    def _beside(self, here: _Trial, law: Law, slopes: Float | None) -> _Trial | None:
        """One law more, all of them where they decide together; None where it decides nothing."""
        best: _Trial | None = None
        for name in law.forms:
            start = self._promising(here, LawForm(law, name), slopes)
            if start is None:
                continue
            found = self._moved(start)
            low, high = found.ends
            # One that was there and is nothing now goes in the end.
            low[:-1][low[:-1] == 0.0] = -np.inf
            if np.min(np.minimum(found.x - low, high - found.x)) < ERROR_STEP:
                # At the end of what is tried the records want another law than this one.
                continue
            evidence = found.evidence(here.fits)
            if evidence > DECISIVE and (best is None or evidence > best.evidence(here.fits)):
                best = found
        return best

    def _promising(self, here: _Trial, form: LawForm, others: Float | None) -> _Trial | None:
        """A place from which a law may decide, by two small steps; None where they promise none."""
        forms = (*here.forms, form)
        sides = (-TRIAL_STEP, TRIAL_STEP)
        behind, ahead = (self._trial(forms, np.append(here.x, s), here.fits) for s in sides)
        rows = _independent(here.fits)
        if behind is None or ahead is None or others is None:
            return None
        left, slope = here.residual(rows), here.change(behind, ahead, rows) / (2 * TRIAL_STEP)
        # The others move with it: they have their share of what it does.
        shares = linear_least_squares(others, slope, MIN_DIRECTION)
        slope = slope - others @ shares
        reach = TRIAL_STEPS * TRIAL_STEP
        places = np.clip(np.linspace(-reach, reach, PLACES), *form.law.places(form.name))
        whole, along, square = (here.by_output(each) for each in (left**2, left * slope, slope**2))
        steps = places[:, None]
        sizes = 1 + (2 * along * steps + square * steps**2) / np.maximum(
            whole, np.finfo(float).tiny
        )
        promised = -np.log(np.maximum(sizes, LEAST_SHARE)) @ rows
        best = int(np.argmax(promised))
        if promised[best] <= DECISIVE or np.min(sizes[best]) > 1 - MIN_SHARE:
            return None
        x = np.append(here.x - shares * places[best], places[best])
        return self._trial(forms, np.clip(x, *_ends(forms)), here.fits)

    def _needed(self, here: _Trial) -> _Trial:
        """Without the laws that decide nothing once the others have moved."""
        while here.forms:
            # The one that is nearest to nothing, over its error.
            k = int(np.argmin(np.abs(here.x) / self._errors(here)))
            rest = self._without(here, k)
            if rest is None or here.evidence(rest.fits) > DECISIVE:
                break
            here = rest
        return here

    def _without(self, here: _Trial, k: int) -> _Trial | None:
        forms = tuple(form for j, form in enumerate(here.forms) if j != k)
        start = self._trial(forms, np.delete(here.x, k), here.fits)
        return None if start is None else self._moved(start)

    def _moved(self, start: _Trial) -> _Trial:
        """The least error of all outputs near a start, by every parameter of a law at once."""
        best = self._descended(start)
        # Trials follow one minimum of the rates; where another is better the search goes on in it.
        fresh = self._trial(best.forms, best.x)
        if fresh is not None and fresh.fall(best.fits, _independent(best.fits)) > MIN_FALL:
            best = self._descended(fresh)
        return best

    def _descended(self, best: _Trial) -> _Trial:
        if not best.forms:
            return best
        damping, slopes = DAMPING, None
        for _ in range(MAX_STEPS):
            rows = _independent(best.fits)
            left = best.residual(rows)
            slopes = self._slopes(best, rows) if slopes is None else slopes
            if slopes is None:
                break
            gradient, information = slopes.T @ left, slopes.T @ slopes
            damped = information + damping * np.diag(np.diag(information) + 1e-12)
            step = np.clip(best.x - np.linalg.solve(damped, gradient), *best.ends) - best.x
            promised = -(2 * gradient @ step + step @ information @ step)
            if promised < LEAST_GAIN or damping > STIFFEST:
                break
            there = self._trial(best.forms, best.x + step, best.fits)
            if there is not None and there.fall(best.fits, rows) > 0:
                best, slopes, damping = there, None, damping * SOFTER
            else:
                damping *= STIFFER
        return best

    def _slopes(self, here: _Trial, rows: Float) -> Float | None:
        """Slopes of `_Trial.residual` by the parameters, shape (groups of all, laws)."""
        columns = [np.zeros((sum(len(fit.residual) for fit in here.fits), 0))]
        for k, form in enumerate(here.forms):
            high = form.law.places(form.name)[1]
            step = ERROR_STEP if here.x[k] + ERROR_STEP <= high else -ERROR_STEP
            moved = self._trial(here.forms, here.x + step * (np.arange(len(here.x)) == k),
                                here.fits, k)  # fmt: skip
            if moved is None:
                return None
            columns.append(here.change(here, moved, rows) / step)
        return np.column_stack(columns)

    def _errors(self, here: _Trial) -> Float:
        """Standard errors beside each other, shape (laws,)."""
        slopes = self._slopes(here, _independent(here.fits)) if here.forms else None
        if slopes is None:
            return np.abs(here.x)
        # What the records do not show is somewhere between its ends.
        low, high = here.ends
        known = np.diag(1 / (high - low) ** 2)
        return np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes + known)))

    def _trial(
        self,
        forms: tuple[LawForm, ...],
        x: Float,
        near: Sequence[FittedKinds] | None = None,
        moved: int | None = None,
    ) -> _Trial | None:
        """Every output fitted with these values; None where one cannot be.

        Of all values `moved` alone may differ from those with which `near` was fitted.
        """
        effects = [form.law.at(form.name, float(v)) for form, v in zip(forms, x, strict=True)]
        if moved is not None:
            effects.append(effects.pop(moved))
        fits = self._fits(tuple(effects), near, near if moved is not None else None)
        return None if fits is None else _Trial(forms, x, fits)

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
        alone = effects[-1].channel if base and effects[-1].side == "sensor" else None
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


def _ends(forms: Sequence[LawForm]) -> Float:
    """Where the search of every parameter ends, shape (2, parameters)."""
    return np.array([form.law.places(form.name) for form in forms]).reshape(-1, 2).T


def _sizes(fits: Sequence[FittedKinds]) -> Float:
    """Sum of squares of every output, shape (outputs,)."""
    return np.array([max(fit.size, np.finfo(float).tiny) for fit in fits])


def _independent(fits: Sequence[FittedKinds]) -> Float:
    """Rows of every output that count as independent, shape (outputs,)."""
    return np.array([fit.independent for fit in fits])
