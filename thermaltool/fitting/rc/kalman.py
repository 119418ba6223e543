"""Continuous-discrete Kalman filter over pieces of logs, for a batch of parameter vectors at once.

The covariance runs row by row until it no longer changes; the mean, which is then linear in the
readings, runs through chunks of rows side by side. Both are exact. The state at the start of a
piece has a wide prior. Taken as a parameter, it would follow a first reading without noise, and
the likelihood would have no maximum.

Sources: A. H. Jazwinski, Stochastic Processes and Filtering Theory (1970), 7.2; N. R. Kristensen,
H. Madsen, S. B. Jørgensen, Automatica 40 (2004) 225 (the likelihood, eqs. 6 and 7).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from thermaltool.fitting.rc.data import FilterPiece
from thermaltool.fitting.rc.state_space import Discretization, ThermalModes

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# The covariance stands where its diagonal changes by less than this share from row to row; it is
# looked at every so many rows.
_STANDS, _LOOK = 1e-11, 4


@dataclass(frozen=True)
class StartPrior:
    """Node temperatures at the start of a piece before any reading: their mean and spread [K]."""

    mean: float
    spread: float


@dataclass(frozen=True)
class Innovations:
    """One-step errors of N rows, B parameter vectors and m outputs.

    Attributes
    ----------
    errors : ndarray, shape (N, B, m)
        Reading minus its prediction; 0 where there is none.
    predictions : ndarray, shape (N, B, m)
        Of every row, from the readings before it.
    covariances : ndarray, shape (T, B, m, m)
        Of the errors; rows of missing readings are those of a unit matrix.
    inverses : ndarray, shape (T, B, m, m)
    log_determinants : ndarray, shape (T, B)
    entry : ndarray, shape (N,)
        Which of the T covariances a row has.
    """

    errors: Array
    predictions: Array
    covariances: Array
    inverses: Array
    log_determinants: Array
    entry: Indices

    def deviance(self) -> Array:
        """−2 log L without its constant, shape (B,)."""
        weighted = _by_entry(self.inverses, self.entry, self.errors)
        squares = np.einsum("kbi,kbi->b", self.errors, weighted)
        return np.asarray(self.counts @ self.log_determinants + squares)

    @property
    def counts(self) -> Array:
        """Rows that have each covariance, shape (T,)."""
        return np.bincount(self.entry, minlength=len(self.inverses)).astype(np.float64)

    def standardized(self, output: int) -> Array:
        """Errors of one output in standard deviations, shape (N,); of the first vector."""
        scale = 1.0 / np.sqrt(self.covariances[:, 0, output, output])
        return np.asarray(self.errors[:, 0, output] * scale[self.entry])


def innovations(
    modes: ThermalModes, piece: FilterPiece, prior: StartPrior | None = None
) -> Innovations:
    """One-step errors over a piece.

    Parameters
    ----------
    modes : ThermalModes
    piece : FilterPiece
    prior : StartPrior, optional
        Of the state at the first row. Default: the machine is at rest there.
    """
    lengths, step = piece.steps
    by_step = modes.discretized(lengths)
    mean, spread = _start(modes, piece, prior)
    covariances, entry, kinds = _covariances(modes, by_step, piece, step, spread)
    gain, total, inverses, log_determinants = _gains(modes, covariances, piece.present[kinds])
    decay = by_step.decay[step[kinds]]
    forward = decay[..., None] * gain
    closed = -forward @ modes.outputs
    n = closed.shape[-1]
    closed[..., range(n), range(n)] += decay
    readings = np.where(piece.present, piece.readings, 0.0)
    centred = readings[:, None] - np.where(piece.present[:, None], modes.offsets, 0.0)
    added = _inputs(by_step, piece, step) + _by_entry(forward, entry, centred)
    predictions = _run(modes.outputs, closed, entry, added, mean) + modes.offsets
    errors = np.where(piece.present[:, None], readings[:, None] - predictions, 0.0)
    return Innovations(errors, predictions, total, inverses, log_determinants, entry)


def _start(
    modes: ThermalModes, piece: FilterPiece, prior: StartPrior | None
) -> tuple[Array, Array]:
    """Expected modes at the first row, shape (B, n), and their covariance, (B, n, n)."""
    if prior is None:
        pairs = modes.rates[:, :, None] + modes.rates[:, None, :]
        return modes.settled(piece.at_rest), modes.diffusion / pairs
    inverse = np.asarray(np.linalg.inv(modes.states), np.float64)
    level: Array = prior.mean * inverse.sum(axis=2)
    return level, prior.spread**2 * (inverse @ np.swapaxes(inverse, 1, 2))


def _by_entry(matrices: Array, entry: Indices, vectors: Array) -> Array:
    """Each row's matrix (B, i, j) of a table times its vector (B, j), shape (N, B, i)."""
    if len(matrices) == 1:
        return np.asarray((matrices[0] @ vectors[..., None])[..., 0])
    return np.asarray((matrices[entry] @ vectors[..., None])[..., 0])


