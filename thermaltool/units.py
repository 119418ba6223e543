"""The border's nomenclature: a column name is ``<quantity>_<place>_<unit>``.

``T_spindle_degC`` is an absolute temperature, ``dT_pair1_K`` a difference of two, ``Q_main_W`` a
heat, ``Q_main_1`` a heat relative to full scale, ``d_z_um`` a displacement, ``n_spindle_rpm`` a
speed, ``v_x_m/min`` a feed, ``U_heater_V`` a voltage, ``V_coolant_l/min`` a flow; ``time_s`` (or
ISO 8601 ``time``) is the clock. The place may be absent (``T_degC``) and may contain underscores.
"""

from __future__ import annotations

import re
from collections.abc import Container, Sequence
from dataclasses import dataclass
from typing import Literal

from thermaltool.errors import UnitError

# Between two samples a value is constant ("zero") or runs straight ("first"): the hold's order.
Hold = Literal["zero", "first"]
# What counts as zero of a channel: a value, or its first one in a log.
Reference = float | Literal["first"]

# Quantities that run on between samples; heat, voltage, speed are commanded.
_CONTINUOUS = ("temperature", "temperature difference", "length", "angle")
_DISPLACEMENTS = ("length", "angle")
_HEATING = (
    *("power", "heat flux", "ratio", "speed", "velocity"),
    *("temperature", "temperature difference"),
)
_SYMBOLS = {
    "degC": "°C",
    "um": "µm",
    "urad": "µrad",
    "pct": "%",
    "us": "µs",
    "W/m2": "W/m²",
    "W/m^2": "W/m²",
    "kW/m2": "kW/m²",
    "W/cm2": "W/cm²",
    "m3/h": "m³/h",
    "m3/s": "m³/s",
}

# unit -> (dimension, factor to the dimension's base unit)
UNITS: dict[str, tuple[str, float]] = {
    "s": ("time", 1.0),
    "ms": ("time", 1e-3),
    "us": ("time", 1e-6),
    "ns": ("time", 1e-9),
    "min": ("time", 60.0),
    "h": ("time", 3600.0),
    "d": ("time", 86400.0),
    "degC": ("temperature", 1.0),
    "K": ("temperature difference", 1.0),
    "mK": ("temperature difference", 1e-3),
    "W": ("power", 1.0),
    "mW": ("power", 1e-3),
    "kW": ("power", 1e3),
    "W/m2": ("heat flux", 1.0),
    "W/m^2": ("heat flux", 1.0),
    "kW/m2": ("heat flux", 1e3),
    "W/cm2": ("heat flux", 1e4),
    "K/W": ("thermal resistance", 1.0),
    "J/K": ("heat capacity", 1.0),
    "um": ("length", 1.0),
    "nm": ("length", 1e-3),
    "mm": ("length", 1e3),
    "m": ("length", 1e6),
    "urad": ("angle", 1.0),
    "rad": ("angle", 1e6),
    "rpm": ("speed", 1.0),
    "m/s": ("velocity", 1.0),
    "mm/s": ("velocity", 1e-3),
    "m/min": ("velocity", 1.0 / 60.0),
    "mm/min": ("velocity", 1e-3 / 60.0),
    "V": ("voltage", 1.0),
    "mV": ("voltage", 1e-3),
    "A": ("current", 1.0),
    "N": ("force", 1.0),
    "Nm": ("torque", 1.0),
    "Hz": ("frequency", 1.0),
    "bar": ("pressure", 1.0),
    "mbar": ("pressure", 1e-3),
    "Pa": ("pressure", 1e-5),
    "kPa": ("pressure", 1e-2),
    "MPa": ("pressure", 10.0),
    "l/min": ("flow", 1.0),
    "l/h": ("flow", 1.0 / 60.0),
    "ml/min": ("flow", 1e-3),
    "m3/h": ("flow", 1000.0 / 60.0),
    "m3/s": ("flow", 6e4),
    "kg/s": ("mass flow", 1.0),
    "kg/h": ("mass flow", 1.0 / 3600.0),
    "pct": ("ratio", 0.01),
    "1": ("ratio", 1.0),
}


@dataclass(frozen=True)
class Channel:
    """One column: its `name`, and the `quantity`, `place` and `unit` that the name says."""

    name: str
    quantity: str
    place: str
    unit: str

    @property
    def dimension(self) -> str:
        """The physical quantity of the unit: temperature, length, power, …"""
        return UNITS[self.unit][0]


def parse_channel(name: str) -> Channel:
    """Read quantity, place and unit off a column name.

    Raises
    ------
    UnitError
        Where the last part is no known unit (the message lists them), or where an absolute
        temperature is named as a difference (``dT_..._degC``) or the reverse (``T_..._K``).
    """
    head, _, unit = name.rpartition("_")
    if not head or unit not in UNITS:
        # Another spelling of the same unit; a near name of another one (degF, degC) misleads.
        spelt = {each.casefold(): each for each in (*UNITS, *_SYMBOLS.values())}
        own = {shown: name for name, shown in _SYMBOLS.items()}
        found = spelt.get(unit.casefold()) if head else None
        near = [own.get(found, found)] if found else []
        hint = f" (did you mean {head}_{near[0]}?)" if near else ""
        raise UnitError(
            f"{name}: unknown unit {unit!r}{hint}; a name is <quantity>_<place>_<unit> with one of "
            + ", ".join(UNITS)
        )
    quantity, _, place = head.partition("_")
    if quantity == "dT" and unit == "degC":
        raise UnitError(f"{name}: a difference of temperatures is in K, not degC")
    if quantity == "T" and unit in ("K", "mK"):
        raise UnitError(f"{name}: an absolute temperature is in degC; a difference is dT_..._K")
    return Channel(name, quantity, place, unit)


