"""State space of an estimator over one sample, and the steady covariance of its prediction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermaltool.errors import FitError
from thermaltool.responses.modes import Float


@dataclass(frozen=True)
class StateSpace:
    """x ← F x + w, readings H x + e, estimates C x.

    Attributes
    ----------
    F : ndarray, shape (n, n)
    H : ndarray, shape (n_sensors, n)
    C : ndarray, shape (n_estimates, n)
    Q : ndarray, shape (n, n)
        Covariance of w over one sample.
    R : ndarray, shape (n_sensors, n_sensors)
        Of e, the sensors' white noise.
    """

    F: Float
    H: Float
    C: Float
    Q: Float
    R: Float

    def predicted(self) -> Float:
        """Steady covariance of the state before a reading, shape (n, n)."""
        return predicted_covariance(self.F, self.H, self.Q, self.R)

    def filter_gain(self, P: Float) -> Float:
        """What a reading corrects, for a predicted covariance `P`: P Hᵀ (H P Hᵀ + R)⁻¹."""
        return np.asarray(np.linalg.solve(self.H @ P @ self.H.T + self.R, self.H @ P).T)


def predicted_covariance(F: Float, H: Float, Q: Float, R: Float) -> Float:
    """Steady covariance of the one-step prediction: the filter Riccati equation by doubling.

    Parameters
    ----------
    F : ndarray, shape (n, n)
    H : ndarray, shape (p, n)
    Q : ndarray, shape (n, n)
    R : ndarray, shape (p, p)

    Returns
    -------
    P : ndarray, shape (n, n)
        P = F P Fᵀ − F P Hᵀ (H P Hᵀ + R)⁻¹ H P Fᵀ + Q.

    Raises
    ------
    FitError
        Where it does not converge: a state that no sensor sees and that does not decay.
    """
    A, G, P = F.T.copy(), H.T @ np.linalg.solve(R, H), Q.copy()
    eye = np.eye(len(F))
    for _ in range(64):
        W = np.linalg.solve(eye + G @ P, np.hstack([A, G]))
        WA, WG = W[:, : len(F)], W[:, len(F) :]
        with np.errstate(over="ignore", invalid="ignore"):
            step = A.T @ P @ WA
            G = G + A @ WG @ A.T
            A = A @ WA
            P = P + step
        P = (P + P.T) / 2
        if not np.all(np.isfinite(P)):
            break
        if np.max(np.abs(step)) <= 1e-13 * np.max(np.abs(P)):
            return P
    raise FitError("the estimator's Riccati equation has no steady solution")


def propagated(A: Float, added: Float, P: Float, count: int) -> Float:
    """`P` after `count` steps P ← added + A P Aᵀ, by doubling.

    Parameters
    ----------
    A, added, P : ndarray, shape (n, n)
    count : int
    """
    power, total = A, added
    while count:
        if count & 1:
            P = total + power @ P @ power.T
        count >>= 1
        if count:
            total = total + power @ total @ power.T
            power = power @ power
    return (P + P.T) / 2
