"""Modes over an uneven clock that many inputs go through: what hangs on the clock alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermaltool.responses.propagation import recursion_of

Float = NDArray[np.float64]

# Decay over a block, as an exponent, about; at most twice that. Sums of what is divided by the
# decay keep 13 digits.
BLOCK_DECAY = 64.0
# Modes whose numbers of blocks differ by less than this factor are cut into as many.
BLOCK_RATIO = 4
# Rows of a block at least: of fewer the blocks take longer than the rows.
MIN_BLOCK_ROWS = 8


@dataclass(frozen=True)
class BlockSums:
    """Some modes in blocks of rows: x_k = E_k (x_s + Σ_j a_j/E_(j+1)), decay E from the block's s.

    Attributes
    ----------
    own : ndarray of int, shape (m,)
        Which modes.
    before : ndarray, shape (m, blocks, rows)
        Weights of the input before each sample, over the decay to its end.
    now : ndarray, shape (m, blocks, rows), or None
        The same of the input behind it; None where it has none.
    decay : ndarray, shape (m, blocks, rows)
    """

    own: NDArray[np.int64]
    before: Any
    now: Any
    decay: Any

    def run(self, weights: Any, u: Float) -> Float:
        """Weighted sum of the states for an input, from rest at its first row, shape (n + 1,).

        Parameters
        ----------
        weights : ndarray, shape (modes,), real or complex
            The ones of all modes.
        u : ndarray, shape (n + 1,)
        """
        _, blocks, rows = self.before.shape
        padded = np.zeros(blocks * rows + 1)
        padded[: len(u)] = u
        states = self.before * padded[:-1].reshape(blocks, rows)
        if self.now is not None:
            states += self.now * padded[1:].reshape(blocks, rows)
        np.cumsum(states, axis=2, out=states)
        if blocks > 1:
            over = self.decay[:, :, -1]
            states += recursion_of(over, over * states[:, :, -1])[:, :-1, None]
        states *= self.decay
        y = np.tensordot(weights[self.own], states, 1).real
        return np.append(0.0, y.ravel()[: len(u) - 1])


@dataclass(frozen=True)
class UnevenClock:
    """Modes over one clock.

    Attributes
    ----------
    sums : tuple of BlockSums
        Modes that decay alike together.
    fast : ndarray of int, shape (k,)
        Modes that decay too fast for any block.
    """

    sums: tuple[BlockSums, ...]
    fast: NDArray[np.int64]

    @staticmethod
    def of(rates: Float, steps: Float, phi: Any, before: Any, now: Any) -> UnevenClock:
        """From the coefficients of every row.

        Parameters
        ----------
        rates : ndarray, shape (modes,) [1/s]
            How fast each mode decays.
        steps : ndarray, shape (n,) [s]
            Two at least.
        phi, before, now : ndarray, shape (modes, n)
            Decay over each sample, and weights of the inputs before and behind it.
        """
        least = np.ceil(rates * np.sum(steps) / BLOCK_DECAY)
        count = BLOCK_RATIO ** np.ceil(np.log(np.maximum(least, 1.0)) / np.log(BLOCK_RATIO))
        sums, fast = [], []
        for blocks in np.unique(count):
            own = np.flatnonzero(count == blocks)
            cut = _cut(float(np.max(rates[own])), steps, int(blocks))
            if cut is None:
                fast += own.tolist()
                continue
            rows = -(-len(steps) // cut)
            shape, more = (len(own), cut, rows), ((0, 0), (0, cut * rows - len(steps)))
            passed = np.pad(phi[own], more, constant_values=1.0).reshape(shape)
            decay = np.cumprod(passed, axis=2)
            first, second = (
                np.pad(w[own], more).reshape(shape) / decay if np.any(w) else None
                for w in (before, now)
            )
            sums.append(BlockSums(own, first, second, decay))
        return UnevenClock(tuple(sums), np.array(fast, int))


def _cut(fastest: float, steps: Float, blocks: int) -> int | None:
    """Number of blocks, from `blocks` on, in which a rate [1/s] decays little; None if none."""
    while blocks == 1 or blocks * MIN_BLOCK_ROWS <= len(steps):
        rows = -(-len(steps) // blocks)
        lengths = np.add.reduceat(steps, np.arange(0, len(steps), rows))
        if fastest * np.max(lengths) <= 2 * BLOCK_DECAY:
            return -(-len(steps) // rows)
        blocks *= 2
    return None
