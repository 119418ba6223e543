"""Gram matrices of lagged series from their correlations: no matrix of lagged columns is built."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MAX_PRODUCT = 8192  # samples: no library splits so short a product over threads
MAX_DENSE_RESPONSE = 1024  # samples: a longer response is not laid out as a matrix, for memory


def lagged_products(u: Array, v: Array, rows: int, columns: int, first: int) -> Array:
    """M_ij = Σ_{t >= first} u_{t-i} v_{t-j}, ndarray (rows + 1, columns + 1).

    Only the first row and the first column are sums; the others follow by taking the ends in and
    out: M_{i+1,j+1} = M_ij + u_{first-1-i} v_{first-1-j} - u_{n-1-i} v_{n-1-j}.

    Parameters
    ----------
    u, v : ndarray (n,)
    first : int
        At least `rows` and `columns`, below n.
    """
    n = u.size
    M = np.empty((rows + 1, columns + 1))
    M[0] = [inner(u[first:], v[first - j : n - j]) for j in range(columns + 1)]
    M[:, 0] = [inner(u[first - i : n - i], v[first:]) for i in range(rows + 1)]
    j = np.arange(columns)
    before, after = v[first - 1 - j], v[n - 1 - j]
    for i in range(rows):
        M[i + 1, 1:] = M[i, :-1] + u[first - 1 - i] * before - u[n - 1 - i] * after
    return M


def inner(u: Array, v: Array) -> float:
    """u'v of two vectors, in blocks.

    A linear-algebra library that splits a long product over threads waits for them longer than
    the product takes, much longer where the cores are busy.
    """
    if u.size <= MAX_PRODUCT:
        return float(u @ v)
    edges = range(0, u.size, MAX_PRODUCT)
    return float(sum([u[k : k + MAX_PRODUCT] @ v[k : k + MAX_PRODUCT] for k in edges]))


def products_of(rows: Array) -> Array:
    """rows rows', ndarray (c, c), of few long rows."""
    count = rows.shape[0]
    out = np.empty((count, count))
    for i in range(count):
        for j in range(i, count):
            out[i, j] = out[j, i] = inner(rows[i], rows[j])
    return out


def lagged_gram(u: Array, v: Array, p: int, q: int) -> Array:
    """Gram matrix of u_{t-1..t-p}, v_{t-1..t-q} from their correlations (ends left out)."""
    n = u.size
    uu = [inner(u[k:], u[: n - k]) for k in range(p)]
    vv = [inner(v[k:], v[: n - k]) for k in range(q)]
    # u_{t-i} v_{t-j}: lag j - i of u ahead of v.
    ahead = [inner(v[k:], u[: n - k]) for k in range(p - 1, 0, -1)]
    uv = ahead + [inner(u[k:], v[: n - k]) for k in range(q)]
    gram = np.empty((p + q, p + q))
    i, j = np.arange(p), np.arange(q)
    if p:
        gram[:p, :p] = np.array(uu)[np.abs(i[:, None] - i)]
    if q:
        gram[p:, p:] = np.array(vv)[np.abs(j[:, None] - j)]
    if p and q:
        gram[:p, p:] = np.array(uv)[j - i[:, None] + p - 1]
        gram[p:, :p] = gram[:p, p:].T
    return gram


class Shifted:
    """H: column i is a response `h` delayed by i; as many rows as differ from zero.

    A short response is laid out as a matrix; a long one never is.

    Parameters
    ----------
    h : ndarray (k,)
    order : int
        Columns.
    size : int
        Largest number of rows.
    """

    def __init__(self, h: Array, order: int, size: int) -> None:
        self.h, self.order = h, order
        self.rows = min(h.size + order - 1, size)
        self.matrix = self._delayed(h, order) if h.size <= MAX_DENSE_RESPONSE else None

    def _delayed(self, h: Array, columns: int) -> Array:
        H = np.zeros((self.rows, columns))
        for i in range(min(columns, self.rows)):
            H[i : i + h.size, i] = h[: self.rows - i]
        return H

    def gram(self) -> Array:
        """H'H, ndarray (r, r)."""
        return self.products(self.h, self.order)

    def products(self, other: Array, columns: int) -> Array:
        """H'M, ndarray (r, columns), M made of `other` as H is of `h`."""
        if self.matrix is not None:
            second = self.matrix if other is self.h else self._delayed(other, columns)
            return np.asarray(self.matrix.T @ second)
        first = max(self.order, columns) - 1
        padded = np.zeros((2, first + self.rows))
        for row, response in zip(padded, (self.h, other), strict=True):
            row[first : first + response.size] = response[: self.rows]
        return lagged_products(padded[0], padded[1], self.order - 1, columns - 1, first)

    def against(self, a: Array) -> Array:
        """H'a, ndarray (r, c), for series in the rows of `a`, ndarray (c, n)."""
        if self.matrix is not None:
            return np.asarray(self.matrix.T @ a[:, : self.rows].T)
        ends = [min(self.h.size, self.rows - i) for i in range(self.order)]
        return np.array([[inner(self.h[:n], row[i : i + n]) for row in a]
                         for i, n in enumerate(ends)])  # fmt: skip

    def spread(self, state: Array) -> Array:
        """H c for states in the columns of `state`, as rows, ndarray (c, rows)."""
        if self.matrix is not None:
            return np.asarray((self.matrix @ state).T)
        return np.stack([np.convolve(self.h, c)[: self.rows] for c in state.T])
