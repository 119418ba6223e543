"""OE in continuous time by simplified refined instrumental variables (SRIVC; Young 2011, 8).

The same search as in discrete time with the filters s^j/A(s) in place of lags: those of an input
are exact between its samples (held or joined by lines), those of the output join it by lines. Time
counts in samples within the search.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.transfer.model import TransferModel, decay
from thermaltool.fitting.transfer.oe import OeStructure, search_fields
from thermaltool.fitting.transfer.orders import Orders
from thermaltool.fitting.transfer.output_error import Problem
from thermaltool.fitting.transfer.polynomials import from_real_roots, partial_fractions
from thermaltool.fitting.transfer.search import SearchResult
from thermaltool.fitting.transfer.structure import Structure
from thermaltool.signals.intervals import Estimate, normal_estimate, standard_error
from thermaltool.units import Hold

# A constant coefficient of A(s) below this is that of a pole at zero, s in 1/samples.
MIN_CONSTANT_COEFFICIENT = 1e-30


@dataclass(frozen=True)
class ContinuousProblem(Problem):
    """Denominators A(s) = s^n + a1 s^(n−1) + ... + an, as (1, a1, ..., an), s in 1/samples.

    The inputs go on between samples as the data say.
    """

    def recursion(self, f: Array) -> Array:
        return np.asarray(np.poly(np.exp(np.roots(f))).real)

    def start(self, lags: Array) -> Array:
        return from_real_roots(-1 / np.asarray(lags, float))

    def parts(self, lags: Array, nb: int) -> Array:
        return partial_fractions(-1.0 / lags, range(nb))

    def numerators(self, u: Array, f: Array, i: int, out: Array) -> None:
        n = len(u) - self.orders.first
        # A held input reaches the next sample first: the filter has that sample in it.
        begin = self.orders.first - self.orders.nk[i] + (self.data.holds[i] == "zero")
        numerators, denominator = sampled(f, self.data.holds[i])
        for j, row in enumerate(out):
            row[:] = lfilter(numerators[j], denominator, u)[begin : begin + n]

    def _follow(self, x: Array, f: Array, out: Array) -> None:
        numerators, denominator = sampled(f, "first")
        for j, row in enumerate(out):
            row[:] = -lfilter(numerators[len(out) - 1 - j], denominator, x)

    def steps_between(self, f: Array, after: Array) -> Array:
        return np.asarray((after - f)[:, 1:].T)

    def moved(self, F: Sequence[Array], step: Array) -> tuple[Array, ...]:
        result, at = [], 0
        for f in F:
            n = len(f) - 1
            after = np.concatenate([[1.0], f[1:] + step[at : at + n]])
            if np.isfinite(after).all():
                poles = np.roots(after)
                after = np.poly(np.where(poles.real > 0, -poles.conj(), poles)).real
            result.append(after)
            at += n
        return tuple(result)


@dataclass(frozen=True, kw_only=True)
class ContinuousModel(TransferModel):
    """B(s)/A(s) of each input, A = s^n + a1 s^(n−1) + ... + an, B = b0 + b1 s + ...

    `B` and `F` are its exact discrete form; `orders` those of B(s) and A(s).

    Attributes
    ----------
    theta : ndarray, shape (p,)
        All a, then all b, s in 1/samples; `covariance` is theirs.
    """

    theta: Array

    @property
    def coefficients(self) -> Array:
        return self.theta * self.dt**self.seconds

    @property
    def coefficient_covariance(self) -> Array:
        scale = self.dt**self.seconds
        return self.covariance * np.outer(scale, scale)

    def moved(self, j: int, by: float) -> TransferModel:
        theta = self.theta.copy()
        theta[j] += by
        F, B = _discrete(theta, self.orders, self.holds)
        return replace(self, theta=theta, F=F, B=B)

    @property
    def seconds(self) -> Array:
        """A(s) is divided by dt^n where s is in 1/s, and so is B(s)."""
        o = self.orders
        a = [-np.arange(1.0, n + 1) for n in o.nf]
        b = [np.arange(float(nb)) - n for nb, n in zip(o.nb, o.nf, strict=True)]
        return np.concatenate([*a, *b])

    def _denominator(self, group: int) -> tuple[slice, Array]:
        """Where its coefficients stand, and A(s)."""
        start = sum(self.orders.nf[:group])
        own = slice(start, start + self.orders.nf[group])
        return own, np.concatenate([[1.0], self.theta[own]])

    def _rates(self, group: int) -> NDArray[np.complex128]:
        """Roots of A(s), the slowest first."""
        s = np.roots(self._denominator(group)[1]).astype(complex)
        return s[np.argsort(-s.real, kind="stable")]

    def poles(self, group: int = 0) -> Array:
        return np.asarray(np.exp(self._rates(group)))

    def time_constants(self, group: int = 0) -> tuple[Estimate, ...]:
        own, _ = self._denominator(group)
        rates, block = self._rates(group), self.covariance[own, own]
        found, n = [], len(rates)
        for k, s in enumerate(rates):
            # A(s) = 0: ∂s/∂a_j = −s^(n−j)/Π(s − others).
            others = np.prod(s - np.delete(rates, k))
            slope = -(s ** np.arange(n - 1.0, -1.0, -1.0)) / (others or 1e-300)
            found.append(decay(float(s.real), slope.real, block, self.dt))
        return tuple(found)

    def gain(self, k: int) -> Estimate:
        o = self.orders
        last = sum(o.nf[: k + 1]) - 1
        first = sum(o.nf) + sum(o.nb[:k])
        value = float(self.theta[first] / self.theta[last])
        slope = np.zeros(len(self.theta))
        slope[first], slope[last] = 1 / self.theta[last], -value / self.theta[last]
        return normal_estimate(value, standard_error(slope, self.covariance))


def sampled(f: Array, hold: Hold) -> tuple[Array, Array]:
    """s^j/A(s), j = 0 ... n−1, over one sample: numerators (n, n + 1), denominator (n + 1).

    By the exponential of the companion matrix with the input's own course (Van Loan 1978).
    """
    n = len(f) - 1
    whole = np.zeros((n + 2, n + 2))
    whole[: n - 1, 1:n] = np.eye(n - 1)
    whole[n - 1, :n] = -f[:0:-1]
    whole[n - 1, n] = whole[n, n + 1] = 1.0
    M = expm(whole)
    A, held, ramp = M[:n, :n], M[:n, n], M[:n, n + 1]
    before, now = (held, np.zeros(n)) if hold == "zero" else (held - ramp, ramp)
    denominator = np.poly(A).real
    markov, x = [now], before + A @ now
    for _ in range(n):
        markov.append(x)
        x = A @ x
    h = np.array(markov).T
    numerators = np.array([np.convolve(row, denominator)[: n + 1] for row in h])
    return numerators, np.asarray(denominator)


@dataclass(frozen=True)
class ContinuousOeStructure(OeStructure):
    """OE in continuous time; the model is given as its exact discrete form.

    Orders: nb coefficients of B(s), at most nf; nk samples of delay, of which a held input has one.
    """

    def orders(self, nb: tuple[int, ...], nf: int | tuple[int, ...], nk: tuple[int, ...]) -> Orders:
        orders = super().orders(nb, nf, nk)
        return replace(orders, nb=tuple(map(min, orders.nb, orders.nf)))

    @property
    def candidates(self) -> Structure:
        """Orders are chosen by discrete models, which take less time."""
        return OeStructure(self.noise, self.real_poles)

    def problem(self, data: TrainingData, orders: Orders) -> Problem:
        if any(b > f for b, f in zip(orders.nb, orders.nf, strict=True)):
            raise FitError("in continuous time nb is at most nf: the response has no direct part")
        for name, nk, hold in zip(data.inputs, orders.nk, data.holds, strict=True):
            if hold == "zero" and nk < 1:
                raise FitError(f"{name} is held between samples: its delay nk is at least 1")
        return ContinuousProblem(data.about_levels(orders.first), orders)

    def model(self, problem: Problem, found: SearchResult, data: TrainingData) -> TransferModel:
        orders = problem.orders
        for f in found.F:
            if not f[-1] > MIN_CONSTANT_COEFFICIENT:
                raise FitError("the fit has a pole at 0, it integrates: take a lower order")
        numerators = found.projection.linear[: sum(orders.nb)]
        theta = np.concatenate([*(f[1:] for f in found.F), numerators])
        F, B = _discrete(theta, orders, data.holds)
        fields = search_fields(self, problem, found, data, coloured=True)
        fields["method"] += " in continuous time"
        return ContinuousModel(B=B, F=F, theta=theta, **fields)

    def labels(self, model: TransferModel) -> list[str]:
        own = [f"[{name}]" if len(model.names) > 1 else "" for name in model.names]
        o = model.orders
        a = [f"a{j + 1}{x}" for x, n in zip(own, o.nf, strict=True) for j in range(n)]
        return [*a, *(f"b{j}{x}" for x, nb in zip(own, o.nb, strict=True) for j in range(nb))]


def _discrete(
    theta: Array, orders: Orders, holds: Sequence[Hold]
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """F(q) and B(q) of every input, one denominator each."""
    F, B, at, on = [], [], 0, sum(orders.nf)
    for n, nb, hold in zip(orders.nf, orders.nb, holds, strict=True):
        numerators, denominator = sampled(np.concatenate([[1.0], theta[at : at + n]]), hold)
        b = theta[on : on + nb] @ numerators[:nb]
        F.append(denominator)
        B.append(b[1:] if hold == "zero" else b)
        at, on = at + n, on + nb
    return tuple(F), tuple(B)
