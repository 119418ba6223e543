"""A thin plate that a ring heats and its faces cool: finite volumes in circles, of numpy alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RingPlate:
    """(1/r)(r T')' − a T + K δ(r − r0)/r0 q = (1/α) dT/dt.

    Parameters
    ----------
    K : float [K per unit of heat]
    a : float [1/length²]
        Loss of the faces.
    alpha : float [length²/s]
    r0 : float [length]
        Of the ring.
    fine : float [length]
        Width of a cell near the ring; beyond `near` they grow by a twentieth.
    near : float [length]
    """

    K: float
    a: float
    alpha: float
    r0: float = 0.12
    fine: float = 0.002
    near: float = 0.3

    def step(self, r: float, t: Array) -> Array:
        """Rise at `r` for one unit of heat from t = 0 on.

        Parameters
        ----------
        r : float [length]
        t : ndarray, shape (n,) [s]
        """
        edges = np.arange(0.0, self.near, self.fine).tolist()
        while edges[-1] < 12 / np.sqrt(self.a):
            edges.append(edges[-1] + max(1.05 * (edges[-1] - edges[-2]), self.fine))
        faces = np.array(edges)
        middle, volume = (faces[1:] + faces[:-1]) / 2, np.diff(faces**2) / 2
        between = faces[1:-1] / np.diff(middle)
        balance = np.diag(-self.a * volume)
        for k, flow in enumerate(between):
            balance[k : k + 2, k : k + 2] += flow * np.array([[-1.0, 1.0], [1.0, -1.0]])
        root = np.sqrt(volume)
        rates, shapes = np.linalg.eigh(self.alpha * balance / np.outer(root, root))
        ring = np.interp(np.arange(len(middle)), *_between(middle, self.r0))
        read = np.interp(np.arange(len(middle)), *_between(middle, r))
        fed = shapes.T @ (self.alpha * self.K * ring / root)
        return (np.expm1(np.outer(t, rates)) / rates * fed) @ (shapes.T @ (read / root))


def _between(middle: Array, r: float) -> tuple[list[float], list[float]]:
    """A place as a hat over the two cells beside it: where, and with what weights."""
    k = int(np.searchsorted(middle, r)) - 1
    share = (r - middle[k]) / (middle[k + 1] - middle[k])
    return [k - 1, k, k + 1, k + 2], [0.0, 1 - share, share, 0.0]
