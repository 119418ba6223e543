"""Which kind of response an output has to each drive: by evidence, and by rows held out.

Every kind is fitted to the same records and asked twice. Evidence: the Bayesian information
criterion, with as many rows as the colour of the residual leaves independent. Prediction: the error
on blocks of rows that the fit has not seen, in turn. Of the kinds that no other one surpasses in
either, the one with the fewest parameters is taken; of several drives, with the fewest time
constants.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from thermaltool.fitting.candidate_data import BLOCKS, MIN_EXCESS, CandidateData
from thermaltool.fitting.dead_times import delayed_kinds
from thermaltool.fitting.discrepancy import AS_NEAR
from thermaltool.fitting.kind_candidate import (
    LEFT_OUT,
    MORE_PARAMETERS,
    MORE_TIME_CONSTANTS,
    PLATE,
    ROD,
    SLAB,
    WHY_ALONE,
    WHY_FEWEST,
    WHY_SIMPLEST,
    WORSE_UNSEEN,
    KindCandidate,
    complexity,
    is_as_good,
)
from thermaltool.fitting.mixed_kinds import (
    DELAYED,
    KINDS_FOR_ONE,
    common_lags,
    mixed_kinds,
)
from thermaltool.fitting.output_fit import check_records
from thermaltool.fitting.projection import GridStates, surroundings
from thermaltool.fitting.response_search import FittedKinds, KindSearch
from thermaltool.fitting.sound_kinds import (
    DECISIVE,
    best_of,
    criterion,
    sound_ones,
    without_delays,
)
from thermaltool.model import Drive
from thermaltool.record import Record
from thermaltool.responses.modes import Float

# Below so many rows for each drive nothing is compared.
MIN_ROWS = 50
# Kinds that compete; those with a delay are tried where the delay itself has evidence.
KINDS = (
    "conduction",
    "rational1",
    "rational2",
    "rational3",
    "rational4",
    "deflection",
    "joint_deflection",
)
# Fitted ones of a slab, which is tried where others ask for more.
SLAB_PARAMETERS = 5
# What speaks against a gain of one to the surroundings: an error as large as the noise.
MIN_AGAINST_EQUILIBRIUM = 1.0
# A lag of the surroundings so many times the slowest of any heat is none of the same body; and one
# that is so many times the slowest where gains are free stands for surroundings that nobody logs.
SLOWER_THAN_HEAT, SLOWER_THAN_FREE = 3.0, 2.0
# A larger error on held-out blocks is sure from so many standard errors: not where one block, the
# only one with a step in it, makes it.
SURE = 2.0


def choose_response(
    records: Sequence[Record],
    drives: Sequence[Drive],
    output: str,
    usual: str,
    fixed: Mapping[str, float] | None = None,
    free_start: bool = False,
    progress: Callable[[str], None] = lambda message: None,
    states: GridStates | None = None,
    equilibrium: bool = True,
) -> tuple[KindCandidate, ...]:
    """All kinds of response on the same records, the chosen one among them.

    Parameters
    ----------
    records : sequence of Record
    drives : sequence of Drive
    output : str
    usual : str
        The kind that is taken among equals.
    fixed : mapping of parameter name to value, optional
    free_start : bool
        See `fit_output`.
    progress : callable
    states : dict, optional
        See `CalibrationProblem.assemble`.
    equilibrium : bool
        Whether a temperature takes that of its surroundings in the end, unless the records are
        against it.

    Returns
    -------
    tuple of KindCandidate
        By their number of parameters; none where the rows are too few to compare.
    """
    check_records(records, drives, output)
    if sum(len(record) for record in records) < MIN_ROWS * len(drives):
        return ()
    task = KindSearch(
        records, drives, output, free_start, fixed or {}, {} if states is None else states,
        equilibrium and bool(surroundings(drives, output)),
    )  # fmt: skip
    found = _compared(task, usual, progress)
    taken = next((each for each in found if each.chosen and each.equilibrium), None)
    if taken is None:
        return found
    against, unseen = _never_settles(task, taken)
    if against or unseen:
        progress("trying any gain to the surroundings")
        free = _compared(task.out_of_equilibrium(), usual, progress)
        if against or is_as_good(free, found, task.data((0.0,) * len(drives)).noise):
            return free
    return found


def _never_settles(task: KindSearch, taken: KindCandidate) -> tuple[bool, bool]:
    """Whether another gain to the surroundings than one is beyond doubt, or as likely.

    Not all that warms and cools an output need be logged: a floor, a coolant, a wall. But a free
    gain stands in for any small error of structure, too, and other logs pay for it: what is small
    counts where only a lag that is much slower than any other makes the gain one. Where the
    surroundings are followed by a lag that no heat has, one is as likely as the other.
    """
    acting = [d for d, kind in enumerate(taken.kinds) if kind != LEFT_OUT]
    kinds = tuple(taken.kinds[d] for d in acting)
    delays = tuple(taken.delays[d] for d in acting)
    bound = task.driven_by([task.drives[d] for d in acting])
    settled, free = (
        own.fit(kinds, delays, common=taken.common) for own in (bound, bound.out_of_equilibrium())
    )
    if settled is None or free is None:
        return False, False
    slowest = [response.slowest() for response in settled.responses]
    around = surroundings(bound.drives, task.output)
    # One body has the same slow lags, whatever moves it; shared ones are seen where they end.
    others = [
        SLOWER_THAN_HEAT * each
        for d, each in enumerate(slowest)
        if d not in around and not taken.common
    ]
    unseen = max(slowest[d] for d in around) > max(others, default=task.duration)
    freely = max(response.slowest() for response in free.responses)
    stretched = max(slowest) > SLOWER_THAN_FREE * freely
    if free.soundness.flaw:
        return False, unseen or stretched
    rows = free.independent
    least = 0.0 if stretched else MIN_AGAINST_EQUILIBRIUM
    against = criterion(settled, rows) - criterion(free, rows) > DECISIVE and all(
        free.data.counts(errors, others, least)
        for errors, others in (
            (settled.residual, free.residual),
            (settled.held_out, free.held_out),
        )
    )
    return against, unseen


def _compared(
    task: KindSearch, usual: str, progress: Callable[[str], None]
) -> tuple[KindCandidate, ...]:
    """All kinds of response to the drives of a task, the chosen one among them."""
    drives, fixed = task.drives, task.fixed
    still = (0.0,) * len(drives)
    found: list[FittedKinds] = []
    for kind in KINDS if len(drives) == 1 else dict.fromkeys((usual, *KINDS_FOR_ONE)):
        progress(f"trying {kind}")
        own = task.fit((kind,) * len(drives), still)
        found += [own] if own is not None else []
    if not found:
        return ()
    best = best_of(found, _independent(found))
    # A wall with weak films is a rod of little loss, too: it is tried first.
    for kind in (SLAB, *((ROD,) if usual == PLATE else ())) if len(drives) == 1 else ():
        if best.parameters > SLAB_PARAMETERS or best.kinds == (PLATE,):
            progress(f"trying {kind}")
            own = task.fit((kind,), still)
            found += [own] if own is not None else []
            best = best_of(found, _independent(found))
    if not fixed.get("delay"):
        progress("trying delays")
        rationals = [each for each in found if each.kinds[0] in DELAYED]
        found += delayed_kinds(task, rationals, _independent(found))
    if len(drives) > 1:
        progress("trying a kind for each drive")
        found += mixed_kinds(task, found, _independent(found))
        progress("trying time constants that all drives share")
        shared = common_lags(task, found, _independent(found))
        if not fixed.get("delay"):
            progress("trying delays before these")
            whole = [each for each in without_delays(shared) if LEFT_OUT not in each.kinds]
            shared += delayed_kinds(task, whole, _independent([*found, *shared]))
        found += shared
    judged = _Judgement(found, task.data(still), _independent(found)).candidates(usual)
    around = set(surroundings(drives, task.output)) if task.equilibrium else set()
    return tuple(
        replace(each, equilibrium=any(each.kinds[d] != LEFT_OUT for d in around)) for each in judged
    )


def _independent(found: Sequence[FittedKinds]) -> float:
    """Rows that count as independent in what the closest kinds leave: of poor ones few are."""
    return min(sound_ones(found), key=lambda each: each.size).independent


def _all_weights(each: FittedKinds) -> Float:
    """Grid weights of every drive, zeros of one that is left out; shape (drives, rates)."""
    own = iter(each.weights)
    still = np.zeros(len(each.data.problem.grid.rates))
    return np.array([still if kind == LEFT_OUT else next(own) for kind in each.kinds])


class _Judgement:
    """Candidates side by side: what each is worth beside the best, in evidence and prediction."""

    def __init__(self, found: Sequence[FittedKinds], data: CandidateData, rows: float) -> None:
        self.data, self.rows = data, rows
        # A delay is a cause of its own: it has to say more than any kind without one that is as
        # sound.
        plain, alike = without_delays(found), without_delays(sound_ones(found))
        least = min((criterion(each, rows) for each in alike), default=np.inf)
        self.delayed = least - criterion(best_of(found, rows), rows) > DECISIVE
        self.found = list(found) if self.delayed else plain
        sound = sound_ones(self.found)
        self.least = criterion(best_of(sound, rows), rows)
        kept = {id(each) for each in sound}
        self.notes = [
            self._before(each, sound) if id(each) in kept else each.soundness.flaw
            for each in self.found
        ]
        left = [each for each, note in zip(self.found, self.notes, strict=True) if not note]
        self.notes = [
            note or self._held_out(each, left)
            for each, note in zip(self.found, self.notes, strict=True)
        ]

    def _before(self, each: FittedKinds, others: Sequence[FittedKinds]) -> str:
        """Why a candidate is out before any row is held out; empty where it is not."""
        own = criterion(each, self.rows)
        # What a dead time leaves is large for a while after each switch, and little on the whole.
        less = any(
            own > criterion(other, self.rows) + DECISIVE
            and (self.delayed or self._counts(each, other, each.residual, other.residual))
            for other in others
        )
        return "less evidence" if less else ""

    def _held_out(self, each: FittedKinds, others: Sequence[FittedKinds]) -> str:
        """Why a candidate is out by rows held out; empty where it is not."""
        blocks = np.arange(len(each.residual)) * BLOCKS // len(each.residual)
        for other in others:
            worse = np.bincount(blocks, each.held_out**2 - other.held_out**2)
            sure = float(np.sum(worse)) > SURE * float(np.std(worse)) * np.sqrt(len(worse))
            if sure and self._counts(each, other, each.held_out, other.held_out):
                return WORSE_UNSEEN
        return ""

    def _counts(self, each: FittedKinds, other: FittedKinds, errors: Float, others: Float) -> bool:
        """Whether the error of one is larger than what its fewer rates and shapes are worth.

        Of two that are as simple none is worth more: what is decisive decides.
        """
        if self._size(other) <= self._size(each):
            return True
        fewer = max(len(other.theta) - len(each.theta), 1)
        return self.data.counts(errors, others, MIN_EXCESS * fewer**0.5)

    @staticmethod
    def _size(each: FittedKinds) -> tuple[int, int]:
        return complexity(each.kinds, each.theta, each.parameters)

    def candidates(self, usual: str) -> tuple[KindCandidate, ...]:
        """Every candidate with its note, the chosen one among them.

        Parameters
        ----------
        usual : str
            The kind that is taken among equals.
        """
        sound = [k for k, note in enumerate(self.notes) if not note]
        sizes = [self._size(each) for each in self.found]
        taken = min(
            sound,
            key=lambda k: (
                sizes[k],
                self.found[k].kinds[0] != usual,
                self.data.rms(self.found[k].held_out),
            ),
        )
        fewest = WHY_FEWEST if sizes[taken][0] else WHY_SIMPLEST
        nearest = min(sound_ones(self.found), key=lambda each: each.size)
        result = []
        for k, (each, note) in enumerate(zip(self.found, self.notes, strict=True)):
            near = not self.data.counts(each.residual, nearest.residual, AS_NEAR)
            if k == taken:
                note = WHY_ALONE if len(sound) == 1 else fewest
            result.append(
                KindCandidate(
                    each.kinds,
                    each.delays,
                    each.parameters,
                    self.data.rms(each.residual),
                    self.data.rms(each.held_out) if "held_out" in each.__dict__ else None,
                    criterion(each, self.rows) - self.least,
                    each.soundness.cancellation,
                    note
                    or (MORE_TIME_CONSTANTS if sizes[k][0] > sizes[taken][0] else MORE_PARAMETERS),
                    k == taken,
                    weights=_all_weights(each) if near and not each.soundness.flaw else None,
                    theta=each.theta,
                    common=each.common,
                )
            )
        return tuple(sorted(result, key=lambda each: (each.parameters, each.criterion)))
