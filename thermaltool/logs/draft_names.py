"""Guesses of what foreign columns are: quantity, place and unit from a name and its values."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass

import numpy as np

from thermaltool.logs.foreign_units import known_unit
from thermaltool.record import Array
from thermaltool.units import UNITS

# Symbol of a quantity in a name, by the dimension of its unit.
SYMBOLS = {
    "temperature": "T",
    "temperature difference": "dT",
    "power": "Q",
    "heat flux": "q",
    "length": "d",
    "angle": "phi",
    "speed": "n",
    "velocity": "v",
    "torque": "M",
    "voltage": "U",
    "current": "I",
    "force": "F",
    "frequency": "f",
    "pressure": "p",
    "flow": "V",
    "mass flow": "m",
    "ratio": "Q",
    "thermal resistance": "R",
    "heat capacity": "C",
}
# Words of names, English and German, and the unit that is likely.
WORDS = (
    (r"temp\w*|thermo\w*|tc\d*|pt100\w*|bed|chamber|hotend|extruder|nozzle|ambient|raumluft",
     "degC"),
    (r"rpm|speed|drehzahl|spindle_?speed", "rpm"),
    (r"pwm|duty|powers|load|last", "1"),
    (r"power|leistung|heat|watt\w*", "W"),
    (r"disp\w*|displacement|weg\w*|probe\w*|dial\w*|gauge|taster|eddy\w*|drift|growth|offset|"
     r"verlagerung|dehnung", "um"),
    (r"volt\w*|spannung|voltage", "V"),
    (r"current|strom|amp\w*", "A"),
    (r"flow|durchfluss", "l/min"),
    (r"pressure|druck", "bar"),
)  # fmt: skip
# Values that a temperature of a machine may have [degC], those without a word for it by far fewer.
TEMPERATURES = (-60.0, 450.0)
USUAL_TEMPERATURES = (5.0, 150.0)
USUAL_FAHRENHEIT = (41.0, 302.0)  # where a name ends in _F: beyond, it is a force
# A K of a value above this is no difference of temperatures [K].
ABSOLUTE_KELVIN = 200.0
# Unit and the words around it in a name: "T1 [°C]", "Temp (degF)", "Weg / mm", "Weg in mm".
_BRACKETED = re.compile(r"\s*[\[(<{]\s*([^\])>}]*)\s*[\])>}]\s*$")
_BEHIND = re.compile(r"(?:\s*/\s*|\s+in\s+|\s+|_)([^\s_/]+(?:/[^\s_/]+)?)$")
_LETTERS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "Ä": "Ae", "Ö": "Oe",
                          "Ü": "Ue", "°": "", "µ": "u", "μ": "u"})  # fmt: skip


@dataclass(frozen=True)
class Guess:
    """A name, the written unit where it is another one than that of the name, and the reason.

    Without a name the column is left out.
    """

    name: str | None
    unit: str | None
    reason: str


def guess_channel(foreign: str, unit: str, values: Array) -> Guess:
    """What a column is.

    Parameters
    ----------
    foreign : str
        Its name.
    unit : str
        The unit that the file has for it; empty where it has none.
    values : ndarray, shape (n,)
        NaN where missing.
    """
    present = values[np.isfinite(values)]
    if not present.size:
        return Guess(None, None, "left out: no numbers")
    low, high = float(present.min()), float(present.max())
    span = f"values {low:g} to {high:g}"
    head, written = _split_unit(foreign, unit)
    usual = USUAL_FAHRENHEIT[0] <= low <= high <= USUAL_FAHRENHEIT[1]
    if foreign.endswith("_F") and not unit and not usual:
        head, written = foreign, ""
    if written and (found := known_unit(written)) is not None and UNITS[found[0]][0] != "time":
        own = found[0]
        if own == "K" and high > ABSOLUTE_KELVIN:
            return Guess(_name("degC", head), written, f"{written} by its name, {span}: absolute")
        differs = found != (own, 1.0, 0.0)
        said = written if differs else None
        return Guess(_name(own, head), said, f"{own if not differs else written}: {span}")
    # Of "heater_bed.pwm" the key says what it is, of "bed.value" the object.
    last = foreign.rpartition(".")[2]
    for part, words, likely in [(part, *each) for part in (last, foreign) for each in WORDS]:
        if not re.search(rf"(?:^|[\W_\d])(?:{words})(?:$|[\W_\d])", part, re.IGNORECASE):
            continue
        if likely == "degC" and not TEMPERATURES[0] <= low <= high <= TEMPERATURES[1]:
            continue
        guessed = "pct" if likely == "1" and high > 1.5 else likely
        return Guess(_name(guessed, head), None, f"guessed: {guessed} from its name and {span}")
    fraction = np.any(present != np.round(present))
    letter = re.match(r"[Tt](?:[\W_]|\d|$)|.*_t$", foreign)
    if USUAL_TEMPERATURES[0] <= low < high <= USUAL_TEMPERATURES[1] and (fraction or letter):
        return Guess(_name("degC", head), None, f"guessed: degC from the {span}")
    return Guess(None, None, f"not guessed, {span}: left out until it has a name with its unit")


def _split_unit(foreign: str, unit: str) -> tuple[str, str]:
    """A name without its unit, and that unit; the file's own unit counts first."""
    for pattern in (_BRACKETED, _BEHIND):
        found = pattern.search(foreign)
        if found is None:
            continue
        word = found[1].strip()
        # A letter behind a blank may be an axis: "Probe C", "Motor A".
        certain = pattern is _BRACKETED or len(word) > 1 or "/" in found[0]
        certain |= found[0] in ("_C", "_F", "_K", "_V", "_W")
        if certain and known_unit(word) is not None:
            return foreign[: found.start()], unit or word
    return foreign, unit


def _name(unit: str, head: str) -> str:
    """``<quantity>_<place>_<unit>`` with the words of a foreign name as its place."""
    symbol = SYMBOLS[UNITS[unit][0]]
    plain = unicodedata.normalize("NFKD", head.translate(_LETTERS))
    place = "_".join(re.findall(r"[A-Za-z0-9]+", plain.encode("ascii", "ignore").decode()))
    if f"{place}_".lower().startswith(f"{symbol}_".lower()):
        place = place[len(symbol) + 1 :]
    return f"{symbol}_{place}_{unit}" if place else f"{symbol}_{unit}"


def distinct(name: str, taken: set[str]) -> str:
    """The name, or with a number where it is taken."""
    head, _, unit = name.rpartition("_")
    candidate, k = name, 2
    while candidate in taken:
        candidate, k = f"{head}_{k}_{unit}", k + 1
    taken.add(candidate)
    return candidate
