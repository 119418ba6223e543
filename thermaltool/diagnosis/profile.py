"""The best amplitudes of a cause from inner products alone.

Of signatures with the residual and with each other, under every noise level, nuisance projected
out; the noise of each output is estimated anew for every candidate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermaltool.effects.effect import Float

Index = NDArray[np.int64]


@dataclass(frozen=True)
class Base:
    """An output without a further cause, in one state, at every level.

    Attributes
    ----------
    square, logdet : ndarray, shape (levels,)
    dof : int
    least : float
        Sum of squares that stands for rounding: nothing is explained better than that.
    whitening : list of ndarray, shape (c, r)
        Combinations of the active nuisance that are orthonormal, priors included.
    pull : list of ndarray, shape (r,)
        Of those combinations by the residual.
    fitted : ndarray, shape (levels, c)
        Best nuisance.
    """

    square: Float
    logdet: Float
    dof: float
    least: float
    active: Index
    whitening: list[Float]
    pull: list[Float]
    fitted: Float

    def negative_log(self, square: Float) -> Float:
        """Negative log likelihood for sums of squares, shape (..., levels)."""
        return 0.5 * (self.dof * np.log(np.maximum(square, self.least) / self.dof) + self.logdet)

    @cached_property
    def best(self) -> float:
        return float(np.min(self.negative_log(self.square)))

    @property
    def white(self) -> float:
        """Standard deviation of the white noise of a reading."""
        return float(np.sqrt(self.square[self.level] / self.dof))

    @property
    def level(self) -> int:
        return int(np.argmin(self.negative_log(self.square)))


@dataclass(frozen=True)
class Reduced:
    """Products of signatures with the residual and each other, nuisance projected out."""

    base: Base
    b: Float  # (levels, k)
    own: Float  # (levels, k)
    pairs: Mapping[tuple[int, int], Float]

    @cached_property
    def most(self) -> Float:
        """Largest rise of the log likelihood by each signature alone, shape (k,)."""
        removed = np.where(self.own > 0, self.b**2 / np.where(self.own > 0, self.own, 1.0), 0.0)
        negative = self.base.negative_log((self.base.square[:, None] - removed).T)
        return np.asarray(self.base.best - negative.min(axis=1))

    def part(self, index: Sequence[int], amplitudes: Sequence[int]) -> Part:
        """Signatures `index` as part of a candidate with these amplitudes."""
        C = np.empty((len(self.b), len(index), len(index)))
        for i, p in enumerate(index):
            for j, q in enumerate(index):
                C[:, i, j] = self.own[:, p] if p == q else self.pairs[(min(p, q), max(p, q))]
        return Part(self.b[:, list(index)], C, np.array(amplitudes, int), self.base)


@dataclass(frozen=True)
class Part:
    """What a candidate does to one output: its signatures there and whose amplitudes they have."""

    b: Float  # (levels, m)
    C: Float  # (levels, m, m)
    amplitudes: Index  # (m,) into the candidate's amplitudes
    base: Base

    def negative_log(self, amplitudes: Float) -> Float:
        """Negative log likelihood with a candidate's amplitudes, shape (levels,)."""
        return self.base.negative_log(self.square(amplitudes))

    def square(self, amplitudes: Float) -> Float:
        """Sum of squares that is left, shape (levels,)."""
        a = amplitudes[self.amplitudes]
        explained = 2 * self.b @ a - np.einsum("i,gij,j->g", a, self.C, a)
        return np.asarray(self.base.square - explained)


@dataclass(frozen=True)
class Profile:
    """The best amplitudes of a candidate.

    Attributes
    ----------
    amplitudes : ndarray, shape (p,)
    gains : ndarray, shape (outputs,)
        Rise of the log likelihood of each output.
    levels : list of int
        Noise level of each output.
    """

    amplitudes: Float
    gains: Float
    levels: list[int]


def profile(parts: Sequence[Part], size: int, fixed: Float | None = None) -> Profile:
    """Maximize the likelihood over amplitudes and, for each output, its noise.

    Parameters
    ----------
    parts : sequence of Part
    size : int
        Number of amplitudes.
    fixed : ndarray, shape (size,), optional
        Amplitudes that are given.
    """
    levels = [_independent(part) for part in parts]
    amplitudes = np.zeros(size)
    for _ in range(8):
        H, h = np.zeros((size, size)), np.zeros(size)
        for part, g in zip(parts, levels, strict=True):
            rows = part.amplitudes
            square = float(part.square(amplitudes)[g])
            variance = max(square, part.base.least) / part.base.dof
            H[np.ix_(rows, rows)] += part.C[g] / variance
            h[rows] += part.b[g] / variance
        before = amplitudes
        amplitudes = _inverse(H) @ h if fixed is None else fixed
        new = [int(np.argmin(part.negative_log(amplitudes))) for part in parts]
        settled = new == levels and np.allclose(before, amplitudes, rtol=1e-3)
        levels = new
        if settled:
            break
    gains = [
        part.base.best - part.negative_log(amplitudes)[g]
        for part, g in zip(parts, levels, strict=True)
    ]
    return Profile(amplitudes, np.array(gains), levels)


def _independent(part: Part) -> int:
    """The level at which a part would explain its output best by itself."""
    if part.b.shape[1] == 1:
        own = part.C[:, 0, 0]
        removed = np.where(own > 0, part.b[:, 0] ** 2 / np.where(own > 0, own, 1.0), 0.0)
    else:
        size = np.sqrt(np.maximum(np.einsum("gii->gi", part.C), 1e-300))
        scaled = part.C / (size[:, :, None] * size[:, None, :])
        inverse = np.linalg.pinv(scaled, rcond=1e-10, hermitian=True)
        b = part.b / size
        removed = np.einsum("gi,gij,gj->g", b, inverse, b)
    return int(np.argmin(part.base.negative_log(part.base.square - removed)))


def _inverse(matrix: Float) -> Float:
    if matrix.shape == (1, 1):
        return 1.0 / matrix if matrix[0, 0] > 0 else np.zeros((1, 1))
    size = np.sqrt(np.maximum(np.diag(matrix), 0))
    size[size == 0] = np.inf
    scaled = matrix / np.outer(size, size)
    return np.asarray(np.linalg.pinv(scaled, rcond=1e-10, hermitian=True) / np.outer(size, size))
