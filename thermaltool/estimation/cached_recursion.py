"""What the estimators share: a recursion that is solved for once."""

from __future__ import annotations

from functools import lru_cache

from thermaltool.responses.modes import CLOCK_STEP, Recursion

# Sample lengths whose recursion is kept: an even clock has one, a printed jittering one a few.
MAX_CACHED_RECURSIONS = 64


class CachedRecursion:
    """The recursion of an estimator, solved for once for each sample length.

    A subclass gives `_build`. The cache is one of the instance: it goes when the estimator goes.
    """

    def __post_init__(self) -> None:
        object.__setattr__(self, "_recursions", lru_cache(MAX_CACHED_RECURSIONS)(self._of_ticks))

    def recursion(self, dt: float) -> Recursion:
        """The recursion over a sample of `dt` [s], to a clock step."""
        recursion: Recursion = self._recursions(round(dt / CLOCK_STEP))  # type: ignore[attr-defined]
        return recursion

    def _of_ticks(self, ticks: int) -> Recursion:
        return self._build(ticks * CLOCK_STEP)

    def _build(self, dt: float) -> Recursion:
        raise NotImplementedError
