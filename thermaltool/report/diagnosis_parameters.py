"""Parameters of a cause in a sentence; the table of the causes has every one of them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from thermaltool.effects.instant import INSTANTS
from thermaltool.report.diagnosis_advice import moved_first
from thermaltool.report.diagnosis_words import (
    Document,
    duration,
    estimated,
    number,
    with_unit,
)
from thermaltool.report.text import listed
from thermaltool.units import parse_channel

# Numbers of several outputs that a sentence holds at most, those of the outputs moved most first.
MAX_OUTPUTS = 3
# Gains of a loss of heat at one place, behind the fast, a middle and the slowest lag.
LAGS = ("fast", "middle", "slow")


def parameter_sentence(document: Document, cause: Document) -> str:
    """``gain[d_z_um] 0.6 (0.59 to 0.63) µm/°C, time_constant 840 (800 to 880) s``

    Of a loss of heat at one place what it does to each output in the long run, and how soon; of a
    changed one how many times as fast.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    cause : mapping
        One of its causes.
    """
    parameters = _from_the_first_row(document, cause)
    outputs = _outputs(parameters, moved_first(document, cause))
    if any(name.startswith("middle[") for name in parameters):
        return _loss(cause, parameters, outputs)
    if {"factor", "time_constant"} <= parameters.keys():
        return _changed(parameters)
    told = outputs[:MAX_OUTPUTS]
    names = [n for output in told for n in parameters if _output(n) == output]
    names += [name for name in parameters if _output(name) is None]
    values = [_told(name, parameters[name]) for name in names]
    if outputs[MAX_OUTPUTS:]:
        values.append(f"less of {', '.join(outputs[MAX_OUTPUTS:])} (below)")
    return ", ".join(values)


def _changed(parameters: Mapping[str, Document]) -> str:
    """How fast heat is lost now; by what modes mix besides is below."""
    factor, before = (parameters[name]["value"] for name in ("factor", "time_constant"))
    return (
        f"about {factor:.2g} times as fast, a time constant of {duration(before)} is about "
        f"{duration(before / factor)} now"
    )


def _loss(cause: Document, parameters: Mapping[str, Document], outputs: Sequence[str]) -> str:
    """What each output moves by in the long run, and the lag that most of it goes through."""
    short, long = (parameters[name]["value"] for name in ("time_constant", "slowest"))
    lags = dict(zip(LAGS, (short, (short * long) ** 0.5, long), strict=True))
    said: list[str] = []
    for output in outputs[:MAX_OUTPUTS]:
        gains = {lag: parameters[f"{lag}[{output}]"]["value"] for lag in LAGS}
        most = max(gains, key=lambda lag: abs(gains[lag]))
        moved = with_unit(number(sum(gains.values())), parse_channel(output).unit)
        through = "" if said else "mostly through a lag of "
        said.append(f"{output} by {moved} ({through}{duration(lags[most])})")
    if rest := outputs[MAX_OUTPUTS:]:
        said.append(f"others ({', '.join(rest)}) by what is below")
    known = {"time_constant", "slowest"}
    further = [n for n in parameters if _output(n) is None and n not in known]
    place = cause["partner"] or "the place"
    line = f"each degree that {place} is warm moves in the long run {listed(said)}"
    return ", ".join([*(_told(name, parameters[name]) for name in further), line])


def _from_the_first_row(document: Document, cause: Document) -> dict[str, Document]:
    """The parameters; instants of a log count from its first row, not by its clock."""
    begins = {log["sha256"]: log.get("begins_s", 0.0) for log in document["logs"]}
    since = begins.get(cause["log"], 0.0)

    def told(name: str, each: Document) -> Document:
        if name not in INSTANTS or not since:
            return each
        interval = each["interval"] and [end - since for end in each["interval"]]
        return {**each, "value": each["value"] - since, "interval": interval}

    return {name: told(name, each) for name, each in cause["parameters"].items()}


def _outputs(parameters: Mapping[str, Document], moved: Sequence[str]) -> list[str]:
    """Outputs that have parameters of their own, those that are moved most first."""
    named = dict.fromkeys(o for name in parameters if (o := _output(name)) is not None)
    return [o for o in moved if o in named] + [o for o in named if o not in moved]


def _output(name: str) -> str | None:
    """The output that a parameter is of: ``gain[d_z_um]``."""
    found = re.fullmatch(r"\w+\[(.+)\]", name)
    return None if found is None else found[1]


def _told(name: str, each: Document) -> str:
    value, *ends = estimated(each["value"], each["interval"])
    told = f"{value} ({' to '.join(ends)})" if ends else value
    return f"{name} {with_unit(told, each['unit'])}"