def parse_quantity(text: str) -> tuple[float, str | None]:
    """A number and its unit as they are typed: ``5um``, ``0.5 °C``; None where there is no unit.

    Raises
    ------
    UnitError
        No number, or an unknown unit (the message lists the known ones).
    """
    found = re.fullmatch(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S*)\s*", text)
    if found is None:
        raise UnitError(f"{text!r} is not a number with a unit, like 5um")
    value, unit = float(found[1]), found[2]
    unit = next((name for name, shown in _SYMBOLS.items() if shown == unit), unit)
    if unit and unit not in UNITS:
        raise UnitError(f"{text}: unknown unit {unit!r}; known: {', '.join(UNITS)}")
    return value, unit or None


def converted(value: float, unit: str, to: str) -> float | None:
    """A difference in another unit; None where the two do not go together.

    A difference of temperatures is the same in K and in degC.
    """
    (own, factor), (other, divisor) = UNITS[unit], UNITS[to]
    # "temperature difference" is one of temperatures
    if own.partition(" ")[0] != other.partition(" ")[0]:
        return None
    return value * factor / divisor


def amount_in(amount: float | str, unit: str) -> float:
    """An amount in a unit: a number counts in it, a text may have a unit of its own (``0.5um``).

    Parameters
    ----------
    amount : float or str
    unit : str

    Raises
    ------
    UnitError
        No amount, or of another quantity.
    """
    if not isinstance(amount, str):
        return amount
    value, own = parse_quantity(amount)
    found = value if own is None else converted(value, own, unit)
    if found is None:
        raise UnitError(f"{amount}: not a quantity of {symbol(unit)}")
    return found


def small_unit(channel: str) -> str:
    """The unit in which small moves of a channel are told: um, urad, else its own.

    Parameters
    ----------
    channel : str
    """
    own = parse_channel(channel)
    return {"length": "um", "angle": "urad"}.get(own.dimension, own.unit)


def hold_of(channel: str) -> Hold:
    """How a channel goes on between samples, by its quantity."""
    return "first" if parse_channel(channel).dimension in _CONTINUOUS else "zero"


# No temperature is below [degC].
ABSOLUTE_ZERO = -273.15
FAHRENHEIT = (5 / 9, -160 / 9)  # scale and offset of degF to degC


def is_temperature(channel: str) -> bool:
    """Whether a channel is a temperature or a difference of two.

    Parameters
    ----------
    channel : str
    """
    return parse_channel(channel).dimension.startswith("temperature")


def kelvins(channel: str) -> float:
    """A unit of a temperature channel in kelvin: 0.001 of one in mK.

    Parameters
    ----------
    channel : str
    """
    return UNITS[parse_channel(channel).unit][1] / UNITS["K"][1]


def is_absolute(channel: str) -> bool:
    """Whether a channel is a temperature, and no difference of two.

    Parameters
    ----------
    channel : str
    """
    return parse_channel(channel).dimension == "temperature"


def is_displacement(channel: str) -> bool:
    """Whether a channel is a length or an angle, which have no zero of their own."""
    return parse_channel(channel).dimension in _DISPLACEMENTS


def is_overdamped(drives: Sequence[str], output: str) -> bool:
    """Whether heat alone leads from drives to an output, so that nothing swings.

    Heats, temperatures and speeds drive a temperature or a displacement.

    Parameters
    ----------
    drives : sequence of str
    output : str
    """
    heating = all(parse_channel(name).dimension in _HEATING for name in drives)
    return heating and (is_temperature(output) or is_displacement(output))


def drive_reference(channel: str) -> Reference:
    """What counts as no drive: the first value of an absolute temperature, 0 of all else."""
    return "first" if is_absolute(channel) else 0.0


def counts_from_first(channel: str) -> bool:
    """Whether only changes of a channel mean anything: a displacement or absolute temperature."""
    return is_displacement(channel) or drive_reference(channel) == "first"


def source_rest(channel: str) -> Reference:
    """Where a channel adds nothing: a temperature and a displacement at first, all else at 0."""
    return "first" if is_temperature(channel) or is_displacement(channel) else 0.0


def clock_unit(names: Container[str]) -> str | None:
    """The unit of the clock among column names: of ``time_<unit>``, "iso" for ``time``, or None."""
    for unit, (dimension, _) in UNITS.items():
        if dimension == "time" and f"time_{unit}" in names:
            return unit
    return "iso" if "time" in names else None


def names(wanted: str | Sequence[str]) -> tuple[str, ...]:
    """Names of channels; a string is one name."""
    return (wanted,) if isinstance(wanted, str) else tuple(wanted)


def symbol(unit: str) -> str:
    """A unit as it is printed."""
    return _SYMBOLS.get(unit, unit)


def per(unit: str, by: str) -> str:
    """The unit of a gain: of one unit by another, either composed or not."""
    return f"{unit}/({by})" if "/" in by else f"{unit}/{by}"


def printed(unit: str) -> str:
    """A unit, composed or not, as it is printed: ``um/degC`` is µm/°C, ``um/1`` is µm."""
    if unit in UNITS or "/" not in unit:
        return "" if unit == "1" else symbol(unit)
    whole, _, by = (
        unit.removesuffix(")").partition("/(") if unit[-1] == ")" else (unit.rpartition("/"))
    )
    first, second = symbol(whole) if whole == "1" else printed(whole), printed(by)
    if not second:
        return printed(whole)
    return f"{first}/({second})" if "/" in second else f"{first}/{second}"
