"""Whether the sensors still answer to a heat in the ratios of the model: a score test.

A machine that loses more heat, or a sensor that has come loose, changes how much of a heat each
sensor shows. One heat for all of them takes up what they have in common; their ratios are left. The
score of the likelihood for a gain of each sensor, and its information, are sums over the
innovations and what a gain would add to them (Basseville and Nikiforov 1993, sec. 8.2); sums that
forget. Gains as far from one as the calibration itself leaves them open are expected: they are the
prior that the sums are held against. It needs numpy alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.responses.modes import Float

# Score and information are forgotten by e in this time [s]: half of a shift.
MEMORY = 7200.0
# Nothing is said in the first so many seconds: the start is where a response is wrong.
FIRST_SILENCE = 1200.0
# How often it is looked at [s].
EVERY = 60.0
# Days without a change of the machine on which an alarm is admitted [1], if the calibration's
# errors are what they are taken for.
FALSE_DAYS = 0.01
# A gain that all sensors share is a heat: it may be any [1].
COMMON = 1.0
DAY = 86400.0


@dataclass(frozen=True)
class WhitenedSample:
    """A steady filter over one length of sample.

    Attributes
    ----------
    F, H, G : ndarray
        x ← F x, readings H x, gain.
    root : ndarray, shape (n_sensors, n_sensors)
        Whitens an innovation.
    kept : ndarray, shape (n, n)
        What a state becomes without its readings, (I − G H) F.
    whitened : ndarray, shape (n_sensors, n)
        What a state foretells of the next readings, whitened.
    log_scale : float
        Logarithm of the determinant of `root`.
    """

    F: Float
    H: Float
    G: Float
    root: Float
    kept: Float
    whitened: Float
    log_scale: float

    @staticmethod
    def of(F: Float, H: Float, G: Float, S: Float) -> WhitenedSample:
        """From the covariance of its innovations, too."""
        root = np.linalg.inv(np.linalg.cholesky(S))
        scale = float(np.sum(np.log(np.diag(root))))
        return WhitenedSample(F, H, G, root, F - G @ H @ F, root @ H @ F, scale)


class GainTest:
    """The test of one stream or record.

    Parameters
    ----------
    shared : ndarray, shape (n_sensors, n_drives)
        Share of each drive in a sensor's signal [1].
    error : sequence of float
        Standard deviation of each sensor's gain around that of the model [1].

    Attributes
    ----------
    value : float
        The statistic: chi-squared, of as many degrees of freedom as sensors exceed drives.
    limit : float
        Above it the gains contradict.
    """

    def __init__(self, shared: Float, error: Sequence[float]) -> None:
        sensors, drives = shared.shape
        if len(error) != sensors:
            raise ModelError("design.bands.gain_error: not one for each sensor")
        self._prior = np.diag(np.square(error)) + COMMON**2 * shared @ shared.T
        self.limit = chi_squared_limit(max(sensors - drives, 1), FALSE_DAYS * MEMORY / DAY)
        self._sensors = sensors
        self.value = 0.0

    def start(self, states: int) -> None:
        """Begin with a filter of so many states, which knows nothing of other gains."""
        self._moved = np.zeros((states, self._sensors))
        self._score = np.zeros(self._sensors)
        self._information = np.zeros((self._sensors, self._sensors))
        self._age = self._due = 0.0
        self.value = 0.0

    def forget_state(self) -> None:
        """The filter begins anew, and knows nothing of other gains; what was found stays."""
        self._moved[:] = 0.0

    def step(self, over: WhitenedSample, signals: Float, z: Float, dt: float, counts: bool) -> None:
        """Take a row.

        Parameters
        ----------
        over : WhitenedSample
            The filter over the sample that ends here.
        signals : ndarray, shape (n_sensors,)
            What the heat alone is foretold to give each sensor.
        z : ndarray, shape (n_sensors,)
            The whitened innovation.
        dt : float [s]
        counts : bool
            Whether this row may say something.
        """
        if counts:
            slope = over.root * signals - over.whitened @ self._moved
            self._score += z @ slope
            self._information += slope.T @ slope
        self._moved = over.kept @ self._moved + over.G * signals
        self._due += dt
        if self._due >= EVERY:
            self._age += self._due
            stays = math.exp(-self._due / MEMORY)
            self._score *= stays
            self._information *= stays
            self._due = 0.0
            self._look()

    def _look(self) -> None:
        M, b = self._information, self._score
        if self._age < FIRST_SILENCE or not np.any(M):
            return
        # b ~ N(0, M + M Σ M): what M lets through, noise and prior together.
        size, vectors = np.linalg.eigh(M)
        kept = size > 1e-12 * size[-1]
        axes, size = vectors[:, kept], size[kept]
        seen = axes.T @ b / size
        spread = np.diag(1 / size) + axes.T @ self._prior @ axes
        self.value = float(seen @ np.linalg.solve(spread, seen))

    def gains(self) -> Float:
        """Gain of each sensor over that of the model, their mean being one; shape (n_sensors,)."""
        spread = np.eye(self._sensors)
        found = np.linalg.solve(self._information + spread, self._score)
        return np.asarray(1 + found - np.mean(found))

    def state(self) -> list[Any]:
        """For `resume`, as JSON."""
        arrays = self._moved, self._score, self._information
        return [*(each.tolist() for each in arrays), self._age, self._due, self.value]

    def resume(self, values: list[Any]) -> None:
        """Go on from a state, after `start`.

        Raises
        ------
        ValueError
            Not a state of this test.
        """
        *arrays, age, due, value = values
        found = [np.array(each, float) for each in arrays]
        shapes = [each.shape for each in (self._moved, self._score, self._information)]
        whole = np.concatenate([[age, due, value], *(each.ravel() for each in found)])
        if [each.shape for each in found] != shapes or not np.isfinite(whole).all():
            raise ValueError("not a state of this test")
        self._moved, self._score, self._information = found
        self._age, self._due, self.value = float(age), float(due), float(value)


def chi_squared_limit(freedom: int, above: float) -> float:
    """What a chi-squared variable exceeds with a probability (Wilson and Hilferty 1931).

    Parameters
    ----------
    freedom : int
    above : float
        Below 0.5.
    """
    from statistics import NormalDist

    spread = 2 / (9 * freedom)
    return freedom * (1 - spread + NormalDist().inv_cdf(1 - above) * math.sqrt(spread)) ** 3
