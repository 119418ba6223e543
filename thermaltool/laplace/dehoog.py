"""Fourier series with an accelerated tail, for a window of times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermaltool.laplace.sampling import ROUNDING, ComplexArray, RealArray, Sampler

# Aliasing: the series returns f(t) + Σ e^(−2kγT) f(t + 2kT); these are e^(−2γT) in the series
# that answers and in the one that checks it, different so that the check sees the aliases.
ALIASING, CHECK_ALIASING = 1e-14, 1e-13
TAIL_ORDER = 20  # pairs of terms of the accelerated tail
# Heads are multiples of this.
BLOCK_TERMS = 32

# Half periods T over the last time: of the series that answers, and of those that check it. One
# check agrees by chance where f jumps; two hardly do.
HALF_PERIOD, CHECK_HALF_PERIODS = 2.0, (2.6, 3.1)
# F is screened for oscillation that the head does not resolve up to this term, at every
# `SCREEN_STRIDE`th: a pole left of the line is seen over 5 terms and more. Differences of this
# order annihilate what is smooth; what they leave counts from this part of the error wanted.
PROBE_TERMS, SCREEN_STRIDE, SCREEN_ORDER, SCREEN_PART = 4096, 4, 10, 0.01
# Times at which a longer series is summed, and the period of its twin, in which F is rounded
# otherwise: what the longer one changes must exceed their difference by this factor.
MAX_PROBES, TWIN, CONSISTENT = 16, 1.001, 5.0


def dehoog(
    sample: Sampler, t: RealArray, head: int, check: int
) -> tuple[RealArray, RealArray, RealArray]:
    """Values, error estimates and rounding for times `t` (n,) of one window.

    The error is the largest difference from series with other periods, larger aliases and `check`
    terms in their heads.
    """
    values, rounding = _series(sample, t, HALF_PERIOD * t[-1], ALIASING, head)
    rounding = rounding + ALIASING * abs(values).max()
    error = np.zeros_like(t)
    for half_period in CHECK_HALF_PERIODS:
        other, _ = _series(sample, t, half_period * t[-1], CHECK_ALIASING, check)
        error = np.maximum(error, abs(values - other))
    return values, error + rounding, rounding


def beyond_head(
    sample: Sampler, t: RealArray, values: RealArray, head: int, wanted: float
) -> float:
    """The largest change of `values` (n,) that `PROBE_TERMS` terms in place of `head` make.

    An oscillation that is faster than the head resolves leaves no trace in the terms from which
    its tail is guessed: all heads that are too short agree on the same wrong answer. Zero where
    F looks smooth beyond the head, to a part of the error `wanted` [unit of `values`], and where
    it is not finite there: nothing is known.
    """
    half_period = HALF_PERIOD * t[-1]
    k = np.arange(head, PROBE_TERMS, SCREEN_STRIDE)
    if k.size <= SCREEN_ORDER:
        return 0.0
    gamma = _line(half_period, ALIASING)
    with np.errstate(all="ignore"):
        left = (
            gamma * abs(np.diff(sample.lenient(_nodes(gamma, half_period, k)), SCREEN_ORDER)).max()
        )
    if not np.isfinite(left) or left <= SCREEN_PART * wanted:
        return 0.0
    probes = np.unique(np.linspace(0, t.size - 1, min(t.size, MAX_PROBES)).astype(int))
    longer, twin = (
        _series(sample, t[probes], ratio * half_period, ALIASING, PROBE_TERMS)[0]
        for ratio in (1.0, TWIN)
    )
    change = abs(values[probes] - (longer + twin) / 2).max()
    return float(change) if change > CONSISTENT * abs(longer - twin).max() else 0.0


def _line(half_period: float, aliasing: float) -> float:
    """Re s of the line on which aliases of the series are `aliasing` [1/s]."""
    return float(-np.log(aliasing) / (2 * half_period))


def _nodes(gamma: float, half_period: float, k: NDArray[np.int_]) -> ComplexArray:
    """The `k`-th points on the line Re s = `gamma` [1/s]."""
    return (gamma + 1j * np.pi / half_period * k).astype(np.complex128)


def _series(
    sample: Sampler, t: RealArray, half_period: float, aliasing: float, head: int
) -> tuple[RealArray, RealArray]:
    """Values from a Fourier series on the line Re s = γ, and what rounding may do to them.

    De Hoog, Knight & Stokes, SIAM J. Sci. Stat. Comput. 3 (1982) 357: the series in
    z = e^(iπt/T) is summed as a continued fraction with an estimate of its remainder (their
    eq. 16-25). Here the first `head` terms are summed as they are and only the rest is
    accelerated; this resolves poles up to Im s = π·head/T, and times t ≪ T.
    """
    gamma = _line(half_period, aliasing)
    k = np.arange(head + 2 * TAIL_ORDER + 1)
    terms = sample(_nodes(gamma, half_period, k)) * np.where(k == 0, 0.5, 1.0)
    z = np.exp(1j * np.pi / half_period * t)
    with np.errstate(all="ignore"):  # a degenerate fraction gives NaN: no answer, error infinite
        total = _polynomial(terms[:head], z) + z**head * _continued_fraction(terms[head:], z)
    scale = np.exp(gamma * t) / half_period
    return scale * total.real, ROUNDING * scale * abs(terms).sum()


def _polynomial(terms: ComplexArray, z: ComplexArray) -> ComplexArray:
    """Σ terms_k z^k: blocks of `BLOCK_TERMS` as one matrix product, then Horner over the blocks."""
    powers = np.cumprod(np.broadcast_to(z, (BLOCK_TERMS, z.size)), axis=0)
    blocks = terms.reshape(-1, BLOCK_TERMS) @ np.concatenate([np.ones((1, z.size)), powers[:-1]])
    total = blocks[-1]
    for block in blocks[-2::-1]:
        total = total * powers[-1] + block
    return total


def _continued_fraction(terms: ComplexArray, z: ComplexArray) -> ComplexArray:
    """Σ terms_k z^k by the quotient-difference algorithm."""
    d = _quotient_difference(terms)
    before = np.stack([np.zeros_like(z), np.ones_like(z)])  # numerator and denominator
    now = np.stack([np.full_like(z, d[0]), np.ones_like(z)])
    for coefficient in d[1:-1]:
        before, now = now, now + coefficient * z * before
    half = 0.5 * (1 + (d[-2] - d[-1]) * z)
    remainder = -half * (1 - np.sqrt(1 + d[-1] * z / half**2))
    numerator, denominator = now + remainder * before
    return np.asarray(numerator / denominator)


def _quotient_difference(terms: ComplexArray) -> ComplexArray:
    """Coefficients d_0 … d_2M of the continued fraction of a power series of 2M + 1 terms."""
    d = np.zeros_like(terms)
    d[0] = terms[0]
    q = _divide(terms[1:], terms[:-1])
    e = np.zeros_like(terms)
    for r in range(1, terms.size, 2):
        d[r] = -q[0]
        e = q[1:] - q[:-1] + e[1 : q.size]
        d[r + 1] = -e[0]
        q = _divide(q[1:-1] * e[1:], e[:-1])
    return d


def _divide(a: ComplexArray, b: ComplexArray) -> ComplexArray:
    """a / b; zero where b is: the fraction ends there."""
    return np.divide(a, b, out=np.zeros_like(a), where=b != 0)
