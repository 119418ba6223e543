"""A linear system over samples of one length, run over a whole record in blocks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

# Samples of a block of `Recursion.run`: longer ones make its matrices larger than they save.
BLOCK = 64
# Blocks that are joined to one where there are more than so many, of a system of few states:
# preparing it takes as long as walking through some hundred.
JOINED, MIN_BLOCKS, MAX_JOINED = 16, 256, 16


@dataclass(frozen=True)
class Recursion:
    """One sample of a linear system: x ← F x + G0 u_before + G1 u_now, then y = C x.

    Attributes
    ----------
    F : ndarray, shape (n, n)
    G0, G1 : ndarray, shape (n, m)
        Weights of the inputs at the start and at the end of the sample. With a zero-order hold
        ``G1`` is zero.
    C : ndarray, shape (p, n)
    """

    F: Float
    G0: Float
    G1: Float
    C: Float

    def run(self, u: Float, x: Float | None = None) -> tuple[Float, Float]:
        """Outputs for a whole record sampled at one period.

        Parameters
        ----------
        u : ndarray, shape (n_samples, m)
        x : ndarray, shape (n,), optional
            State at the first sample, before which nothing is known; rest when absent.

        Returns
        -------
        y : ndarray, shape (n_samples, p)
        x : ndarray, shape (n,)
            State at the last sample.

        Notes
        -----
        The record is cut into blocks. Within a block the recursion is unrolled into two matrix
        products for all blocks at once; only the states at the block borders are walked through.
        """
        x = np.zeros(len(self.F)) if x is None else np.asarray(x, float)
        if not len(u):
            return np.empty((0, len(self.C))), x
        gain, (_, to_state, from_state, to_output) = self._gain, self._unrolled
        drive = u[:-1] if gain is self.G0 else np.hstack([u[:-1], u[1:]])
        steps, m = len(drive), gain.shape[1]
        # The last block is filled up with an input of zero.
        chunks = np.zeros((-(-steps // BLOCK), BLOCK * m))
        chunks.reshape(-1, m)[:steps] = drive
        borders = self._borders(chunks @ to_state, x)
        inside = borders[:-1] @ from_state
        inside += chunks @ to_output
        y = np.empty((steps + 1, len(self.C)))
        y[0], y[1:] = self.C @ x, inside.reshape(len(chunks) * BLOCK, len(self.C))[:steps]
        if not (rest := steps % BLOCK):
            return y, borders[-1]
        x = borders[-2]
        for _ in range(rest):
            x = self.F @ x
        return y, x + chunks[-1, : rest * m] @ to_state[(BLOCK - rest) * m :]

    def _borders(self, carried: Float, x: Float) -> Float:
        """States at the first row of each block and behind the last, shape (n_blocks + 1, n)."""
        power, n = self._unrolled[0], len(x)
        borders = np.empty((len(carried) + 1, n))
        borders[0] = x
        begun = 0
        if len(carried) >= MIN_BLOCKS and n <= MAX_JOINED:
            # Blocks of blocks, as a record that is long has too many to be walked through.
            whole = len(carried) // JOINED
            far, to_last, from_first, to_inner = self._joined
            chunks = carried[: whole * JOINED].reshape(whole, JOINED * n)
            ends = np.empty((whole + 1, n))
            ends[0] = x
            for k, added in enumerate(chunks @ to_last):
                ends[k + 1] = far @ ends[k] + added
            begun = whole * JOINED
            inner = ends[:-1] @ from_first
            inner += chunks @ to_inner
            borders[1 : begun + 1] = inner.reshape(begun, n)
        for k in range(begun, len(carried)):
            borders[k + 1] = power @ borders[k] + carried[k]
        return borders

    def settled(self, u: Float) -> Float:
        """The state in which an input that has stood at `u` for ever leaves the system.

        Parameters
        ----------
        u : ndarray, shape (m,)

        Returns
        -------
        x : ndarray, shape (n,)
        """
        still = np.eye(len(self.F)) - self.F
        return np.asarray(np.linalg.solve(still, (self.G0 + self.G1) @ u))

    @cached_property
    def _gain(self) -> Float:
        """Weights of the inputs that act in a sample: of the earlier ones, and of both."""
        return np.hstack([self.G0, self.G1]) if np.any(self.G1) else self.G0

    @cached_property
    def _unrolled(self) -> tuple[Float, Float, Float, Float]:
        """F^BLOCK, and what inputs and first state of a block do to its last state and outputs."""
        return _unrolled(self.F, self._gain, self.C, BLOCK)

    @cached_property
    def _joined(self) -> tuple[Float, Float, Float, Float]:
        """The same of `JOINED` blocks, whose inputs are what each adds to the state."""
        still = np.eye(len(self.F))
        return _unrolled(self._unrolled[0], still, still, JOINED)


def _unrolled(F: Float, gain: Float, C: Float, block: int) -> tuple[Float, Float, Float, Float]:
    """F^block, and what inputs and first state of a block do to its last state and outputs."""
    n, m, p = len(F), gain.shape[1], len(C)
    decay = np.diagonal(F)
    if np.count_nonzero(F) == np.count_nonzero(decay):
        # Modes that do not touch: their powers are those of numbers, all at once.
        kept = decay ** np.arange(block + 1)[:, None]
        reach, seen = kept[:-1, :, None] * gain, kept[1:, None, :] * C
        return _block_matrices(np.diag(kept[-1]), reach, seen, C)
    # One sample after the other: powers by squaring lose digits where states differ in scale.
    reach, seen = np.empty((block, n, m)), np.empty((block, p, n))
    power, reach[0], seen[0] = F, gain, C @ F  # F^k gain, and C F^(k + 1)
    for k in range(1, block):
        reach[k], seen[k] = F @ reach[k - 1], seen[k - 1] @ F
        power = power @ F
    return _block_matrices(power, reach, seen, C)


def _block_matrices(
    power: Float, reach: Float, seen: Float, C: Float
) -> tuple[Float, Float, Float, Float]:
    """The matrices of a block from F^k gain and C F^(k + 1), for each k."""
    (block, n, m), p = reach.shape, len(C)
    markov = np.concatenate([C @ reach, np.zeros((1, p, m))])
    lag = np.arange(block) - np.arange(block)[:, None]
    to_output = markov[np.where(lag < 0, block, lag)].transpose(0, 3, 1, 2)
    return (
        power,
        reach[::-1].transpose(0, 2, 1).reshape(block * m, n),
        seen.transpose(2, 0, 1).reshape(n, block * p),
        to_output.reshape(block * m, block * p),
    )