def _inputs(by_step: Discretization, piece: FilterPiece, step: Indices) -> Array:
    """What the inputs add over the step after each row, shape (N, B, n)."""
    result = np.empty((len(piece), *by_step.decay.shape[1:]))
    if len(by_step.held) > 8:  # an uneven clock: each row has its own
        result[:] = np.einsum("kbnq,kq->kbn", by_step.held[step], piece.inputs)
        result += np.einsum("kbnq,kq->kbn", by_step.ramp[step], piece.changes)
        return result
    for s in range(len(by_step.held)):
        rows = step == s
        result[rows] = np.tensordot(piece.inputs[rows], by_step.held[s], (1, 2))
        result[rows] += np.tensordot(piece.changes[rows], by_step.ramp[s], (1, 2))
    return result


def _covariances(
    modes: ThermalModes,
    by_step: Discretization,
    piece: FilterPiece,
    step: Indices,
    P: Array,
) -> tuple[Array, Indices, Indices]:
    """Covariances of the predicted modes, (T, B, n, n); which a row has; and a row that has each.

    From P at the first row. An entry of the table has one pattern of readings and one step.
    """
    m, present = piece.present.shape[1], piece.present.tolist()
    pattern = piece.present @ (1 << np.arange(m))
    shrink = by_step.decay[..., :, None] * by_step.decay[..., None, :]
    changes = np.flatnonzero((np.diff(pattern) != 0) | (np.diff(step) != 0)) + 1
    sensors = [(modes.outputs[:, i, :], modes.variances[:, i, None]) for i in range(m)]
    bounds = [0, *changes.tolist(), len(piece)]
    table: list[Array] = []
    entry, kinds = np.empty(len(piece), np.int64), []
    for begin, end in pairwise(bounds):
        there = [pair for pair, known in zip(sensors, present[begin], strict=True) if known]
        factor, noise = shrink[step[begin]], by_step.noise[step[begin]]
        for k in range(begin, end):
            entry[k] = len(table)
            table.append(P)
            kinds.append(k)
            following = _updated(P, there) * factor + noise
            looked = (k - begin) % _LOOK == _LOOK - 1
            if looked and _stands(P, following):
                entry[k:end] = entry[k]
                P = following
                break
            P = following
    return np.array(table), entry, np.array(kinds)


def _stands(before: Array, after: Array) -> bool:
    diagonal = np.einsum("bii->bi", after)
    change = np.abs(diagonal - np.einsum("bii->bi", before))
    return bool(np.all(change <= _STANDS * diagonal))


def _updated(P: Array, sensors: Sequence[tuple[Array, Array]]) -> Array:
    """Covariance after readings, one after the other."""
    for h, variance in sensors:
        seen = (P @ h[:, :, None])[..., 0]
        total = (h * seen).sum(axis=1, keepdims=True) + variance
        P = P - seen[:, :, None] * (seen / total)[:, None, :]
    return P


def _gains(
    modes: ThermalModes, covariances: Array, present: NDArray[np.bool_]
) -> tuple[Array, Array, Array, Array]:
    """Kalman gains (T, B, n, m); covariances of errors, their inverses and log determinants."""
    seen = covariances @ np.swapaxes(modes.outputs, 1, 2)
    total = modes.outputs @ seen
    m = total.shape[-1]
    total[..., range(m), range(m)] += modes.variances
    both = present[:, None, :, None] & present[:, None, None, :]
    total = np.where(both, total, np.eye(m))
    inverse = np.asarray(np.linalg.inv(total), np.float64)
    gain = np.where(present[:, None, None, :], seen, 0.0) @ inverse
    return gain, total, inverse, np.linalg.slogdet(total)[1]


def _run(outputs: Array, closed: Array, entry: Indices, added: Array, start: Array) -> Array:
    """Outputs of x' = F x + b, shape (N, B, m).

    Chunks of rows run side by side, from zero and from each unit start; then their own starts are
    carried from chunk to chunk.

    Parameters
    ----------
    outputs : ndarray, shape (B, m, n)
    closed : ndarray, shape (T, B, n, n)
        F, one of which each row has by `entry`.
    entry : ndarray, shape (N,)
    added : ndarray, shape (N, B, n)
        b.
    start : ndarray, shape (B, n)
    """
    rows, batch, n = added.shape
    length = max(int(np.sqrt(rows)), 1)
    chunks = -(-rows // length)
    spare = chunks * length - rows
    which = np.append(entry, np.full(spare, entry[-1])).reshape(chunks, length)
    added = np.append(added, np.zeros((spare, batch, n)), axis=0).reshape(chunks, length, batch, n)
    state = np.zeros((chunks, batch, n, 1 + n))
    state[..., 1:] = np.eye(n)
    seen = np.empty((chunks, length, batch, outputs.shape[1], 1 + n))
    for j in range(length):
        seen[:, j] = outputs @ state
        one = which[0, j]
        F = closed[one] if np.all(which[:, j] == one) else closed[which[:, j]]
        state = F @ state
        state[..., 0] += added[:, j]
    begins = np.empty((chunks, 1, batch, n, 1))
    current = start[..., None]
    for c in range(chunks):
        begins[c, 0] = current
        current = state[c, ..., 1:] @ current + state[c, ..., :1]
    result = seen[..., 0] + (seen[..., 1:] @ begins)[..., 0]
    return np.asarray(result.reshape(chunks * length, batch, -1)[:rows])
