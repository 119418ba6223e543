"""The tables of a diagnosis, read off its JSON document."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from thermaltool.report.diagnosis_verdict import percents, shares
from thermaltool.report.diagnosis_words import (
    ROLES,
    ROUNDING,
    Document,
    band_name,
    called,
    condition_name,
    duration,
    estimated,
    follows,
    judged_on,
    kind_of,
    log_name,
    number,
    percent,
    relevant_conditions,
)
from thermaltool.report.style import channel_unit
from thermaltool.units import printed

# What is open between causes, by kind.
OPEN = {
    "indistinguishable": "look alike",
    "rival": "as likely",
    "suspected": "may be",
    "invisible": "cannot be seen",
}
# Larger odds are told as these.
MAX_ODDS = 1000.0
# Causes listed as tried.
MAX_LISTED = 12
# Below this p-value what noise and discrepancy leave is not white.
MIN_P_WHITE = 0.01


@dataclass(frozen=True)
class Section:
    """A table of a report: the first row is the heading.

    Attributes
    ----------
    short : bool
        Belongs into the short form.
    """

    title: str
    rows: list[list[str]]
    short: bool = True


def sections(document: Document) -> list[Section]:
    """Every table that has rows.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    """
    found = [
        _outputs(document),
        _causes(document),
        _severity(document),
        _gains(document),
        _written(document),
        _alternatives(document),
        _tried(document),
        _ruled_out(document),
        _conditions(document),
        _bands(document),
        _dependences(document),
    ]
    return [section for section in found if len(section.rows) > 1]


def _outputs(document: Document) -> Section:
    several = len(document["logs"]) > 1
    where = ["worst in"] if several else []
    rows = [["output", *where, "unit", "residual RMS", "noise", "calibration left", "rest",
             "rest of the power", "zero off by", "slow discrepancy", "independent rows",
             "beside it white"]]  # fmt: skip
    for name, report in document["residuals"].items():
        noise, p_white = report["noise"], report["white_p"]
        slow = number(noise["discrepancy"])
        if noise["time_constant"] is not None:
            slow += f" over {duration(noise['time_constant'])}"
        rows.append(
            [
                name,
                *([log_name(document, report["log"])] if several else []),
                channel_unit(name),
                *(number(report["parts"][key]) for key in ("rms", "noise", "calibration", "rest")),
                # Rounded as in the sentence above it: the three add up.
                percents(list(shares(report).values()))[-1],
                number(report["mean"]),
                slow,
                f"{report['effective_rows']:.0f} of {report['rows']}",
                f"{'yes' if p_white >= MIN_P_WHITE else 'no'} (p {p_white:.2g})",
            ]
        )
    return Section("What the model gets wrong", rows)


def _causes(document: Document) -> Section:
    rows = [["cause", "channel", "evidence", "explains", "parameter", "value", "95 %", "unit"]]
    for cause in document["causes"]:
        head = [
            cause["name"],
            cause["channel"],
            number(cause["evidence"]),
            percent(cause["explained"]) if cause["gain"] else "–",
        ]
        for name, each in cause["parameters"].items() or [("–", None)]:
            if each is None:
                rows.append([*head, name, "", "", ""])
                continue
            interval = each["interval"]
            value, *ends = estimated(each["value"], interval)
            bounds = " to ".join(ends) or "given"
            rows.append([*head, name, value, bounds, printed(each["unit"])])
            head = ["", "", "", ""]
    return Section("Causes", rows)


def _severity(document: Document) -> Section:
    rows = [["cause", "output", "unit", "moves by up to", "RMS", "tolerance", "times"]]
    for cause in document["causes"]:
        # Of an unknown one it is the RMS where that is worst.
        worst = "" if cause["location"] is None else " RMS there"
        rows += [
            [
                called(cause["name"], cause["channel"]),
                output,
                channel_unit(output),
                f"{number(each['largest'])}{worst}",
                *(number(each[key]) for key in ("rms", "tolerance", "times_tolerance")),
            ]
            for output, each in cause["severity"].items()
        ]
    if not document["tolerance"]:
        rows = [row[:-2] for row in rows]
    return Section("How severe each cause is", rows)


def _gains(document: Document) -> Section:
    rows = [["cause", "on", "output", "unit", "RMS before", "after", "gain (95 %)",
             "largest before", "after", "fit % before", "after"]]  # fmt: skip
    files = {log["sha256"]: Path(log["name"]).name for log in document["logs"]}
    for cause in document["causes"]:
        # What happened in one log is worth something there alone.
        judged = files.get(cause["log"]) or judged_on(document)
        for channel, gain in cause["gain"].items():
            if abs(gain["rms_before"] - gain["rms_after"]) <= ROUNDING * gain["rms_before"]:
                continue  # it does not reach this output
            low, high = (number(end) for end in gain["interval"])
            rows.append(
                [
                    called(cause["name"], cause["channel"]),
                    judged,
                    channel,
                    channel_unit(channel),
                    number(gain["rms_before"]),
                    number(gain["rms_after"]),
                    f"{low} to {high}{'' if gain['claimed'] else ', not claimed'}",
                    number(gain["max_before"]),
                    number(gain["max_after"]),
                    number(gain["fit_before"]),
                    number(gain["fit_after"]),
                ]
            )
    return Section("What knowing them is worth", rows)


def _written(document: Document) -> Section:
    rows = [["model", "log", "output", "unit", "RMSE", "zero off by", "RMSE, zero free", "fit %"]]
    names = {
        log["sha256"]: f"{Path(log['name']).name} ({role})"
        for key, role in ROLES.items()
        for log in document[key]
    }
    for row in document["written"]:
        cause = row["cause"]
        rows.append(
            [
                "as it came" if cause is None else f"+ {called(cause['name'], cause['channel'])}",
                names.get(row["log"], "–"),
                row["output"],
                channel_unit(row["output"]),
                *(number(row[key]) for key in ("rmse", "zero_off_by", "rmse_zero_free",
                                               "fit_percent")),
            ]
        )  # fmt: skip
    return Section("The written model on every log, as simulate runs it", rows)


def _alternatives(document: Document) -> Section:
    rows = [["open", "causes", "angle", "what would tell", "opens to"]]
    for each in document["alternatives"]:
        pairs = zip(each["names"], each["channels"], strict=True)
        rows.append(
            [
                OPEN[kind_of(each)],
                " / ".join(called(*pair) for pair in pairs),
                f"{number(each['angle_deg'])}°" if len(each["names"]) > 1 else "–",
                each["separating_experiment"] or "–",
                "–" if each["opened_deg"] is None else f"{number(each['opened_deg'])}°",
            ]
        )
    return Section("What else it could be", rows)


def _tried(document: Document) -> Section:
    rows = [["cause", "channel", "evidence", "detectable", "verdict"]]
    for each in document["tried"][:MAX_LISTED]:
        detectable = number(each["detectable"])
        if each["output"] and each["detectable"] is not None:
            detectable += f" {channel_unit(each['output'])} of {each['output']}"
        rows.append(
            [each["name"], each["channel"], number(each["evidence"]), detectable, each["verdict"]]
        )
    hidden = len(document["tried"]) - MAX_LISTED
    more = f" ({hidden} weaker ones not shown)" if hidden > 0 else ""
    return Section(f"Causes tried, each alone{more}", rows)


def _ruled_out(document: Document) -> Section:
    rows = [["cause", "channel", "would be seen from", "of what matters", "odds against"]]
    for each in document["ruled_out"]:
        unit = channel_unit(each["output"])
        rows.append(
            [
                each["name"],
                each["channel"],
                f"{number(each['above'])} {unit} of {each['output']}",
                f"{number(each['matters'])} {unit}".rstrip(),
                f"{'> ' if each['odds'] > 0.999 * MAX_ODDS else ''}{number(each['odds'])} to 1",
            ]
        )
    return Section("Ruled out in a size that matters", rows, short=False)


def _conditions(document: Document) -> Section:
    rows = [["output", "while", "RMS", "mean", "of the misfit", "of the time"]]
    for name, report in document["residuals"].items():
        rows += [
            [name, condition_name(c), number(c["rms"]), number(c["mean"]), percent(c["power"]),
             percent(c["time"])]
            for c in relevant_conditions(document, report)
        ]  # fmt: skip
    return Section("In which condition", rows, short=False)


def _bands(document: Document) -> Section:
    rows = [["output", "period", "of the misfit"]]
    for name, report in document["residuals"].items():
        rows += [[name, band_name(band), percent(band["power"])] for band in report["bands"]]
    return Section("How slowly", rows, short=False)


def _dependences(document: Document) -> Section:
    rows = [["output", "follows", "most at a lag of", "correlation", "bound (1 %)", "p"]]
    for name, report in document["residuals"].items():
        for d in report["dependences"]:
            if not follows(report, d["channel"]):
                continue
            first, last = (duration(lag) for lag in d["lag"])
            rows.append(
                [
                    name,
                    d["channel"],
                    first if first == last else f"{first} to {last}",
                    number(d["correlation"]),
                    number(d["bound"]),
                    f"{d['p_value']:.2g}",
                ]
            )
    return Section("Inputs that the residual follows, now or later", rows, short=False)
