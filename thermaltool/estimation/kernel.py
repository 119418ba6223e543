"""The regularized inverse of a temperature response, and its time-domain kernel.

Fraser 1997, (5.55), (5.59): f_R(t) = (At + Bt²)e^(−ct) is added to the step response, so that
H_R(s) = H(s) + As/(s+c)² + 2Bs/(s+c)³ has an inverse G = 1/H_R = G_p + A0 + A1 s with, because H
decays faster than any power of s, A1 = 1/A and A0 = 2c/A − 2B/A² exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from thermaltool.errors import FitError, ModelError
from thermaltool.laplace import invert
from thermaltool.responses.modes import Complex, Float, Modes


@dataclass(frozen=True)
class Regularization:
    """f_R(t) = (At + Bt²)e^(−ct).

    Attributes
    ----------
    A : float [unit of the response per s]
    B : float [unit of the response per s²]
    c : float [1/s]

    Raises
    ------
    ModelError
        A is zero or c is not above zero: there is no inverse, or it does not settle.
    """

    A: float
    B: float
    c: float

    def __post_init__(self) -> None:
        if not np.isfinite([self.A, self.B, self.c]).all() or self.A == 0 or self.c <= 0:
            raise ModelError(
                f"a regularization needs finite A, B, c with A other than 0 and c above 0 "
                f"(A={self.A:g}, B={self.B:g}, c={self.c:g})"
            )

    def transfer(self, s: Complex) -> Complex:
        """As/(s+c)² + 2Bs/(s+c)³: what is added to H.

        Parameters
        ----------
        s : ndarray, any shape, complex [rad/s]
        """
        s = np.asarray(s, complex)
        return self.A * s / (s + self.c) ** 2 + 2 * self.B * s / (s + self.c) ** 3

    def slope(self, s: Complex) -> Complex:
        """Derivative of `transfer` by s.

        Parameters
        ----------
        s : ndarray, any shape, complex [rad/s]
        """
        s, c = np.asarray(s, complex), self.c
        first = self.A * (c - s) / (s + c) ** 3
        return np.asarray(first + 2 * self.B * (c - 2 * s) / (s + c) ** 4)

    def singular_weights(self) -> tuple[float, float]:
        """A0 and A1: what the inverse does to ΔT and to its derivative."""
        return 2 * self.c / self.A - 2 * self.B / self.A**2, 1 / self.A


@dataclass(frozen=True)
class RegularizedInverse:
    """G(s) = G_p(s) + A0 + A1 s with G_p as modes.

    Attributes
    ----------
    regular : Modes
        G_p; its poles are the zeros of H_R.
    A0, A1 : float
        Singular weights of this sum of modes. They differ from the exact ones by as much as the
        modes differ from the response, which keeps G(0)·H(0) = 1.
    """

    regular: Modes
    A0: float
    A1: float

    @property
    def damping(self) -> float:
        """Smallest damping ratio of the poles: 1 for real ones, near 0 where the kernel rings."""
        return float(np.min(-self.regular.poles.real / np.abs(self.regular.poles)))

    def transfer(self, s: Complex) -> Complex:
        """G(s) at complex frequencies, ndarray of any shape [rad/s]."""
        return np.asarray(self.regular.transfer(s) + self.A0 + self.A1 * s)

    def filtered(self, cutoff: float) -> Modes:
        """Third-order Butterworth low-pass times G, as modes.

        The filter falls faster than the derivative in G rises, so no singular part is left.

        Parameters
        ----------
        cutoff : float [Hz]
        """
        omega = 2 * np.pi * cutoff
        own = omega * np.array([-1.0, -0.5 + 0.5j * np.sqrt(3)], complex)
        # Residues of the filter at its own poles.
        first = omega**3 / (own[0] ** 2 + omega * own[0] + omega**2)
        second = omega**3 / ((own[1] + omega) * 2j * own[1].imag)
        poles = self.regular.poles
        gain = omega**3 / ((poles + omega) * (poles**2 + omega * poles + omega**2))
        weights = np.array([first, second]) * self.transfer(own.astype(complex))
        return Modes(
            np.concatenate([poles, own]), np.concatenate([self.regular.weights * gain, weights])
        )


def invert_modes(response: Modes, regularization: Regularization) -> RegularizedInverse:
    """The inverse of H_R for a response of simple real modes.

    Parameters
    ----------
    response : Modes
    regularization : Regularization

    Raises
    ------
    FitError
        Where the response has double or complex poles, or a zero of H_R lies in the right
        half-plane: the inverse would be unstable.
    """
    if np.any(response.double) or np.any(response.poles.imag):
        raise FitError("the kernel form takes a response of simple real modes; use --form kalman")
    there = response.weights != 0
    p, w = response.poles.real[there], response.weights.real[there]
    A, B, c = regularization.A, regularization.B, regularization.c
    n = len(p)
    # State space of H_R, the added part as a chain of three poles at −c:
    # s/(s+c)² = 1/(s+c) − c/(s+c)², s/(s+c)³ = 1/(s+c)² − c/(s+c)³.
    F = np.zeros((n + 3, n + 3))
    F[range(n), range(n)] = p
    F[n:, n:] = -c * np.eye(3) + np.eye(3, k=-1)
    b = np.concatenate([np.ones(n), [1.0, 0.0, 0.0]])
    read = np.concatenate([w, [A, 2 * B - A * c, -2 * B * c]])
    # Expansion at infinity: H_R = h1/s + h2/s² + …, hence A1 = 1/h1 and A0 = −h2/h1².
    h1, h2 = read @ b, read @ F @ b
    # Dynamics that keep the output at zero, plus one eigenvalue at the origin: the output itself.
    zeros = np.linalg.eigvals(F - np.outer(b, read @ F) / h1)
    zeros = np.delete(zeros, np.argmin(np.abs(zeros)))
    if np.any(zeros.real >= 0):
        raise FitError("the regularized inverse is unstable: a zero lies in the right half-plane")
    zeros = zeros[zeros.imag >= 0].astype(complex)
    slope = -(w / (zeros[:, None] - p) ** 2).sum(1) + regularization.slope(zeros)
    return RegularizedInverse(Modes(zeros, 1 / slope), float(-h2 / h1**2), float(1 / h1))


@dataclass(frozen=True)
class Kernel:
    """Weights of the inverse on equally spaced samples.

    Q̂(t_n) = Σ_k weight[k]·ΔT[n−k] + A0·ΔT[n] + A1·(ΔT[n] − ΔT[n−1])/dt, with ΔT a straight line
    between samples; the weights are exact integrals of G_p over each sample.

    Attributes
    ----------
    time : ndarray, shape (n,) [s]
    weight : ndarray, shape (n,)
        [drive per unit of the sensor]
    A0, A1 : float
    error : float
        Estimated absolute error of the weights.
    """

    time: Float
    weight: Float
    A0: float
    A1: float
    error: float


def kernel_table(
    transfer: Callable[[Complex], Complex],
    regularization: Regularization,
    dt: float,
    window: int,
    tol: float = 1e-8,
) -> Kernel:
    """The kernel by numerical inversion of G_p/s², from the closed form of H.

    Parameters
    ----------
    transfer : callable
        H(s), ndarray in and out.
    dt : float [s]
    window : int
        Number of weights.
    tol : float
        Wanted error of a weight, relative to the larger of A0 and 2c/A (A0 is zero for B = c A).

    Raises
    ------
    FitError
        H decays no faster than 1/s: A0 and A1 are then not those of the regularization.

    Notes
    -----
    With ΔT linear between samples the weight k is the second difference of the inverse of G_p/s².
    """
    A0, A1 = regularization.singular_weights()
    far = np.array([1e9 * regularization.c], complex)
    if np.abs(far * transfer(far))[0] > 1e-6 * abs(regularization.A):
        raise FitError("the kernel takes a response that starts by diffusion, with zero slope")

    def regular(s: Complex) -> Complex:
        return np.asarray(1 / (transfer(s) + regularization.transfer(s)) - A0 - A1 * s)

    t = dt * np.arange(window + 1)
    scale = max(abs(A0), abs(2 * regularization.c * A1))
    twice = invert(lambda s: regular(s) / s**2, t[1:], tol=tol * dt * scale, rtol=0.0)
    ramp = np.concatenate([[0.0], twice.values])
    weight = np.empty(window)
    weight[0] = ramp[1] / dt
    weight[1:] = (ramp[2:] - 2 * ramp[1:-1] + ramp[:-2]) / dt
    error = float(4 * np.max(twice.error) / dt)
    return Kernel(t[:window].astype(float), weight, A0, A1, error)
