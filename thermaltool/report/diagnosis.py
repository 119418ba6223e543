"""What a diagnosis says, for people: its first lines, its tables, and the whole in Markdown.

All of it is read off the JSON document of a diagnosis.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from thermaltool.documents import write_whole
from thermaltool.report.diagnosis_advice import severity_sentence
from thermaltool.report.diagnosis_tables import sections
from thermaltool.report.diagnosis_words import (
    DECISIVE_EVIDENCE,
    ROLES,
    Document,
    band_name,
    called,
    condition_name,
    judged_on,
    names_of,
    number,
    percent,
    with_unit,
    written_chains,
)
from thermaltool.report.style import channel_unit, time_unit
from thermaltool.report.text import aligned

if TYPE_CHECKING:
    from thermaltool.record import Record

# A condition is told where it holds so much more of the misfit than of the time, a band where it
# holds this share of the misfit.
MIN_EXCESS, MIN_BAND_SHARE = 0.1, 0.5
# Causes that are told one by one.
MAX_CAUSES_TOLD = 3
GLOSSARY = """\
- *Noise* is the white noise of a reading, estimated on the same log. *Slow discrepancy* is what
  the model gets wrong without having a name: its size and how fast it changes.
- *Rest is white*: whether what noise and slow discrepancy leave is unpredictable.
  *Independent rows* say as much about a mean as all rows, whose errors follow each other.
- *Heating* and *cooling*: the output moves away from rest, or back to it.
- *Evidence* is the fall of BIC when the cause is added, under white noise plus a slow
  discrepancy, after a correction for the number of causes tried. From 4.6 (odds of 10) a cause is
  tried on unseen rows; above 10 (odds of 150) it is called decisive.
- *Gain* is what the cause takes off the residual, by the written models without it and with it,
  the zero of each log free, with its 95 % interval; one that includes zero is not claimed.
- *Detectable* is the RMS change of an output that this log would have shown.
"""


def main_output(document: Document) -> str | None:
    """The output with most of its residual above noise and the calibration's own error.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    """
    residuals = document["residuals"]
    return max(residuals, key=lambda name: residuals[name]["above_floor"], default=None)


# ---------------------------------------------------------------- the first lines


def summary(document: Document) -> list[str]:
    """A few sentences that need no explanation, the verdict first.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    """
    lines = [_verdict(document)]
    output = main_output(document)
    if output is not None and not document["adequate"]:
        lines += _where(document["residuals"][output], output)
    causes = document["causes"]
    if [cause for cause in causes if cause["location"] is None]:
        for cause in causes[:MAX_CAUSES_TOLD]:
            lines += [_cause(document, cause, len(causes)), *_advice(document, cause)]
        if len(causes) > MAX_CAUSES_TOLD:
            rest = causes[MAX_CAUSES_TOLD:]
            more = ", ".join(called(cause["name"], cause["channel"]) for cause in rest)
            lines.append(f"Further causes: {more}.")
        lines += [*_worth(document), *_spoiled(document)]
    else:
        for cause in causes:
            lines += [_cause(document, cause, 1), *_advice(document, cause)]
        lines += _no_cause(document)
    return [*lines, *_unknown(document)]


def _verdict(document: Document) -> str:
    share, verdict = document["noise_share"], document["verdict"]
    line = f"The model is {verdict} for {names_of(document['logs'])}"
    if verdict == "cannot judge":
        line = f"The model cannot be judged by {names_of(document['logs'])}"
    output = main_output(document)
    if output is None:
        return f"{line}."
    report = document["residuals"][output]
    unit = channel_unit(output)
    how = "only " if verdict != "adequate" and share < 0.5 else ""
    return (
        f"{line}: {how}{percent(share)} of the residual's power in {output} is sensor "
        f"noise or what the calibration itself left (residual {number(report['spread'])} {unit} "
        f"RMS, noise {number(report['noise']['white'])} {unit}"
        + (f", calibration {number(report['floor'])} {unit})." if report["floor"] else ").")
    )


