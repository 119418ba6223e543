"""Contours that serve a window of times with one set of evaluations of F."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from thermaltool.laplace.sampling import ROUNDING, ComplexArray, RealArray, Sampler

# Last over first time of a window, and its largest size (which bounds the memory).
MAX_TIME_RATIO, MAX_WINDOW_SIZE = 16.0, 4096


def windows(t: RealArray) -> list[slice]:
    """Slices of the ascending times `t`, within `MAX_TIME_RATIO` and `MAX_WINDOW_SIZE` each."""
    slices: list[slice] = []
    stop = t.size
    while stop:
        start = max(int(np.searchsorted(t, t[stop - 1] / MAX_TIME_RATIO)), stop - MAX_WINDOW_SIZE)
        slices.append(slice(start, stop))
        stop = start
    return slices[::-1]


@lru_cache
def hyperbola_rule(order: int) -> tuple[ComplexArray, ComplexArray]:
    """Nodes and weights on a hyperbola for times in [1/`MAX_TIME_RATIO`, 1].

    Weideman & Trefethen, Math. Comp. 76 (2007) 1341, section 4: z = μ(1 + sin(iu − φ)) with the
    midpoint rule of step h; μ and h balance the truncation against both discretization errors
    and φ gives the fastest decay. `order` nodes in the upper half plane stand for both halves.
    """
    phi = np.linspace(np.pi / 4, np.pi / 2, 2002)[1:-1]
    excess = 4 * phi - np.pi
    reach = np.arccosh(((np.pi - 2 * phi) * MAX_TIME_RATIO + excess) / (excess * np.sin(phi)))
    best = np.argmax((np.pi**2 - 2 * np.pi * phi) / reach)
    step, mu = reach[best] / order, np.pi * excess[best] / reach[best] * order
    angle = 1j * (np.arange(order) + 0.5) * step - phi[best]
    return mu * (1 + np.sin(angle)), mu * np.cos(angle) * step / np.pi


# Decay e^(−0.9·order): 36 nodes reach rounding; the lower order's error is about tenfold.
HYPERBOLA_ORDERS = (36, 33)


def hyperbola(sample: Sampler, t: RealArray) -> tuple[RealArray, RealArray]:
    """Values and error estimates on one contour for times `t` (n,) of one window."""
    (best, rounding), (lower, _) = (_contour(sample, t, order) for order in HYPERBOLA_ORDERS)
    return best, abs(best - lower) + rounding


def _contour(sample: Sampler, t: RealArray, order: int) -> tuple[RealArray, RealArray]:
    """The sum Σ Re(c e^(st)) = Σ |c| e^(t Re s) cos(t Im s + arg c), and its rounding."""
    nodes, weights = hyperbola_rule(order)
    last = t[-1]
    terms = sample(nodes / last) * weights / last
    decay = np.exp(np.outer(t / last, nodes.real))
    wave = np.cos(np.outer(t / last, nodes.imag) + np.angle(terms))
    return (decay * wave) @ abs(terms), ROUNDING * (decay @ abs(terms))
