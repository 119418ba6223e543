"""A response row by row: its recursion over samples of any length, behind its dead time.

`Modes.run` is the same for whole records at once; ``tests/responses`` holds the two together for
every kind.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.modes import Float, Hold, Modes
from thermaltool.responses.recursion import Recursion
from thermaltool.responses.sample_clock import CLOCK_STEP

# Length of a stretch of input [clock steps], and the input at both of its ends.
Span = tuple[int, float, float]

# Sample lengths whose recursion is kept ready: an even clock has one, a printed one a few.
MAX_CACHED_RECURSIONS = 32
# The steady state is found over a sample of one second; any length gives the same [clock steps].
STEADY_STATE_TICKS = round(1.0 / CLOCK_STEP)


def split_delay(modes: Modes) -> tuple[Modes, float]:
    """A response without its dead time, and the dead time [s].

    Parameters
    ----------
    modes : Modes
    """
    return (modes.prompt(), modes.delay) if isinstance(modes, DelayedModes) else (modes, 0.0)


class RecursionCache:
    """Recursions of one response without dead time, for any number of clock steps.

    Parameters
    ----------
    modes : Modes
    hold : "zero" or "first"
    """

    def __init__(self, modes: Modes, hold: Hold) -> None:
        self.states = modes.states
        self._modes, self._hold = modes, hold
        self._cached: dict[int, tuple[Float, Float, Float]] = {}

    def over(self, ticks: int) -> Recursion:
        """The recursion over a sample of `ticks` clock steps.

        Parameters
        ----------
        ticks : int
        """
        return self._modes.discretize(ticks * CLOCK_STEP, self._hold)

    def advance(self, x: Float, ticks: int, start: float, end: float) -> Float:
        """The state `ticks` clock steps after `x`, with this input at both ends.

        Parameters
        ----------
        x : ndarray, shape (states,)
        ticks : int
        start, end : float
            The input at both ends.
        """
        kept = self._cached.get(ticks)
        if kept is None:
            if len(self._cached) >= MAX_CACHED_RECURSIONS:
                del self._cached[next(iter(self._cached))]
            r = self.over(ticks)
            kept = self._cached[ticks] = r.F, r.G0[:, 0].copy(), r.G1[:, 0].copy()
        F, G0, G1 = kept
        x = F.dot(x) + G0 * start
        return x if self._hold == "zero" else x + G1 * end

    def settled(self, u: float) -> Float:
        """The steady state under a constant input, shape (states,).

        Parameters
        ----------
        u : float
        """
        if not u:
            return np.zeros(self.states)
        return self.over(STEADY_STATE_TICKS).settled(np.array([u]))


class SpanDelay:
    """What enters leaves a dead time later, in the same parts or in smaller ones.

    Every span enters once and leaves once, in one part or a few: the work for a sample does not
    grow with the dead time.

    Parameters
    ----------
    ticks : int
        Dead time [clock steps]. Below zero a held input acts before the row in which it is logged:
        exact where rows are no closer than that.
    """

    def __init__(self, ticks: int) -> None:
        self.ticks = ticks
        self.start(0.0)

    def start(self, u: float) -> None:
        """A constant input `u` has stood for ever.

        Parameters
        ----------
        u : float
        """
        self._waiting = deque([(self.ticks, u, u)] if self.ticks > 0 else [])

    def advance(self, entered: list[Span]) -> list[Span]:
        """Take what enters; what leaves in the same time.

        Parameters
        ----------
        entered : list of (ticks, start, end)
        """
        if self.ticks < 0:
            return [part for span in entered for part in self._early(span)]
        if not self.ticks:
            return entered
        self._waiting.extend(entered)
        left, parts = sum(ticks for ticks, _, _ in entered), []
        while left:
            ticks, start, end = self._waiting.popleft()
            if ticks > left:
                middle = start + (end - start) * left / ticks
                self._waiting.appendleft((ticks - left, middle, end))
                ticks, end = left, middle
            parts.append((ticks, start, end))
            left -= ticks
        return parts

    def _early(self, span: Span) -> list[Span]:
        """A held input whose following value acts already at the end of the sample."""
        ticks, start, end = span
        early = min(ticks, -self.ticks)
        return [(t, u, u) for t, u in ((ticks - early, start), (early, end)) if t]

    def scale(self, factor: float) -> None:
        """Multiply all that waits by `factor`."""
        self._waiting = deque((ticks, factor * a, factor * b) for ticks, a, b in self._waiting)

    def state(self) -> list[list[float]]:
        """For `resume`, as JSON."""
        return [list(part) for part in self._waiting]

    def resume(self, state: list[Any]) -> None:
        """Go on from `state`; raises TypeError or ValueError where it is none."""
        waiting = [(float(t), float(a), float(b)) for t, a, b in state]
        lengths = [ticks for ticks, _, _ in waiting]
        whole = all(ticks > 0 and ticks.is_integer() for ticks in lengths)
        fitting = sum(lengths) == max(self.ticks, 0)
        if not whole or not fitting or not np.isfinite(np.ravel(waiting)).all():
            raise ValueError("not a state of this model")
        self._waiting = deque((int(ticks), a, b) for ticks, a, b in waiting)


class DelayLine:
    """A dead time, and the state of a response that is driven by what leaves it.

    Parameters
    ----------
    recursions : RecursionCache
    ticks : int
        Dead time [clock steps].

    Attributes
    ----------
    x : ndarray, shape (states,)
        The state after all that has left.
    """

    def __init__(self, recursions: RecursionCache, ticks: int) -> None:
        self._recursions, self._dead_time = recursions, SpanDelay(ticks)
        self.start(0.0)

    def start(self, u: float) -> None:
        """The steady state under a constant input `u`.

        Parameters
        ----------
        u : float
        """
        self.x = self._recursions.settled(u)
        self._dead_time.start(u)

    def advance(self, entered: list[Span]) -> list[Span]:
        """Take what enters; what leaves in the same time drives the state, and is returned.

        Parameters
        ----------
        entered : list of (ticks, start, end)
        """
        parts = self._dead_time.advance(entered)
        for ticks, start, end in parts:
            self.x = self._recursions.advance(self.x, ticks, start, end)
        return parts

    def scale(self, factor: float) -> None:
        """Multiply the state, and all that waits, by `factor`."""
        self.x = self.x * factor
        self._dead_time.scale(factor)

    def state(self) -> list[Any]:
        """For `resume`, as JSON."""
        return [self.x.tolist(), self._dead_time.state()]

    def resume(self, state: list[Any]) -> None:
        """Go on from `state`; raises TypeError or ValueError where it is none."""
        kept, spans = state
        x = np.array(kept, float)
        if x.shape != (self._recursions.states,) or not np.isfinite(x).all():
            raise ValueError("not a state of this model")
        self._dead_time.resume(spans)
        self.x = x


class ResponseRecursion:
    """The output of one response now, and a while ahead.

    Two delay lines, one behind the other: at the end of the first is the state of the horizon, as
    far as what has come by now makes it; at the end of the second the state of now.

    Parameters
    ----------
    modes : Modes
    hold : "zero" or "first"
        The input between samples: constant at the earlier value, or a straight line.
    horizon : float [s]
        How far `ahead` looks.
    """

    def __init__(self, modes: Modes, hold: Hold, horizon: float = 0.0) -> None:
        prompt, dead_time = split_delay(modes)
        self._hold: Hold = hold
        # The input of the row itself, which a direct feedthrough takes at once.
        self._direct, self._input = prompt.direct, 0.0
        prompt = prompt.proper
        recursions = RecursionCache(prompt, hold)
        delay, far = round(dead_time / CLOCK_STEP), round(horizon / CLOCK_STEP)
        self._lines = [DelayLine(recursions, max(delay - far, 0))]
        if min(delay, far):
            self._lines.append(DelayLine(recursions, min(delay, far)))
        # What acts from now on is felt for this long at the horizon.
        r = recursions.over(max(far - delay, 0))
        self._C, self._C_ahead = r.C[0], r.C[0] @ r.F
        self._gain_ahead = float(r.C[0] @ (r.G0 + r.G1)[:, 0])

    def start(self, u: float = 0.0, acting: float | None = None) -> None:
        """At rest, or in the steady state under a constant input `u`.

        Parameters
        ----------
        u : float
        acting : float, optional
            The input of the first row itself; `u` where it is not given.
        """
        self._input = u if acting is None else acting
        for line in self._lines:
            line.start(u)

    def advance(self, ticks: int, start: float, end: float) -> None:
        """Go on by `ticks` clock steps with this input at their ends; of a held one the first.

        Parameters
        ----------
        ticks : int
        start, end : float
            The input at both ends.
        """
        parts = [(ticks, start, end if self._hold == "first" else start)]
        self._input = end
        for line in self._lines:
            parts = line.advance(parts)

    def now(self) -> float:
        """The output."""
        return float(self._C.dot(self._lines[-1].x)) + self._direct * self._input

    def ahead(self, u: Float) -> Float:
        """The output at the horizon for every input that is held from now on, shape of `u`.

        Parameters
        ----------
        u : ndarray, any shape
        """
        return np.asarray(
            self._C_ahead.dot(self._lines[0].x) + (self._gain_ahead + self._direct) * u
        )

    def scale(self, factor: float) -> None:
        """Multiply all that is stored by `factor`."""
        self._input *= factor
        for line in self._lines:
            line.scale(factor)

    def state(self) -> list[Any]:
        """For `resume`, as JSON."""
        lines = [line.state() for line in self._lines]
        return [*lines, self._input] if self._direct else lines

    def resume(self, state: list[Any]) -> None:
        """Go on from `state`; raises TypeError or ValueError where it is none."""
        if self._direct:
            *state, last = state
            if not np.isfinite(float(last)):
                raise ValueError("not a state of this model")
            self._input = float(last)
        for line, kept in zip(self._lines, state, strict=True):
            line.resume(kept)
