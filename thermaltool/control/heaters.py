"""A heater that bends a machine back: the power that a model asks for, sample by sample.

After Mareš et al., who hold an angle by a controlled heat source. The source goes through inverse
transfer functions (Q_S = Q_C γ1 γ2⁻¹); here the model runs forward and the power is searched that
brings its output to zero after the lead. So curves and schedules need no inverse, and what the
limits keep from the machine is remembered by the model.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from thermaltool.effects.curve import DriveCurve
from thermaltool.errors import ModelError
from thermaltool.model import Drive, Model, Term
from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.modes import CLOCK_STEP, Float, Hold, Modes, Recursion

Values = Mapping[str, float | Float]
# Length [clock steps], and what acts at both ends.
Span = tuple[int, float, float]

# Powers that are tried; between two of them a straight line is taken.
CHOICES = 281
# Recursions for different lengths that are kept ready.
KEPT = 32
# Any length gives the same steady state [clock steps].
SETTLING = round(1.0 / CLOCK_STEP)


class Recursions:
    """Recursions of one response for any number of clock steps, the latest kept ready."""

    def __init__(self, modes: Modes, hold: Hold) -> None:
        self.states = modes.states
        self._modes, self._hold = modes, hold
        self._kept: dict[int, Recursion] = {}

    def over(self, ticks: int) -> Recursion:
        """The recursion over `ticks`."""
        if ticks not in self._kept:
            if len(self._kept) >= KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[ticks] = self._modes.discretize(ticks * CLOCK_STEP, self._hold)
        return self._kept[ticks]

    def settled(self, acting: float) -> Float:
        """The state where `acting` has stood for ever."""
        if not acting:
            return np.zeros(self.states)
        return self.over(SETTLING).settled(np.array([acting]))


class Line:
    """A delay line and the state at its end: what enters acts `ticks` later.

    Every span enters once and leaves once, in one part or a few: the work for a sample does not
    grow with the delay.

    Attributes
    ----------
    x : ndarray, shape (n,)
        The state after all that has left.
    """

    def __init__(self, steps: Recursions, ticks: int) -> None:
        self._steps, self._ticks = steps, ticks
        self.start(0.0)

    def start(self, acting: float) -> None:
        """From where `acting` has stood for ever."""
        self.x = self._steps.settled(acting)
        self._waiting = deque([(self._ticks, acting, acting)] if self._ticks else [])

    def advance(self, entered: Sequence[Span]) -> list[Span]:
        """Take what enters; what leaves in the same time moves the state, and is returned."""
        self._waiting.extend(entered)
        left, parts = sum(ticks for ticks, _, _ in entered), []
        while left:
            ticks, start, end = self._waiting.popleft()
            if ticks > left:
                middle = start + (end - start) * left / ticks
                self._waiting.appendleft((ticks - left, middle, end))
                ticks, end = left, middle
            r = self._steps.over(ticks)
            self.x = r.F @ self.x + r.G0[:, 0] * start + r.G1[:, 0] * end
            parts.append((ticks, start, end))
            left -= ticks
        return parts

    def state(self) -> list[Any]:
        """For `resume`, as JSON."""
        return [self.x.tolist(), [list(part) for part in self._waiting]]

    def resume(self, state: list[Any]) -> None:
        """Go on from `state`; raises TypeError or ValueError where it is none."""
        kept, spans = state
        x, waiting = np.array(kept, float), [(float(t), float(a), float(b)) for t, a, b in spans]
        lengths = [ticks for ticks, _, _ in waiting]
        whole = all(ticks > 0 and ticks.is_integer() for ticks in lengths)
        fitting = x.shape == (self._steps.states,) and sum(lengths) == self._ticks
        if not whole or not fitting or not np.isfinite([*x, *np.ravel(waiting)]).all():
            raise ValueError("not a state of this model")
        self.x, self._waiting = x, deque((int(ticks), a, b) for ticks, a, b in waiting)


class Way:
    """A term in time: what it has stored, and what it will give a while later.

    Two delay lines, one behind the other: at the end of the first is the state of the horizon, as
    far as what has come by now makes it; at the end of the second the state of now.

    Parameters
    ----------
    model : Model
    term : Term
    horizon : float [s]
        How far `ahead` looks.
    """

    def __init__(self, model: Model, term: Term, horizon: float) -> None:
        modes, lag = parted(model, term)
        self._drive, self._band = term.drive, term.band
        self._hold: Hold = next(d.hold for d in model.drives if d.channel == term.drive)
        self._curves = [e for e in model.effects
                        if isinstance(e, DriveCurve) and e.channel == term.drive]  # fmt: skip
        steps = Recursions(modes, self._hold)
        delay, far = round(lag / CLOCK_STEP), round(horizon / CLOCK_STEP)
        self._lines = [Line(steps, max(delay - far, 0))]
        if min(delay, far):
            self._lines.append(Line(steps, min(delay, far)))
        # What acts from now on is felt for this long at the horizon.
        r = steps.over(max(far - delay, 0))
        self._C, self._C_ahead = r.C[0], r.C[0] @ r.F
        self._gain = float(r.C[0] @ (r.G0 + r.G1)[:, 0])

    def acting(self, values: Values) -> Float:
        """What the response takes of the drives, each relative to its reference."""
        bent = np.asarray(values[self._drive], float)
        for curve in self._curves:
            bent = curve.bent(bent)
        if self._band is not None:
            bent = bent * self._band.share(np.asarray(values[self._band.channel], float))
        return bent

    def start(self, acting: float) -> None:
        """From where `acting` has stood for ever."""
        for line in self._lines:
            line.start(acting)

    def advance(self, dt: float, start: float, end: float) -> None:
        """Go on by `dt` [s], at whose ends so much acts; what is commanded is held."""
        parts = [(round(dt / CLOCK_STEP), start, end if self._hold == "first" else start)]
        for line in self._lines:
            parts = line.advance(parts)

    def now(self) -> float:
        """The output."""
        return float(self._C @ self._lines[-1].x)

    def ahead(self, acting: Float) -> Float:
        """The output at the horizon where so much acts from now on."""
        return np.asarray(self._C_ahead @ self._lines[0].x + self._gain * acting)

    def state(self) -> list[Any]:
        """For `resume`, as JSON."""
        return [line.state() for line in self._lines]

    def resume(self, state: list[Any]) -> None:
        """Go on from `state`; raises TypeError or ValueError where it is none."""
        for line, kept in zip(self._lines, state, strict=True):
            line.resume(kept)


def parted(model: Model, term: Term) -> tuple[Modes, float]:
    """The response of a term without its delay, and the delay [s]."""
    modes = term.response.modes(model.sample_period)
    return (modes.prompt(), modes.delay) if isinstance(modes, DelayedModes) else (modes, 0.0)


class Stabilizer:
    """The power of one heater that holds one output of a model at zero.

    The output is foretold, all drives held, for `lead` after the heater's delay.

    Parameters
    ----------
    model : Model
    heater : str
        The drive that is set.
    target : str
        The output that is held.
    limits : (float, float) [unit of the heater]
        Its least and largest value.
    lead : float [s]

    Raises
    ------
    ModelError
        As `parts_of`.
    """

    def __init__(
        self, model: Model, heater: str, target: str, limits: tuple[float, float], lead: float
    ) -> None:
        own, self.read, terms = parts_of(model, heater, target)
        self.heater, self._reference = heater, float(own.reference)
        # Of several delays the shortest: then the heater begins to be felt.
        felt = min(parted(model, term)[1] for term in terms if term.drive == heater)
        self.ways = [Way(model, term, felt + lead) for term in terms]
        self.choices = np.linspace(*limits, CHOICES)
        self._last: dict[str, float] = {}

    def start(self, readings: Mapping[str, float], settled: bool = False) -> None:
        """At rest, or settled at the first readings with the heater off.

        Parameters
        ----------
        readings : mapping of channel to float
            All of `read`, relative to their references.
        """
        self._last = dict(readings)
        for way in self.ways:
            way.start(float(way.acting(self._values(readings, 0.0))) if settled else 0.0)

    def advance(self, dt: float, readings: Mapping[str, float], power: float) -> None:
        """Go on by `dt` [s] to new readings; the heater stood at `power` meanwhile."""
        start, end = self._values(self._last, power), self._values(readings, power)
        for way in self.ways:
            way.advance(dt, float(way.acting(start)), float(way.acting(end)))
        self._last = dict(readings)

    def now(self) -> float:
        """The output of the model, relative to rest."""
        return sum(way.now() for way in self.ways)

    def power(self) -> float:
        """The power that is wanted from now on."""
        values = self._values(self._last, self.choices)
        after = np.zeros(CHOICES)
        for way in self.ways:
            after = after + way.ahead(way.acting(values))
        crossed = np.flatnonzero(after[:-1] * after[1:] <= 0)
        if not len(crossed):
            # No power reaches zero. Over a short lead a schedule can have its strongest effect
            # amid its range; what lasts is at an end.
            return float(self.choices[0 if abs(after[0]) <= abs(after[-1]) else -1])
        size = np.abs(after)
        k = int(crossed[np.argmin(np.minimum(size[crossed], size[crossed + 1]))])
        share = size[k] / (size[k] + size[k + 1]) if size[k] else 0.0
        return float(self.choices[k] + share * (self.choices[k + 1] - self.choices[k]))

    def _values(self, readings: Mapping[str, float], power: float | Float) -> Values:
        return {**readings, self.heater: power - self._reference}

    def state(self) -> list[Any]:
        """For `resume`, as JSON."""
        return [self._last, [way.state() for way in self.ways]]

    def resume(self, state: list[Any]) -> None:
        """Go on from `state`; raises KeyError, TypeError or ValueError where it is none."""
        self._last = {d.channel: float(state[0][d.channel]) for d in self.read}
        for way, kept in zip(self.ways, state[1], strict=True):
            way.resume(kept)


def parts_of(
    model: Model, heater: str, target: str
) -> tuple[Drive, tuple[Drive, ...], tuple[Term, ...]]:
    """The heater, the drives that are read, and the terms that act on the target.

    Raises
    ------
    ModelError
        A heater that is no drive, is measured instead of set, has no known zero, or does not act
        on the target; a target that is no output; nothing beside the heater; an effect other than
        curves of drives; a schedule by what is no drive.
    """
    drives = {d.channel: d for d in model.drives}
    if heater not in drives:
        raise ModelError(f"{heater} is not a drive of the model; there are {', '.join(drives)}")
    outputs = [o.channel for o in model.outputs]
    if target not in outputs:
        raise ModelError(f"{target} is not an output of the model; there are {', '.join(outputs)}")
    own = drives[heater]
    if own.hold != "zero" or own.reference == "first":
        raise ModelError(f"{heater} is not set like a power, but measured from its first value")
    terms = tuple(t for t in model.terms if t.output == target)
    choosers = [t.band.channel for t in terms if t.band is not None]
    needed = {*choosers, *(t.drive for t in terms)}
    if all(t.drive != heater for t in terms):
        raise ModelError(f"{heater} does not act on {target}")
    if needed == {heater}:
        raise ModelError(f"nothing but {heater} acts on {target}: there is nothing to hold off")
    for channel in needed:
        if channel not in drives:
            raise ModelError(f"a schedule by {channel}, which is no drive of the model")
    for effect in model.effects:
        if not isinstance(effect, DriveCurve):
            raise ModelError(f"a heater cannot be set by a model with the effect {effect.name}")
    return own, tuple(d for d in model.drives if d.channel in needed - {heater}), terms
