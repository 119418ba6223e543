"""What the effects of a model do where readings come in and drives are unknown.

Only effects without a log of their own are permanent: an accident of one log says nothing of the
next. Sensor and wiring effects are taken back on the readings, and a sensor's lag joins its
response; sources are known inputs (`thermaltool.estimation.known_inputs`); structure effects bend
the estimated deflection; drive effects are taken back on the estimated drive, or act on a measured
one. What cannot be had in a stream is refused by name (`check_supported`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NoReturn

import numpy as np

from thermaltool.effects.effect import STILL, Effect, Side
from thermaltool.effects.joint_contact import JointContact
from thermaltool.errors import ModelError
from thermaltool.model import Model, acting_effects
from thermaltool.responses.modes import Float
from thermaltool.units import Hold, Reference, is_absolute, is_displacement

# A function of the moment alone, of values of any shape.
StaticMap = Callable[[Float], Float | None]

# Points of the calibrated range at which a curve is judged: its slope to half a percent.
CURVE_POINTS = 201
# A true value that comes back from its reading within this share of the range is the same.
INVERSE_TOLERANCE = 1e-6


@dataclass(frozen=True)
class InputColumn:
    """One column on its way into the estimator.

    Attributes
    ----------
    column : str
    rest : "first" or float
        What counts as zero; "first" is the first value.
    calibrated : (float, float) or None
        What the calibration has seen of it, relative to rest; None where it is not in the model.
    sensor : bool
        Estimates rest on it; else it is a known input.
    commanded : bool
        It may stand still for as long as it likes.
    to_true, to_acting : tuple of callable
        From a reading to the true value behind it, and from a measured drive to what acts.
    """

    column: str
    rest: Reference
    calibrated: tuple[float, float] | None
    sensor: bool
    commanded: bool = False
    to_true: tuple[StaticMap, ...] = ()
    to_acting: tuple[StaticMap, ...] = ()

    @property
    def tells_rest(self) -> bool:
        """Whether a machine at rest reads rest here: a sensor, or a temperature that drives."""
        if self.sensor or self.commanded:
            return self.sensor
        return self.rest != "first" and is_absolute(self.column)

    @property
    def hold(self) -> Hold:
        """Whether its first value is exact: of a command, and of a source as its effect has it."""
        return "zero" if self.commanded or self.calibrated is None else "first"


def apply_maps(maps: Iterable[StaticMap], values: Float) -> Float:
    """`values` through one static map after the other.

    Parameters
    ----------
    maps : iterable of callable
    values : ndarray, any shape
    """
    for each in maps:
        passed = each(values)
        assert passed is not None, "examined before"
        values = passed
    return values


def permanent_effects(model: Model) -> tuple[Effect, ...]:
    """The effects that are not confined to a log.

    Parameters
    ----------
    model : Model
    """
    return acting_effects(model)


def reading_columns(model: Model) -> dict[str, str]:
    """Where the reading of each output stands: its own column, unless plugs were swapped.

    Parameters
    ----------
    model : Model
    """
    stands = {o.channel: o.channel for o in model.outputs}
    for effect in permanent_effects(model):
        if effect.side == "wiring" and effect.partner in stands and effect.channel in stands:
            a, b = effect.channel, effect.partner
            stands[a], stands[b] = stands[b], stands[a]
    return {sensor: column for column, sensor in stands.items()}


def _effects_at(model: Model, side: Side, channel: str) -> list[Effect]:
    return [e for e in permanent_effects(model) if e.side == side and e.channel == channel]


def sensor_time_constants(model: Model, sensor: str) -> list[float]:
    """Time constants with which a sensor follows the truth [s].

    Parameters
    ----------
    model : Model
    sensor : str
    """
    return [e.lag for e in _effects_at(model, "sensor", sensor) if e.lag > 0]


def reading_maps(model: Model, sensor: str) -> tuple[StaticMap, ...]:
    """Maps from a sensor's reading, relative to rest, to the true value behind it.

    Parameters
    ----------
    model : Model
    sensor : str
    """
    return tuple(e.undone for e in reversed(_effects_at(model, "sensor", sensor)) if not e.lag > 0)


def drive_maps(model: Model, drive: str) -> tuple[StaticMap, ...]:
    """Maps from a drive, relative to its reference, to what acts of it at once.

    Parameters
    ----------
    model : Model
    drive : str
    """
    effects = _effects_at(model, "drive", drive)
    return tuple(partial(e.drive, STILL) for e in effects if e.memoryless)


def spreading_joints(model: Model) -> tuple[JointContact, ...]:
    """Joints by which outputs bend together.

    Parameters
    ----------
    model : Model
    """
    every = permanent_effects(model)
    return tuple(e for e in every if isinstance(e, JointContact) and e.spreads)


def contact_column(model: Model, channel: str) -> InputColumn:
    """How an output is read by which a joint bends others.

    Parameters
    ----------
    model : Model
    channel : str
    """
    own = next(o for o in model.outputs if o.channel == channel)
    bent = next(e.bent for e in spreading_joints(model) if e.channel == channel)
    maps = reading_maps(model, channel)
    return InputColumn(channel, own.offset, own.range, False, to_true=maps, to_acting=(bent,))


def _bent(effect: Effect, values: Float) -> Float:
    return effect.output(effect.channel, {effect.channel: values}, STILL)


def estimate_maps(model: Model, estimate: str) -> tuple[StaticMap, ...]:
    """Maps of an estimate: to drives as they are logged, to deflections as they bend.

    Parameters
    ----------
    model : Model
    estimate : str
    """
    bends = _effects_at(model, "structure", estimate)
    acting = reversed(_effects_at(model, "drive", estimate))
    before = (e.undone for e in acting if e.undone(STILL.time) is not None)
    return (*before, *(partial(_bent, e) for e in bends))


def noise_amplification(model: Model, sensor: str) -> float:
    """Largest slope of the true value over the reading, in the calibrated range.

    Parameters
    ----------
    model : Model
    sensor : str

    Raises
    ------
    ModelError
        A reading does not say what is behind it.
    """
    static = [e for e in _effects_at(model, "sensor", sensor) if not e.lag > 0]
    if not static:
        return 1.0
    low, high = next(o.range for o in model.outputs if o.channel == sensor)
    truth = np.linspace(min(low, 0.0), max(high, 0.0), CURVE_POINTS)
    for effect in static:
        if effect.undone(truth) is None:
            refuse(effect, "no reading of a stream tells what is behind it")
    reading = truth
    for effect in static:
        reading = effect.output(sensor, {sensor: reading}, STILL)
    back = apply_maps(reading_maps(model, sensor), reading)
    if not np.allclose(back, truth, rtol=0, atol=INVERSE_TOLERANCE * max(np.ptp(truth), 1e-12)):
        refuse(static[-1], "two values give one reading within the calibrated range")
    return float(np.max(np.abs(np.diff(truth) / np.diff(reading))))


def check_supported(model: Model, measured: Sequence[str] = ()) -> tuple[str, ...]:
    """What a user should know of the effects at run time; refuses what cannot be had there.

    Parameters
    ----------
    measured : sequence of str
        Drives that are read from the stream.

    Raises
    ------
    ModelError
        An effect that no estimator can follow, by name.
    """
    roles = {o.channel: o.role for o in model.outputs}
    notes = []
    for effect in permanent_effects(model):
        name, channel = effect.name, effect.channel
        if effect.event:
            refuse(effect, "an accident that belongs to one log, which is not named")
        if effect.side == "drive":
            if channel in measured and not effect.memoryless:
                refuse(effect, "not supported on a drive that is read from the stream")
            if channel not in measured and effect.undone(STILL.time) is None:
                notes.append(f"{channel}: the estimate is what acts, behind {name}")
        elif effect.side == "source":
            if effect.partner is not None:
                refuse(effect, f"not supported where heat is lost at one place, {effect.partner}")
            if not any(effect.paths(output) for output in roles):
                refuse(effect, "no column tells a stream of it")
        elif effect.side == "structure" and effect.joins:
            if channel not in roles or is_displacement(channel):
                refuse(effect, "supported only where a temperature that is read says how far")
        elif effect.side == "structure":
            if roles.get(channel) != "deflection" or not effect.memoryless:
                refuse(effect, "supported only where it bends an estimated deflection at once")
        elif effect.side == "sensor":
            if roles.get(channel) == "deflection":
                notes.append(f"{channel}: what is estimated is the truth, before {name}")
            else:
                noise_amplification(model, channel)
                _examine_order(model, channel)
        elif effect.side == "wiring":
            ends = {roles.get(channel), roles.get(effect.partner or "")}
            if len(ends) > 1 or None in ends:
                refuse(effect, f"{channel} and {effect.partner} are not two sensors of the model")
            if ends == {"deflection"}:
                notes.append(f"{channel}, {effect.partner}: estimated under their right names")
    return tuple(notes)


def _examine_order(model: Model, sensor: str) -> None:
    """A lag behind a bent curve is not that of a linear response."""
    bent = None
    for effect in _effects_at(model, "sensor", sensor):
        if effect.lag > 0 and bent is not None:
            refuse(effect, f"not supported behind {bent.name}")
        if effect.lag <= 0:
            one, two = (_bent(effect, np.array([x])) for x in (1.0, 2.0))
            bent = bent if np.allclose(two, 2 * one) else effect


def refuse(effect: Effect, why: str) -> NoReturn:
    """Say by name which effect cannot be had, and why.

    Parameters
    ----------
    effect : Effect
    why : str
    """
    place = f" of {effect.channel}" if effect.channel else ""
    raise ModelError(f"the model's effect {effect.name}{place}: {why}")
