"""Inversion rules that scale with each time: f(t) ≈ (1/t) Σ Re[ω_k F(α_k/t)].

The unified framework of Abate & Whitt, INFORMS J. Comput. 18 (2006) 408, holds three classical
methods as three sets of nodes α_k and weights ω_k. Each time has its own nodes.
"""

from __future__ import annotations

from functools import lru_cache
from math import comb, factorial, log

import numpy as np

from thermaltool.laplace.sampling import ROUNDING, ComplexArray, RealArray, Sampler


@lru_cache
def talbot_rule(order: int) -> tuple[ComplexArray, ComplexArray]:
    """Fixed Talbot contour (Abate & Valko, Int. J. Numer. Meth. Engng 60 (2004) 979, eq. 19-21)."""
    theta = np.arange(1, order) * np.pi / order
    cot = 1 / np.tan(theta)
    radius = 2 * order / 5
    nodes = np.append(radius * theta * (cot + 1j), radius)
    slope = np.append(1 + 1j * theta * (1 + cot**2) - 1j * cot, 0.5)
    return nodes.astype(np.complex128), (0.4 * slope * np.exp(nodes)).astype(np.complex128)


@lru_cache
def euler_rule(order: int) -> tuple[ComplexArray, ComplexArray]:
    """Fourier series with Euler summation (Abate & Whitt 2006, eq. 36-38)."""
    xi = np.ones(2 * order + 1)
    xi[0] = 0.5
    xi[order + 1 :] = [
        sum(comb(order, j) for j in range(k)) / 2**order for k in range(order, 0, -1)
    ]
    k = np.arange(2 * order + 1)
    nodes = order * log(10) / 3 + 1j * np.pi * k
    weights = 10 ** (order / 3) * (-1.0) ** k * xi
    return nodes.astype(np.complex128), weights.astype(np.complex128)


@lru_cache
def stehfest_rule(order: int) -> tuple[ComplexArray, ComplexArray]:
    """Gaver-Stehfest, real nodes only (Stehfest, Comm. ACM 13 (1970) 47); 2·`order` terms."""
    weights = [
        (-1) ** (order + k)
        * sum(
            j ** (order + 1) * comb(order, j) * comb(2 * j, j) * comb(j, k - j)
            for j in range((k + 1) // 2, min(k, order) + 1)
        )
        / factorial(order)
        for k in range(1, 2 * order + 1)
    ]
    nodes = log(2) * np.arange(1, 2 * order + 1)
    return nodes.astype(np.complex128), log(2) * np.array(weights, dtype=np.complex128)


RULES = {"talbot": talbot_rule, "euler": euler_rule, "stehfest": stehfest_rule}

# (order, lower orders): where rounding, amplified by the weights, meets truncation in double
# precision. The largest difference from the lower orders is the error estimate.
ORDERS = {"talbot": (20, 18), "euler": (14, 12), "stehfest": (7, 6, 5)}


def apply_rule(sample: Sampler, t: RealArray, name: str) -> tuple[RealArray, RealArray]:
    """Values and error estimates of the rule `name` at times `t`, both of shape (n,)."""
    (values, rounding), *lower = (_sum(sample, t, *RULES[name](order)) for order in ORDERS[name])
    return values, rounding + np.max([abs(values - other) for other, _ in lower], axis=0)


def _sum(
    sample: Sampler, t: RealArray, nodes: ComplexArray, weights: ComplexArray
) -> tuple[RealArray, RealArray]:
    """The rule's sum, and what rounding may do to it."""
    terms = weights * sample((nodes / t[:, None]).ravel()).reshape(t.size, nodes.size)
    return terms.real.sum(axis=1) / t, ROUNDING * abs(terms).sum(axis=1) / t
