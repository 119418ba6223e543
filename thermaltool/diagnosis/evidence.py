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
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from thermaltool.diagnosis.assumptions import Assumptions
from thermaltool.diagnosis.whitening import whitening
from thermaltool.effects.effect import Float
from thermaltool.signals.likelihood import Factor, StackedFactors
from thermaltool.signals.row_groups import Index, RowGroups

# Groups of columns without a prior; all others have mean zero and variance one.
FLAT_GROUPS = ("offset", "accepted")
# Evidence (fall of BIC, corrected for the causes tried) from which a cause is held out, and from
# which two answers are told apart: odds of 150.
DECISIVE_EVIDENCE = 10.0
# A signature of which less than this share is left after projection cannot be seen.
MIN_SHARE_LEFT = 1e-5
# How much larger the discrepancy of a clean log may be than expected: a deviation of its logarithm.
DISCREPANCY_SPREAD = 0.3
# Sum of squares that stands for rounding, over rows times white variance.
ROUNDING = 1e-4

WHITE_ALONE = (0.0, 1.0)


@dataclass(frozen=True)
class NoiseLevel:
    """Products of residual and nuisance columns under one covariance of the noise.

    Attributes
    ----------
    ratio : float
        Variance of the discrepancy over that of white noise.
    tau : float [s]
        Time constant of the discrepancy.
    odds : float
        Logarithm of the odds against it.
    factor : Factor
        The covariance.
    gram : ndarray, shape (1 + c, 1 + c)
        Of the columns under its inverse.
    """

    ratio: float
    tau: float
    odds: float
    factor: Factor
    gram: Float


