"""What the linear estimators share: one recursion for each sample length, solved for once."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from thermaltool.responses.modes import Float
from thermaltool.responses.recursion import Recursion
from thermaltool.responses.sample_clock import CLOCK_STEP, uniform_spans

# Sample lengths whose recursion is kept: an even clock has one, a printed jittering one a few.
MAX_CACHED_RECURSIONS = 64


class LinearEstimator:
    """An estimator that is a linear recursion; a subclass builds it and names its estimates."""

    def __post_init__(self) -> None:
        # A cache of the instance: it goes when the estimator goes.
        object.__setattr__(self, "_recursions", lru_cache(MAX_CACHED_RECURSIONS)(self._of_ticks))

    @property
    def estimates(self) -> tuple[str, ...]:
        """Channels that are estimated, the deflections last."""
        raise NotImplementedError

    def recursion(self, dt: float) -> Recursion:
        """The recursion over one sample: from columns that are read to estimates.

        Parameters
        ----------
        dt : float [s]
            To a clock step.
        """
        recursion: Recursion = self._recursions(round(dt / CLOCK_STEP))  # type: ignore[attr-defined]
        return recursion

    def _of_ticks(self, ticks: int) -> Recursion:
        return self._build(ticks * CLOCK_STEP)

    def _build(self, dt: float) -> Recursion:
        raise NotImplementedError

    def start(self, dt: float, readings: Float, settled: bool = False) -> Float:
        """State at the first readings, shape (n,): at rest, or settled at them.

        Parameters
        ----------
        dt : float [s]
        readings : ndarray, shape (n_columns,)
        settled : bool
        """
        if settled:
            return self.recursion(dt).settled(readings)
        return np.zeros(len(self.recursion(dt).F))

    def at_rest(self, dt: float, readings: Float) -> Float:
        """What the sensors of a machine at rest read, relative to the model's zero.

        Parameters
        ----------
        dt : float [s]
        readings : ndarray, shape (n_columns,)
            The first.

        Returns
        -------
        ndarray, shape (n_sensors,)
            Of the sensors that estimates rest on.
        """
        return np.zeros(len(readings))

    def run(self, time: Float, readings: Float, settled: bool = False) -> Float:
        """Estimates for a whole record, equal to the stream's sample by sample.

        Parameters
        ----------
        time : ndarray, shape (n,) [s], increasing
        readings : ndarray, shape (n, n_sensors)
        settled : bool
            The machine has stood at the first readings for long; else it is at rest there.

        Returns
        -------
        estimates : ndarray, shape (n, n_estimates)
        """
        out = np.zeros((len(time), len(self.estimates)))
        x = None
        for rows, dt in uniform_spans(time):
            if x is None:
                x = self.start(dt, readings[0], settled)
            out[rows], x = self.recursion(dt).run(readings[rows], x)
        return out
