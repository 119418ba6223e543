"""The ring source by quadrature of the printed integrals: shares no code with the package."""

from __future__ import annotations

import numpy as np
from scipy.special import hankel1, hankel2, jv


def panels(edges, order=24):
    """Gauss-Legendre nodes and weights on panels between `edges`."""
    x, w = np.polynomial.legendre.leggauss(order)
    edges = np.asarray(edges, float)
    half, middle = np.diff(edges) / 2, (edges[1:] + edges[:-1]) / 2
    return (middle[:, None] + half[:, None] * x).ravel(), (half[:, None] * w).ravel()


def ring_transfer(s, K, a, alpha, r, r0):
    """(5.8): K α ∫ β J0(βr) J0(βr0) / (s + α(a + β²)) dβ at one complex s.

    The integrand oscillates and decays like 1/β² only. Up to B, beyond the poles ±iλ, the real axis
    is integrated panel by panel; beyond it J0 = (H1 + H2)/2, and the terms that decay upward
    (downward) are integrated along B + iy (B − iy), where they fall exponentially.
    """
    lam = np.sqrt(a + s / alpha)
    border = 3 * abs(lam) + 4 / r
    beta, w = panels(np.linspace(0, border, 2 + int(border * (r + r0))))
    near = np.sum(w * beta * jv(0, beta * r) * jv(0, beta * r0) / (beta**2 + lam**2))
    y, w = panels(np.concatenate([[0], np.geomspace(1e-3 / (r + r0), 60 / (r - r0), 40)]))
    up, down = border + 1j * y, border - 1j * y

    def tail(z, outer, inner):
        return np.sum(w * z * outer(0, z * r) * inner(0, z * r0) / (z**2 + lam**2)) / 4

    far = 1j * (tail(up, hankel1, hankel1) + tail(up, hankel1, hankel2))
    far -= 1j * (tail(down, hankel2, hankel2) + tail(down, hankel2, hankel1))
    return K * (near + far)


def ring_step(t, K, a, alpha, r, r0):
    """(3.7) at times t: the steady state less a part that falls like a Gaussian in β."""
    t = np.asarray(t, float)
    steady = ring_transfer(0.0, K, a, alpha, r, r0).real
    reach = np.sqrt(45 / (alpha * t[t > 0].min()))
    beta, w = panels(np.linspace(0, reach, 8 + int(reach * (r + r0))))
    shape = w * beta / (beta**2 + a) * jv(0, beta * r) * jv(0, beta * r0)
    rest = np.exp(-np.outer(t, (a + beta**2) * alpha)) @ shape
    return np.where(t > 0, steady - K * rest, 0.0)
