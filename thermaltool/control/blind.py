"""Control without a temperature: the estimator's own prediction stands in, while it is worth it."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.known_inputs import KnownInputEstimator
from thermaltool.responses.modes import Float

# Standard deviations in a 95 % band.
INTERVAL = 2.0
# The longest that a prediction is foretold to be worth it, in sample periods.
MAX_PERIODS = 100_000


class BlindPrediction:
    """Readings that are expected of lost sensors, and the band of the deflections behind them.

    A lost sensor is taken to read what the state foretells, so that it corrects nothing. The
    covariance of the state then grows with the random walk of the heat: after a sample,

        P ← (I − K H) (F P Fᵀ + Q) (I − K H)ᵀ + K R Kᵀ,

    with the columns of K zero that belong to sensors which are lost.

    Parameters
    ----------
    estimator : KnownInputEstimator
        Whose inner one is a Kalman filter.
    outputs : sequence of str
        Deflections that are held.
    tolerance : sequence of float, one for each of them
    period : float [s]

    Attributes
    ----------
    lost : frozenset of int
        Sensors of the filter that do not count.
    """

    def __init__(
        self,
        estimator: KnownInputEstimator,
        outputs: Sequence[str],
        tolerance: Sequence[float],
        period: float,
    ) -> None:
        assert isinstance(estimator.inner, KalmanEstimator)
        self._estimator, self._inner, self._period = estimator, estimator.inner, period
        self._rows = [estimator.estimates.index(each) for each in outputs]
        self._tolerance = np.array(tolerance)
        self.lost: frozenset[int] = frozenset()
        self._P = self._started()

    def _started(self) -> Float:
        """Covariance of the state while every sensor is read."""
        space, (P, gain) = self._inner.state_space(self._period), self._inner.steady(self._period)
        return np.asarray(P - gain @ space.H @ P)

    def take(self, dt: float, lost: Collection[int]) -> None:
        """A sample of `dt` [s] without these sensors."""
        lost = frozenset(lost)
        if not lost:
            if self.lost:
                self.lost, self._P = lost, self._started()
            return
        self.lost, self._P = lost, self._advanced(self._P, dt, lost)

    def _advanced(self, P: Float, dt: float, lost: Collection[int]) -> Float:
        space, gain = self._inner.state_space(dt), np.array(self._inner.steady(dt)[1])
        gain[:, list(lost)] = 0.0
        kept = np.eye(len(P)) - gain @ space.H
        P = kept @ (space.F @ P @ space.F.T + space.Q) @ kept.T + gain @ space.R @ gain.T
        return np.asarray((P + P.T) / 2)

    def filled(self, dt: float, x: Float, before: Float, readings: Sequence[float]) -> list[float]:
        """Readings after `dt` [s], with what is expected in the place of those that are lost.

        Parameters
        ----------
        dt : float [s]
        x : ndarray, shape (n,)
            State of the estimator at the sample before.
        before : ndarray
            Readings there.
        readings : sequence of float
        """
        filled = list(readings)
        if self.lost:
            now = np.where(np.isfinite(readings), readings, 0.0)
            space = self._inner.state_space(dt)
            expected = self._estimator.expected(space, dt, x, before, now)
            for k in self.lost:
                filled[k] = float(expected[k])
        return filled

    def band(self, P: Float | None = None) -> Float:
        """Half width of the 95 % band of the deflections, shape (number of outputs,)."""
        C, P = self._inner.recursion(self._period).C[self._rows], self._P if P is None else P
        return np.asarray(INTERVAL * np.sqrt(np.einsum("ij,jk,ik->i", C, P, C)))

    def worth_it(self, x: Float, P: Float | None = None) -> bool:
        """Whether the band is below what the disturbance does where nothing is held.

        Parameters
        ----------
        x : ndarray, shape (n,)
            State of the estimator.
        P : ndarray, optional
            Covariance. Default: as it is now.
        """
        C = self._inner.recursion(self._period).C[self._rows]
        bends = C @ x[: C.shape[1]] / self._tolerance
        limit = max(float(np.linalg.norm(bends)), 1.0)
        return bool(np.linalg.norm(self.band(P) / self._tolerance) <= limit)

    def lasts(self, x: Float) -> float:
        """How long the prediction will be worth it where nothing changes [s]."""
        P, periods = self._P, 0
        while periods < MAX_PERIODS and self.worth_it(x, P):
            P, periods = self._advanced(P, self._period, self.lost), periods + 1
        return periods * self._period

    def state(self) -> list[list[float]]:
        """Covariance, for `resume`, as JSON."""
        return self._P.tolist() if self.lost else []

    def resume(self, values: Sequence[Sequence[float]], lost: Collection[int]) -> None:
        """Go on from `values`; ValueError where they are no covariance of this estimator."""
        P = np.array(values, float) if values else self._P
        if P.shape != self._P.shape or not np.all(np.isfinite(P)):
            raise ValueError("not a covariance of this estimator")
        self._P, self.lost = P, frozenset(lost)
