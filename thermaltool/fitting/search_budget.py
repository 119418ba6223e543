"""How long a search for the best candidate may take, and what is said meanwhile."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass
class SearchBudget:
    """A search ends with the best of what it has tried, when its time is over or the user says so.

    Attributes
    ----------
    seconds : float [s]
        From the first search on; inf for no end.
    progress : callable
        Takes a word on what has been tried.
    now : callable
        A clock [s].
    tried : int
        Candidates of the search.
    ended : bool
        Whether the search has ended before its last candidate.
    """

    seconds: float = math.inf
    progress: Callable[[str], None] = lambda message: None
    now: Callable[[], float] = time.monotonic
    tried: int = field(default=0, init=False)
    ended: bool = field(default=False, init=False)
    _interrupted: bool = field(default=False, init=False)
    _end: float | None = field(default=None, init=False)
    _until: float = field(default=math.inf, init=False)

    def begin(self, searches_left: int) -> None:
        """Begin one of so many searches that are left, with its share of the time."""
        now = self.now()
        self._end = now + self.seconds if self._end is None else self._end
        self._until = now + max(self._end - now, 0.0) / searches_left

    @property
    def is_over(self) -> bool:
        """Whether nothing more is to be tried."""
        over = self._interrupted or self.now() >= self._until
        self.ended = self.ended or over
        return over

    def interrupt(self) -> None:
        """The user wants no more: this search ends, and those that follow try one candidate."""
        self._interrupted = self.ended = True

    def count(self) -> None:
        """One candidate more has been tried."""
        self.tried += 1
        self.progress(f"{self.tried} candidates")
