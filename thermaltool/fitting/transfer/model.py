"""An identified transfer function: its polynomials, what they mean, and how sure they are."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.signal import lfilter

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.error_model import known_runs
from thermaltool.fitting.output_model import ContinuousTerm, OutputModel
from thermaltool.fitting.transfer.continuous_term import continuous_term
from thermaltool.fitting.transfer.orders import Orders
from thermaltool.fitting.transfer.output_error import free_responses
from thermaltool.fitting.transfer.polynomials import difference_basis
from thermaltool.fitting.transfer.structure import Structure
from thermaltool.fitting.transfer.term_covariance import with_covariance
from thermaltool.record import Record
from thermaltool.signals.intervals import (
    Estimate,
    log_normal_estimate,
    normal_estimate,
    standard_error,
)
from thermaltool.units import Hold


@dataclass(frozen=True, kw_only=True)
class TransferModel(OutputModel):
    """y(k) = Σ_i B_i(q)/F_i(q) u_i(k − nk_i) + offset + noise, sampled at dt.

    Attributes
    ----------
    structure : Structure
        Where the noise enters.
    orders : Orders
    holds : tuple of "zero" or "first"
        Of each input between its samples.
    lagging : tuple of str
        Inputs of which none is feedthrough.
    B : tuple of ndarray
        Numerator of each input, from its first coefficient after the delay on.
    F : tuple of ndarray
        Denominator of each group of inputs, leading 1 included.
    C, D : ndarray
        Noise polynomials, leading 1 included.
    output_variance : float [unit²]
        Of the output that was fitted.
    covariance : ndarray, shape (p, p)
        Of all F − 1 = q^-1 Σ d_j (1 − q^-1)^j, then of all B = Σ c_j (1 − q^-1)^j: in differences,
        where gains and slow poles are not small differences of large numbers.
    """

    structure: Structure
    orders: Orders
    holds: tuple[Hold, ...]
    lagging: tuple[str, ...] = ()
    B: tuple[Array, ...]
    F: tuple[Array, ...]
    C: Array = field(default_factory=lambda: np.ones(1))
    D: Array = field(default_factory=lambda: np.ones(1))
    output_variance: float

    def group_of(self, k: int) -> int:
        """Which denominator belongs to input k."""
        return next(g for g, inputs in enumerate(self.orders.groups) if k in inputs)

    def denominator(self, k: int) -> Array:
        """Denominator of input k, F, in powers of 1/q."""
        return self.F[self.group_of(k)]

    @property
    def coefficients(self) -> Array:
        """Of all F without their 1, then of all B."""
        return np.concatenate([*(f[1:] for f in self.F), *self.B])

    @property
    def seconds(self) -> Array:
        """Powers of a second in the units of the `coefficients`: none by lags."""
        return np.zeros(len(self.coefficients))

    @property
    def coefficient_covariance(self) -> Array:
        """Of the `coefficients`, shape (p, p)."""
        turn = _lag_map(self.orders)
        return turn @ self.covariance @ turn.T

    @property
    def parameters(self) -> int:
        """Coefficients of all polynomials and the offsets."""
        return len(self.coefficients) + len(self.C) + len(self.D) - 2 + len(self.zeros)

    @property
    def order(self) -> int:
        return sum(self.orders.nf)

    @property
    def sample_delays(self) -> tuple[int, ...]:
        return self.orders.nk

    @property
    def residual_parameters(self) -> int:
        return self.structure.residual_parameters(self)

    @property
    def yic(self) -> float:
        """Young's criterion, ln(σ²/σ²_y) + ln(mean of p_ii/θ_i²) (Young 2011)."""
        share = np.diag(self.coefficient_covariance) / np.maximum(self.coefficients**2, 1e-300)
        # A candidate of too high an order can have variances below rounding.
        return float(
            np.log(self.sigma2 / self.output_variance) + np.log(max(float(np.mean(share)), 1e-300))
        )

    def respond(self, inputs: Array) -> Array:
        """Noise-free output from rest, without the offset; inputs (m, n) before the record: zero.

        Parameters
        ----------
        inputs : ndarray, shape (m, n)
        """
        y = np.zeros(inputs.shape[1])
        for k, (b, nk) in enumerate(zip(self.B, self.orders.nk, strict=True)):
            numerator = np.concatenate([np.zeros(nk), b])
            y += lfilter(numerator, self.denominator(k), inputs[k])
        return y

    def _from_rest(self, record: Record, levels: Array) -> Array:
        return self.respond(record.matrix(self.names) - levels[:, None])

    def _free_responses(self, record: Record) -> Array:
        first = self.orders.first
        rows = np.zeros((self.order, len(record)))
        if len(record) > first and self.order:
            rows[:, first:] = np.vstack([free_responses(f, len(record) - first) for f in self.F])
        return rows

    def _known(self, record: Record) -> NDArray[np.bool_]:
        rows = np.arange(len(record)) >= self.orders.first
        return (rows & (len(record) > self.orders.shortest)) | record.at_rest

    def residuals(self, data: TrainingData) -> Iterator[tuple[Array, Array]]:
        for record in data.records:
            error = self.structure.residual(self, record)
            if error is None:
                continue
            inputs, count = record.matrix(self.names), len(record) - len(error)
            for run in known_runs(error):
                yield error[run], inputs[:, : count + run.stop]

    def term(self, k: int) -> ContinuousTerm:
        return continuous_term(self, k)

    def sure_term(self, k: int) -> ContinuousTerm:
        return with_covariance(self, k, continuous_term(self, k))

    def acting_on(self, k: int) -> list[int]:
        """Which parameters of the `covariance` the response to input k depends on."""
        o, g = self.orders, self.group_of(k)
        counts = [len(f) - 1 for f in self.F]
        first, at = sum(counts[:g]), sum(counts) + sum(o.nb[:k])
        return [*range(first, first + counts[g]), *range(at, at + o.nb[k])]

    def moved(self, j: int, by: float) -> TransferModel:
        """The model with parameter j of the `covariance` changed by an amount."""
        values = self.coefficients + by * _lag_map(self.orders)[:, j]
        parts = np.split(values, np.cumsum([*(len(f) - 1 for f in self.F), *self.orders.nb])[:-1])
        count = len(self.F)
        return replace(self, F=tuple(np.append(1.0, f) for f in parts[:count]),
                       B=tuple(parts[count:]))  # fmt: skip

    def poles(self, group: int = 0) -> Array:
        """Roots of a denominator in z, the slowest first."""
        z = np.roots(self.F[group]).astype(complex)
        return z[np.argsort(-np.abs(z), kind="stable")]

    def time_constants(self, group: int = 0) -> tuple[Estimate, ...]:
        """−dt/ln|z| of every pole, the slowest first, with intervals by the delta method [s].

        Of a pair it is the decay of its envelope. The interval is symmetric in the logarithm.
        """
        start = sum(len(f) - 1 for f in self.F[:group])
        poles = self.poles(group)
        n = len(poles)
        block = self.covariance[start : start + n, start : start + n]
        found = []
        for k, z in enumerate(poles):
            # z^n F(z) = 0: ∂z/∂d_j = −z^(n−1) (1 − 1/z)^j/Π(z − others); ln|z| changes by the real
            # part of ∂z/z.
            others = np.prod(z - np.delete(poles, k))
            change = -(z ** (n - 2.0)) * (1 - 1 / z) ** np.arange(n) / (others or 1e-300)
            found.append(decay(math.log(max(abs(z), 1e-300)), change.real, block, self.dt))
        return tuple(found)

    def gain(self, k: int) -> Estimate:
        """Steady state of the output per unit of input k, B(1)/F(1)."""
        g = self.group_of(k)
        b, f = self.B[k], self.F[g]
        value = float(b.sum() / f.sum())
        # F(1) = 1 + d_0, B(1) = c_0.
        at_b = sum(len(each) - 1 for each in self.F) + sum(len(each) for each in self.B[:k])
        slope = np.zeros(len(self.covariance))
        if len(f) > 1:
            slope[sum(len(each) - 1 for each in self.F[:g])] = -value / f.sum()
        slope[at_b] = 1 / f.sum()
        return normal_estimate(value, standard_error(slope, self.covariance))

    def named(self) -> Iterator[tuple[str, Estimate]]:
        """Every coefficient by name, with its 95 % interval."""
        errors = np.sqrt(np.maximum(np.diag(self.coefficient_covariance), 0.0))
        for label, value, error in zip(self.labels(), self.coefficients, errors, strict=True):
            yield label, normal_estimate(float(value), float(error))

    def labels(self) -> list[str]:
        """Names of the `coefficients`."""
        return self.structure.labels(self)


def _lag_map(orders: Orders) -> Array:
    """From parameters in differences to those by lags: denominators, then numerators."""
    return np.asarray(block_diag(*(difference_basis(n).T for n in (*orders.nf, *orders.nb))))


def decay(rate: float, slope: Array, covariance: Array, dt: float) -> Estimate:
    """The time constant −dt/rate of a pole [s], its interval symmetric in the logarithm.

    Parameters
    ----------
    rate : float
        Real part of the pole in s, per sample: ln|z|.
    slope : ndarray
        Of the rate, in parameters of this covariance.
    """
    tau = -dt / min(rate, -1e-16)
    return log_normal_estimate(tau, standard_error(slope, covariance) * tau / dt)
