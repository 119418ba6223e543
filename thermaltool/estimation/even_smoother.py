"""Fixed-interval smoother on an even clock: one gain for all rows, and still exact at the start.

The steady Kalman filter is the exact one for a machine whose first state has the steady covariance
P of a prediction. A machine that starts with P₀ (at rest: zero) is reached without a gain for each
row: with r and N the adjoint and its covariance behind the first row (de Jong 1989), D = P − P₀,

    r' = (I − N D)⁻¹ r,   a₀ = −D r',   −2 log p' = −2 log p + rᵀ D r' + log det(I − N D)

makes the conditional mean of the first prior that of the second, which follows from the change of
the prior of the first state alone. Two recursions with constant matrices do the rest: linear work,
and many records cost one set of matrices. `smoother.smooth` takes any clock and missing readings.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from thermaltool.estimation.state_space import StateSpace, propagated
from thermaltool.responses.modes import Float
from thermaltool.responses.recursion import Recursion

# What is left of a start below this share no longer counts.
REMAINDER = 1e-10


class EvenSmoother:
    """Smoother of records of `rows` rows.

    Parameters
    ----------
    space : StateSpace
        Over one sample.
    start : ndarray, shape (n, n)
        Covariance of the first state.
    rows : int
    shocked : sequence of int
        States of which `scores` and `information` tell, and that `run` may know to be moved.

    Raises
    ------
    FitError
        The Riccati equation has no steady solution.
    """

    def __init__(
        self, space: StateSpace, start: Float, rows: int, shocked: Sequence[int] = ()
    ) -> None:
        F, H, C = space.F, space.H, space.C
        self.rows, self.sensors, self._C = rows, len(H), C
        self.P = P = space.predicted()
        self.S = H @ P @ H.T + space.R
        self.H, self.K = H, F @ space.filter_gain(P)
        self.L = F - self.K @ H
        self.weighed = np.asarray(np.linalg.solve(self.S, H))
        self._weight = np.linalg.inv(self.S)
        self.D = P - start
        self._forward = Recursion(self.L, self.K, np.zeros_like(self.K), np.vstack([H, C]))
        back = self.weighed.T
        self._back = Recursion(self.L.T, np.zeros_like(back), back, C @ P.T)
        self._shocked = list(shocked)
        self._entered = np.eye(len(P))[self._shocked]
        self._score = Recursion(self.L.T, np.zeros_like(back), back, self._entered)
        self.N = propagated(self.L.T, H.T @ self.weighed, np.zeros_like(P), rows)
        self.ratio = np.eye(len(P)) - self.N @ self.D

    @property
    def variance(self) -> Float:
        """Variance of each estimate far from both ends of the record, shape (n_estimates,)."""
        PC = self.P @ self._C.T
        return np.asarray(np.einsum("ij,ij->j", PC, self._C.T - self.N @ PC))

    @cached_property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the readings' covariance."""
        steady = self.rows * float(np.linalg.slogdet(self.S)[1])
        return steady + float(np.linalg.slogdet(self.ratio)[1])

    def run(self, readings: Float, shocks: Float | None = None) -> tuple[Float, float]:
        """Smoothed estimates, and the readings squared over their covariance.

        Parameters
        ----------
        readings : ndarray, shape (n, n_sensors)
        shocks : ndarray, shape (n, n_shocked), optional
            What the shocked states are known to be moved by at each row, before its reading.

        Returns
        -------
        estimates : ndarray, shape (n, n_estimates)
        squares : float
            yᵀ Σ⁻¹ y.
        """
        estimates, first, squares = self._begun(readings, shocks)
        count = min(self.rows, self._memory)
        estimates[:count] += self._pass(np.zeros((count, self.sensors)), first)[0]
        return estimates, squares

    def start(self, readings: Float) -> tuple[Float, float]:
        """What readings say of the start, and how likely they are: half the work of `run`.

        Parameters
        ----------
        readings : ndarray, shape (n, n_sensors)

        Returns
        -------
        state : ndarray, shape (n_states,)
            Conditional mean of the first state, before its reading.
        squares : float
            As of `run`.
        """
        return self._begun(readings)[1:]

    def _begun(self, readings: Float, shocks: Float | None = None) -> tuple[Float, Float, float]:
        """Estimates as from a start of zero, the first state, and the squares."""
        estimates, v, r = self._pass(readings, np.zeros(len(self.P)), shocks)
        squares = float(np.sum(self._weight * (v.T @ v)))
        told = np.linalg.solve(self.ratio, r)
        return estimates, -self.D @ told, squares + float(r @ self.D @ told)

    def scores(self, readings: Float) -> Float:
        """How the log likelihood changes with a shock to a state, at the shock of zero.

        Parameters
        ----------
        readings : ndarray, shape (n, n_sensors)

        Returns
        -------
        ndarray, shape (n, n_shocked)
            Of a shock at each row, before its reading.
        """
        v, _ = self._innovations(readings, np.zeros(len(self.P)))
        found, r = self._adjoint(self._score, v)
        first = -self.D @ np.linalg.solve(self.ratio, r)
        count = min(self.rows, self._memory)
        v, _ = self._innovations(np.zeros((count, self.sensors)), first)
        found[:count] += self._adjoint(self._score, v)[0]
        return found

    def information(self) -> Float:
        """Information that readings hold on such a shock, shape (n, n_shocked)."""
        W, count, at = self.H.T @ self.weighed, min(self.rows, self._memory), self._shocked
        # From the last row back until the readings that are still to come make no difference.
        late, N = np.empty((count, len(at))), np.zeros_like(W)
        # What so many rows that are still to come tell of a shock now, through any state.
        told = np.empty((count, len(W), len(at)))
        for k in range(count):
            N = W + self.L.T @ N @ self.L
            late[k], told[k] = N[at, at], N[:, at]
        found = np.tile(late[-1], (self.rows, 1))
        found[self.rows - count :] = late[::-1]
        # A start that is known better than the steady filter knows a state: its first rows.
        gained, back = np.linalg.solve(self.ratio.T, self.D), np.eye(len(W))
        for k in range(count):
            reach = back @ told[min(self.rows - k, count) - 1]
            found[k] += np.einsum("ij,ik,kj->j", reach, gained, reach)
            back = self.L.T @ back
        return np.maximum(found, 0.0)

    def _pass(
        self, readings: Float, first: Float, shocks: Float | None = None
    ) -> tuple[Float, Float, Float]:
        v, predicted = self._innovations(readings, first, shocks)
        added, r = self._adjoint(self._back, v)
        return predicted + added, v, r

    def _innovations(
        self, readings: Float, first: Float, shocks: Float | None = None
    ) -> tuple[Float, Float]:
        if shocks is None:
            out, _ = self._forward.run(readings, first)
        else:
            # A shock before the next reading is an input of this row.
            following = np.vstack([shocks[1:], np.zeros((1, shocks.shape[1]))])
            moved = first + shocks[0] @ self._entered
            out, _ = self._forward_shocked.run(np.hstack([readings, following]), moved)
        # `run` takes an input at the start of its sample: row k has seen rows before k.
        return readings - out[:, : self.sensors], out[:, self.sensors :]

    def _adjoint(self, back: Recursion, v: Float) -> tuple[Float, Float]:
        padded = np.vstack([np.zeros((1, self.sensors)), v[::-1]])
        added, r = back.run(padded, np.zeros(len(self.P)))
        return added[:0:-1], r

    @cached_property
    def _forward_shocked(self) -> Recursion:
        """The filter whose shocked states are known to move."""
        G = np.hstack([self.K, self._entered.T])
        return Recursion(self.L, G, np.zeros_like(G), np.vstack([self.H, self._C]))

    @cached_property
    def _memory(self) -> int:
        """Rows until a first state is forgotten."""
        stays = float(np.max(np.abs(np.linalg.eigvals(self.L))))
        rows = np.log(REMAINDER) / np.log(max(stays, 1e-12)) if stays < 1 else np.inf
        return int(min(self.rows, 2 * rows + 64))
