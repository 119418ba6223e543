"""A heater that bends a machine back: the power that a model asks for, sample by sample.

After Mareš et al., who hold an angle by a controlled heat source. The source goes through inverse
transfer functions (Q_S = Q_C γ1 γ2⁻¹); here the model runs forward and the power is searched that
brings its output to zero after the lead. So curves and schedules need no inverse, and what the
limits keep from the machine is remembered by the model.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from thermaltool.effects.curve import DriveCurve
from thermaltool.errors import ModelError
from thermaltool.model import Drive, Model, Term
from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.modes import CLOCK_STEP, Float, Hold, Recursion

Values = Mapping[str, float | Float]
# Length [s], and what acts at both ends.
Span = tuple[float, float, float]

# Powers that are tried; between two of them a straight line is taken.
CHOICES = 281
# Recursions for different lengths that are kept ready.
KEPT = 32


class Way:
    """A term in time: what it has stored, and what it will give.

    Parameters
    ----------
    model : Model
    term : Term
    """

    def __init__(self, model: Model, term: Term) -> None:
        modes = term.response.modes(model.sample_period)
        self.delay = modes.delay if isinstance(modes, DelayedModes) else 0.0
        self._modes = modes.prompt() if isinstance(modes, DelayedModes) else modes
        self._drive, self._band = term.drive, term.band
        self._hold: Hold = next(d.hold for d in model.drives if d.channel == term.drive)
        self._curves = [e for e in model.effects
                        if isinstance(e, DriveCurve) and e.channel == term.drive]  # fmt: skip
        self._kept: dict[int, Recursion] = {}
        self._C = self._recursion(model.sample_period).C[0]
        self.start(0.0)

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
        # The state is that of the moment the delay ago; what came since waits.
        self._waiting = [(self.delay, acting, acting)] if self.delay else []
        self._x = np.zeros(self._modes.states)
        if acting:
            self._x = self._recursion(1.0).settled(np.array([acting]))

    def advance(self, dt: float, start: float, end: float) -> None:
        """Go on by `dt` [s], at whose ends so much acts; what is commanded is held."""
        self._waiting.append((dt, start, end if self._hold == "first" else start))
        self._x, self._waiting = self._passed(dt)

    def ahead(self, time: float, acting: Float) -> Float:
        """The output in `time` [s] where so much acts from now on."""
        x, _ = self._passed(time)
        held = time - self.delay
        if held <= CLOCK_STEP / 2:
            return np.full(np.shape(acting), float(self._C @ x))
        r = self._recursion(held)
        return np.asarray(self._C @ r.F @ x + (self._C @ (r.G0 + r.G1)[:, 0]) * acting)

    def _passed(self, time: float) -> tuple[Float, list[Span]]:
        """The state after `time` [s] of what waits, or all of it, and what still waits then."""
        x, left = self._x, time
        for k, (length, start, end) in enumerate(self._waiting):
            if left <= CLOCK_STEP / 2:
                return x, self._waiting[k:]
            if left < length - CLOCK_STEP / 2:
                middle = start + (end - start) * left / length
                rest = [(length - left, middle, end), *self._waiting[k + 1 :]]
                return self._moved(x, left, start, middle), rest
            x, left = self._moved(x, length, start, end), left - length
        return x, []

    def _moved(self, x: Float, dt: float, start: float, end: float) -> Float:
        r = self._recursion(dt)
        return np.asarray(r.F @ x + r.G0[:, 0] * start + r.G1[:, 0] * end)

    def _recursion(self, dt: float) -> Recursion:
        ticks = max(round(dt / CLOCK_STEP), 1)
        if ticks not in self._kept:
            if len(self._kept) >= KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[ticks] = self._modes.discretize(ticks * CLOCK_STEP, self._hold)
        return self._kept[ticks]

    def state(self) -> list[Any]:
        """For `resume`, as JSON."""
        return [self._x.tolist(), [list(part) for part in self._waiting]]

    def resume(self, state: list[Any]) -> None:
        """Go on from `state`; raises TypeError or ValueError where it is none."""
        x, waiting = np.array(state[0], float), [(float(t), float(a), float(b))
                                                 for t, a, b in state[1]]  # fmt: skip
        finite = np.isfinite(x).all() and np.isfinite(waiting).all()
        late = abs(sum(part[0] for part in waiting) - self.delay) > CLOCK_STEP
        if x.shape != self._x.shape or late or not finite:
            raise ValueError("not a state of this model")
        self._x, self._waiting = x, waiting


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
        self.ways = [Way(model, term) for term in terms]
        delays = [w.delay for w, t in zip(self.ways, terms, strict=True) if t.drive == heater]
        # Of several delays the shortest: then the heater begins to be felt.
        self._horizon = min(delays) + lead
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
        return float(sum(way.ahead(0.0, np.zeros(())) for way in self.ways))

    def power(self) -> float:
        """The power that is wanted from now on."""
        values = self._values(self._last, self.choices)
        after = np.zeros(CHOICES)
        for way in self.ways:
            after = after + way.ahead(self._horizon, way.acting(values))
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