def _where(report: Document, output: str) -> Iterator[str]:
    """When it is wrong, and how slowly."""
    line, stretch = "It is wrong in every condition alike", report["worst"]
    if report["conditions"]:
        # What the machine does says more to a reader than the level of a channel.
        worst = max(
            report["conditions"],
            key=lambda c: c["power"] - c["time"] + (c["channel"] is None) * MIN_EXCESS / 2,
        )
        if worst["power"] - worst["time"] > MIN_EXCESS:
            excess = (
                f"{percent(worst['power'])} of the misfit in {percent(worst['time'])} of the time"
            )
            line = f"It is wrong mostly while {condition_name(worst)} ({excess})"
    bands = [band for band in report["bands"] if band["power"] > MIN_BAND_SHARE]
    if bands:
        line += f", {percent(bands[0]['power'])} of it {band_name(bands[0])}"
    if stretch is not None and stretch["time"] < 1 - MIN_EXCESS:
        unit, length = time_unit(stretch["stop"])
        start, stop = (f"{stretch[end] / length:.3g}" for end in ("start", "stop"))
        rms = f"{number(stretch['rms'])} {channel_unit(output)}"
        line += f"; worst from {start} to {stop} {unit} ({rms} RMS)"
    yield f"{line}."


def _cause(document: Document, cause: Document, count: int) -> str:
    number_of = f" {document['causes'].index(cause) + 1} of {count}" if count > 1 else ""
    if cause["location"] is not None:
        name = called(cause["name"], cause["channel"])
        return f"Cause{number_of}: {name}, {_place(document, cause)}."
    values = [_parameter(name, each) for name, each in cause["parameters"].items()]
    where = f", in {_log_name(document, cause['log'])} alone" if cause["log"] else ""
    parameters = f": {', '.join(values)}" if values else ""
    return (
        f"Cause{number_of}: {called(cause['name'], cause['channel'])}, "
        f"{cause['explanation'].partition(':')[0]}{where}{parameters}; "
        f"evidence {number(cause['evidence'])}{_weight(cause['evidence'])}."
    )


def _advice(document: Document, cause: Document) -> Iterator[str]:
    """How severe a cause is, and what to do about it."""
    if severe := severity_sentence(document, cause):
        yield severe
    if cause["action"]:
        yield f"To do: {cause['action']}."


def _place(document: Document, cause: Document) -> str:
    """What an unknown cause is known by."""
    place = cause["location"]
    unit, length = time_unit(place["stop"])
    start, stop = (f"{place[end] / length:.3g}" for end in ("start", "stop"))
    line = f"{cause['explanation']}: {number(place['rms'])} {channel_unit(place['output'])} RMS"
    if place["condition"]:
        line += f", mostly while {place['condition']}"
    line += f", most from {start} to {stop} {unit}"
    if len(document["logs"]) > 1:
        line += f" of {_log_name(document, place['log'])}"
    band = {key: place[key] for key in ("shortest", "longest")}
    return f"{line}, {band_name(band)}; evidence {number(cause['evidence'])}"


def _weight(evidence: float) -> str:
    return " (decisive)" if evidence >= DECISIVE_EVIDENCE else ""


def _log_name(document: Document, digest: str) -> str:
    return next((Path(log["name"]).name for log in document["logs"] if log["sha256"] == digest),
                digest[:8])  # fmt: skip


def _parameter(name: str, each: Document) -> str:
    value, unit = number(each["value"]), each["unit"]
    if each["interval"] is None:
        return f"{name} {with_unit(value, unit)}"
    low, high = (number(end) for end in each["interval"])
    return f"{name} {with_unit(f'{value} ({low} to {high})', unit)}"


def _worth(document: Document) -> Iterator[str]:
    """What the written model is worth on the output that it does most for, cause after cause."""
    chains = {
        output: steps
        for output, steps in written_chains(document).items()
        if steps[-1] != steps[0] and steps[0].spread
    }
    if not chains:
        return
    best = min(chains, key=lambda output: chains[output][-1].spread / chains[output][0].spread)
    unit, steps = channel_unit(best), chains[best]
    free = " to ".join(number(step.spread) for step in steps)
    counted = " to ".join(number(step.rmse) for step in steps)
    sure = any(cause["gain"].get(best, {}).get("claimed") for cause in document["causes"])
    line = (
        f"On {judged_on(document)}, the written model takes the residual of {best} from {free} "
        f"{unit} RMS, the zero of each log free"
    )
    if counted != free:
        line += f" ({counted} {unit} as simulate counts)"
    held = [each for c in document["causes"] if (each := c["held_out"].get(best))]
    if held and not document["validated_on"]:
        ends = f"{number(held[0]['rms_before'])} to {number(held[-1]['rms_after'])}"
        line += f"; these rows it has seen, held out in turn they go from {ends}"
    yield f"{line}{'.' if sure else '; the gain is not sure.'}"


def _spoiled(document: Document) -> Iterator[str]:
    if document["spoiled"]:
        yield (
            f"The extended model is worse than the one that came in for {document['spoiled']}: "
            "it is not to be used."
        )


