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

import numpy as np

from thermaltool.diagnosis.observed import Observed
from thermaltool.diagnosis.profile import Base, Index, Reduced
from thermaltool.effects.effect import Float
from thermaltool.signals.likelihood import Factor

State = frozenset[str]


def released(state: State) -> State:
    """The state in which the model's own parameters are free."""
    return (state - {"tight"}) | {"released"}


# Evidence (fall of BIC, corrected for the causes tried) from which a cause is held out: odds of 10.
STRONG = 4.6
# ... from which two answers are told apart: odds of 150.
DECISIVE = 10.0
# Groups of columns without a prior; all others have mean zero and variance one.
FLAT = ("offset", "accepted")
# A signature of which less than this share is left after projection cannot be seen.
INVISIBLE = 1e-5
# Eigenvalues of the scaled nuisance: what is below is left out, and where the digits of the
# products no longer carry the whole projection.
SINGULAR, COLLINEAR = 1e-13, 1e-7
# How much larger the discrepancy of a clean log may be than expected: a deviation of its logarithm.
SPREAD = 0.3
_RATIOS = 10.0 ** np.arange(-2, 7)
_NEAR_RATIOS = (0.003, 0.02, 0.1, 0.35, 1.0, 3.0)
_NEAR_TAUS = (0.1, 0.33, 1.0, 3.0)


@dataclass(frozen=True)
class Level:
    """One noise level: products of the residual and the nuisance columns under it."""

    ratio: float
    tau: float
    odds: float  # logarithm, against it
    factor: Factor
    solved: Float  # (n, 1 + c)
    gram: Float  # (1 + c, 1 + c)


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
    expected : callable, optional
        Discrepancy of a clean log by its time constant [s]: a larger one has the odds of `SPREAD`
        against it; with it the white noise, too, is held near `white` (by as many rows as there
        are). Without it both are free.
    """

    def __init__(
        self,
        observed: Observed,
        residual: Float,
        nuisance: Mapping[str, Float],
        centre: Mapping[str, Float],
        white: float,
        state: State,
        expected: Callable[[float], float] | None = None,
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
        self.trust = 0 if expected is None else self.observed.size
        self.expected = expected
        noise = observed.noise

        def levels(points: list[tuple[float, float]]) -> list[Level]:
            return [self._level(0.0, 1.0), *(self._level(*p) for p in points)]

        if "white" in state:
            self.levels = [self._level(0.0, 1.0)]
            self.white = self.base(state).white
            self._bases.clear()
            self.share = self._effective(state)
            return
        self.share = 1.0
        taus = np.geomspace(3 * noise.period, max(noise.span / 2, 6 * noise.period), 7).tolist()
        self.levels = levels([(r, t) for r in _RATIOS for t in taus])
        if expected is None:
            for _ in range(2):
                self.white = self.base(state).white
                self._bases.clear()
        best = self.levels[self.base(state).level]
        tau = best.tau if best.ratio else float(np.sqrt(taus[0] * taus[-1]))
        ratio = best.ratio or 0.1
        self.levels = levels([(r * ratio, t * tau) for r in _NEAR_RATIOS for t in _NEAR_TAUS])
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
        odds = 0.0
        if self.expected is not None and ratio:
            over = np.log(np.sqrt(ratio) * self.white / self.expected(tau))
            odds = 0.5 * float(max(over, 0.0) / SPREAD) ** 2
        return Level(ratio, tau, odds, factor, solved, self.columns.T @ solved)

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
        square, logdet, whitening, pulls, fitted = [], [], [], [], []
        for level in self.levels:
            half, spread = self._whitening(level, active, prior)
            pull = half.T @ (level.gram[0, active + 1] - prior * centre)
            square.append(level.gram[0, 0] + float(prior @ centre**2) - float(pull @ pull))
            given = 2 * level.odds - float(np.sum(np.log(prior[~flat])))
            logdet.append(level.factor.logdet + spread + given)
            whitening.append(half)
            pulls.append(pull)
            fitted.append(half @ pull)
        dof = self.observed.size - int(flat.sum()) + self.trust
        known = self.trust * self.white**2
        least = known + max(1e-4 * self.observed.size * self.white**2, 1e-300)
        squares = np.maximum(np.array(square) + known, least)
        return Base(
            squares, np.array(logdet), dof, least, active, whitening, pulls, np.array(fitted)
        )

    def _whitening(self, level: Level, active: Index, prior: Float) -> tuple[Float, float]:
        """Combinations of the active nuisance that are orthonormal under a level and its prior.

        Returns
        -------
        ndarray, shape (c, r)
            A root of the inverse of the nuisance's precision.
        float
            Log determinant of the precision.
        """
        gram = level.gram[np.ix_(active + 1, active + 1)]
        size = np.sqrt(np.diag(gram) + prior)
        size[size == 0] = 1.0
        values, vectors = np.linalg.eigh((gram + np.diag(prior)) / np.outer(size, size))
        spread = float(np.sum(np.log(np.maximum(values, SINGULAR)))) + 2 * float(np.log(size).sum())
        kept = values > SINGULAR
        half = vectors[:, kept] / size[:, None] / np.sqrt(values[kept])
        if np.any(values[kept] < COLLINEAR):
            # Once more from the columns themselves (Cholesky QR twice: Yamamoto et al. 2015).
            columns = self.columns[:, active + 1] @ half
            again = columns.T @ level.factor.solve(columns) + half.T @ (prior[:, None] * half)
            values, vectors = np.linalg.eigh((again + again.T) / 2)
            half = half @ (vectors / np.sqrt(values))
            spread += float(np.log(values).sum())
        return half, spread

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
        left = np.array([i for i, _ in products.pairs], int)
        right = np.array([j for _, j in products.pairs], int)
        b, own, pairs = [], [], []
        products_pairs = np.array(list(products.pairs.values())).T
        products_pairs = products_pairs.reshape(len(self.levels), -1)
        for g in range(len(self.levels)):
            cross = products.nuisance[g][:, base.active + 1]
            through = cross @ base.whitening[g]
            left_over = products.own[g] - np.einsum("ij,ij->i", through, through)
            # What the nuisance can say as well is no evidence.
            seen = left_over > INVISIBLE * products.own[g]
            with_residual = products.nuisance[g][:, 0] - through @ base.pull[g]
            b.append(np.where(seen, with_residual, 0.0))
            own.append(np.where(seen, left_over, products.own[g]))
            pairs.append(
                np.where(
                    seen[left] & seen[right],
                    products_pairs[g] - np.einsum("ij,ij->i", through[left], through[right]),
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
