"""The first rows of a filter that begins in a state of which little is known.

The gain of a steady filter takes a start for as well known as any later row. Until the readings
have told it, the covariance of the start itself is carried along, and with it the gain and what is
expected of an innovation (the Kalman filter as it is, sample by sample). It needs numpy alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.gain_test import WhitenedSample
from thermaltool.responses.modes import Float
from thermaltool.responses.sample_clock import CLOCK_STEP

# An innovation says something of the machine where its variance is no more than so many times the
# steady one, in any direction: else the start is more than half of it [1].
MAX_START_SHARE = 2.0
# The gain and the innovations' variances are those of the steady filter to this share [1].
CONVERGED = 0.01


class FreeStart:
    """The filter of a machine that is warm, from its first reading on.

    Parameters
    ----------
    estimator : KalmanEstimator
    dt : float [s]
        The usual sample.
    level : sequence of float, one for each drive
        Standard deviation of the heat that the machine has had [unit of the drive].
    kept : list, optional
        What `state` gave, to go on from.

    Raises
    ------
    ValueError
        Not a state of this filter.

    Attributes
    ----------
    over : bool
        Whether the steady filter can go on.
    counts : bool
        Whether the last innovation rests on the rows before it more than on the start.
    """

    def __init__(
        self,
        estimator: KalmanEstimator,
        dt: float,
        level: Sequence[float],
        kept: list[Any] | None = None,
    ) -> None:
        self._estimator = estimator
        self._P = estimator.start_covariance(dt, level, "free")
        self.over = self.counts = False
        if kept is not None:
            P = np.array(kept, float)
            if P.shape != self._P.shape or not np.isfinite(P).all():
                raise ValueError("not a state of this filter")
            self._P = P

    def state(self) -> list[Any]:
        """The covariance, as JSON."""
        found: list[Any] = self._P.tolist()
        return found

    def first(self, dt: float, reading: Float) -> Float:
        """The state after the first reading, shape (n,)."""
        space = self._estimator.state_space(dt)
        G = space.filter_gain(self._P)
        self._keep(G, space.H, space.R)
        return np.asarray(G @ reading)

    def sample(self, ticks: int, steady: WhitenedSample) -> WhitenedSample:
        """The filter over a sample of `ticks` clock steps, where it is `steady` in the long run."""
        space = self._estimator.state_space(ticks * CLOCK_STEP)
        self._P = space.F @ self._P @ space.F.T + space.Q
        G = space.filter_gain(self._P)
        now = WhitenedSample.of(space.F, space.H, G, space.H @ self._P @ space.H.T + space.R)
        self._keep(G, space.H, space.R)
        # The root of a covariance over another: its singular values are one where they agree.
        ratio = steady.root @ np.linalg.inv(now.root)
        sizes = np.linalg.svd(ratio, compute_uv=False) ** 2
        self.counts = bool(sizes[0] <= MAX_START_SHARE)
        near = np.max(np.abs(G - steady.G)) <= CONVERGED * np.max(np.abs(steady.G))
        self.over = bool(near and np.max(np.abs(sizes - 1)) <= CONVERGED)
        return now

    def _keep(self, G: Float, H: Float, R: Float) -> None:
        """What a reading leaves of the covariance (Joseph's form, which stays positive)."""
        kept = np.eye(len(G)) - G @ H
        self._P = kept @ self._P @ kept.T + G @ R @ G.T
