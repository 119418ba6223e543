"""Which input schedules what, by how many levels, beside how many modes: by rows held out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.lpv.form import MAX_LPV_MODES, LpvForm
from thermaltool.fitting.lpv.identify import identify_lpv
from thermaltool.fitting.lpv.model import Lpv
from thermaltool.fitting.search_budget import SearchBudget
from thermaltool.fitting.selection import FITTED_SHARE, Candidate, held_out_level, rank
from thermaltool.units import Reference, is_temperature

# Rows by which the choice is made, at most.
MAX_CHOICE_ROWS = 4000
# Numbers of levels that are tried; two are the bilinear model.
LEVEL_COUNTS = (2, 3, 5)
# Modes beside which the search for levels begins; rounds of it; a round counts that lowers the
# logarithm of the error variance of the rows held out, with its parameters, by so much.
FIRST_MODES, MAX_ROUNDS, MIN_FALL = (1, 2, 3), 5, 0.01
# Values beside the ends that a power, or a gain by level, takes to show [of the range].
SAME_VALUE = 0.02
# A level between the ends lies where an input stays for so many of the rows, at least.
MIN_STAY = 0.01


def choice_rows(data: TrainingData) -> TrainingData:
    """The rows by which the choice is made.

    Parameters
    ----------
    data : TrainingData
    """
    return data if data.rows <= MAX_CHOICE_ROWS else data.excerpt(MAX_CHOICE_ROWS)


def choose_form(
    data: TrainingData,
    references: tuple[Reference, ...],
    delays: Sequence[tuple[int, ...]],
    modes: int | None = None,
    level_counts: Sequence[int] = LEVEL_COUNTS,
    direct: bool = False,
    budget: SearchBudget | None = None,
) -> tuple[Candidate[Lpv], ...]:
    """Forms by what they predict of rows held out, the best first.

    Linear modes first, with each of the delays; from the best, whatever changes one thing (a loss
    or gains by the level of an input, more levels, a power, a mode more or less) and predicts
    better, until nothing does.

    Parameters
    ----------
    data : TrainingData
    references : tuple of "first" or float
    delays : sequence of tuple of int
        Samples by which each input acts later.
    modes : int, optional
    level_counts : sequence of int
    direct : bool
        Whether outputs may follow inputs of the same row.
    budget : SearchBudget, optional

    Raises
    ------
    FitError
        No candidate fits.
    """
    data.check()
    budget = budget or SearchBudget()
    split = choice_rows(data).split(FITTED_SHARE)
    # Levels of inputs tell nothing of the outputs held out, and hold for all rows.
    room = _Room(data, references, tuple(level_counts), modes)

    def fit(each: Lpv, part: TrainingData) -> Lpv:
        if part is split.fitted:
            return each
        return identify_lpv(part, each.form, references, [each.theta], judged=False)

    def candidates() -> Iterator[Lpv]:
        problem: FitError | None = None
        best: tuple[float, Lpv] | None = None
        tried: set[LpvForm] = set()
        firsts = FIRST_MODES if modes is None else (modes,)
        waiting = [LpvForm(n, delays=late, direct=direct) for late in delays for n in firsts]
        for _ in range(1 + MAX_ROUNDS):
            before = best
            for form in waiting:
                tried.add(form)
                starts = () if before is None else [_start(before[1], form)]
                try:
                    model = identify_lpv(split.fitted, form, references, starts, judged=False)
                except FitError as error:
                    problem = problem or error
                    continue
                level = held_out_level(model, split)
                if np.isfinite(level) and (best is None or level < best[0] - MIN_FALL):
                    best = level, model
                yield model
            if best is None or best is before:
                break
            waiting = [form for form in room.neighbours(best[1].form) if form not in tried]
        if best is None and problem is not None:
            raise problem

    return rank(candidates(), fit, split, "no parameter-varying model fits", budget)


def _start(known: Lpv, form: LpvForm) -> Array:
    """Where the search of a neighbour begins."""
    theta, old = known.theta, known.form
    taus = theta[: old.modes]
    if form.modes > old.modes:
        taus = np.append(taus, np.min(taus) - 1.0)
    elif form.modes < old.modes:
        # Without the mode of the least weight.
        sizes = sum(np.abs(o.weights[: old.modes]).sum(axis=(1, 2)) for o in known.outputs)
        taus = np.delete(taus, int(np.argmin(sizes)))
    return replace(old, modes=form.modes).carried_over(
        np.concatenate([taus, theta[old.modes :]]), form
    )


@dataclass(frozen=True)
class _Room:
    """What can be tried on a record."""

    data: TrainingData
    references: tuple[Reference, ...]
    level_counts: tuple[int, ...]
    modes: int | None

    def _values(self, name: str) -> Array:
        return np.concatenate([record.column(name) for record in self.data.records])

    def _levels(self, name: str, count: int) -> tuple[float, ...]:
        """Both ends, and between them what the input takes for long, evenly if it can be."""
        values = self._values(name)
        low, high = float(values.min()), float(values.max())
        cells = ((values - low) / (high - low) / SAME_VALUE).astype(int)
        own = [values[cells == cell] for cell in np.unique(cells)]
        visited = np.array([np.median(v) for v in own if len(v) >= MIN_STAY * len(values)])
        # Beside an end there is no level: both would share their rows.
        visited = visited[np.minimum(visited - low, high - visited) > 2 * SAME_VALUE * (high - low)]
        wanted = np.linspace(low, high, count)[1:-1]
        near = {float(visited[np.argmin(np.abs(visited - at))]) for at in wanted if len(visited)}
        return (low, *sorted(near), high)

    def _graded(self, name: str) -> bool:
        """Whether an input takes values between its ends."""
        values = self._values(name)
        low, span = float(values.min()), float(np.ptp(values))
        share = (values - low) / span
        return bool(np.any((share > SAME_VALUE) & (share < 1 - SAME_VALUE)))

    def _chooses(self, name: str) -> bool:
        """Whether an input can schedule others: its zero is the same in every log."""
        return self.references[self.data.inputs.index(name)] != "first"

    def _power(self, name: str) -> bool:
        """Whether an input may act by a power: a command, with a zero, of more than two levels."""
        return self._chooses(name) and not is_temperature(name) and self._graded(name)

    def neighbours(self, form: LpvForm) -> Iterator[LpvForm]:
        """Forms that differ by one thing."""
        for name in self.data.inputs:
            if self._chooses(name):
                yield from self._scheduled(form, name)
        size = {
            name: float(np.max(np.abs(self._values(name) - float(rest))))
            for name, rest in zip(self.data.inputs, self.references, strict=True)
            if self._power(name)
        }  # fmt: skip
        powers = [tuple(n for n in self.data.inputs if (n in form.powers) != (n == own))
                  for own in size]  # fmt: skip
        for chosen in dict.fromkeys([*powers, tuple(size)]):
            # Gains by the level of an input are a curve of it already.
            if not (form.gain and form.channel in chosen):
                yield replace(form, powers=chosen, sizes=tuple((n, size[n]) for n in chosen))
        if self.modes is None:
            for modes in (form.modes - 1, form.modes + 1):
                if 1 <= modes <= MAX_LPV_MODES:
                    yield replace(form, modes=modes)

    def _scheduled(self, form: LpvForm, name: str) -> Iterator[LpvForm]:
        graded = self._graded(name)
        counts = self.level_counts if graded else self.level_counts[:1]
        at = len(form.levels) if form.channel == name else 0
        wanted = counts[:1] if not at else (at, *[n for n in counts if n > at][:1])
        for count in wanted:
            levels = form.levels if count == at else self._levels(name, count)
            rest = float(self.references[self.data.inputs.index(name)])
            for loss, gain in ((True, False), (False, True), (True, True)):
                if gain and not (graded or len(self.data.inputs) > 1):
                    continue
                kept = tuple(n for n in form.powers if not (gain and n == name))
                sizes = tuple(pair for pair in form.sizes if pair[0] in kept)
                yield replace(form, channel=name, levels=levels, loss=loss, gain=gain,
                              powers=kept, sizes=sizes, rest=rest)  # fmt: skip
