"""Poles by subspace identification: MOESP and CVA on the pieces of every record, at several rates.

Past inputs and outputs predict future outputs through the state alone; the singular vectors of that
prediction, future inputs projected out, span the extended observability matrix, whose shift
structure has the poles (Verhaegen 1994, MOESP with past data; Larimore 1990, CVA; Van Overschee and
De Moor 1996, chapters 2 and 4). What is linear for given poles is found elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.even_clock import MAX_FILLED_ROWS
from thermaltool.signals.symmetric import eigh

Complex = NDArray[np.complex128]

# Rows of the past and of the future in a window: at most, and at least beyond the order.
MAX_BLOCK_ROWS, MIN_BLOCK_ROWS = 20, 3
# Largest number of rows of the matrix of windows (its cost grows with their square), and of windows
# that are compared.
MAX_MATRIX_ROWS, MAX_WINDOWS = 500, 12000
# Each rate averages so many rows of the one before; the slowest leaves so many windows.
RATE_STEP, MIN_WINDOWS = 5, 60
# Poles are kept between these magnitudes: the logarithm of what is beyond says nothing.
MIN_RADIUS, MAX_RADIUS = 1e-3, 1 - 1e-5


@dataclass(frozen=True)
class Realization:
    """Extended observability matrix of one rate and weighting, before its order is chosen.

    Attributes
    ----------
    span : float
        Sample period of this rate, in those of the data.
    outputs : int
        Rows of a block of `observability`.
    observability : ndarray, shape (p · i, k)
        Most significant direction first.
    """

    span: float
    outputs: int
    observability: Array

    def poles(self, order: int) -> Complex | None:
        """Poles in s of this order, each of a pair [1/sample period]; None where it has too few.

        Parameters
        ----------
        order : int
        """
        p, gamma = self.outputs, self.observability[:, :order]
        if gamma.shape[1] < order or len(gamma) - p < order:
            return None
        z = np.linalg.eigvals(np.linalg.lstsq(gamma[:-p], gamma[p:], rcond=None)[0])
        size = np.clip(np.abs(z), MIN_RADIUS, MAX_RADIUS)
        # A negative real pole has no logarithm that is real: its decay is kept.
        angle = np.where(z.imag == 0, 0.0, np.angle(z))
        return np.asarray((np.log(size) + 1j * angle) / self.span, complex)


def realizations(data: TrainingData, order: int) -> list[Realization]:
    """Both weightings at every rate that the records are long enough for.

    Parameters
    ----------
    data : TrainingData
        On an even clock.
    order : int
        The largest that is asked for.
    """
    m, p = len(data.inputs), len(data.outputs)
    least = max(MIN_BLOCK_ROWS, -(-order // p) + 1)
    block = max(least, min(MAX_BLOCK_ROWS, MAX_MATRIX_ROWS // (2 * (m + p))))
    whole = list(_without_holes(data))
    if not whole:
        return []
    scale = _scales([part for _, part in whole])
    whole = [(origin, part / scale[:, None]) for origin, part in whole]
    found = []
    span = 1
    while True:
        parts = [(origin, _averaged(part, span)) for origin, part in whole]
        windows = sum(max(part.shape[1] - 2 * block + 1, 0) for _, part in parts)
        if windows < MIN_WINDOWS + (data.experiments if span > 1 else 0):
            break
        found += list(_weighted(parts, p, block, float(span), windows))
        span *= RATE_STEP
    return found


def _without_holes(data: TrainingData) -> Iterator[tuple[int, Array]]:
    """Outputs and inputs of all pieces with their experiments, shape (p + m, rows).

    Straight lines are drawn over short holes of the outputs: what is linear is not fitted here.
    """
    for record, u, y in zip(data.records, data.u, data.y, strict=True):
        known = np.flatnonzero(np.isfinite(y).all(axis=0))
        for rows in np.split(known, np.flatnonzero(np.diff(known) > MAX_FILLED_ROWS + 1) + 1):
            if len(rows):
                clock = np.arange(rows[0], rows[-1] + 1)
                drawn = [np.interp(clock, rows, own[rows]) for own in y]
                yield record.origin, np.vstack([*drawn, u[:, clock]])


def _scales(parts: Sequence[Array]) -> Array:
    deviation = np.hstack(parts).std(axis=1)
    return np.asarray(np.where(deviation > 0, deviation, 1.0))


def _averaged(values: Array, span: int) -> Array:
    """Means of every `span` rows, shape (channels, n // span)."""
    count = values.shape[1] // span
    return values[:, : count * span].reshape(len(values), count, span).mean(axis=2)


def _weighted(
    parts: list[tuple[int, Array]], p: int, block: int, span: float, windows: int
) -> Iterator[Realization]:
    """MOESP and CVA of windows of 2 · `block` rows; an offset for each experiment is taken off."""
    stride, columns = max(1, windows // MAX_WINDOWS), []
    origins: list[Array] = []
    for origin, part in parts:
        if part.shape[1] < 2 * block:
            continue
        seen = sliding_window_view(part, 2 * block, axis=1)[:, ::stride].transpose(2, 0, 1)
        columns.append(seen)
        origins.append(np.full(seen.shape[2], origin))
    every, which = np.concatenate(columns, axis=2), np.concatenate(origins)
    for origin in np.unique(which):
        own = which == origin
        every[:, :, own] -= every[:, :, own].mean(axis=2, keepdims=True)
    past, future = every[:block], every[block:]
    rows = [future[:, p:], past, future[:, :p]]
    sizes = [each.shape[0] * each.shape[1] for each in rows]
    stacked = np.vstack([each.reshape(size, -1) for each, size in zip(rows, sizes, strict=True)])
    if stacked.shape[1] <= len(stacked):
        return
    # Of the lower triangular factor only: the windows themselves are not needed any longer.
    lower = np.asarray(np.linalg.qr(stacked.T, mode="r")).T
    a, b = sizes[0], sizes[0] + sizes[1]
    predicted, left = lower[b:, a:b], lower[b:, b:]
    gamma, values, _ = np.linalg.svd(predicted, full_matrices=False)
    yield Realization(span, p, gamma * np.sqrt(values))
    spread = predicted @ predicted.T + left @ left.T
    power, vectors = eigh(spread)
    root = np.sqrt(np.maximum(power, 1e-12 * power[-1]))
    gamma, values, _ = np.linalg.svd((vectors / root).T @ predicted, full_matrices=False)
    yield Realization(span, p, (vectors * root) @ gamma * np.sqrt(values))
