"""Units as other programs write them, and what makes them units of this one."""

from __future__ import annotations

import re

from thermaltool.units import FAHRENHEIT, UNITS

# Spelling, in lower case and without blanks, -> (unit of a name, scale, offset).
SPELLINGS: dict[str, tuple[str, float, float]] = {
    **dict.fromkeys(
        ("°c", "degc", "c", "celsius", "deg_c", "deg.c", "grdc", "grad", "℃"), ("degC", 1.0, 0.0)
    ),
    **dict.fromkeys(
        ("°f", "degf", "f", "fahrenheit", "deg_f", "deg.f", "℉"), ("degC", *FAHRENHEIT)
    ),
    **dict.fromkeys(("kelvin", "degk", "k_abs"), ("degC", 1.0, -273.15)),
    **dict.fromkeys(("µm", "μm", "micron", "microns", "mikrometer"), ("um", 1.0, 0.0)),
    **dict.fromkeys(("in", "inch", "inches"), ("um", 25400.0, 0.0)),
    "mil": ("um", 25.4, 0.0),
    "cm": ("um", 1e4, 0.0),
    **dict.fromkeys(("millimeter", "millimetre"), ("mm", 1.0, 0.0)),
    **dict.fromkeys(("µrad", "μrad"), ("urad", 1.0, 0.0)),
    "mrad": ("urad", 1e3, 0.0),
    **dict.fromkeys(("arcsec", '"'), ("urad", 4.84813681109536, 0.0)),
    **dict.fromkeys(("1/min", "u/min", "r/min", "min-1", "min^-1", "rev/min"), ("rpm", 1.0, 0.0)),
    **dict.fromkeys(("mmpm", "mm/minute"), ("mm/min", 1.0, 0.0)),
    **dict.fromkeys(("in/min", "ipm", "inch/min"), ("mm/min", 25.4, 0.0)),
    **dict.fromkeys(("n·m", "n⋅m", "n*m", "n.m", "n-m"), ("Nm", 1.0, 0.0)),
    **dict.fromkeys(("watt", "watts"), ("W", 1.0, 0.0)),
    **dict.fromkeys(("volt", "volts"), ("V", 1.0, 0.0)),
    **dict.fromkeys(("amp", "amps", "ampere", "amperes"), ("A", 1.0, 0.0)),
    "ma": ("A", 1e-3, 0.0),
    **dict.fromkeys(("%", "percent", "prozent"), ("pct", 1.0, 0.0)),
    **dict.fromkeys(("w/m²", "w/m^2"), ("W/m2", 1.0, 0.0)),
    **dict.fromkeys(("lpm", "l/minute"), ("l/min", 1.0, 0.0)),
    "psi": ("bar", 0.0689475729, 0.0),
    **dict.fromkeys(("m³/h", "m^3/h"), ("m3/h", 1.0, 0.0)),
    "kn": ("N", 1e3, 0.0),
    **dict.fromkeys(("µs", "μs"), ("us", 1.0, 0.0)),
    **dict.fromkeys(("sec", "secs", "second", "seconds", "sek", "sekunden"), ("s", 1.0, 0.0)),
    **dict.fromkeys(("minute", "minutes", "minuten"), ("min", 1.0, 0.0)),
    **dict.fromkeys(("hour", "hours", "stunden", "hr", "hrs"), ("h", 1.0, 0.0)),
    **dict.fromkeys(("day", "days", "tage"), ("d", 1.0, 0.0)),
    "msec": ("ms", 1.0, 0.0),
}
# Of letters that mean another unit in the other case: mW and MW, A and a.
_BY_LOWER = {unit.lower(): unit for unit in UNITS if unit not in ("m", "mW", "MPa")}


def known_unit(text: str) -> tuple[str, float, float] | None:
    """A unit as another program writes it: unit of a name, scale and offset; None if unknown.

    Parameters
    ----------
    text : str
        ``°F``, ``W/m²``, ``U/min``, or a unit of this program.
    """
    word = re.sub(r"\s", "", text)
    if word in UNITS and word != "K":
        return word, 1.0, 0.0
    if word == "K":
        return "K", 1.0, 0.0
    if word.lower() in SPELLINGS:
        return SPELLINGS[word.lower()]
    unit = _BY_LOWER.get(word.lower())
    return None if unit is None else (unit, 1.0, 0.0)


def to_unit(text: str, wanted: str) -> tuple[float, float] | None:
    """Scale and offset from a written unit to a unit of names; None where they do not go together.

    A temperature in K becomes one in degC by its zero; a difference in degC or degF one in K.
    """
    found = known_unit(text)
    if found is None:
        return None
    unit, scale, offset = found
    (own, factor), (other, divisor) = UNITS[unit], UNITS[wanted]
    if own == other:
        return scale * factor / divisor, offset
    if (own, other) == ("temperature", "temperature difference"):
        return scale / divisor, 0.0
    if (own, other) == ("temperature difference", "temperature"):
        return scale * factor, -273.15
    return None
