"""Penalties on a heat, as what the heat does in a state space.

A quadratic penalty on the d-th difference of the heat, λ Σ (Δᵈu / level)², is the logarithm of the
prior of a heat whose d-th difference is white: order 0 white noise, order 1 a random walk, order 2
an integrated one. So Tikhonov's solution for a machine at rest is a fixed-interval smoother. The
heat is zero before the first row; a heat that acts from there on is a difference like any other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.even_smoother import EvenSmoother
from thermaltool.estimation.state_space import StateSpace
from thermaltool.responses.modes import Float
from thermaltool.responses.recursion import Recursion


@dataclass(frozen=True)
class HeatProblem:
    """Heat of one drive from sensors on an even clock, the machine at rest at the start.

    Attributes
    ----------
    estimator : KalmanEstimator
        Of one drive; its responses and its sensors' noise count.
    dt : float [s]
    level : float
        The drive's largest size in the calibration [unit of the drive].
    """

    estimator: KalmanEstimator
    dt: float
    level: float

    def space(
        self, order: int, weight: float, pinned: float | None = None
    ) -> tuple[StateSpace, Float]:
        """State space of a penalty, and the covariance of the first state.

        Parameters
        ----------
        order : int
            0, 1 or 2, of the difference that is penalized.
        weight : float
            λ [1].
        pinned : float, optional
            Weight of a further penalty on the distance of the heat from a last column of readings
            [1]: Σ ((u − reading) / level)².

        Returns
        -------
        space : StateSpace
            Its one estimate is the heat.
        start : ndarray, shape (n, n)
        """
        space = self._unpenalized
        modal, n = self.estimator.modal, len(space.F)
        # The second order has the heat's last difference for a state of its own, behind the rest.
        states = n + (order == 2)
        F, H = np.zeros((states, states)), np.zeros((len(space.H), states))
        F[:n, :n], H[:, :n] = space.F, space.H
        C, entered = np.zeros((1, states)), np.zeros(states)
        C[0, modal] = entered[modal] = 1.0
        if order == 0:
            F[modal, modal] = 0.0
        if order == 2:
            F[modal, n] = F[n, n] = entered[n] = 1.0
        heated = (self.level**2 / weight) * np.outer(entered, entered)
        Q = heated.copy()
        drift = np.arange(modal + 1, n)
        Q[drift, drift] = np.diag(space.Q)[drift]
        start = heated
        start[drift, drift] = [each.drift**2 for each in self.estimator.noise]
        R = space.R
        if pinned is not None:
            H = np.vstack([H, C])
            R = np.diag([*np.diag(R), self.level**2 / pinned])
        return StateSpace(F, H, C, Q, R), start

    def simulated(self, heat: Float) -> Float:
        """Readings without noise that a heat makes.

        Parameters
        ----------
        heat : ndarray, shape (n,)

        Returns
        -------
        ndarray, shape (n, n_sensors)
        """
        return self.machine.run(heat[:, None])[0]

    @cached_property
    def machine(self) -> Recursion:
        """From the heat to the readings, over one sample."""
        modal, space = self.estimator.modal, self._unpenalized
        G = space.F[:modal, modal : modal + 1]
        return Recursion(space.F[:modal, :modal], G, np.zeros_like(G), space.H[:, :modal])

    def misfit(self, residuals: Float) -> float:
        """Squares of residuals over the covariance of the sensors' noise, drift included [1].

        Parameters
        ----------
        residuals : ndarray, shape (n, n_sensors)
        """
        white = np.array([each.white for each in self.estimator.noise])
        drift = np.array([each.drift for each in self.estimator.noise])
        if not drift.any():
            return float(np.sum(np.square(residuals / white)))
        first = self.estimator.modal + 1
        space = self._unpenalized
        own = slice(first, first + len(drift))
        F, H, Q = space.F[own, own], space.H[:, own], space.Q[own, own]
        noise = StateSpace(F, H, H, Q, space.R)
        return EvenSmoother(noise, np.diag(drift**2), len(residuals)).start(residuals)[1]

    @cached_property
    def _unpenalized(self) -> StateSpace:
        return self.estimator.state_space(self.dt)
