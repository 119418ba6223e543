"""Validity of a model: the ranges that its calibration has seen, and the rest it starts from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isclose
from typing import TYPE_CHECKING

import numpy as np

from thermaltool.model.rest import relative, rest_level, rest_shifts
from thermaltool.responses.modes import Float
from thermaltool.units import (
    ABSOLUTE_ZERO,
    FAHRENHEIT,
    UNITS,
    Reference,
    is_absolute,
    parse_channel,
)

if TYPE_CHECKING:
    from thermaltool.model.document import Model


@dataclass(frozen=True)
class Excursion:
    """Where a channel leaves the range that the calibration has seen.

    Attributes
    ----------
    channel : str
    rows, first : int
        How many are outside, and the first of them.
    value, low, high : float [unit of the channel]
        There, and the range, as the log counts.
    rest : float or None [unit of the channel]
        The first reading from which both count; None where they count from a fixed value.
    """

    channel: str
    rows: int
    first: int
    value: float
    low: float
    high: float
    rest: float | None = None


@dataclass(frozen=True)
class UnitSuspect:
    """A channel that is as in the calibration, were the log in another `unit` than its name says.

    Attributes
    ----------
    channel : str
    unit : str or None
        None where no unit is a thousand times that of the name, or a thousandth.
    logged, seen : float [unit of the name]
        Size in the log and in the calibration: the largest value, of other drives than temperatures
        relative to rest; of outputs that have no absolute level, how far they move.
    by_model : bool
        `seen` is instead the size that by the model goes with the other channels of the log.
    """

    channel: str
    unit: str | None
    logged: float
    seen: float
    by_model: bool = False


# A channel whose size becomes that of the calibration, to this factor, in another unit, a thousand
# times as large or as small, while some channel at the other end of the model moves by this share
# of its range, has that unit.
SAME_SIZE, UNIT_STEP, MIN_MOVED = 2.0, 1000.0, 0.1
# A log in degF has its lowest value, in degC, near that of the calibration: to this part of the
# range.
SAME_BEGIN = 0.25
# Units of a temperature that is in none of degC.
ABSOLUTE_UNITS = ("K", "degF")
# Beyond the calibrated range by more than this part of its width, a model extrapolates.
MARGIN = 0.1
# A first reading further from rest than this share of what the calibration has seen is no rest.
REST_SHARE = 0.1
NOT_AT_REST = "is not rest, which the estimates start from: see --initial settled"
UNTOLD_REST = "is taken to have stood for long: no sensor tells where the machine is"


def away_from_rest(value: float, seen: tuple[float, float]) -> bool:
    """Whether a first reading, relative to rest, contradicts a machine at rest.

    Parameters
    ----------
    value : float
        Relative to rest.
    seen : (float, float)
        What the calibration has seen.
    """
    return abs(value) > REST_SHARE * max(abs(seen[0]), abs(seen[1]))


def excursions(
    model: Model, columns: Mapping[str, Float], zeros: Mapping[str, float] | None = None
) -> tuple[Excursion, ...]:
    """Channels that leave their calibrated range by more than `MARGIN` of its width.

    Parameters
    ----------
    columns : mapping of channel to ndarray, shape (n,); channels that are absent are passed over
    zeros : mapping of output to float, optional
        What outputs count from that did not begin at rest. Others count from their first rows.
    """
    found, known_zeros = [], zeros or {}
    for drive in model.drives:
        if drive.channel in columns:
            values = relative(columns[drive.channel], drive.reference, drive.hold)
            since = drive.reference == "first"
            found += _excursion(drive.channel, values, drive.range, columns[drive.channel], since)
    # A drive has a range of its own.
    others = columns.keys() - {drive.channel for drive in model.drives}
    for effect in model.effects:
        if effect.known_range and effect.channel in others:
            found += _excursion(effect.channel, columns[effect.channel], effect.known_range)
    known = {d.channel: d for d in model.drives if d.channel in columns}
    shifts = rest_shifts(
        model, {c: rest_level(columns[c], d.reference, d.hold) for c, d in known.items()}
    )
    for output in model.outputs:
        if output.channel in columns:
            if output.channel in known_zeros:
                values = columns[output.channel] - known_zeros[output.channel]
            else:
                values = relative(columns[output.channel], output.offset)
                values = values - shifts.get(output.channel, 0.0)
            since = output.offset == "first"
            found += _excursion(
                output.channel, values, output.range, columns[output.channel], since
            )
    return tuple(found)


def unit_suspects(model: Model, columns: Mapping[str, Float]) -> tuple[UnitSuspect, ...]:
    """Channels of a log that may be in another unit than their names say.

    Parameters
    ----------
    columns : mapping of channel to ndarray, shape (n,); channels that are absent are passed over
    """
    there = {name: v[np.isfinite(v)] for name, v in columns.items()}
    drives = [d for d in model.drives if len(there.get(d.channel, ()))]
    outputs = [o for o in model.outputs if len(there.get(o.channel, ()))]
    # What an output moves by tells of the drives, and the other way round.
    drives_move, outputs_move = (
        not each or any(np.ptp(there[c.channel]) > MIN_MOVED * np.ptp(c.range) for c in each)
        for each in (drives, outputs)
    )
    found = []
    for drive in drives:
        if outputs_move:
            values = relative(columns[drive.channel], drive.reference, drive.hold)
            logged, seen = float(np.nanmax(np.abs(values))), max(map(abs, drive.range))
            found.append(thousandth(drive.channel, logged, seen))
        found.append(_other_unit(drive.channel, there[drive.channel], drive.reference, drive.range))
    for output in outputs:
        if drives_move and not is_absolute(output.channel):
            logged, seen = (float(np.ptp(each)) for each in (there[output.channel], output.range))
            found.append(thousandth(output.channel, logged, seen))
        values = there[output.channel]
        found.append(_other_unit(output.channel, values, output.offset, output.range))
    return tuple(each for each in found if each is not None)


def thousandth(channel: str, logged: float, seen: float) -> UnitSuspect | None:
    """Whether values are a thousand times as large, or as small, as the calibration's.

    Parameters
    ----------
    channel : str
    logged, seen : float [unit of the channel]
        Sizes.
    """
    own, factor = UNITS[parse_channel(channel).unit]
    suspects = (
        unit
        for unit, (dimension, other) in UNITS.items()
        if dimension == own
        and any(isclose(other / factor, step) for step in (UNIT_STEP, 1 / UNIT_STEP))
        and 1 / SAME_SIZE < other / factor * logged / seen < SAME_SIZE
    )
    # One unit has several names.
    unit = next(suspects, None) if logged and seen else None
    return None if unit is None else UnitSuspect(channel, unit, logged, seen)


def _other_unit(
    channel: str, values: Float, rest: Reference, seen: tuple[float, float]
) -> UnitSuspect | None:
    """Whether a temperature is as in the calibration, were it in K or in degF."""
    if rest == "first" or not is_absolute(channel):
        return None
    low, high = (rest + end for end in seen)
    lowest, highest, width = float(np.min(values)), float(np.max(values)), high - low
    kelvins = lowest - high > -ABSOLUTE_ZERO / 2 and lowest + ABSOLUTE_ZERO < high + width
    scale, offset = FAHRENHEIT
    begins, ends = (scale * value + offset for value in (lowest, highest))
    as_before = abs(begins - low) < SAME_BEGIN * width and ends < high + width
    fahrenheit = lowest > high + MARGIN * width and as_before
    unit = "K" if kelvins else "degF" if fahrenheit else None
    return None if unit is None else UnitSuspect(channel, unit, highest, high)


def extrapolated(model: Model, estimates: Mapping[str, Float]) -> tuple[Excursion, ...]:
    """Estimated deflections, relative to rest, beyond what the calibration has seen.

    Parameters
    ----------
    model : Model
    estimates : mapping of channel to ndarray, shape (n,)
    """
    found = []
    for output in model.deflections:
        if output.channel in estimates:
            found += _excursion(output.channel, estimates[output.channel], output.range)
    return tuple(found)


def _excursion(
    channel: str,
    values: Float,
    seen: tuple[float, float],
    logged: Float | None = None,
    since_first: bool = False,
) -> list[Excursion]:
    """How values relative to rest leave their range; told as they are logged, where they are."""
    low, high = seen
    slack = MARGIN * (high - low)
    outside = np.flatnonzero((values < low - slack) | (values > high + slack))
    if not len(outside):
        return []
    first = int(outside[0])
    value = float(values[first])
    rest = 0.0 if logged is None else float(logged[first]) - value
    own = rest if since_first else None
    return [Excursion(channel, len(outside), first, value + rest, low + rest, high + rest, own)]
