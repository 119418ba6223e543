"""First sentence of a diagnosis: the verdict, and what the residual of one output is made of."""

from __future__ import annotations

from collections.abc import Sequence

from thermaltool.report.diagnosis_advice import worst_moved
from thermaltool.report.diagnosis_words import (
    ROUNDING,
    Document,
    in_log,
    names_of,
    number,
    percent,
)
from thermaltool.report.style import channel_unit
from thermaltool.report.text import listed

# How the parts of a residual are called.
PARTS = {"noise": "noise", "calibration": "what the calibration left", "rest": "the rest"}


def main_output(document: Document) -> str | None:
    """The output of whose power noise and what the calibration left account for least.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    """
    residuals = document["residuals"]

    def weight(name: str) -> tuple[float, float]:
        report = residuals[name]
        return shares(report)["rest"], report["above_noise"]

    return max(residuals, key=weight, default=None)


def output_of_verdict(document: Document) -> str | None:
    """The output that the first sentences are of: that of the cause, where the others are good.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    """
    causes = document["causes"]
    if document["verdict"] == "not adequate" and document["noise_share"] >= 0.5 and causes:
        return worst_moved(document, causes[0]) or main_output(document)
    return main_output(document)


def shares(report: Document) -> dict[str, float]:
    """Share of a residual's power that each of its parts has; they add up to one.

    Parameters
    ----------
    report : mapping
        Of an output.
    """
    parts = report["parts"]
    power = parts["rms"] ** 2
    each = {name: parts[name] ** 2 for name in ("noise", "calibration", "rest")}
    return {name: (square / power if power else 0.0) for name, square in each.items()}


def percents(parts: Sequence[float]) -> list[str]:
    """Shares of a whole as percentages that add up to 100 as they are printed.

    Parameters
    ----------
    parts : sequence of float
        They add up to one.
    """
    whole = [int(100 * part) for part in parts]
    by_remainder = sorted(range(len(parts)), key=lambda k: whole[k] - 100 * parts[k])
    for k in by_remainder[: 100 - sum(whole)]:
        whole[k] += 1
    return [
        percent(part) if part < 0.01 or part > 0.99 else f"{each} %"
        for part, each in zip(parts, whole, strict=True)
    ]


def verdict_sentence(document: Document) -> str:
    """``The model is adequate for run.csv: of the residual of d_z_um, 1.2 µm RMS, noise is ...``

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    """
    verdict, output = document["verdict"], output_of_verdict(document)
    line = f"The model is {verdict} for {names_of(document['logs'])}"
    if verdict == "cannot judge":
        line = f"The model cannot be judged by {names_of(document['logs'])}"
        if document["rests"]:
            return f"{line}."
    if document["not_judged"]:
        line += f", {listed(document['not_judged'])} not judged"
    if output is None or output not in document["residuals"]:
        return f"{line}."
    report, unit = document["residuals"][output], channel_unit(output)
    parts = report["parts"]
    if not parts["rms"]:
        return f"{line}: it leaves nothing of {output}."
    where = in_log(document, report)
    share = shares(report)
    found = [
        (words, f"{number(parts[name])} {unit}", much)
        for (name, words), much in zip(PARTS.items(), percents(list(share.values())), strict=True)
        if share[name] > ROUNDING
    ]
    told = [
        f"{words}{'' if k else ' is'} {size} ({much}{'' if k else ' of the power'})"
        for k, (words, size, much) in enumerate(found)
    ]
    line += f": of the residual of {output}{where}, {number(parts['rms'])} {unit} RMS, "
    line += listed(told)
    minor = verdict == "not adequate" and ROUNDING < share["rest"] <= 0.5
    return f"{line}{', which has a cause' if minor and document['causes'] else ''}."
