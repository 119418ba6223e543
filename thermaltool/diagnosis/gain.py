"""What one model is worth beside another on the same rows, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermaltool.effects.effect import Float
from thermaltool.signals.agreement import agreement

# Blocks of the bootstrap of a gain, and draws.
BOOTSTRAP_BLOCKS, DRAWS = 36, 2000
# A gain below this share of the RMS is of no practical use.
MIN_GAIN = 0.1
# A loss of RMS that is sure counts from this share of the power of a reading's noise; from so many
# times of it where the zero is that of one reading, whose own noise it carries (two deviations).
MIN_LOSS, MIN_LOSS_COUNTED = 0.1, 4.0
# ... and a loss on the very rows from this share of the RMS.
MIN_LOSS_SHARE = 0.02


@dataclass(frozen=True)
class Gain:
    """What a cause is worth for one channel.

    Attributes
    ----------
    rms_before, rms_after, max_before, max_after : float [unit of the channel]
    fit_before, fit_after : float [%]
    interval : (float, float)
        95 % interval of ``rms_before - rms_after`` by block bootstrap.
    """

    rms_before: float
    rms_after: float
    max_before: float
    max_after: float
    fit_before: float
    fit_after: float
    interval: tuple[float, float]

    @property
    def claimed(self) -> bool:
        """Whether the interval excludes no gain."""
        return self.interval[0] > 0

    @property
    def spoiled(self) -> bool:
        """Whether the interval excludes all but a loss."""
        return self.interval[1] < 0

    @property
    def harmful(self) -> bool:
        """Whether a loss is sure, and of practical size."""
        return self.spoiled and self.rms_after > (1 + MIN_GAIN) * self.rms_before

    @property
    def useful(self) -> bool:
        """Whether the gain is of practical use, sure or not."""
        return self.rms_after < (1 - MIN_GAIN) * self.rms_before

    def worse(self, noise: float, least: float = MIN_LOSS) -> bool:
        """Whether a loss is sure, and more than noise.

        Parameters
        ----------
        noise : float [unit of the channel]
            Of a reading.
        least : float
            Power from which a loss counts, over that of the noise.
        """
        return self.spoiled and self._lost(noise, least)

    def lost(self, noise: float, least: float = MIN_LOSS) -> bool:
        """Whether these very rows are worse by more than noise, be it sure for others or not.

        Parameters
        ----------
        noise, least : float
            As in `worse`.
        """
        share = self.rms_after > (1 + MIN_LOSS_SHARE) * self.rms_before
        return share and self._lost(noise, least)

    def _lost(self, noise: float, least: float) -> bool:
        return self.rms_after**2 - self.rms_before**2 > least * noise**2


def compare(
    measured: Float, before: Float, after: Float, seed: int = 0, hidden: float = 0.0
) -> Gain:
    """Gain of errors over others, with its bootstrap interval.

    Parameters
    ----------
    measured, before, after : ndarray, shape (n,) [unit of the channel]
        What was measured, and the errors without and with a cause.
    seed : int
        Of the bootstrap.
    hidden : float [unit of the channel]
        Noise of a reading that these rows do not show, being averages; RMS and fit are those of
        readings.
    """
    blocks = min(BOOTSTRAP_BLOCKS, len(measured))
    edges = np.arange(blocks) * len(measured) // blocks
    counts = np.diff(np.append(edges, len(measured)))
    squares = np.add.reduceat(np.column_stack([before**2, after**2]), edges)
    draws = np.random.default_rng(seed).integers(0, blocks, (DRAWS, blocks))
    means = np.sqrt(squares[draws].sum(1) / counts[draws].sum(1)[:, None] + hidden**2)
    low, high = np.quantile(means[:, 0] - means[:, 1], [0.025, 0.975])
    a, b = agreement(measured, measured - before), agreement(measured, measured - after)
    a, b = a.with_noise(hidden), b.with_noise(hidden)
    return Gain(
        a.rmse,
        b.rmse,
        a.max_error,
        b.max_error,
        a.fit_percent,
        b.fit_percent,
        (float(low), float(high)),
    )
