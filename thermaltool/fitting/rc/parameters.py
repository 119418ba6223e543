"""Parameters of a network as the vector that is searched: logarithms, logits, plain numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermaltool.fitting.rc.network import RcNetwork, RcParameter
from thermaltool.signals.intervals import NORMAL_95, Estimate, log_normal_estimate, normal_estimate

Array = NDArray[np.float64]

# An interval that spans more than this factor says nothing of a positive parameter.
MAX_INTERVAL_FACTOR = 100.0
# How far a search goes from its start, in logarithms and logits.
SEARCH_WIDTH = 14.0
# Noise that is smaller than its start by this, in logarithms, is none.
VANISHED = 4.0


@dataclass(frozen=True)
class SearchSpace:
    """Free parameters as a vector, and all parameters from it.

    Attributes
    ----------
    network : RcNetwork
    low, high : ndarray, shape (p,)
        Bounds of what is searched.
    """

    network: RcNetwork
    low: Array
    high: Array

    @staticmethod
    def around(network: RcNetwork, start: Array) -> SearchSpace:
        """Bounds on both sides of a start, shape (p,), as it is searched."""
        wide = np.array([np.inf if p.scale == "linear" else SEARCH_WIDTH for p in network.free])
        return SearchSpace(network, start - wide, start + wide)

    def clipped(self, vectors: Array) -> Array:
        """Vectors within the bounds, shape (..., p)."""
        return np.clip(vectors, self.low, self.high)

    def at_zero(self, vector: Array) -> NDArray[np.bool_]:
        """Which noise has vanished beside the scale of the data, shape (p,)."""
        noise = [p.name.endswith((".diffusion", ".noise")) for p in self.network.free]
        return np.asarray(noise & (vector < (self.low + self.high) / 2 - VANISHED))

    def values(self, vectors: Array) -> Array:
        """Values of all parameters, fixed ones among them, shape (..., P).

        Parameters
        ----------
        vectors : ndarray, shape (..., p)
        """
        parameters = self.network.parameters
        result = np.empty((*vectors.shape[:-1], len(parameters)))
        free = 0
        for k, p in enumerate(parameters):
            if p.fixed:
                result[..., k] = p.start
            else:
                result[..., k] = natural(p, vectors[..., free])
                free += 1
        return result


def natural(parameter: RcParameter, searched: Array) -> Array:
    """A parameter's value from what is searched."""
    if parameter.scale == "log":
        return np.asarray(np.exp(searched))
    if parameter.scale == "logit":
        return np.asarray(1.0 / (1.0 + np.exp(-searched)))
    return searched


def searched(parameter: RcParameter, value: float) -> float:
    """What is searched for a parameter, from its value."""
    if parameter.scale == "log":
        return float(np.log(value))
    if parameter.scale == "logit":
        return float(np.log(value / (1.0 - value)))
    return value


def estimates(
    parameters: Sequence[RcParameter], vector: Array, errors: Array
) -> dict[str, Estimate]:
    """Free parameters with their 95 % intervals, by name.

    Parameters
    ----------
    parameters : sequence of RcParameter
        The free ones.
    vector, errors : ndarray, shape (p,)
        What is searched, and its standard errors.
    """
    found = {}
    for p, x, error in zip(parameters, vector.tolist(), errors.tolist(), strict=True):
        value = float(natural(p, np.array(x)))
        if p.scale == "log":
            found[p.name] = log_normal_estimate(value, error, p.unit)
        elif p.scale == "linear":
            found[p.name] = normal_estimate(value, error, p.unit)
        else:
            ends = natural(p, x + NORMAL_95 * min(error, 1e3) * np.array([-1.0, 1.0])).tolist()
            found[p.name] = Estimate(value, ends[0], ends[1], p.unit)
    return found


def is_identified(parameter: RcParameter, estimate: Estimate) -> bool:
    """Whether an interval says anything: within a factor of 100, or of a share within 0.9."""
    if not np.isfinite([estimate.low, estimate.high]).all():
        return False
    if parameter.scale == "log":
        return estimate.high <= MAX_INTERVAL_FACTOR * estimate.low
    return parameter.scale == "linear" or estimate.high - estimate.low < 0.9