def _no_cause(document: Document) -> Iterator[str]:
    tried = document["tried"]
    yield from (f"{each}." for each in document["undecided"])
    if document["verdict"] == "not adequate":
        if not document["causes"]:
            yield "Cause: none in the catalogue explains it."
        if tried:
            best = tried[0]
            held = best["verdict"] == "evidence"
            yield (
                f"The nearest in the catalogue is {called(best['name'], best['channel'])} "
                f"(evidence {number(best['evidence'])}, {DECISIVE_EVIDENCE:g} is decisive"
                f"{', but it does not help on unseen rows' if held else ''})."
            )
    elif tried:
        names = {each["name"] for each in tried}
        suspected = any(each.get("kind") == "suspected" for each in document["alternatives"])
        adds = "is sure" if suspected else "adds anything"
        yield f"No effect found: {len(names)} causes were tried and none {adds}."


def _unknown(document: Document) -> Iterator[str]:
    # The first of either kind: what looks alike, and what cannot be seen.
    first_of_kind: dict[str | None, Document] = {}
    for each in document["alternatives"]:
        first_of_kind.setdefault(each.get("kind"), each)
    for each in first_of_kind.values():
        first, *rest = [
            called(name, channel)
            for name, channel in zip(each["names"], each["channels"], strict=True)
        ]
        if each.get("kind") == "invisible":
            names = ", ".join([first, *rest])
            line = (
                f"Not known: this log cannot show {names}, which look like the model's own response"
            )
            aim = "to show them"
        elif each.get("kind") == "suspected":
            line = f"Not sure: what is left may be {' or '.join([first, *rest])}"
            aim = "to find out"
        else:
            line = f"Not known: {first} cannot be told from {' or '.join(rest)} in this log"
            aim = "to tell them apart"
        if each["separating_experiment"]:
            line += f"; {aim}: {each['separating_experiment']}"
        yield f"{line}."
    blind = dict.fromkeys(t["name"] for t in document["tried"] if t["verdict"] == "cannot be seen")
    if blind and not document["causes"] and "invisible" not in first_of_kind:
        yield f"Not known: this log cannot show {', '.join(blind)}."
    for note in document["notes"]:
        yield f"Note: {note}."


def short_form(document: Document) -> str:
    """The first lines and the tables that belong to them, as plain text.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    """
    parts = summary(document)
    for section in sections(document):
        if section.short:
            parts += [f"\n{section.title}", aligned(section.rows)]
    return "\n".join(parts)


# ---------------------------------------------------------------- Markdown


def write_report(
    path: str,
    document: Document,
    curves: Sequence[tuple[str, Record]],
    check: Callable[[str], None] = lambda target: None,
) -> None:
    """Write the report in Markdown, its figures beside it as PNG.

    Parameters
    ----------
    path : str
    document : mapping
        The diagnosis as JSON.
    curves : sequence of (output, Record)
        See `thermaltool.report.diagnosis_figures.pictures`.
    check : callable
        Takes the file of each figure before it is written, and may refuse it.
    """
    from thermaltool.report.diagnosis_figures import pictures

    # Figures first: the report appears when what it shows is there.
    figures = []
    for picture in pictures(curves, document):
        target = f"{os.path.splitext(path)[0]}_{picture.name}.png"
        check(target)
        write_whole(picture.png, target)
        figures.append((os.path.basename(target), picture.what))
    write_whole(to_markdown(document, figures).encode(), path)


def to_markdown(document: Document, figures: Sequence[tuple[str, str]]) -> str:
    """The whole report.

    Parameters
    ----------
    figures : sequence of (str, str)
        File relative to the report, and what it shows.
    """
    lines = [f"# {document['model']} on {names_of(document['logs'])}", ""]
    for sentence in summary(document):
        lines += [_escaped(sentence), ""]
    for file, what in figures:
        lines += [f"![{what}](<{file}>)", ""]
    for section in sections(document):
        lines += [f"## {section.title}", "", *_markdown_table(section.rows), ""]
    lines += ["## Words", "", GLOSSARY.rstrip(), ""]
    lines += ["## Inputs", ""]
    for key, role in ROLES.items():
        lines += [f"- {role}: `{log['name']}`, SHA-256 `{log['sha256']}`" for log in document[key]]
    return "\n".join(lines) + "\n"


def _markdown_table(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    heading, *body = rows
    yield _row(heading)
    yield _row(["---"] * len(heading))
    yield from map(_row, body)


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(_escaped(cell).replace('|', chr(92) + '|') for cell in cells)} |"


def _escaped(text: str) -> str:
    """Underscores and stars of channel names as they stand."""
    return text.replace("_", "\\_").replace("*", "\\*").replace("<", "&lt;")
