"""The output-error problem y = Σ B/F u + offset + what is left of the start + noise.

For given denominators F everything else is linear and is projected out: numerators, one offset for
each experiment and, for each stretch, the free responses of F from an unknown state. What remains
is searched by two kinds of step that share all their filters:

- refined instrumental variables (SRIV; Young 2011, chapter 7): the equation is filtered by 1/F,
  y = −ΔF·y/F + B·u/F + e, and the lags of y, which carry noise, are correlated with those of the
  noise-free output;
- Gauss-Newton on the prediction error: the same with the noise-free output on both sides.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from thermaltool.identification.transfer.data import Array, Data, Stretch
from thermaltool.identification.transfer.polynomials import (
    difference_basis,
    from_lags,
    partial_fractions,
    stabilized,
)

# Directions of the normal equations below this share of the largest are left out.
RANK = 1e-13


@dataclass(frozen=True)
class Orders:
    """Orders of one model.

    Attributes
    ----------
    nb, nk : tuple of int
        For each input: coefficients of B, and samples of delay before the first.
    nf : tuple of int
        Order of each denominator: one for each group of inputs.
    groups : tuple of tuple of int
        Inputs that share a denominator.
    """

    nb: tuple[int, ...]
    nf: tuple[int, ...]
    nk: tuple[int, ...]
    groups: tuple[tuple[int, ...], ...]

    @cached_property
    def first(self) -> int:
        """First row whose inputs are all in the record."""
        return max(b + k for b, k in zip(self.nb, self.nk, strict=True)) - 1

    @cached_property
    def shortest(self) -> int:
        """A stretch of no more rows says nothing: its start takes them."""
        return self.first + sum(self.nf) + 1

    @cached_property
    def parameters(self) -> int:
        return sum(self.nb) + sum(self.nf)


@dataclass(frozen=True)
class Projection:
    """The linear parameters for given denominators.

    Attributes
    ----------
    linear : ndarray
        Numerators (in differences), offsets, free responses.
    loss : float [unit²]
        Sum of the squared errors.
    rows : tuple of ndarray
        For each used stretch its columns, each a row: room for those of the denominators, then
        those of `linear`.
    """

    linear: Array
    loss: float
    rows: tuple[Array, ...] = field(default=(), compare=False, repr=False)


@dataclass(frozen=True)
class Slopes:
    """Sums over all rows that a step needs.

    Attributes
    ----------
    gram, mixed : ndarray, shape (p, p)
        Of the instruments with themselves and with the regressors that carry the noise.
    score : ndarray, shape (p,)
        Of the instruments with the error.
    loss : float
    searched : int
        How many of the p belong to the denominators; they come first.
    """

    gram: Array
    mixed: Array
    score: Array
    loss: float
    searched: int


@dataclass(frozen=True)
class Problem:
    """One data set and one choice of orders.

    Attributes
    ----------
    whitening : (ndarray, ndarray) or None
        D and C: all rows pass D/C first, where the noise is (C/D) white (RIV).
    """

    data: Data
    orders: Orders
    whitening: tuple[Array, Array] | None = None
    _basis: dict[int, Array] = field(default_factory=dict, compare=False)

    def basis(self, n: int) -> Array:
        if n not in self._basis:
            self._basis[n] = difference_basis(n)
        return self._basis[n]

    @cached_property
    def rows(self) -> int:
        """Rows that count."""
        return sum(len(s) - self.orders.first for s in self.used)

    @cached_property
    def used(self) -> list[Stretch]:
        """Stretches long enough to say anything."""
        return [s for s in self.data.stretches if len(s) > self.orders.shortest]

    @cached_property
    def linear_count(self) -> int:
        free = sum(not s.at_rest for s in self.used) * sum(self.orders.nf)
        return sum(self.orders.nb) + self.data.origins + free

    @cached_property
    def places(self) -> list[NDArray[np.intp]]:
        """Where the linear columns of each used stretch stand."""
        own, starts = sum(self.orders.nb), sum(self.orders.nf)
        begin, found = own + self.data.origins, []
        for s in self.used:
            free = np.arange(begin, begin + (0 if s.at_rest else starts))
            found.append(np.concatenate([np.arange(own), [own + s.origin], free]).astype(np.intp))
            begin += len(free)
        return found

    def _columns(self, stretch: Stretch, F: Sequence[Array]) -> Array:
        """Of one stretch, each a row: room for the denominators, numerators, offset, responses."""
        o, n = self.orders, len(stretch) - self.orders.first
        searched, own = sum(o.nf), sum(o.nb)
        rows = np.empty((searched + own + 1 + (0 if stretch.at_rest else searched), n))
        at, free = np.cumsum([searched, *o.nb]), searched + own + 1
        rows[free - 1] = 1.0
        impulse = np.zeros(n)
        impulse[0] = 1.0
        for group, f in zip(o.groups, F, strict=True):
            for i in group:
                self.numerators(stretch.inputs[i], f, i, rows[at[i] : at[i + 1]])
            response = lfilter([1.0], self.recursion(f), impulse)
            for j in range(0 if stretch.at_rest else len(f) - 1):
                rows[free, :j] = 0.0
                rows[free, j:] = response[: n - j]
                free += 1
        return rows

    def recursion(self, f: Array) -> Array:
        """The denominator in q^-1 whose free responses are those of `f`."""
        return f

    def start(self, lags: Array) -> Array:
        """A denominator of these time constants, in samples."""
        return from_lags(lags)

    def only(self, inputs: Sequence[int], data: Data, orders: Orders) -> Problem:
        """The same problem of some of the inputs."""
        return replace(self, data=data, orders=orders)

    def parts(self, lags: Array, nb: int) -> Array:
        """The numerators q^0, q^-1, ... over poles of these time constants in partial fractions.

        Parameters
        ----------
        lags : ndarray, shape (..., nf) [samples]
            Distinct.
        nb : int
            Of those above nf only nf are made: what is left are plain lags of the input.

        Returns
        -------
        parts : ndarray, shape (..., min(nb, nf), nf)
        """
        return partial_fractions(np.exp(-1.0 / lags), range(lags.shape[-1] - 1, -1, -1)[:nb])

    def numerators(self, u: Array, f: Array, i: int, out: Array) -> None:
        """(1 − q^-1)^j u/F, delayed, on the rows that count; into the rows `out`."""
        x = lfilter([1.0], f, u)
        n = len(x) - self.orders.first
        for j in range(len(out)):
            if j:
                x = np.diff(x)
            begin = self.orders.first - self.orders.nk[i] - j
            out[j] = x[begin : begin + n]

    def _follow(self, x: Array, f: Array, out: Array) -> None:
        """−q^-1 (1 − q^-1)^j x/F into the rows `out`: how the output follows a change of F."""
        for j in range(len(out)):
            if j:
                out[j, 0], out[j, 1:] = out[j - 1, 0], np.diff(out[j - 1])
            else:
                out[0, 0], out[0, 1:] = 0.0, lfilter([-1.0], f, x)[:-1]

    def denominators(self, signals: Sequence[Array], F: Sequence[Array], out: Array) -> None:
        at = 0
        for x, f in zip(signals, F, strict=True):
            self._follow(x, f, out[at : at + len(f) - 1])
            at += len(f) - 1

    def white(self, rows: Array) -> Array:
        return rows if self.whitening is None else lfilter(*self.whitening, rows)

    def project(self, F: Sequence[Array], keep: bool = True) -> Projection:
        """Numerators, offsets and free responses by least squares."""
        n, searched = self.linear_count, sum(self.orders.nf)
        gram, right, power, kept = np.zeros((n, n)), np.zeros(n), 0.0, []
        for s, place in zip(self.used, self.places, strict=True):
            columns, y = self._columns(s, F), self.white(s.output[self.orders.first :])
            rows = self.white(columns[searched:])
            gram[np.ix_(place, place)] += rows @ rows.T
            right[place] += rows @ y
            power += float(y @ y)
            if keep:
                kept.append(columns)
        linear = solve(gram, right)
        return Projection(linear, max(power - float(linear @ right), 0.0), tuple(kept))

    def slopes(self, F: Sequence[Array], here: Projection, mixed: bool = True) -> Slopes:
        """The sums for a step from `F`."""
        searched = sum(self.orders.nf)
        size = searched + self.linear_count
        gram, cross = np.zeros((size, size)), np.zeros((size, searched))
        score, loss = np.zeros(size), 0.0
        for place, Z, error in self.instruments(F, here):
            Z, e = self.white(Z), self.white(error)
            gram[np.ix_(place, place)] += Z @ Z.T
            score[place] += Z @ e
            loss += float(e @ e)
            if mixed:
                carried = np.empty((searched, len(error)))
                self.denominators([error] * len(F), F, carried)
                cross[place] += Z @ self.white(carried).T
        whole = gram.copy()
        whole[:, :searched] += cross
        return Slopes(gram, whole, score, loss, searched)

    def instruments(
        self, F: Sequence[Array], here: Projection
    ) -> Iterator[tuple[NDArray[np.intp], Array, Array]]:
        """For each used stretch: places of its columns, the columns, the error."""
        searched = sum(self.orders.nf)
        for k, (place, (error, signals)) in enumerate(
            zip(self.places, self.errors(here), strict=True)
        ):
            self.denominators(signals, F, here.rows[k][:searched])
            yield np.concatenate([np.arange(searched), searched + place]), here.rows[k], error

    def errors(self, here: Projection) -> Iterator[tuple[Array, list[Array]]]:
        """For each used stretch: its error, and the response of each group without the offset."""
        o, searched = self.orders, sum(self.orders.nf)
        edges = np.cumsum([0, *o.nb])
        for k, (s, at) in enumerate(zip(self.used, self.places, strict=True)):
            rows, theta = here.rows[k][searched:], here.linear[at]
            error = s.output[o.first :] - theta @ rows
            signals, free = [], sum(o.nb) + 1
            for group, n in zip(o.groups, o.nf, strict=True):
                only = np.zeros(len(theta))
                own = [np.arange(edges[i], edges[i + 1]) for i in group]
                state = np.arange(free, free + (0 if s.at_rest else n))
                place = np.concatenate([*own, state])
                only[place] = theta[place]
                signals.append(only @ rows)
                free += n
            yield error, signals

    def step_between(self, f: Array, after: Array) -> Array:
        """The step of `moved` that leads from one denominator to another."""
        return np.asarray(np.linalg.solve(self.basis(len(f) - 1).T, (after - f)[1:]))

    def moved(self, F: Sequence[Array], step: Array) -> tuple[Array, ...]:
        """Denominators after a step in the difference basis, made stable."""
        result, at = [], 0
        for f in F:
            n = len(f) - 1
            after = np.concatenate([[1.0], f[1:] + step[at : at + n] @ self.basis(n)])
            result.append(stabilized(after) if np.isfinite(after).all() else after)
            at += n
        return tuple(result)


def solve(matrix: Array, right: Array) -> Array:
    """matrix⁻¹ right, scaled first; directions without support stay at zero."""
    size = np.sqrt(np.abs(np.diag(matrix)))
    size = np.where(size > 0, size, 1.0)
    scaled = matrix / np.outer(size, size)
    answer = np.linalg.lstsq(scaled, (right.T / size).T, rcond=RANK)[0]
    return np.asarray((answer.T / size).T)
