"""Poles behind one combination of the inputs each: the residues of a minimal realization.

A state of a minimal realization with simple poles takes one combination of the inputs, its
participation factors, and acts on every output by one weight, its mode shape: the residue matrix
of each pole has rank one (Kailath 1980, Linear Systems, 6.5), m + p numbers in place of m · p. For
given real poles and participations the weights and offsets are linear; all that a step needs of
the rows are the sums of products of a few signals, piece by piece.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, solve_triangular

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.joint import MIN_LOSS, ProjectedOutput, Sensitivities, criterion
from thermaltool.fitting.subspace.problem import LOG_DIFFERENCE, SubspaceProblem
from thermaltool.fitting.subspace.sections import PoleSection, responses
from thermaltool.signals.gauss_newton import solve

# Share of the diagonal that a singular matrix of the signals of a pole to come is lifted by.
LIFTED_SHARE = 1e-9


@dataclass(frozen=True)
class ModalStart:
    """Poles and what drives each.

    Attributes
    ----------
    rates : ndarray, shape (N,)
        Logarithms of the rates [1/sample period].
    participations : ndarray, shape (N, m)
        Of the inputs in their `scales`; rows of length one.
    """

    rates: Array
    participations: Array

    @property
    def sections(self) -> tuple[PoleSection, ...]:
        """Each pole by itself."""
        return tuple(PoleSection((float(rate),)) for rate in self.rates)


@dataclass(frozen=True)
class Signals:
    """Signals of one piece, without what its start explains of them.

    Attributes
    ----------
    values : ndarray, shape (N · m + N + others + N or 0 + p, rows)
        Responses of every pole to every input, slopes of those to its combination, other columns,
        slopes of what the start leaves behind, outputs.
    taken : ndarray, shape (as many, N or 0)
        What the start explains.
    """

    values: Array
    taken: Array

    @cached_property
    def gram(self) -> Array:
        """Sums of products of the signals."""
        return np.asarray(self.values @ self.values.T)


@dataclass(frozen=True)
class ModalPoint:
    """Poles and participations with all that is linear for them.

    Attributes
    ----------
    start : ModalStart
    problem : ModalProblem
    linear : ndarray, shape (p, N + others)
        Weights of every pole, feedthrough of every input where there is any, offsets.
    gram : ndarray, shape (N + others, N + others)
    losses : ndarray, shape (p,) [unit²]
    pieces : tuple of Signals
    """

    start: ModalStart
    problem: ModalProblem
    linear: Array
    gram: Array
    losses: Array
    pieces: tuple[Signals, ...]

    @property
    def rows(self) -> int:
        """Rows that count."""
        return sum(piece.values.shape[1] for piece in self.pieces)

    @cached_property
    def criterion(self) -> float:
        """½ Σ n ln(loss/n) over the outputs."""
        return criterion([(float(loss), self.rows) for loss in self.losses])

    @cached_property
    def tangents(self) -> Array:
        """Directions in which the participations can move, shape (N, m − 1, m)."""
        m = self.start.participations.shape[1]
        found = [np.linalg.svd(b[None])[2][1:] for b in self.start.participations]
        return np.array(found).reshape(len(found), m - 1, m)

    def slopes_of(self, k: int, piece: Signals) -> Array:
        """How output k follows what is searched, as sums of the signals of a piece.

        Parameters
        ----------
        k : int
        piece : Signals

        Returns
        -------
        ndarray, shape (N · m, signals)
            By the logarithms of the rates, then along the tangents pole by pole.
        """
        n, m = self.start.participations.shape
        found, weights = np.zeros((n * m, len(piece.values))), self.linear[k, :n]
        modes = np.arange(n)
        found[modes, n * m + modes] = weights
        if piece.taken.shape[1]:
            left = self.errors_of(piece)[k] @ piece.taken
            found[modes, n * m + n + self.problem.others + modes] = left
        for j, (weight, own) in enumerate(zip(weights, self.tangents, strict=True)):
            at = n + j * (m - 1)
            found[at : at + m - 1, j * m : (j + 1) * m] = weight * own
        return found

    def columns_of(self, piece: Signals) -> Array:
        """The linear columns as sums of signals of a piece, shape (N + others, signals)."""
        n, m = self.start.participations.shape
        return _mixing(self.start.participations, self.problem.others,
                       len(piece.values), n * m + n)  # fmt: skip

    def errors_of(self, piece: Signals) -> Array:
        """The errors of all outputs as sums of the signals of a piece, shape (p, signals)."""
        found = -self.linear @ self.columns_of(piece)
        found[:, -len(self.linear) :] += np.eye(len(self.linear))
        return np.asarray(found)

    @cached_property
    def linearized(self) -> list[ProjectedOutput]:
        """Every output with its slopes by what is searched, the linear parameters projected out."""
        found = []
        for k, linear in enumerate(self.linear):
            q = self.start.participations.size
            inner, across, pull = np.zeros((q, q)), np.zeros((q, len(linear))), np.zeros(q)
            for piece in self.pieces:
                slopes = self.slopes_of(k, piece) @ piece.gram
                inner += slopes @ self.slopes_of(k, piece).T
                across += slopes @ self.columns_of(piece).T
                pull += slopes @ self.errors_of(piece)[k]
            by = solve(self.gram, across.T)
            found.append(ProjectedOutput(linear, float(self.losses[k]), self.rows, by, self.gram,
                                         inner - across @ by, pull))  # fmt: skip
        return found

    def sensitivities(self) -> Iterator[Sensitivities]:
        """How every piece follows the parameters."""
        place = np.arange(len(self.gram))
        for j, piece in enumerate(self.pieces):
            values = self.problem.problem.spread(j, piece.values)
            columns = self.columns_of(piece) @ values
            slopes = [
                self.slopes_of(k, piece) @ values - f.by_searched.T @ columns
                for k, f in enumerate(self.linearized)
            ]
            yield Sensitivities(place, slopes, [columns] * len(slopes))


@dataclass(frozen=True)
class ModalProblem:
    """Least squares of all outputs for given poles and participations.

    Attributes
    ----------
    problem : SubspaceProblem
    """

    problem: SubspaceProblem

    @property
    def data(self) -> TrainingData:
        """What is fitted."""
        return self.problem.data

    @property
    def others(self) -> int:
        """Linear columns beside those of the poles: feedthrough of every input, offsets."""
        return len(self.data.inputs) * self.problem.direct + self.data.experiments

    @cached_property
    def scales(self) -> Array:
        """Deviation of every input, shape (m,); one where it stands still."""
        deviation = np.hstack(self.data.u).std(axis=1)
        return np.asarray(np.where(deviation > 0, deviation, 1.0))

    def _responses(self, j: int, rates: Array) -> Array:
        """Responses to the scaled inputs and other columns, shape (N · m + others, rows)."""
        found = self.problem.shared(j, ModalStart(rates, np.zeros((0, 0))).sections)
        found[: len(rates) * len(self.scales)] /= np.tile(self.scales, len(rates))[:, None]
        return found

    def _slopes(self, j: int, start: ModalStart) -> Array:
        """Slopes of every pole's response to its combination of the inputs, shape (N, rows)."""
        driven = self.problem.driven[j] / self.scales[:, None]
        holds = self.data.holds
        found = np.zeros((len(start.rates), int(self.problem.known[j].sum())))
        for hold in set(holds):
            alike = [own == hold for own in holds]
            mixed = start.participations[:, alike] @ driven[alike]
            for k, (rate, drive) in enumerate(zip(start.rates, mixed, strict=True)):
                faster, slower = (
                    responses(PoleSection((float(rate + sign),)), drive[None], (hold,))
                    for sign in (LOG_DIFFERENCE, -LOG_DIFFERENCE)
                )
                slope = (faster - slower)[0] / (2 * LOG_DIFFERENCE)
                found[k] += self.problem.counted(j, slope)
        return found

    def _free(self, j: int, rates: Array) -> Array:
        return self.problem.free(j, ModalStart(rates, np.zeros((0, 0))).sections)

    def signals(self, j: int, start: ModalStart, further: Array | None = None) -> Signals:
        """Signals of piece j.

        Parameters
        ----------
        j : int
        start : ModalStart
        further : ndarray, optional
            Logarithms of rates whose responses follow those of the others; then without slopes.
        """
        (n, m), e = start.participations.shape, self.others
        y, free = self.problem.measured(j), self._free(j, start.rates)
        if further is not None:
            parts = [self._responses(j, np.append(start.rates, further)), y]
        else:
            faster, slower = (self._free(j, start.rates + sign * LOG_DIFFERENCE)
                              for sign in (1, -1))  # fmt: skip
            of_start = (faster - slower) / (2 * LOG_DIFFERENCE)
            own = self._responses(j, start.rates)
            parts = [own[: n * m], self._slopes(j, start), own[-e:], of_start, y]
        values = np.vstack(parts)
        taken = np.zeros((len(values), len(free)))
        if len(free):
            taken = solve(free @ free.T, free @ values.T).T
            values = values - taken @ free
        return Signals(values, taken)

    def project(self, start: ModalStart) -> ModalPoint:
        """All that is linear for these poles and participations.

        Parameters
        ----------
        start : ModalStart
        """
        n, m = start.participations.shape
        pieces = tuple(self.signals(j, start) for j in range(len(self.data.records)))
        p, e = len(self.data.outputs), self.others
        gram, cross, power = np.zeros((n + e, n + e)), np.zeros((n + e, p)), np.zeros(p)
        for piece in pieces:
            mixing = _mixing(start.participations, e, len(piece.values), n * m + n)
            mixed = mixing @ piece.gram
            gram += mixed @ mixing.T
            cross += mixed[:, -p:]
        linear = solve(gram, cross).T
        for piece in pieces:
            mixing = _mixing(start.participations, e, len(piece.values), n * m + n)
            errors = piece.values[-p:] - linear @ (mixing @ piece.values)
            power += np.sum(errors**2, axis=1)
        losses = np.maximum(power, MIN_LOSS * self.problem.powers)
        return ModalPoint(start, self, linear, gram, losses, pieces)

    def one_more(self, point: ModalPoint, rates: Array) -> list[ModalStart]:
        """Starts with one pole more, the best one of lowest error first.

        Of each rate the combination of the inputs that explains most of what is left, by reduced
        rank regression (Anderson 1951).

        Parameters
        ----------
        point : ModalPoint
        rates : ndarray
            Logarithms of those that are tried.
        """
        start, p, e = point.start, len(self.data.outputs), self.others
        n, m = start.participations.shape
        whole: Array | None = None
        for j in range(len(self.data.records)):
            own = self.signals(j, start, rates).gram
            whole = own if whole is None else whole + own
        assert whole is not None
        at = (n + len(rates)) * m
        mixing = _mixing(start.participations, e, len(whole), at)
        weights = 1 / np.sqrt(point.losses)
        across = mixing @ whole
        off = solve(across @ mixing.T, across)
        left = whole - across.T @ off
        found = []
        for k, rate in enumerate(rates):
            own_places = slice((n + k) * m, (n + k + 1) * m)
            own, cross = left[own_places, own_places], left[own_places, -p:] * weights
            own = own + LIFTED_SHARE * max(float(np.trace(whole[own_places, own_places])),
                                           1e-300) * np.eye(m)  # fmt: skip
            lower = cho_factor(own, lower=True)[0]
            towards, gains, _ = np.linalg.svd(solve_triangular(lower, cross, lower=True))
            b = solve_triangular(lower, towards[:, 0], lower=True, trans=1)
            b /= np.linalg.norm(b)
            found.append((float(gains[0]), ModalStart(
                np.append(start.rates, rate), np.vstack([start.participations, b]))))  # fmt: skip
        return [each for _, each in sorted(found, key=lambda pair: -pair[0])]


def _mixing(participations: Array, others: int, signals: int, others_at: int) -> Array:
    """The linear columns as sums of signals, shape (N + others, signals)."""
    n, m = participations.shape
    found = np.zeros((n + others, signals))
    for k, b in enumerate(participations):
        found[k, k * m : (k + 1) * m] = b
    rows = np.arange(others)
    found[n + rows, others_at + rows] = 1.0
    return found
