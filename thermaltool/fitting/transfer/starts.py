"""Starts of the search: real poles on a coarse grid of time constants, ranked by their loss.

With distinct real poles B/F is a sum of first-order responses. Those of the whole grid are computed
once; every choice of poles is then a least-squares fit by their sums alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermaltool.fitting.data import Array
from thermaltool.fitting.transfer.output_error import Problem
from thermaltool.signals.gauss_newton import MIN_DIRECTION, MIN_SIZE

Index = NDArray[np.intp]
# Fastest time constant of the grid [samples], and how many there are on it at most.
MIN_TIME_CONSTANT, MAX_GRID_SIZE = 0.7, 7
# Time constants nearer than this in logarithm count as the same.
MIN_LOG_DISTANCE = 0.01


@dataclass(frozen=True)
class Start:
    """A denominator and the loss of its least-squares fit."""

    loss: float
    F: Array


@dataclass(frozen=True)
class Grid:
    """First-order responses of one group of inputs to a grid of time constants.

    Attributes
    ----------
    problem : Problem
        Of one group.
    rows : tuple of ndarray
        For each used record: for each input its m responses and its plain lags; ones; the m free
        responses, unless it begins at rest.
    lags : ndarray, shape (c, order) [samples]
        Of each choice of poles.
    turns : tuple of ndarray
        For each used record, from its rows to those of a model with the chosen poles (c, l, r).
    locals : tuple of ndarray
        For each used record and choice, from products with its rows to those with what is left
        of its shared columns beside its free responses, (c, s, s + f), and
    frees : tuple of ndarray
        the inverse of the normal equations of the free responses alone (c, f, f).
    inverses : ndarray
        Of the normal equations of the shared columns, of each choice.
    """

    problem: Problem
    rows: tuple[Array, ...]
    lags: Array
    turns: tuple[Array, ...]
    locals: tuple[Array, ...]
    frees: tuple[Array, ...]
    inverses: Array

    def ranked(self, outputs: Sequence[Array], count: int) -> list[Start]:
        """The best starts for these outputs of the used records, on the rows that count.

        Parameters
        ----------
        outputs : sequence of ndarray
        count : int
        """
        rights = np.zeros((len(self.lags), self.problem.shared_count))
        power = np.zeros(len(self.lags))
        for j, y, rows, turn, local, free in zip(
            self.problem.used, outputs, self.rows, self.turns, self.locals, self.frees, strict=True
        ):
            seen = self.problem.white(y, j)
            right = turn @ (rows @ seen)
            rights[:, self.problem.place(j)] += np.einsum("kij,kj->ki", local, right)
            own = right[:, local.shape[1] :]
            power += float(seen @ seen) - np.einsum("ki,kij,kj->k", own, free, own)
        loss = power - np.einsum("ki,kij,kj->k", rights, self.inverses, rights)
        order = [k for k in np.argsort(loss) if np.isfinite(loss[k])]
        return [Start(float(loss[k]), self.problem.start(self.lags[k])) for k in order[:count]]


def grid(problem: Problem, around: Array | None = None) -> Grid:
    """The grid of a problem with one group of inputs and at least one pole.

    Parameters
    ----------
    problem : Problem
    around : ndarray, shape (order,) [samples], optional
        Time constants: only one of them at a time takes values of the grid, the others stand.
    """
    lags, chosen = _pairs(problem) if around is None else _beside(problem, around)
    rows = tuple(problem.white(_rows(problem, k, lags), k) for k in problem.used)
    at_rest = [problem.data.records[k].at_rest for k in problem.used]
    kinds = {rest: _turns(problem, lags, chosen, rest) for rest in set(at_rest)}
    turns = tuple(kinds[rest] for rest in at_rest)
    grams = np.zeros((len(chosen), problem.shared_count, problem.shared_count))
    left, frees = [], []
    for k, own, turn in zip(problem.used, rows, turns, strict=True):
        place = problem.place(k)
        n = len(place)
        gram = turn @ (own @ own.T) @ turn.transpose(0, 2, 1)
        free = _inverses(gram[:, n:, n:])
        across = -gram[:, :n, n:] @ free
        local = np.concatenate([np.broadcast_to(np.eye(n), (len(gram), n, n)), across], axis=2)
        grams[:, place[:, None], place] += gram[:, :n, :n] + across @ gram[:, n:, :n]
        left.append(local)
        frees.append(free)
    return Grid(problem, rows, lags[chosen], turns, tuple(left), tuple(frees), _inverses(grams))


def _coarse(problem: Problem) -> Array:
    """Time constants from below a sample to half the record [samples]."""
    longest = max(problem.data.longest / 2.0, 8.0)
    # Poles with a time constant below a sample are as good as delays.
    count = max(3, min(MAX_GRID_SIZE, round(np.log(longest) / np.log(4)) + 1))
    return np.geomspace(MIN_TIME_CONSTANT, longest, count)


def _pairs(problem: Problem) -> tuple[Array, Index]:
    """Time constants, and which of them make a denominator.

    Pairs of the grid; orders above the second add halves of the faster one.
    """
    nf, coarse = problem.orders.nf[0], _coarse(problem)
    lags = np.concatenate([coarse * 0.5**k for k in range(max(nf - 1, 1))])
    chosen = [
        [*pair, *(pair[0] + len(coarse) * k for k in range(1, nf - 1))]
        for pair in itertools.combinations(range(len(coarse)), min(nf, 2))
    ]
    return lags, np.array(chosen, dtype=np.intp)


def _beside(problem: Problem, around: Array) -> tuple[Array, Index]:
    """Time constants, and which of them make a denominator: all but one of those `around`."""
    coarse = _coarse(problem)
    # Partial fractions want distinct poles.
    apart = np.min(np.abs(np.log(coarse[:, None] / around)), axis=1) > MIN_LOG_DISTANCE
    coarse = coarse[apart]
    kept = itertools.combinations(range(len(coarse), len(coarse) + len(around)), len(around) - 1)
    chosen = [[m, *rest] for rest in kept for m in range(len(coarse))]
    return np.concatenate([coarse, around]), np.array(chosen, dtype=np.intp)


def _turns(problem: Problem, lags: Array, chosen: Index, at_rest: bool) -> Array:
    """From the rows of the grid to those of a model, for each choice of poles."""
    nb, m, (count, nf) = problem.orders.nb, len(lags), chosen.shape
    parts = problem.parts(lags[chosen], max(nb))
    plain = [max(n - nf, 0) for n in nb]
    free = (0, 0) if at_rest else (nf, m)
    turns = np.zeros((count, sum(nb) + 1 + free[0], len(nb) * m + sum(plain) + 1 + free[1]))
    each, row, column = np.arange(count), 0, 0
    for n, lagged in zip(nb, plain, strict=True):
        for j in range(n - lagged):
            turns[each[:, None], row + j, column + chosen] = parts[:, j]
        for j in range(lagged):
            turns[:, row + n - lagged + j, column + m + j] = 1.0
        row, column = row + n, column + m + lagged
    turns[:, row, column] = 1.0
    for j in range(free[0]):
        turns[each, row + 1 + j, column + 1 + chosen[:, j]] = 1.0
    return turns


def _rows(problem: Problem, k: int, lags: Array) -> Array:
    o, m, record, inputs = problem.orders, len(lags), problem.data.records[k], problem.data.u[k]
    n = len(record) - o.first
    plain = [max(nb - o.nf[0], 0) for nb in o.nb]
    rows = np.ones((len(o.nb) * m + sum(plain) + 1 + (0 if record.at_rest else m), n))
    at = 0
    for i, (nk, lagged) in enumerate(zip(o.nk, plain, strict=True)):
        for lag in lags:
            problem.numerators(inputs[i], problem.start(lag[None]), i, rows[at : at + 1])
            at += 1
        for j in range(lagged):
            rows[at] = inputs[i, o.first - nk - j :][:n]
            at += 1
    if not record.at_rest:
        rows[at + 1 :] = np.exp(np.arange(n) / -lags[:, None])
    return rows


def _inverses(grams: Array) -> Array:
    """Inverses of a pile of normal equations; directions without support are left out."""
    if not grams.shape[-1]:
        return grams
    size = np.sqrt(np.maximum(np.diagonal(grams, axis1=1, axis2=2), 0.0))
    # What a start inside a long hole leaves behind it is gone: no direction, not one to be scaled.
    size = np.where(size > MIN_SIZE, size, 1.0)
    scale = size[:, :, None] * size[:, None, :]
    return np.asarray(np.linalg.pinv(grams / scale, rcond=MIN_DIRECTION, hermitian=True) / scale)