@dataclass(frozen=True)
class NullFit:
    """Likelihood of an output without a further cause, under some assumptions, at every level.

    Attributes
    ----------
    square, logdet : ndarray, shape (levels,)
        Sum of squares that the nuisance leaves, and log determinant of the covariance.
    dof : float
        Degrees of freedom.
    least : float
        Sum of squares that stands for rounding: nothing is explained better than that.
    active : ndarray of int, shape (c,)
        Nuisance columns in use.
    whitening : list of ndarray, shape (c, r)
        Combinations of the active nuisance that are orthonormal, priors included.
    pull : list of ndarray, shape (r,)
        Products of those combinations with the residual.
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
        """Negative log likelihood.

        Parameters
        ----------
        square : ndarray, shape (..., levels)
            Sums of squares.
        """
        return 0.5 * (self.dof * np.log(np.maximum(square, self.least) / self.dof) + self.logdet)

    @cached_property
    def best(self) -> float:
        """Negative log likelihood at the best level."""
        return float(np.min(self.negative_log(self.square)))

    @property
    def white(self) -> float:
        """Standard deviation of the white noise of a reading."""
        return float(np.sqrt(self.square[self.level] / self.dof))

    @property
    def level(self) -> int:
        """Index of the best noise level."""
        return int(np.argmin(self.negative_log(self.square)))


@dataclass(frozen=True)
class ProjectedProducts:
    """Products of signatures with the residual and each other, nuisance projected out.

    Attributes
    ----------
    null : NullFit
    b, own : ndarray, shape (levels, k)
        With the residual, and of each signature with itself.
    pairs : mapping of (i, j) to ndarray, shape (levels,)
        Between signatures of one candidate.
    """

    null: NullFit
    b: Float
    own: Float
    pairs: Mapping[tuple[int, int], Float]

    @cached_property
    def largest_rise(self) -> Float:
        """Largest rise of the log likelihood by each signature alone, shape (k,)."""
        removed = np.where(self.own > 0, self.b**2 / np.where(self.own > 0, self.own, 1.0), 0.0)
        negative = self.null.negative_log((self.null.square[:, None] - removed).T)
        return np.asarray(self.null.best - negative.min(axis=1))


@dataclass(frozen=True)
class SignatureProducts:
    """Products of signatures of one output under every level.

    Attributes
    ----------
    nuisance : ndarray, shape (levels, k, 1 + c)
        With the residual (first) and the nuisance.
    own : ndarray, shape (levels, k)
        Of each with itself.
    pairs : mapping of (i, j) to ndarray, shape (levels,)
        Between signatures of one candidate.
    """

    nuisance: Float
    own: Float
    pairs: Mapping[tuple[int, int], Float]


@dataclass(frozen=True, eq=False)
class OutputEvidence:
    """Residual of one output, what may explain it for free, and its noise; made by `weigh`.

    Attributes
    ----------
    groups : RowGroups
    names : tuple of str, length c
        Group of each nuisance column.
    columns : ndarray, shape (n, 1 + c)
        Residual, and nuisance in units of its prior.
    centre : ndarray, shape (c,)
        Where each column stands already, in units of its prior.
    white : float
        White noise of a reading.
    expected : callable or None
        Discrepancy of a clean log by its time constant [s].
    levels : tuple of NoiseLevel
    independence : float
        Independent readings per row: below one where slow misfit is taken for white.
    """

    groups: RowGroups
    names: tuple[str, ...]
    columns: Float
    centre: Float
    white: float
    expected: Callable[[float], float] | None
    levels: tuple[NoiseLevel, ...] = ()
    independence: float = 1.0

    @cached_property
    def _factors(self) -> StackedFactors:
        return StackedFactors([level.factor for level in self.levels])

    @cached_property
    def _null_fits(self) -> dict[Assumptions, NullFit]:
        return {}

    def at(self, points: Sequence[tuple[float, float]]) -> OutputEvidence:
        """The same under white noise alone and under each (ratio, time constant [s]).

        Parameters
        ----------
        points : sequence of (float, float [s])
        """
        return replace(self, levels=tuple(self._level(*p) for p in (WHITE_ALONE, *points)))

    def only(self, assumptions: Assumptions) -> OutputEvidence:
        """The same without the nuisance that the assumptions leave out.

        Parameters
        ----------
        assumptions : frozenset of str
        """
        kept = np.array([name in assumptions for name in self.names], bool)
        return replace(
            self,
            names=tuple(name for name in self.names if name in assumptions),
            columns=self.columns[:, np.append(True, kept)],
            centre=self.centre[kept],
        )

    def with_residual(self, residual: Float) -> OutputEvidence:
        """The same noise levels and nuisance for another residual.

        Parameters
        ----------
        residual : ndarray, shape (n,)
        """
        columns = self.columns.copy()
        columns[:, 0] = residual
        levels = []
        for level, row in zip(self.levels, self._factors.solve(residual) @ columns, strict=True):
            gram = level.gram.copy()
            gram[0] = gram[:, 0] = row
            levels.append(replace(level, gram=gram))
        return replace(self, columns=columns, levels=tuple(levels))

    def _level(self, ratio: float, tau: float) -> NoiseLevel:
        factor = self.groups.noise.factor(ratio, tau)
        odds = 0.0
        if self.expected is not None and ratio:
            over = np.log(np.sqrt(ratio) * self.white / self.expected(tau))
            odds = 0.5 * float(max(over, 0.0) / DISCREPANCY_SPREAD) ** 2
        return NoiseLevel(ratio, tau, odds, factor, self.columns.T @ factor.solve(self.columns))

    def null(self, assumptions: Assumptions) -> NullFit:
        """The output explained by the nuisance of some assumptions alone.

        Parameters
        ----------
        assumptions : frozenset of str
        """
        if assumptions not in self._null_fits:
            self._null_fits[assumptions] = self._null_fit(assumptions)
        return self._null_fits[assumptions]

    def _null_fit(self, assumptions: Assumptions) -> NullFit:
        active = np.array([k for k, name in enumerate(self.names) if name in assumptions], int)
        flat = np.array([self.names[k] in FLAT_GROUPS for k in active], bool)
        # Precision of the priors, in units of the white noise.
        prior = np.where(flat, 0.0, self.white**2)
        centre = np.where(flat, 0.0, self.centre[active])
        square, logdet, halves, pulls, fitted = [], [], [], [], []
        for level in self.levels:
            half, spread = whitening(
                level.gram[np.ix_(active + 1, active + 1)],
                prior,
                self.columns[:, active + 1],
                level.factor,
            )
            pull = half.T @ (level.gram[0, active + 1] - prior * centre)
            square.append(level.gram[0, 0] + float(prior @ centre**2) - float(pull @ pull))
            given = 2 * level.odds - float(np.sum(np.log(prior[~flat])))
            logdet.append(level.factor.logdet + spread + given)
            halves.append(half)
            pulls.append(pull)
            fitted.append(half @ pull)
        # What is known of the white noise counts as so many readings more.
        trust = 0 if self.expected is None else self.groups.size
        dof = self.groups.size - int(flat.sum()) + trust
        known = trust * self.white**2
        least = known + max(ROUNDING * self.groups.size * self.white**2, 1e-300)
        squares = np.maximum(np.array(square) + known, least)
        return NullFit(
            squares, np.array(logdet), dof, least, active, halves, pulls, np.array(fitted)
        )

    def fitted(self, assumptions: Assumptions, group: str) -> Float:
        """Best nuisance of one group at the best level, shape (columns of the group,).

        Parameters
        ----------
        assumptions : frozenset of str
        group : str
        """
        null = self.null(assumptions)
        return null.fitted[null.level][np.array(self.names)[null.active] == group]

    def correlated_rows(self, assumptions: Assumptions) -> float:
        """Independent readings per row, by the correlation of neighbours."""
        null, residual = self.null(assumptions), self.columns[:, 0]
        left = residual - self.columns[:, null.active + 1] @ null.fitted[0]
        rho = float(left[1:] @ left[:-1] / (left @ left)) if np.any(left) else 0.0
        return float(np.clip((1 - rho) / (1 + rho), 1.0 / len(left), 1.0))

    def products(self, signatures: Float, groups: Sequence[Sequence[int]]) -> SignatureProducts:
        """Inner products of signatures with all that counts.

        Parameters
        ----------
        signatures : ndarray, shape (n, k)
        groups : sequence of sequence of int
            Signatures of each candidate, ascending; their inner products are wanted too.
        """
        levels, (_, width) = len(self.levels), self.columns.shape
        own = np.empty((levels, signatures.shape[1]))
        nuisance = np.empty((levels, signatures.shape[1], width))
        pairs: dict[tuple[int, int], Float] = {}
        for group in groups:
            for k, i in enumerate(group):
                partners = list(group[k + 1 :])
                solved = self._factors.solve(signatures[:, i])
                nuisance[:, i] = solved @ self.columns
                found = solved @ signatures[:, [i, *partners]]
                own[:, i] = found[:, 0]
                pairs |= {(i, j): found[:, 1 + m] for m, j in enumerate(partners)}
        return SignatureProducts(nuisance, own, pairs)

    def projected(self, assumptions: Assumptions, products: SignatureProducts) -> ProjectedProducts:
        """The same products with the nuisance of some assumptions projected out.

        Parameters
        ----------
        assumptions : frozenset of str
        products : SignatureProducts
        """
        null = self.null(assumptions)
        # Combinations of the nuisance under each level; fewer of them where some are singular.
        through = [
            cross @ half
            for cross, half in zip(
                products.nuisance[:, :, null.active + 1], null.whitening, strict=True
            )
        ]
        left_over = products.own - np.array([np.einsum("ij,ij->i", t, t) for t in through])
        # What the nuisance can say as well is no evidence.
        seen = left_over > MIN_SHARE_LEFT * products.own
        pulled = np.array([t @ pull for t, pull in zip(through, null.pull, strict=True)])
        b = np.where(seen, products.nuisance[:, :, 0] - pulled, 0.0)
        pairs = {
            (i, j): np.where(
                seen[:, i] & seen[:, j], both - np.array([t[i] @ t[j] for t in through]), 0.0
            )
            for (i, j), both in products.pairs.items()
        }
        return ProjectedProducts(null, b, np.where(seen, left_over, products.own), pairs)
