"""The output-error problem y = Σ B/F u + offset + what is left of the start + noise.

For given denominators F everything else is linear and is projected out: numerators, one offset for
each experiment and, within each record, the free responses of F from an unknown state. What
remains is searched by two kinds of step that share all their filters:

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

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.transfer.orders import Orders
from thermaltool.fitting.transfer.polynomials import (
    difference_basis,
    from_lags,
    partial_fractions,
    stabilized,
)
from thermaltool.signals.gauss_newton import solve


@dataclass(frozen=True)
class Projection:
    """The linear parameters for given denominators.

    Attributes
    ----------
    linear : ndarray
        Numerators (in differences), offsets.
    loss : float [unit²]
        Sum of the squared errors.
    free : tuple of ndarray
        For each used record the weights of its free responses.
    rows : tuple of ndarray
        For each used record its columns, each a row: room for those of the denominators, then
        its numerators, its offset and its free responses.
    """

    linear: Array
    loss: float
    free: tuple[Array, ...] = ()
    rows: tuple[Array, ...] = field(default=(), compare=False, repr=False)


@dataclass(frozen=True)
class Slopes:
    """Sums over all rows that a step needs, the free responses of each record projected out.

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

    data: TrainingData
    orders: Orders
    whitening: tuple[Array, Array] | None = None
    _basis: dict[int, Array] = field(default_factory=dict, compare=False)

    def basis(self, n: int) -> Array:
        """See `difference_basis`."""
        if n not in self._basis:
            self._basis[n] = difference_basis(n)
        return self._basis[n]

    @cached_property
    def rows(self) -> int:
        """Readings that count."""
        return sum(int(self._counted[k].sum()) for k in self.used)

    @cached_property
    def used(self) -> list[int]:
        """Which records have readings enough to say anything."""
        least = self.orders.shortest - self.orders.first
        known = (np.isfinite(self.output(k)).sum() for k in range(len(self.data.records)))
        return [k for k, readings in enumerate(known) if readings > least]

    def output(self, k: int) -> Array:
        """Output of record k behind the rows that its start takes; NaN where it is missing."""
        return self.data.y[k][0, self.orders.first :]

    @cached_property
    def _counted(self) -> tuple[NDArray[np.bool_], ...]:
        """Rows of each record whose reading counts: whitened, with all that the filter takes."""
        found = []
        for k in range(len(self.data.records)):
            known = np.isfinite(self.output(k))
            counts = known.copy()
            for lag in range(1, 1 if self.whitening is None else len(self.whitening[0])):
                counts[lag:] &= known[:-lag]
            found.append(counts)
        return tuple(found)

    @cached_property
    def shared_count(self) -> int:
        """Linear parameters that all records share: numerators and offsets."""
        return sum(self.orders.nb) + self.data.experiments

    @cached_property
    def linear_count(self) -> int:
        """All linear parameters, those of the free responses as well."""
        free = sum(not self.data.records[k].at_rest for k in self.used) * sum(self.orders.nf)
        return self.shared_count + free

    def place(self, k: int) -> NDArray[np.intp]:
        """Where the numerators and the offset of record k stand among those shared."""
        return self._places[k]

    @cached_property
    def _places(self) -> tuple[NDArray[np.intp], ...]:
        own = sum(self.orders.nb)
        return tuple(np.append(np.arange(own), own + r.origin) for r in self.data.records)

    def _columns(self, k: int, F: Sequence[Array]) -> Array:
        """Of record k, each a row: room for the denominators, numerators, offset, responses."""
        record = self.data.records[k]
        o, n = self.orders, len(record) - self.orders.first
        searched, own = sum(o.nf), sum(o.nb)
        rows = np.empty((searched + own + 1 + (0 if record.at_rest else searched), n))
        at, free = np.cumsum([searched, *o.nb]), searched + own + 1
        rows[free - 1] = 1.0
        for group, f in zip(o.groups, F, strict=True):
            for i in group:
                self.numerators(self.data.u[k][i], f, i, rows[at[i] : at[i + 1]])
            if not record.at_rest:
                rows[free : free + len(f) - 1] = free_responses(self.recursion(f), n)
                free += len(f) - 1
        return rows

    def recursion(self, f: Array) -> Array:
        """The denominator in q^-1 whose free responses are those of `f`."""
        return f

    def start(self, lags: Array) -> Array:
        """A denominator of these time constants, in samples."""
        return from_lags(lags)

    def only(self, data: TrainingData, orders: Orders) -> Problem:
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
                x = x[1:] - x[:-1]
            begin = self.orders.first - self.orders.nk[i] - j
            out[j] = x[begin : begin + n]

    def _follow(self, x: Array, f: Array, out: Array) -> None:
        """−q^-1 (1 − q^-1)^j x/F into the rows `out`: how the output follows a change of F."""
        for j in range(len(out)):
            if j:
                out[j, 0], out[j, 1:] = out[j - 1, 0], out[j - 1, 1:] - out[j - 1, :-1]
            else:
                out[0, 0], out[0, 1:] = 0.0, lfilter([-1.0], f, x)[:-1]

    def denominators(self, signals: Sequence[Array], F: Sequence[Array], out: Array) -> None:
        """Derivatives of filtered signals by the coefficients of their denominators, into `out`."""
        at = 0
        for x, f in zip(signals, F, strict=True):
            self._follow(x, f, out[at : at + len(f) - 1])
            at += len(f) - 1

    def white(self, rows: Array, k: int) -> Array:
        """Rows of record k as they count: whitened, and zero where the output is missing.

        The noise model begins anew behind a hole: what it takes of the rows there is not known.
        """
        counts = self._counted[k]
        if not counts.all():
            rows = np.where(np.isfinite(self.output(k)), rows, 0.0)
        if self.whitening is None:
            return rows
        D, C = self.whitening
        if counts.all():
            return np.asarray(lfilter(D, C, rows))
        innovations = np.where(counts, lfilter(D, [1.0], rows), 0.0)
        return np.where(counts, lfilter([1.0], C, innovations), 0.0)

    def project(self, F: Sequence[Array], keep: bool = True) -> Projection:
        """Numerators, offsets and free responses by least squares."""
        n, searched = self.shared_count, sum(self.orders.nf)
        gram, right, power, kept, parts = np.zeros((n, n)), np.zeros(n), 0.0, [], []
        for k in self.used:
            columns, y = self._columns(k, F), self.white(self.output(k), k)
            rows, place = self.white(columns[searched:], k), self.place(k)
            own, with_output, count = rows @ rows.T, rows @ y, len(place)
            known = np.empty((len(own) - count, count + 1))
            known[:, :count], known[:, count] = own[count:, :count], with_output[count:]
            inner = solve(own[count:, count:], known)
            across = own[:count, count:]
            gram[place[:, None], place] += own[:count, :count] - across @ inner[:, :count]
            right[place] += with_output[:count] - across @ inner[:, count]
            power += float(y @ y) - float(with_output[count:] @ inner[:, count])
            parts.append((place, inner))
            if keep:
                kept.append(columns)
        linear = solve(gram, right)
        free = tuple(inner[:, -1] - inner[:, :-1] @ linear[place] for place, inner in parts)
        return Projection(linear, max(power - float(linear @ right), 0.0), free, tuple(kept))

    def slopes(self, F: Sequence[Array], here: Projection, mixed: bool = True) -> Slopes:
        """The sums for a step from `F`."""
        searched = sum(self.orders.nf)
        size = searched + self.shared_count
        gram, cross = np.zeros((size, size)), np.zeros((size, searched))
        score, loss = np.zeros(size), 0.0
        for k, (place, Z, error) in zip(self.used, self.instruments(F, here), strict=True):
            e, n = self.white(error, k), len(place)
            own = self.white(Z, k)
            products, with_error = own @ own.T, own @ e
            inner = solve(products[n:, n:], products[n:, :n])
            gram[place[:, None], place] += products[:n, :n] - products[:n, n:] @ inner
            score[place] += with_error[:n] - inner.T @ with_error[n:]
            loss += float(e @ e)
            if mixed:
                carried = np.empty((searched, len(error)))
                # A missing reading is taken to be what the model has: the steps end at the same.
                self.denominators([np.nan_to_num(error)] * len(F), F, carried)
                through = own @ self.white(carried, k).T
                cross[place] += through[:n] - inner.T @ through[n:]
        whole = gram.copy()
        whole[:, :searched] += cross
        return Slopes(gram, whole, score, loss, searched)

    def instruments(
        self, F: Sequence[Array], here: Projection
    ) -> Iterator[tuple[NDArray[np.intp], Array, Array]]:
        """For each used record: places of its shared columns, its columns, the error or NaN.

        The columns that are not shared, those of its free responses, come last.
        """
        searched = sum(self.orders.nf)
        for k, rows, (error, signals) in zip(self.used, here.rows, self.errors(here), strict=True):
            self.denominators(signals, F, rows[:searched])
            place = np.concatenate([np.arange(searched), searched + self.place(k)])
            yield place, rows, error

    def errors(self, here: Projection) -> Iterator[tuple[Array, list[Array]]]:
        """For each used record: its error, and the response of each group without the offset.

        The error is NaN where the output is missing.
        """
        o, searched = self.orders, sum(self.orders.nf)
        edges = np.cumsum([0, *o.nb])
        for k, columns, free_weights in zip(self.used, here.rows, here.free, strict=True):
            rows = columns[searched:]
            theta = np.concatenate([here.linear[self.place(k)], free_weights])
            error = self.output(k) - theta @ rows
            signals, free = [], sum(o.nb) + 1
            for group, n in zip(o.groups, o.nf, strict=True):
                only = np.zeros(len(theta))
                own = [np.arange(edges[i], edges[i + 1]) for i in group]
                state = np.arange(free, free + (0 if self.data.records[k].at_rest else n))
                place = np.concatenate([*own, state])
                only[place] = theta[place]
                signals.append(only @ rows)
                free += n
            yield error, signals

    def steps_between(self, f: Array, after: Array) -> Array:
        """The steps of `moved` that lead from one denominator to others.

        Parameters
        ----------
        f : ndarray, shape (n + 1,)
        after : ndarray, shape (m, n + 1)

        Returns
        -------
        steps : ndarray, shape (n, m)
        """
        return np.asarray(np.linalg.solve(self.basis(len(f) - 1).T, (after - f)[:, 1:].T))

    def moved(self, F: Sequence[Array], step: Array) -> tuple[Array, ...]:
        """Denominators after a step in the difference basis, made stable."""
        result, at = [], 0
        for f in F:
            n = len(f) - 1
            after = np.concatenate([[1.0], f[1:] + step[at : at + n] @ self.basis(n)])
            result.append(stabilized(after) if np.isfinite(after).all() else after)
            at += n
        return tuple(result)


def free_responses(f: Array, n: int) -> Array:
    """What a state of 1/F leaves behind, in differences, shape (nf, n)."""
    rows = np.zeros((len(f) - 1, n))
    row = np.zeros(n)
    row[:1] = 1.0
    row = lfilter([1.0], f, row)
    for j in range(len(rows)):
        rows[j] = row
        row = np.diff(row, prepend=0.0)
    return rows
