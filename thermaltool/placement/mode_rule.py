"""Sensors by the rule of Zhu, Ni and Shih (2008, 3.1): one near an extreme of each dominant mode.

Modes are dominant by their weights w = |ξ τ|; of two extremes the one nearer to a heat source
counts, and no sensor is near a node of its mode. One sensor serves several modes where it is near
an extreme of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array

# Part of a mode's largest size from which on a place is near its extreme.
NEAR_EXTREME = 0.9
# The modes that count carry so much of the weights.
DOMINANT_PART = 0.8


@dataclass(frozen=True)
class RulePlacement:
    """Places by the rule.

    Attributes
    ----------
    sensors : tuple of int
        Candidates, in the order of the modes.
    modes : tuple of int
        The mode for which each was placed.
    dominant : tuple of int
        All modes that count, the largest weight first.
    served : tuple of int
        Those of them that some sensor is near an extreme of.
    """

    sensors: tuple[int, ...]
    modes: tuple[int, ...]
    dominant: tuple[int, ...]
    served: tuple[int, ...]


def dominant_modes(weights: Array, part: float = DOMINANT_PART) -> tuple[int, ...]:
    """Modes of the largest weights that together carry so much of them.

    Parameters
    ----------
    weights : ndarray, shape (m,)
    part : float
    """
    size = np.abs(np.asarray(weights, float))
    order = np.argsort(-size, kind="stable")
    carried = np.cumsum(size[order]) / max(float(size.sum()), 1e-300)
    return tuple(order[: int(np.argmax(carried >= part - 1e-12)) + 1].tolist())


def place_by_modes(
    shapes: Array,
    weights: Array,
    distance: Array | None = None,
    *,
    sensors: int | None = None,
    part: float = DOMINANT_PART,
    forbidden: Sequence[int] = (),
) -> RulePlacement:
    """Candidates near the extremes of dominant modes and near heat sources, away from nodes.

    Parameters
    ----------
    shapes : ndarray, shape (N, m)
        Temperature of every mode at every candidate.
    weights : ndarray, shape (m,)
        w = |ξ τ| of every mode.
    distance : ndarray, shape (N,), optional [m]
        From each candidate to the nearest heat source. Default: all alike.
    sensors : int, optional
        How many. Default: as many as serve all dominant modes.
    part : float
        Part of all weights that the dominant modes carry.
    forbidden : sequence of int
        Candidates that cannot be taken.

    Raises
    ------
    FitError
        No candidate, or fewer sensors than dominant modes that need one each.
    """
    shapes = np.asarray(shapes, float)
    near = np.zeros(len(shapes)) if distance is None else np.asarray(distance, float)
    free = np.ones(len(shapes), bool)
    free[list(forbidden)] = False
    if not free.any():
        raise FitError("no candidate is left: all are forbidden")
    dominant = dominant_modes(weights, part)
    chosen: list[int] = []
    modes: list[int] = []
    served: list[int] = []
    size = np.abs(shapes)
    top = np.maximum(size[free].max(axis=0), 1e-300)
    for mode in dominant:
        if any(size[k, mode] >= NEAR_EXTREME * top[mode] for k in chosen):
            served.append(mode)
            continue
        left = free.copy()
        left[chosen] = False
        if not left.any() or (sensors is not None and len(chosen) == sensors):
            continue
        places = np.flatnonzero(left & (size[:, mode] >= NEAR_EXTREME * top[mode]))
        if not len(places):
            places = np.flatnonzero(left)
            best = int(places[np.argmax(size[places, mode])])
        else:
            best = int(places[np.lexsort((-size[places, mode], near[places]))[0]])
        chosen.append(best)
        modes.append(mode)
        served.append(mode)
    missed = [mode for mode in dominant if mode not in served]
    if missed:
        raise FitError(
            f"{len(chosen)} sensors do not see {len(dominant)} dominant modes: mode "
            f"{', '.join(str(1 + mode) for mode in missed)} has none; ask for "
            f"{len(chosen) + len(missed)} sensors or a smaller part of the weights"
        )
    return RulePlacement(tuple(chosen), tuple(modes), dominant, tuple(served))
