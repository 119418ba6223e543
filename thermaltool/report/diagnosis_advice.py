"""What a technician gets from a diagnosis: how severe a cause is, and what to do about it."""

from __future__ import annotations

from thermaltool.report.diagnosis_words import Document, called, number, these_logs
from thermaltool.report.style import channel_unit

# Causes that a sentence names as ruled out; the table has all.
MAX_NAMED = 4


def moved_first(document: Document, cause: Document) -> list[str]:
    """Outputs that a cause moves, the most first: against the tolerance, else against the noise.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    cause : mapping
        One of its causes.
    """
    severity, residuals = cause["severity"], document["residuals"]

    def weight(output: str) -> tuple[float, float]:
        each, report = severity[output], residuals.get(output)
        noise = report["noise"]["white"] if report else 0.0
        return each["times_tolerance"] or 0.0, each["largest"] / (noise or 1.0)

    return sorted(severity, key=weight, reverse=True)


def worst_moved(document: Document, cause: Document) -> str | None:
    """The output that a cause moves most.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    cause : mapping
        One of its causes.
    """
    return next(iter(moved_first(document, cause)), None)


def severity_sentence(document: Document, cause: Document) -> str:
    """``Severity: it moves d_z_um by up to 12 µm (5 µm RMS), 2.4 times the tolerance of 5 µm.``

    Empty where nothing is known of it.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    cause : mapping
        One of its causes.
    """
    output = worst_moved(document, cause)
    if output is None:
        return ""
    each, unit = cause["severity"][output], channel_unit(output)
    largest, rms = (f"{number(each[key])} {unit}".rstrip() for key in ("largest", "rms"))
    if cause["location"] is not None:
        line = f"Severity: {output} is off by {rms} RMS, by {largest} RMS where it is worst"
    elif cause["name"] == "outliers":
        line = f"Severity: readings of {output} are off by up to {largest}"
    else:
        line = f"Severity: it moves {output} by up to {largest} ({rms} RMS over its rows)"
    if each["times_tolerance"] is None:
        return f"{line}."
    allowed = f"the tolerance of {number(each['tolerance'])} {unit}".rstrip()
    if each["times_tolerance"] > 1:
        return f"{line}, {number(each['times_tolerance'])} times {allowed}."
    return f"{line}, within {allowed}."


def ruled_out_sentence(document: Document) -> str:
    """``Ruled out: radiation, transport_delay (Q_main_1): half of … would have been seen.``

    Empty where nothing is.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    """
    entries = document["ruled_out"]
    if not entries:
        return ""
    names = [called(each["name"], each["channel"]) for each in entries]
    more = f" and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else ""
    given = {each["output"] in document["tolerance"] for each in entries}
    which = "of each" if len(names) > 1 else "of it"
    much = f"half the {'tolerance' if given == {True} else 'residual'} {which}"
    if len(given) > 1:
        much = f"half the tolerance {which}, or of the residual where there is none,"
    return (
        f"Ruled out: {', '.join(names[:MAX_NAMED])}{more}; {these_logs(document)} would have shown "
        f"{much} and did not."
    )
