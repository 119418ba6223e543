"""Drives that say much the same: what one of them reads, by the others.

Of readings with the second moments S about rest the expectation of lost ones, given the others, is
S_lo S_oo⁻¹ x_o, and what is left of them has the covariance S_ll − S_lo S_oo⁻¹ S_ol (normal
distribution; Anderson 2003, 2.5.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.responses.modes import Float
from thermaltool.signals.symmetric import pseudo_inverse

# Directions of the scaled readings weaker than this part of the strongest say nothing.
MIN_VARIANCE = 1e-6


@dataclass(frozen=True)
class Redundancy:
    """How drives move together.

    Attributes
    ----------
    channels : tuple of str
        Drives, without those that never moved.
    moments : ndarray, shape (m, m)
        Mean products of the readings, relative to rest.
    errors : tuple of float [unit of the channel]
        Root mean square by which each differs from its expectation by all others, in rows from
        which that was not found.
    """

    channels: tuple[str, ...]
    moments: Float
    errors: tuple[float, ...]

    @cached_property
    def _scale(self) -> Float:
        size = np.sqrt(np.diag(self.moments))
        return np.asarray(np.where(size > 0, size, 1.0))

    @property
    def most_lost(self) -> int:
        """Drives for which the others can stand in at once: fewer than half."""
        return (len(self.channels) - 1) // 2

    def expectation(self, lost: Sequence[int]) -> tuple[Float, Float]:
        """What lost drives are by the others, and how sure that is.

        Parameters
        ----------
        lost : sequence of int
            Of `channels`.

        Returns
        -------
        weights : ndarray, shape (lost, m)
            Of all readings; zero of those that are lost.
        deviation : ndarray, shape (lost,) [unit of each channel]
            Standard deviation of what the others leave open.
        """
        unit = self.moments / np.outer(self._scale, self._scale)
        kept = [k for k in range(len(self.channels)) if k not in lost]
        out = list(lost)
        inverse = pseudo_inverse(unit[np.ix_(kept, kept)], MIN_VARIANCE)
        own = unit[np.ix_(out, kept)] @ inverse
        left = np.diag(unit)[out] - np.sum(own * unit[np.ix_(out, kept)], axis=1)
        weights = np.zeros((len(out), len(self.channels)))
        weights[:, kept] = own * self._scale[out][:, None] / self._scale[kept]
        deviation = np.sqrt(np.maximum(left, 0.0)) * self._scale[out]
        return weights, np.maximum(deviation, np.array(self.errors)[out])

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "channels": list(self.channels),
            "moments": self.moments.tolist(),
            "errors": list(self.errors),
        }


def load_redundancy(document: Any) -> Redundancy:
    """A redundancy of a model document.

    Parameters
    ----------
    document : mapping

    Raises
    ------
    ModelError
        A part missing or not sound.
    """
    try:
        channels = tuple(str(each) for each in document["channels"])
        moments = np.array(document["moments"], float)
        errors = tuple(float(each) for each in document["errors"])
    except (KeyError, TypeError, ValueError) as error:
        raise ModelError(f"{error}") from error
    m = len(channels)
    if moments.shape != (m, m) or len(errors) != m or not np.isfinite(moments).all():
        raise ModelError(f"not the moments and errors of {m} channels")
    if not np.isfinite(errors).all() or min(errors, default=0.0) < 0:
        raise ModelError("errors are finite and not below zero")
    if len(set(channels)) != m:
        raise ModelError("a channel is there twice")
    return Redundancy(channels, moments, errors)
