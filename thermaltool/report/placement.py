"""Chosen sensors as a JSON document, as text and as a figure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.placement.sensor_sets import gains_of_the_next
from thermaltool.report.style import CYCLE, channel_unit, new_figure, plain, shortened
from thermaltool.report.text import aligned

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from thermaltool.placement.sensor_sets import PlacedSensors, SensorSet

# A condition number above this, and a variance inflation above that, leave weights badly known
# (Belsley, Kuh, Welsch 1980).
HIGH_CONDITION = 30.0
WORDS = {
    "held-out": "root mean square of what a regression misses of rows held out",
    "I": "what stays unknown of the deflections",
    "A": "chosen by the variance of all temperatures; what stays unknown of the deflections",
    "D": "chosen by what the readings tell; what stays unknown of the deflections",
    "modes": "by the rule of the dominant modes; what stays unknown of the deflections",
}


def sets_frame(sets: Sequence[SensorSet], outputs: Sequence[str]) -> pandas.DataFrame:
    """One row for each set and output."""
    import pandas

    rows = [
        (len(each.sensors), output, error, " ".join(each.sensors))
        for each in sets
        for output, error in zip(outputs, each.errors, strict=True)
    ]
    columns = ["count", "output", "rmse", "sensors"]
    return pandas.DataFrame(rows, columns=columns).set_index(columns[:2])


def sets_document(sets: Sequence[SensorSet], outputs: Sequence[str]) -> list[dict[str, Any]]:
    """Sets of sensors as JSON."""
    return [
        {
            "count": len(each.sensors),
            "sensors": list(each.sensors),
            "rmse": dict(zip(outputs, each.errors, strict=True)),
            "time_constants_s": list(each.time_constants),
            "efficiency_at_least": each.efficiency,
            "gain_of_the_next": gain,
        }
        for each, gain in zip(sets, gains_of_the_next(sets), strict=True)
    ]


def sets_table(sets: Sequence[SensorSet], outputs: Sequence[str], criterion: str) -> str:
    """Errors and sensors for each number of sensors."""
    units = [f"{output} [{channel_unit(output)}]" for output in outputs]
    bounded = criterion != "held-out"
    extra = ["of the best, at least"] if bounded else ["time constants [s]"]
    rows = [["sensors", *units, "next gains", *extra, "which"]]
    for each, gain in zip(sets, gains_of_the_next(sets), strict=True):
        if bounded:
            last = "" if each.efficiency is None else f"{100 * each.efficiency:.0f} %"
        else:
            last = ", ".join(f"{tau:.3g}" for tau in each.time_constants) or "none"
        rows.append([
            str(len(each.sensors)), *(f"{error:.3g}" for error in each.errors),
            "" if gain is None else f"{100 * gain:.0f} %", last, ", ".join(each.sensors),
        ])  # fmt: skip
    return aligned(rows)


def placement_document(found: PlacedSensors) -> dict[str, Any]:
    """What ``place --json`` writes."""
    return {
        "criterion": found.criterion,
        "outputs": list(found.outputs),
        "candidates": list(found.candidates),
        "sets": sets_document(found.sets, found.outputs),
        "collinearity": {
            "condition_number": found.collinearity.condition,
            "variance_inflation": dict(
                zip(found.collinearity.sensors, found.collinearity.inflation, strict=True)
            ),
            "groups": [list(group) for group in found.collinearity.groups],
        },
    }


def placement_table(found: PlacedSensors) -> str:
    """Errors and sensors for each number of sensors, and which say the same."""
    own = found.collinearity
    high = ", high: weights of all together are badly known" * (own.condition > HIGH_CONDITION)
    parts = [
        f"{WORDS[found.criterion]}, {len(found.candidates)} candidates",
        sets_table(found.sets, found.outputs, found.criterion),
        f"condition number of all candidates: {own.condition:.3g}{high}",
    ]
    parts += [f"say the same: {', '.join(group)}" for group in own.groups]
    return "\n".join(parts)


def draw_errors(ax: Axes, sets: Sequence[SensorSet], outputs: Sequence[str]) -> None:
    """Error of each output against the number of sensors."""
    counts = [len(each.sensors) for each in sets]
    for k, output in enumerate(outputs):
        errors = [each.errors[k] for each in sets]
        ax.plot(counts, errors, marker="o", color=CYCLE[k % len(CYCLE)], label=plain(output))
    units = {channel_unit(output) for output in outputs}
    ax.set(title="What is missed", xlabel="sensors", ylim=(0, None),
           ylabel=f"RMS error [{', '.join(sorted(units))}]")  # fmt: skip
    ax.set_xticks(counts)
    ax.legend()


def draw_placement(found: PlacedSensors) -> Figure:
    """Error of each output against the number of sensors; which sensors each number takes."""
    names = [n for n in found.candidates if any(n in each.sensors for each in found.sets)]
    counts = [len(each.sensors) for each in found.sets]
    figure = new_figure("Sensors", 11.0, max(4.0, 1.6 + 0.26 * len(names)))
    left, right = figure.subplots(1, 2, width_ratios=[1.2, 1.0])
    draw_errors(left, found.sets, found.outputs)
    taken = np.array([[name in each.sensors for each in found.sets] for name in names])
    for row in range(len(names)):
        at = [counts[k] for k in np.flatnonzero(taken[row])]
        right.plot(at, [row] * len(at), "o", color=CYCLE[0], ms=8)
    right.set(title="Which they are", xlabel="sensors", ylim=(len(names) - 0.5, -0.5),
              xlim=(min(counts) - 0.5, max(counts) + 0.5))  # fmt: skip
    right.set_xticks(counts)
    right.set_yticks(range(len(names)), [plain(shortened(name, 24)) for name in names])
    return figure
