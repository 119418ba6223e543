"""How the numbers, names and logs of a diagnosis are printed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thermaltool.units import hold_of, printed

Document = Mapping[str, Any]

# Fall of BIC from which a cause is called decisive: odds of 150.
DECISIVE_EVIDENCE = 10.0
# Below this a number is what rounding leaves of nothing; units are chosen so that none is so small.
ROUNDING = 1e-12
# No interval is told with more digits; beyond this an end of it is none.
MAX_DIGITS, ENDLESS = 6, 1e30
# Causes whose signatures are further apart do not look alike, though they may be as likely [deg].
MIN_ANGLE_OF_RIVALS = 45.0
# What a log is to a diagnosis, by its key in the JSON.
ROLES = {
    "logs": "diagnosed",
    "validated_on": "validation",
    "sound": "as the model came",
    "calibrated_on": "calibration",
}


def estimated(value: float, interval: Sequence[float] | None) -> list[str]:
    """A value and the ends of its interval, with as many digits as tell them apart.

    Parameters
    ----------
    value : float
    interval : (float, float), optional
    """
    told = [value, *(interval or ())]
    width = (interval[1] - interval[0]) / 2 if interval else 0.0
    largest = max(abs(each) for each in told)
    if not 0 < width < largest / 100 or not 1e-3 <= largest < 1e4:
        return [number(each) for each in told]
    digits = min(math.ceil(math.log10(largest / width)) + 1, MAX_DIGITS)
    return [f"{each:.{digits}g}" for each in told]


def number(value: float | None) -> str:
    """Three digits, all before the point; a dash for what is not there.

    Parameters
    ----------
    value : float or None
    """
    if value is None:
        return "–"
    if abs(value) < ROUNDING:
        return "0"
    if abs(value) > ENDLESS:
        return "∞" if value > 0 else "-∞"
    return f"{value:.0f}" if 1000 <= abs(value) < 1e6 else f"{value:.3g}"


def duration(seconds: float) -> str:
    """A time in the unit that suits it: ``30 min``.

    Parameters
    ----------
    seconds : float [s]
    """
    for unit, length in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.3g} {unit}"
    return f"{seconds:.3g} s"


def percent(share: float) -> str:
    """A share; never "100 %" or "0 %" for what is not whole or nothing.

    Parameters
    ----------
    share : float
    """
    if 0.0 < share < 0.01:
        return "< 1 %"
    return "> 99 %" if 0.99 < share < 1.0 else f"{100 * share:.0f} %"


def with_unit(text: str, unit: str) -> str:
    """A text and its printed unit, if it has one.

    Parameters
    ----------
    text, unit : str
    """
    return f"{text} {printed(unit)}".rstrip()


def condition_name(condition: Document) -> str:
    """``heating``, or ``U_V is at 9``.

    Parameters
    ----------
    condition : mapping
    """
    if condition["channel"] is None:
        return str(condition["name"])
    return f"{condition['channel']} is {condition['name']}"


def band_name(band: Document) -> str:
    """``slower than 30 min``.

    Parameters
    ----------
    band : mapping
    """
    low, high = band["shortest"], band["longest"]
    if high is None:
        return f"slower than {duration(low)}" if low else "of any period"
    return f"{duration(low)} to {duration(high)}" if low else f"faster than {duration(high)}"


def called(name: str, channel: str) -> str:
    """A cause and where it acts.

    Parameters
    ----------
    name, channel : str
    """
    return f"{name} ({channel})" if channel else name


def judged_on(document: Document) -> str:
    """On what the gains were measured.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    """
    return names_of(document["validated_on"] or document["logs"])


def kind_of(alternative: Document) -> str:
    """Kind of what is left open; ``rival`` where causes differ and have as much evidence.

    Parameters
    ----------
    alternative : mapping
    """
    kind, angle = alternative.get("kind", "indistinguishable"), alternative["angle_deg"]
    alike = kind != "indistinguishable" or angle is None or angle < MIN_ANGLE_OF_RIVALS
    return str(kind) if alike else "rival"


def these_logs(document: Document) -> str:
    """``this log``, or ``these logs``.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    """
    return "this log" if len(document["logs"]) == 1 else "these logs"


def follows(report: Document, channel: str) -> bool:
    """Whether the residual of an output follows a channel or its past beyond chance.

    Parameters
    ----------
    report : mapping
        Of the output.
    channel : str
    """
    return any(
        each["channel"] == channel and abs(each["correlation"]) > each["bound"]
        for each in report["dependences"]
    )


def relevant_conditions(document: Document, report: Document) -> list[Document]:
    """Conditions that may have to do with the misfit of an output.

    What the machine does, levels of drives and of what is commanded; thirds of a channel that is
    only measured where the residual follows it.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    report : mapping
        Of the output.
    """
    return [
        each
        for each in report["conditions"]
        if each["channel"] is None
        or each["channel"] in document["drives"]
        or hold_of(each["channel"]) == "zero"
        or follows(report, each["channel"])
    ]


def names_of(logs: Sequence[Document]) -> str:
    """Logs in a sentence: by name where they are one or two.

    Parameters
    ----------
    logs : sequence of mapping
        With their names.
    """
    names = [Path(log["name"]).name for log in logs]
    return " and ".join(names) if len(names) < 3 else f"{len(names)} logs"


def log_name(document: Document, digest: str) -> str:
    """Name of a log, or the beginning of its digest.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    digest : str
    """
    logs = (log for role in ("logs", "validated_on", "sound") for log in document[role])
    return next((Path(log["name"]).name for log in logs if log["sha256"] == digest), digest[:8])


def in_log(document: Document, report: Document) -> str:
    """`` in b.csv``: where a residual is, of several logs; empty for one.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    report : mapping
        Of an output.
    """
    return f" in {log_name(document, report['log'])}" if len(document["logs"]) > 1 else ""


@dataclass(frozen=True)
class ChainStep:
    """A written model on one output of several logs.

    Attributes
    ----------
    rmse, spread : float [unit of the output]
        As `simulate` counts, and with the zero of every log free.
    """

    rmse: float
    spread: float


def written_chains(document: Document) -> dict[str, list[ChainStep]]:
    """What the model that came in, and the written one cause after cause, are worth by output.

    Over the logs of `judged_on`; empty where there are no causes.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    """
    digests = {log["sha256"] for log in document["validated_on"] or document["logs"]}
    found: dict[str, list[ChainStep]] = {}
    rows = [row for row in document["written"] if row["log"] in digests and row["rows"]]
    for step in range(1 + len(document["causes"]) if document["causes"] else 0):
        own = [row for row in rows if row["step"] == step]
        for output in dict.fromkeys(row["output"] for row in own):
            here = [row for row in own if row["output"] == output]
            count = sum(row["rows"] for row in here)
            rms = [
                math.sqrt(sum(row["rows"] * row[key] ** 2 for row in here) / count)
                for key in ("rmse", "rmse_zero_free")
            ]
            found.setdefault(output, []).append(ChainStep(*rms))
    return found
