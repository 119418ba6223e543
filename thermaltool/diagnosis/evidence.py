"""Evidence of a cause under white noise plus a slow discrepancy.

What a model misses is never white: a fit that takes it for white lets any flexible cause explain
it. The residual is therefore judged as white noise plus an Ornstein-Uhlenbeck discrepancy, both
estimated anew for every candidate (Kennedy & O'Hagan 2001), after everything that the model could
say for itself has been projected out: its own parameters within their calibration, a linear
response of the size of the calibration's own error, the offset of each log. Under this covariance
a cause enters by inner products of its signature alone, so that one pass judges the catalogue.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermaltool.diagnosis.observed import Observed
from thermaltool.effects.effect import Float
from thermaltool.signals.likelihood import Factor

State = frozenset[str]
Index = NDArray[np.int64]

# Groups of columns without a prior; all others have mean zero and variance one.
FLAT = ("offset", "accepted")
# A signature of which less than this share is left after projection cannot be seen.
INVISIBLE = 1e-5
_RATIOS = 10.0 ** np.arange(-2, 7)
_NEAR_RATIOS = (0.003, 0.02, 0.1, 0.35, 1.0, 3.0)
_NEAR_TAUS = (0.1, 0.33, 1.0, 3.0)


@dataclass(frozen=True)
class Level:
    """One noise level: products of the residual and the nuisance columns under it."""

    ratio: float
    tau: float
    factor: Factor
    solved: Float  # (n, 1 + c)
    gram: Float  # (1 + c, 1 + c)


@dataclass(frozen=True)
class Base:
    """An output without a further cause, in one state, at every level.

    Attributes
    ----------
    square, logdet : ndarray, shape (levels,)
    dof : int
    least : float
        Sum of squares that stands for rounding: nothing is explained better than that.
    inverse : list of ndarray (c, c), of the active nuisance
    fitted : ndarray, shape (levels, c)
        Best nuisance.
    """

    square: Float
    logdet: Float
    dof: float
    least: float
    active: Index
    inverse: list[Float]
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
class Products:
    """Signatures of one output under every level.

    Attributes
    ----------
    nuisance : ndarray, shape (levels, k, 1 + c)
        With the residual (first) and the nuisance.
    own : ndarray, shape (levels, k)
    pairs : mapping of (i, j) to ndarray, shape (levels,)
        Between signatures of one candidate.
    """

    nuisance: Float
    own: Float
    pairs: Mapping[tuple[int, int], Float]


class OutputEvidence:
    """Residual of one output, what may explain it for free, and its noise.

    Parameters
    ----------
    observed : Observed
    residual : ndarray, shape (n,)
    nuisance : mapping of group to ndarray, shape (n, c)
        ``offset`` and ``accepted`` are free; other groups count in units of their prior.
    centre : mapping of group to ndarray, shape (c,)
        Where a group stands already, in units of its prior.
    white : float
        White noise of a reading, from the differences of neighbours.
    state : frozenset of str
        Groups in use at first.
    limit : callable, optional
        Largest discrepancy of a time constant [s] that a clean log may show; with it the white
        noise, too, is held near `white` (by as many rows as there are). Without it both are free.
    """

    def __init__(
        self,
        observed: Observed,
        residual: Float,
        nuisance: Mapping[str, Float],
        centre: Mapping[str, Float],
        white: float,
        state: State,
        limit: Callable[[float], float] | None = None,
    ) -> None:
        self.observed, self.residual = observed, residual
        self.names = [name for name, block in nuisance.items() for _ in range(block.shape[1])]
        self.columns = np.column_stack([residual, *nuisance.values()])
        self.centre = np.concatenate(
            [centre.get(name, np.zeros(block.shape[1])) for name, block in nuisance.items()]
        )
        self.white = white
        # Of the rows, as independent readings: below one where slow misfit is taken for white.
        self.share: float
        self._bases: dict[State, Base] = {}
        self.trust = 0 if limit is None else self.observed.size
        noise = observed.noise

        def allowed(points: list[tuple[float, float]]) -> list[Level]:
            if limit is not None:
                points = [(min(r, (limit(t) / white) ** 2), t) for r, t in points]
            return [self._level(0.0, 1.0), *(self._level(*p) for p in dict.fromkeys(points))]

        if "white" in state:
            self.levels = [self._level(0.0, 1.0)]
            self.white = self.base(state).white
            self._bases.clear()
            self.share = self._effective(state)
            return
        self.share = 1.0
        taus = np.geomspace(3 * noise.period, max(noise.span / 2, 6 * noise.period), 7).tolist()
        self.levels = allowed([(r, t) for r in _RATIOS for t in taus])
        if limit is None:
            for _ in range(2):
                self.white = self.base(state).white
                self._bases.clear()
        best = self.levels[self.base(state).level]
        tau = best.tau if best.ratio else float(np.sqrt(taus[0] * taus[-1]))
        ratio = best.ratio or 0.1
        self.levels = allowed([(r * ratio, t * tau) for r in _NEAR_RATIOS for t in _NEAR_TAUS])
        self._bases.clear()

    def _effective(self, state: State) -> float:
        """Share of the rows that count as independent, by the correlation of neighbours."""
        base = self.base(state)
        left = self.residual - self.columns[:, base.active + 1] @ base.fitted[0]
        rho = float(left[1:] @ left[:-1] / (left @ left)) if np.any(left) else 0.0
        return float(np.clip((1 - rho) / (1 + rho), 1.0 / len(left), 1.0))

    def _level(self, ratio: float, tau: float) -> Level:
        factor = self.observed.noise.factor(ratio, tau)
        solved = factor.solve(self.columns)
        return Level(ratio, tau, factor, solved, self.columns.T @ solved)

    def active(self, state: State) -> Index:
        return np.array([k for k, name in enumerate(self.names) if name in state], int)

    def base(self, state: State) -> Base:
        """The output explained by the nuisance of `state` alone."""
        if state not in self._bases:
            self._bases[state] = self._base(state)
        return self._bases[state]

    def _base(self, state: State) -> Base:
        active = self.active(state)
        flat = np.array([self.names[k] in FLAT for k in active], bool)
        prior = self._precision(active)
        centre = np.where(flat, 0.0, self.centre[active])
        square, logdet, inverse, fitted = [], [], [], []
        for level in self.levels:
            gram = level.gram[np.ix_(active + 1, active + 1)]
            size = np.sqrt(np.diag(gram) + prior)
            size[size == 0] = 1.0
            scaled = (gram + np.diag(prior)) / np.outer(size, size)
            values, vectors = np.linalg.eigh(scaled)
            half = vectors[:, values > 1e-13] / size[:, None]
            inner = (half / values[values > 1e-13]) @ half.T
            pull = level.gram[0, active + 1] - prior * centre
            square.append(level.gram[0, 0] + float(prior @ centre**2) - float(pull @ inner @ pull))
            logdet.append(
                level.factor.logdet
                + float(np.sum(np.log(np.maximum(values, 1e-13))))
                + 2 * float(np.sum(np.log(size)))
                - float(np.sum(np.log(prior[~flat])))
            )
            inverse.append(inner)
            fitted.append(inner @ pull)
        dof = self.observed.size - int(flat.sum()) + self.trust
        known = self.trust * self.white**2
        least = known + max(1e-4 * self.observed.size * self.white**2, 1e-300)
        squares = np.maximum(np.array(square) + known, least)
        return Base(squares, np.array(logdet), dof, least, active, inverse, np.array(fitted))

    def _precision(self, active: Index) -> Float:
        """Of the priors of the active nuisance, in units of the white noise."""
        return np.where(np.isin(np.array(self.names)[active], FLAT), 0.0, self.white**2)

    def products(self, signatures: Float, groups: Sequence[Sequence[int]]) -> Products:
        """Inner products of signatures, shape (n, k), with all that counts.

        Parameters
        ----------
        signatures : ndarray, shape (n, k)
        groups : sequence of sequence of int
            Signatures of one candidate, whose inner products are wanted too.
        """
        wanted = [(i, j) for group in groups for i in group for j in group if i < j]
        left = np.array([i for i, _ in wanted], int)
        right = np.array([j for _, j in wanted], int)
        nuisance, own, pairs = [], [], []
        for level in self.levels:
            solved = level.factor.solve(signatures)
            nuisance.append(signatures.T @ level.solved)
            own.append(np.einsum("ij,ij->j", signatures, solved))
            pairs.append(np.einsum("ij,ij->j", signatures[:, left], solved[:, right]))
        table = np.array(pairs)
        return Products(
            np.array(nuisance),
            np.array(own),
            {pair: table[:, k] for k, pair in enumerate(wanted)},
        )

    def reduced(self, state: State, products: Products) -> Reduced:
        """The same products with the nuisance of `state` projected out."""
        base = self.base(state)
        shift = self._precision(base.active) * self.centre[base.active]
        left = np.array([i for i, _ in products.pairs], int)
        right = np.array([j for _, j in products.pairs], int)
        b, own, pairs = [], [], []
        products_pairs = np.array(list(products.pairs.values())).T
        products_pairs = products_pairs.reshape(len(self.levels), -1)
        for g, level in enumerate(self.levels):
            cross = products.nuisance[g][:, base.active + 1]
            through = cross @ base.inverse[g]
            left_over = products.own[g] - np.einsum("ij,ij->i", through, cross)
            # What the nuisance can say as well is no evidence.
            seen = left_over > INVISIBLE * products.own[g]
            with_residual = products.nuisance[g][:, 0] - through @ (
                level.gram[0, base.active + 1] - shift
            )
            b.append(np.where(seen, with_residual, 0.0))
            own.append(np.where(seen, left_over, products.own[g]))
            pairs.append(
                np.where(
                    seen[left] & seen[right],
                    products_pairs[g] - np.einsum("ij,ij->i", through[left], cross[right]),
                    0.0,
                )
            )
        table = np.array(pairs)
        return Reduced(
            base,
            np.array(b),
            np.array(own),
            {pair: table[:, k] for k, pair in enumerate(products.pairs)},
        )


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
        squares = np.maximum(self.base.square[:, None] - removed, self.base.least)
        negative = 0.5 * (
            self.base.dof * np.log(squares / self.base.dof) + self.base.logdet[:, None]
        )
        return np.asarray(self.base.best - negative.min(axis=0))

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


@dataclass(frozen=True)
class Profile:
    """The best amplitudes of a candidate.

    Attributes
    ----------
    amplitudes : ndarray, shape (p,)
    covariance : ndarray, shape (p, p)
    gains : ndarray, shape (outputs,)
        Rise of the log likelihood of each output.
    levels : list of int
        Noise level of each output.
    """

    amplitudes: Float
    covariance: Float
    gains: Float
    levels: list[int]

    @property
    def gain(self) -> float:
        return float(self.gains.sum())


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
    amplitudes, covariance = np.zeros(size), np.zeros((size, size))
    for _ in range(8):
        H, h = np.zeros((size, size)), np.zeros(size)
        for part, g in zip(parts, levels, strict=True):
            rows = part.amplitudes
            square = part.base.square[g] - float(
                2 * part.b[g] @ amplitudes[rows] - amplitudes[rows] @ part.C[g] @ amplitudes[rows]
            )
            variance = max(square, part.base.least) / part.base.dof
            H[np.ix_(rows, rows)] += part.C[g] / variance
            h[rows] += part.b[g] / variance
        covariance = _inverse(H)
        before = amplitudes
        amplitudes = covariance @ h if fixed is None else fixed
        new = []
        for part in parts:
            a = amplitudes[part.amplitudes]
            square = part.base.square - 2 * part.b @ a + np.einsum("i,gij,j->g", a, part.C, a)
            new.append(int(np.argmin(part.base.negative_log(square))))
        settled = new == levels and np.allclose(before, amplitudes, rtol=1e-3)
        levels = new
        if settled:
            break
    gains = []
    for part, g in zip(parts, levels, strict=True):
        a = amplitudes[part.amplitudes]
        square = part.base.square[g] - float(2 * part.b[g] @ a - a @ part.C[g] @ a)
        gains.append(
            part.base.best
            - float(0.5 * (part.base.dof * np.log(max(square, part.base.least) / part.base.dof)
                           + part.base.logdet[g]))
        )  # fmt: skip
    return Profile(amplitudes, covariance, np.array(gains), levels)


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
