"""Tests of a coloured residual: whether it follows a channel or its past, and what is left over.

Thermal residuals are coloured: a textbook p-value on them finds everything significant. The
residual is described as white noise plus an Ornstein-Uhlenbeck discrepancy, both estimated, and
every test is made on what that description leaves: inner products under its covariance, which are
those of the prewhitened residual with the prewhitened input, and its innovations.

Sources: Ljung, System identification (1999), 16.6 (residual tests); Box, Jenkins & Reinsel, Time
series analysis (2008), 12.1 (prewhitening); Ljung & Box, Biometrika 65 (1978) 297.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import erfc, ndtri

from thermaltool.effects.effect import Float
from thermaltool.record import Record
from thermaltool.signals.likelihood import RestrictedLikelihood, least_on_grid
from thermaltool.signals.row_groups import RowGroups
from thermaltool.signals.whiteness import ljung_box

# A p-value below this rejects.
SIGNIFICANCE = 0.01
# Lags of the innovations that are tested together.
MAX_LAGS = 20


@dataclass(frozen=True)
class Dependence:
    """Whether the residual still follows a channel or its past.

    Attributes
    ----------
    channel : str
    lag : (float, float) [s]
        The lags at which it follows most.
    correlation : float
        Of the prewhitened residual with the prewhitened channel over these lags.
    bound : float
        What independence stays within, at 1 % over all lags.
    p_value : float
        Corrected for the lags that were tried, not for the channels.
    """

    channel: str
    lag: tuple[float, float]
    correlation: float
    bound: float
    p_value: float


class ColouredTests:
    """Tests under white noise plus a discrepancy whose size and time constant are estimated.

    Parameters
    ----------
    time, about : ndarray, shape (n,)
        The residual about the mean of each record.
    records : sequence of slice
    """

    def __init__(self, time: Float, about: Float, records: Sequence[slice]) -> None:
        self.records = records
        logs = [Record(time[r], {}) for r in records]
        groups = RowGroups.of(logs)
        assert groups is not None
        self.groups, self.period, self.size = groups, groups.noise.period, len(time)
        self.clock = self._means(time)
        means = np.zeros((groups.size, len(records)))
        means[np.arange(groups.size), groups.owner] = 1.0
        self.columns = np.column_stack([self._means(about), means])
        self.dof = groups.size - len(records)
        if not np.any(about):
            self.ratio, self.tau = 0.0, 1.0
        else:
            self.ratio, self.tau = self._fit()
        self.factor = groups.noise.factor(self.ratio, self.tau)
        gram = self.columns.T @ self.factor.solve(self.columns)
        inner = np.linalg.inv(gram[1:, 1:])
        square = float(gram[0, 0] - gram[0, 1:] @ inner @ gram[1:, 0])
        self.white = float(np.sqrt(max(square, 0.0) / self.dof))
        self.clean = self.columns[:, 0] - means @ inner @ gram[1:, 0]
        self.solved = self.factor.solve(self.columns[:, 1:]) @ inner
        self.discrepancy = self.white * float(np.sqrt(self.ratio))

    def _means(self, values: Float) -> Float:
        return self.groups.means([values[r] for r in self.records])

    def _fit(self) -> tuple[float, float]:
        """Variance of the discrepancy over that of the white noise, and its time constant [s]."""
        groups = self.groups
        likelihood = RestrictedLikelihood(
            self.clock, self.columns[:, 0], groups.noise.starts, 0, groups.weight, self.period
        )

        def negative_log(log_ratio: float, log_tau: float) -> float:
            tau = float(np.exp(log_tau))
            return likelihood.negative_log(likelihood.walk(float(np.exp(log_ratio)), tau), tau)

        low, high = 3 * self.period, max(likelihood.span / 2, 6 * self.period)
        taus = np.log(np.geomspace(low, high, 5)).tolist()
        grid = [(r, t) for r in (np.log(10.0) * np.arange(-3, 7)).tolist() for t in taus]
        bounds = np.log([[1e-4, 1e9], [low, high]])
        point, value = least_on_grid(negative_log, grid, bounds, (1.0, 0.5), 0.01, 80)
        # Two parameters more than white noise have to earn their keep (BIC).
        if 2 * (likelihood.negative_log(0.0, 1.0) - value) < 2 * np.log(self.dof):
            return 0.0, 1.0
        ratio, tau = np.exp(point).tolist()
        return ratio, tau

    def effective_rows(self) -> float:
        """n over the sum of the autocorrelation."""
        decay = float(np.exp(-self.period / self.tau))
        slow = self.ratio / (1.0 + self.ratio)
        return max(1.0, self.size / (1.0 + 2.0 * slow * decay / (1.0 - decay)))

    def white_p(self) -> float:
        """Ljung-Box on the innovations of the fitted description."""
        innovations = self._innovations()
        lags = min(MAX_LAGS, len(innovations) // 4)
        return ljung_box([innovations], lags, 2 if self.ratio else 0).p_value

    def _innovations(self) -> Float:
        """One-step prediction errors in units of their standard deviation."""
        ratio = self.ratio
        decays = np.exp(-np.diff(self.clock, prepend=self.clock[0]) / self.tau)
        fresh = np.diff(self.groups.owner, prepend=-1) != 0
        state, spread, result = 0.0, ratio, []
        for value, decay, new, weight in zip(
            self.clean.tolist(),
            decays.tolist(),
            fresh.tolist(),
            self.groups.weight.tolist(),
            strict=True,
        ):
            if new:
                state, spread = 0.0, ratio
            else:
                state *= decay
                spread = ratio + decay * decay * (spread - ratio)
            total = spread + weight
            error = value - state
            result.append(error / total**0.5)
            state += spread / total * error
            spread *= weight / total
        return np.array(result)

    def dependence(self, channel: str, values: Float) -> Dependence | None:
        """Whether the residual follows a channel at any lag; None where it does not change."""
        gathered = self._means(values)
        windows, features = [(0, 1)], []
        while 4 * windows[-1][1] < self.groups.size:
            windows.append((windows[-1][1], 2 * windows[-1][1]))
        for first, end in windows:
            feature = np.zeros(self.groups.size)
            for k in range(len(self.records)):
                own = self.groups.owner == k
                feature[own] = _past(gathered[own], first, end)
            features.append(feature)
        block = np.column_stack(features)
        solved = self.factor.solve(block)
        cross = self.columns[:, 1:].T @ solved
        norm = np.einsum("ij,ij->j", block, solved) - np.einsum(
            "ij,ij->j", cross, (self.solved.T @ block)
        )
        there = norm > 1e-9 * np.maximum(np.einsum("ij,ij->j", block, solved), 1e-300)
        if not there.any() or self.white == 0.0:
            return None
        z = np.zeros(len(windows))
        z[there] = (self.clean @ solved)[there] / (self.white * np.sqrt(norm[there]))
        best, tried, root = int(np.argmax(np.abs(z))), int(there.sum()), float(np.sqrt(self.dof))
        one = float(erfc(abs(z[best]) / np.sqrt(2.0)))
        group = self.period * self.size / self.groups.size
        first, end = windows[best]
        return Dependence(
            channel,
            (first * group, (end - 1) * group),
            float(z[best]) / root,
            float(ndtri(0.5 + 0.5 * (1.0 - SIGNIFICANCE) ** (1.0 / tried))) / root,
            float(-np.expm1(tried * np.log1p(-one))) if one < 1.0 else 1.0,
        )


def _past(values: Float, first: int, end: int) -> Float:
    """Mean over the lags first to end - 1 of what a channel has risen since its first value."""
    total = np.append(0.0, np.cumsum(values - values[0]))
    rows = np.arange(1, len(values) + 1)
    return (total[np.maximum(rows - first, 0)] - total[np.maximum(rows - end, 0)]) / (end - first)
