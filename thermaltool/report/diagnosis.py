"""What a diagnosis says, for people: its first lines, and its tables in short.

All of it is read off the JSON document of a diagnosis.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from thermaltool.report.clock_axis import time_unit
from thermaltool.report.diagnosis_advice import (
    ruled_out_sentence,
    severity_sentence,
)
from thermaltool.report.diagnosis_parameters import parameter_sentence
from thermaltool.report.diagnosis_tables import sections
from thermaltool.report.diagnosis_verdict import output_of_verdict, verdict_sentence
from thermaltool.report.diagnosis_words import (
    DECISIVE_EVIDENCE,
    ChainStep,
    Document,
    band_name,
    called,
    condition_name,
    judged_on,
    kind_of,
    log_name,
    names_of,
    number,
    percent,
    relevant_conditions,
    these_logs,
    written_chains,
)
from thermaltool.report.style import channel_unit
from thermaltool.report.text import aligned

# A condition is told where it holds so much more of the misfit than of the time, a band where it
# holds this share of the misfit.
MIN_EXCESS, MIN_BAND_SHARE = 0.1, 0.5
# Causes that are told one by one.
MAX_CAUSES_TOLD = 3


# ---------------------------------------------------------------- the first lines


def summary(document: Document) -> list[str]:
    """A few sentences that need no explanation, the verdict first.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    """
    lines = [verdict_sentence(document)]
    output = output_of_verdict(document)
    wrong = not document["adequate"] and not document["rests"]
    if wrong and output is not None and output in document["residuals"]:
        lines += _where(document, output)
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
    lines += filter(None, [ruled_out_sentence(document)])
    return [*lines, *_unknown(document)]


def _where(document: Document, output: str) -> Iterator[str]:
    """When it is wrong, and how slowly."""
    report = document["residuals"][output]
    conditions = relevant_conditions(document, report)
    line, stretch = "It is wrong in every condition alike", report["worst"]
    if conditions:
        # What the machine does says more to a reader than the level of a channel.
        worst = max(
            conditions,
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
        # More than all rows have about their mean counts from elsewhere.
        aside = stretch["time"] * stretch["rms"] ** 2 > report["spread"] ** 2
        beside = " from the level at which the log begins" if aside else ""
        line += f"; worst from {start} to {stop} {unit} ({rms} RMS{beside})"
    yield f"{line}."


def _cause(document: Document, cause: Document, count: int) -> str:
    number_of = f" {document['causes'].index(cause) + 1} of {count}" if count > 1 else ""
    if cause["location"] is not None:
        name = called(cause["name"], cause["channel"])
        return f"Cause{number_of}: {name}, {_place(document, cause)}."
    where = _in_one_log(document, cause) if cause["log"] else ""
    values = parameter_sentence(document, cause)
    parameters = f": {values}" if values else ""
    return (
        f"Cause{number_of}: {called(cause['name'], cause['channel'])}, "
        f"{cause['explanation'].partition(':')[0]}{where}{parameters}; "
        f"evidence {number(cause['evidence'])}{_weight(cause['evidence'])}."
    )


def _in_one_log(document: Document, cause: Document) -> str:
    """In which log it happened, and in which others it lasts or happens again."""
    own, elsewhere = log_name(document, cause["log"]), cause["elsewhere"]
    if not elsewhere:
        return f", in {own} alone"
    where = [f", in {own}"]
    if lasting := [each for each in elsewhere if each["time"] is None]:
        where.append(f"and lasts: {_logs_named(document, lasting)} has it from the first row on")
    where += [
        f"and again in {log_name(document, each['log'])}, about {_into(each['time'])} into it"
        for each in elsewhere
        if each["time"] is not None
    ]
    return " ".join(where)


def _into(seconds: float) -> str:
    unit, length = time_unit(seconds)
    return f"{seconds / length:.3g} {unit}"


def _logs_named(document: Document, logs: Sequence[Document]) -> str:
    return " and ".join(log_name(document, each["log"]) for each in logs)


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
        line += f" of {log_name(document, place['log'])}"
    band = {key: place[key] for key in ("shortest", "longest")}
    return f"{line}, {band_name(band)}; evidence {number(cause['evidence'])}"


def _weight(evidence: float) -> str:
    return " (decisive)" if evidence >= DECISIVE_EVIDENCE else ""


def _worth(document: Document) -> Iterator[str]:
    """What the written model is worth on the output that it does most for, cause after cause."""
    named = [c for c in document["causes"] if c["location"] is None]
    outliers = [c for c in named if c["name"] == "outliers"]
    for gain in (c["gain"] for c in outliers if c["gain"]):
        output = min(gain, key=lambda o: gain[o]["rms_after"] / (gain[o]["rms_before"] or 1.0))
        before, after = (number(gain[output][key]) for key in ("rms_before", "rms_after"))
        yield (
            f"Without these readings the residual of {output} is {after} "
            f"{channel_unit(output)} RMS, not {before}."
        )
    # Outliers are in all that is written: then the gains beside them count.
    chains = _chains_without(named) if outliers else written_chains(document)
    chains = {o: steps for o, steps in chains.items() if steps[-1] != steps[0] and steps[0].spread}
    if not chains:
        if document["validated_on"] and any(cause["log"] for cause in named):
            where = names_of(document["logs"])
            lasting = any(cause["elsewhere"] for cause in named)
            ends = (
                f"what is written of it acts in {where} alone; calibrate anew, or diagnose both"
                if lasting
                else f"it belongs to {where} alone"
            )
            yield f"On {judged_on(document)} it changes nothing: {ends}."
        return
    best = min(chains, key=lambda output: chains[output][-1].spread / chains[output][0].spread)
    unit, steps = channel_unit(best), chains[best]
    # A cause that is no part of a model changes nothing.
    steps = [step for k, step in enumerate(steps) if not k or step != steps[k - 1]]
    free = " to ".join(number(step.spread) for step in steps)
    counted = " to ".join(number(step.rmse) for step in steps)
    sure = any(cause["gain"].get(best, {}).get("claimed") for cause in named)
    takes = "the extended model would take" if document["spoiled"] else "the written model takes"
    line = (
        f"On {judged_on(document)}{', they left out' if outliers else ''}, {takes} the residual of "
        f"{best} from {free} {unit} RMS, the zero of each log free"
    )
    if counted != free:
        line += f" ({counted} {unit} as simulate counts)"
    held = [each for c in named if (each := c["held_out"].get(best))]
    if held and not document["validated_on"]:
        ends = f"{number(held[0]['rms_before'])} to {number(held[-1]['rms_after'])}"
        line += f"; these rows it has seen, held out in turn they go from {ends}"
    yield f"{line}{'.' if sure else '; the gain is not sure.'}"


def _chains_without(named: Sequence[Document]) -> dict[str, list[ChainStep]]:
    """The chain of gains of the causes beside outliers, these left out; zeros free."""
    found: dict[str, list[ChainStep]] = {}
    for cause in named:
        if cause["name"] == "outliers":
            continue
        for output, gain in cause["gain"].items():
            if output not in found:
                found[output] = [ChainStep(gain["rms_before"], gain["rms_before"])]
            found[output].append(ChainStep(gain["rms_after"], gain["rms_after"]))
    return found


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
        # What is suspected is told below.
        if tried and not _suspected(document):
            best = tried[0]
            held = best["verdict"] == "evidence"
            yield (
                f"The nearest in the catalogue is {called(best['name'], best['channel'])} "
                f"(evidence {number(best['evidence'])}, {DECISIVE_EVIDENCE:g} is decisive"
                f"{', but it does not help on unseen rows' if held else ''})."
            )
    elif tried:
        # A cause in another channel is another cause, as among those that are ruled out.
        causes = {(each["name"], each["channel"]) for each in tried}
        adds = "is sure" if _suspected(document) else "adds anything"
        alone = next((each for each in tried if each["verdict"] == "evidence"), None)
        if alone is not None:
            adds = (
                f"stands ({called(alone['name'], alone['channel'])} has evidence of "
                f"{number(alone['evidence'])} alone, and none beside the start or on unseen rows)"
            )
        yield f"No effect found: {len(causes)} causes were tried and none {adds}."


def _suspected(document: Document) -> bool:
    return any(each.get("kind") == "suspected" for each in document["alternatives"])


def _unknown(document: Document) -> Iterator[str]:
    # The first of either kind: what looks alike, and what cannot be seen.
    first_of_kind: dict[str, Document] = {}
    for each in document["alternatives"]:
        first_of_kind.setdefault(kind_of(each), each)
    these = these_logs(document)
    for kind, each in first_of_kind.items():
        first, *rest = [
            called(name, channel)
            for name, channel in zip(each["names"], each["channels"], strict=True)
        ]
        if kind == "invisible":
            looks = "which look" if rest else "which looks"
            names = ", ".join([first, *rest])
            line = f"Not known: {these} cannot show {names}, {looks} like the model's own response"
            aim = "to show them"
        elif kind == "suspected":
            line = f"Not sure: what is left may be {' or '.join([first, *rest])}"
            aim = "to find out"
        elif kind == "rival":
            line = f"Not sure: {' or '.join(rest)} has as much evidence as {first}"
            aim = "to find out"
        else:
            line = f"Not known: {first} cannot be told from {' or '.join(rest)} in {these}"
            aim = "to tell them apart"
        if each["separating_experiment"]:
            line += f"; {aim}: {each['separating_experiment']}"
        yield f"{line}."
    blind = dict.fromkeys(t["name"] for t in document["tried"] if t["verdict"] == "cannot be seen")
    if blind and not document["causes"] and "invisible" not in first_of_kind:
        yield f"Not known: {these} cannot show {', '.join(blind)}."
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
