"""Modes over an uneven clock that many inputs go through: what hangs on the clock is kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermaltool.responses.propagation import recursion_of
from thermaltool.units import Hold

Float = NDArray[np.float64]

# Decay within a block, as an exponent: sums of what is divided by it keep 13 digits.
MAX_DECAY = 64.0
# Modes whose numbers of blocks differ by less are cut into as many.
ALIKE = 4
# Rows of a block at least: of fewer the blocks take longer than the rows.
MIN_ROWS = 8
# States of all modes up to which a clock is kept (3 MB), and how many are.
MAX_KEPT, KEPT = 2**17, 128


@dataclass(frozen=True)
class UnevenSums:
    """Some modes in blocks of rows: x_k = E_k (x_s + Σ_j a_j/E_(j+1)), decay E from the block's s.

    Attributes
    ----------
    own : ndarray of int, shape (m,)
        Which modes.
    before, now : ndarray, shape (m, blocks, rows)
        Weights of the inputs before and behind each sample, over the decay to its end.
    decay : ndarray, shape (m, blocks, rows)
    """

    own: NDArray[np.int64]
    before: Any
    now: Any
    decay: Any

    def run(self, weights: Any, u: Float) -> Float:
        """Weighted sum of the modes' states for an input, from rest at its first row.

        Parameters
        ----------
        weights : ndarray, shape (modes,), real or complex
            Of all modes.
        u : ndarray, shape (n + 1,)

        Returns
        -------
        ndarray, shape (n + 1,)
        """
        _, blocks, rows = self.before.shape
        padded = np.zeros(blocks * rows + 1)
        padded[: len(u)] = u
        states = self.before * padded[:-1].reshape(blocks, rows)
        states += self.now * padded[1:].reshape(blocks, rows)
        np.cumsum(states, axis=2, out=states)
        if blocks > 1:
            over = self.decay[:, :, -1]
            states += recursion_of(over, over * states[:, :, -1])[:, :-1, None]
        states *= self.decay
        y = np.tensordot(weights[self.own], states, 1).real
        return np.append(0.0, y.ravel()[: len(u) - 1])


@dataclass
class UnevenClock:
    """Modes over one clock, prepared once it comes again.

    Attributes
    ----------
    asked : bool
        Whether it has come.
    sums : list of UnevenSums
    fast : ndarray of int
        Modes that decay too fast for any block.
    """

    asked: bool = False
    sums: list[UnevenSums] | None = None
    fast: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, int))

    def ready(
        self, rates: Float, steps: Float, coefficients: Callable[[], tuple[Any, Any, Any]]
    ) -> bool:
        """Whether it is prepared: it has come before.

        Parameters
        ----------
        rates : ndarray, shape (modes,) [1/s]
            Of the decay.
        steps : ndarray, shape (n,) [s]
        coefficients : callable
            Decay of the modes over each sample, and weights of the inputs before and behind it,
            each of shape (modes, n).
        """
        if self.sums is None and self.asked:
            self._prepare(rates, steps, *coefficients())
        self.asked = True
        return self.sums is not None

    def _prepare(self, rates: Float, steps: Float, phi: Any, before: Any, now: Any) -> None:
        """Modes that are alike together."""
        least = np.ceil(rates * np.sum(steps) / MAX_DECAY)
        count = ALIKE ** np.ceil(np.log(np.maximum(least, 1.0)) / np.log(ALIKE))
        self.sums = []
        for blocks in np.unique(count):
            own = np.flatnonzero(count == blocks)
            cut = _cut(float(np.max(rates[own])), steps, int(blocks))
            if cut is None:
                self.fast = np.append(self.fast, own)
                continue
            rows = -(-len(steps) // cut)
            shape, more = (len(own), cut, rows), ((0, 0), (0, cut * rows - len(steps)))
            passed = np.pad(phi[own], more, constant_values=1.0).reshape(shape)
            decay = np.cumprod(passed, axis=2)
            first, second = (np.pad(w[own], more).reshape(shape) / decay for w in (before, now))
            self.sums.append(UnevenSums(own, first, second, decay))


def _cut(fastest: float, steps: Float, blocks: int) -> int | None:
    """Number of blocks, from `blocks` on, in which a rate [1/s] decays little; None if none."""
    while blocks == 1 or blocks * MIN_ROWS <= len(steps):
        rows = -(-len(steps) // blocks)
        lengths = np.add.reduceat(steps, np.arange(0, len(steps), rows))
        if fastest * np.max(lengths) <= 2 * MAX_DECAY:
            return -(-len(steps) // rows)
        blocks *= 2
    return None


@lru_cache(maxsize=KEPT)
def uneven_clock(poles: bytes, steps: bytes, hold: Hold) -> UnevenClock:
    """The one of these poles, lengths and hold.

    Parameters
    ----------
    poles, steps : bytes
        Of their arrays.
    hold : "zero" or "first"
    """
    return UnevenClock()
