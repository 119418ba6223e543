"""Prediction of held-out rows: blocks of each log, from a fit to all others.

The model's own parameters move within their prior, and those of its causes as far as their slopes
say something, around the full fit. What a cause has in several outputs is one parameter, which all
of them say.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from thermaltool.diagnosis.assumptions import STARTS
from thermaltool.diagnosis.gain import Gain, compare
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.readings import hidden_noise
from thermaltool.diagnosis.simulation import Series
from thermaltool.effects.effect import Effect, Float
from thermaltool.signals.likelihood import ColouredNoise
from thermaltool.signals.row_groups import Index, RowGroups
from thermaltool.signals.symmetric import pseudo_inverse

# Parts of a log of which each is held out once.
FOLDS = 6
# Singular values of the scaled normal matrix of a fold that count, relative to the largest.
RELATIVE_RANK = 1e-12

# A parameter of an accepted cause: number of the effect, and its name.
Place = tuple[int, str]


def held_out_gains(before: Hypothesis, after: Hypothesis, seed: int = 0) -> dict[str, Gain]:
    """Gain of every output by blocked cross-validation.

    Parameters
    ----------
    before, after : Hypothesis
        On the same logs; `after` has one cause more.
    seed : int
        Of the bootstrap.
    """
    # Where nothing says how large a slow discrepancy may be, it would bridge short stretches.
    events = "tight" in after.assumptions and any(e.event for e in after.model.effects)
    # Nothing but the first block says what the start was like: it stays in the fit.
    starts = bool(STARTS & after.assumptions) or any(e.at_start for e in after.model.effects)
    old, new = (_held_out_errors(each, events, starts) for each in (before, after))
    simulated = before.simulation
    return {
        output: compare(
            simulated.measured_rows(output),
            old[output],
            new[output],
            seed,
            hidden_noise(simulated, output),
        )
        for output in before.groups
    }


def _held_out_errors(hypothesis: Hypothesis, events: bool, starts: bool) -> dict[str, Float]:
    """Error of every row of every output, predicted from the other blocks, shape (rows,).

    A cause is judged beside what the calibration leaves open, which the other blocks say.
    """
    tables = {output: _Table.of(hypothesis, output) for output in hypothesis.groups}
    every = [place for table in tables.values() for place in table.places]
    shared = [place for place in dict.fromkeys(every) if every.count(place) > 1]
    errors = {output: np.empty(len(table.fine)) for output, table in tables.items()}
    for k in range(len(hypothesis.logs)):
        blocks = {
            output: _blocks(np.flatnonzero(table.groups.owner == k), events)
            for output, table in tables.items()
        }
        for number in range(FOLDS):
            folds = {output: _fold(each, number) for output, each in blocks.items()}
            fits = {
                output: tables[output].fitted(
                    np.setdiff1d(fold, blocks[output][0]) if starts and len(fold) else fold
                )
                for output, fold in folds.items()
            }
            said = {output: fit.of(shared) for output, fit in fits.items()}
            for output, fold in folds.items():
                if len(fold):
                    others = [each for o, each in said.items() if o != output]
                    rows, predicted = tables[output].predicted(
                        fold, fits[output].beside(shared, others)
                    )
                    errors[output][rows] = predicted
    return errors


def _blocks(rows: Index, events: bool) -> list[Index]:
    """Stretches of one log, shorter ones where something happened at an instant.

    What happened late would else have all that it changed in one block.
    """
    count = min(FOLDS * FOLDS if events else FOLDS, len(rows))
    return np.array_split(rows, count) if count else []


def _fold(blocks: Sequence[Index], number: int) -> Index:
    """Rows that are held out together: every so many-th block."""
    return np.concatenate([np.zeros(0, np.int64), *blocks[number::FOLDS]])


# ---------------------------------------------------------------- fits to some rows


@dataclass(frozen=True)
class _NormalEquations:
    """Least squares of one output on some rows: ``matrix @ moves = right``, both over its noise.

    Attributes
    ----------
    matrix : ndarray, shape (c, c)
    right : ndarray, shape (c,)
    places : mapping of (number of the effect, parameter) to int
        Columns of the parameters of accepted causes.
    prior : ndarray, shape (c,)
        Precisions that the matrix holds; those of causes are about zero.
    """

    matrix: Float
    right: Float
    places: Mapping[Place, int]
    prior: Float

    def of(self, shared: Sequence[Place]) -> tuple[Float, Float]:
        """What its rows say of shared parameters, all else fitted: matrix and right side.

        Without the prior of these: it counts once, not once for each output.
        """
        matrix, right = np.zeros((len(shared), len(shared))), np.zeros(len(shared))
        mine = [k for k, place in enumerate(shared) if place in self.places]
        if mine:
            chosen = np.array([self.places[shared[k]] for k in mine], np.int64)
            rest = np.setdiff1d(np.arange(len(self.right)), chosen)
            through = self.matrix[np.ix_(chosen, rest)]
            known = np.column_stack([self.matrix[np.ix_(rest, chosen)], self.right[rest]])
            taken = through @ _solved(self.matrix[np.ix_(rest, rest)], known)
            of_rows = self.matrix[np.ix_(chosen, chosen)] - np.diag(self.prior[chosen])
            matrix[np.ix_(mine, mine)] = of_rows - taken[:, :-1]
            right[mine] = self.right[chosen] - taken[:, -1]
        return matrix, right

    def beside(self, shared: Sequence[Place], others: Collection[tuple[Float, Float]]) -> Float:
        """Moves of all columns, with what other outputs say of the shared ones."""
        matrix, right = self.matrix.copy(), self.right.copy()
        mine = [k for k, place in enumerate(shared) if place in self.places]
        chosen = np.array([self.places[shared[k]] for k in mine], np.int64)
        for theirs, said in others:
            matrix[np.ix_(chosen, chosen)] += theirs[np.ix_(mine, mine)]
            right[chosen] += said[mine]
        return _solved(matrix, right)


def _solved(matrix: Float, right: Float) -> Float:
    """Least squares solution of normal equations, their columns scaled."""
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    size[size == 0] = 1.0
    inner = pseudo_inverse(matrix / np.outer(size, size), RELATIVE_RANK)
    return np.asarray(((inner @ (right.T / size).T).T / size).T)


@dataclass(frozen=True)
class _Table:
    """Residual of one output and what a fold may use of it.

    Attributes
    ----------
    groups : RowGroups
    coarse, fine : ndarray, shape (groups or rows, 1 + c)
        Residual and sensitivities, means of rows and the rows themselves.
    prior, centre : ndarray, shape (c,)
        Precisions and centres.
    noise : (float, float)
        Variance of the discrepancy over that of white noise, and its time constant [s].
    white : float
    places : mapping of (number of the effect, parameter) to int
        Columns of the parameters of accepted causes.
    """

    groups: RowGroups
    coarse: Float
    fine: Float
    prior: Float
    centre: Float
    noise: tuple[float, float]
    white: float
    places: Mapping[Place, int]

    @classmethod
    def of(cls, hypothesis: Hypothesis, output: str) -> _Table:
        groups, evidence = hypothesis.groups[output], hypothesis.evidence[output]
        nuisance = hypothesis.nuisance[output]
        columns, prior, centre = _columns(hypothesis, output)
        residual = hypothesis.simulation.residual(output)
        table = [np.column_stack(pair) for pair in zip(residual, columns, strict=True)]
        null = evidence.null(hypothesis.assumptions)
        level = evidence.levels[null.level]
        first = len(nuisance.offsets)
        places = {place: first + k for k, place in enumerate(nuisance.accepted)}
        coarse, fine = groups.means(table), groups.joined(table)
        noise = level.ratio, level.tau
        return cls(groups, coarse, fine, prior, centre, noise, null.white, places)

    def fitted(self, held: Index) -> _NormalEquations:
        """Generalized least squares on all rows but some."""
        kept = np.setdiff1d(np.arange(self.groups.size), held)
        starts = np.flatnonzero(np.diff(self.groups.owner[kept], prepend=-1))
        coloured = ColouredNoise(
            self.groups.time[kept], starts, self.groups.weight[kept], self.groups.noise.period
        )
        rows = self.coarse[kept]
        gram = rows.T @ coloured.factor(*self.noise).solve(rows) / self.white**2
        matrix = gram[1:, 1:] + np.diag(self.prior)
        right = gram[0, 1:] - self.prior * self.centre
        return _NormalEquations(matrix, right, self.places, self.prior)

    def predicted(self, fold: Index, moves: Float) -> tuple[Index, Float]:
        """Rows of some groups, and their errors after moves."""
        rows = np.flatnonzero(np.isin(self.row_groups, fold))
        return rows, self.fine[rows, 0] - self.fine[rows, 1:] @ moves

    @cached_property
    def row_groups(self) -> Index:
        """Group of every row."""
        ends = np.append(self.groups.first, len(self.fine))
        return np.repeat(np.arange(self.groups.size), np.diff(ends))


def _columns(hypothesis: Hypothesis, output: str) -> tuple[Series, Float, Float]:
    """What a fold may use: offsets, effects, what the calibration leaves open, starts, switches.

    Returns
    -------
    list of ndarray, shape (n, c), one for each log
        Sensitivities.
    ndarray, shape (c,)
        Precision of the priors, and
    ndarray, shape (c,)
        their centres.
    """
    nuisance = hypothesis.nuisance[output]
    flat = [*nuisance.offsets, *nuisance.accepted.values()]
    prior = nuisance.prior
    used = (STARTS | {"instants", "earlier"}) & hypothesis.assumptions
    starts = [column for group in sorted(used) for column in nuisance.beside[group]]
    columns = [
        np.column_stack([*(c[k] for c in flat), own @ prior.root, *(c[k] for c in starts)])
        for k, own in enumerate(nuisance.moves)
    ]
    free, known = np.zeros(len(flat)), np.zeros(len(starts))
    loose = free.copy()
    for k, (at, name) in enumerate(nuisance.accepted, start=len(nuisance.offsets)):
        loose[k] = _reach(hypothesis.model.effects[at], name) ** -2
    precision = np.concatenate([loose, np.ones_like(prior.centre), np.ones(len(starts))])
    centre = np.concatenate([free, prior.centre, known])
    return columns, precision, centre


def _reach(effect: Effect, name: str) -> float:
    """How far the slope by a parameter of a cause says what it does: a deviation of its prior.

    All the way where outputs are linear in it.
    """
    known, value = effect.parameter(name), abs(effect.parameters[name])
    if known.linear or not value:
        return np.inf
    return effect.course or value if known.unit == "s" and not known.log else value
