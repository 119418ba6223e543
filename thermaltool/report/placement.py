"""Chosen sensors as a JSON document, as text and as a figure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.report.style import CYCLE, channel_unit, new_figure, plain, shortened
from thermaltool.report.text import aligned

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from thermaltool.placement.sensor_sets import PlacedSensors

# A condition number above this, and a variance inflation above that, leave weights badly known
# (Belsley, Kuh, Welsch 1980).
HIGH_CONDITION = 30.0
WORDS = {
    "held-out": "root mean square of what a regression misses of rows held out",
    "I": "what stays unknown of the deflections",
    "A": "chosen by the variance of all temperatures; what stays unknown of the deflections",
    "D": "chosen by what the readings tell; what stays unknown of the deflections",
}


def placement_document(found: PlacedSensors) -> dict[str, Any]:
    """What ``place --json`` writes."""
    return {
        "criterion": found.criterion,
        "outputs": list(found.outputs),
        "candidates": list(found.candidates),
        "sets": [
            {
                "count": len(each.sensors),
                "sensors": list(each.sensors),
                "rmse": dict(zip(found.outputs, each.errors, strict=True)),
                "time_constants_s": list(each.time_constants),
                "efficiency_at_least": each.efficiency,
                "gain_of_the_next": found.gain(1 + k),
            }
            for k, each in enumerate(found.sets)
        ],
        "collinearity": {
            "condition_number": found.collinearity.condition,
            "variance_inflation": dict(
                zip(found.collinearity.sensors, found.collinearity.inflation, strict=True)
            ),
            "groups": [list(group) for group in found.collinearity.groups],
        },
    }


def placement_table(found: PlacedSensors) -> str:
    """Errors and sensors for each number of sensors."""
    units = [f"{output} [{channel_unit(output)}]" for output in found.outputs]
    bounded = found.criterion != "held-out"
    extra = ["of the best, at least"] if bounded else ["time constants [s]"]
    rows = [["sensors", *units, "next gains", *extra, "which"]]
    for k, each in enumerate(found.sets):
        gain = found.gain(1 + k)
        if bounded:
            last = "" if each.efficiency is None else f"{100 * each.efficiency:.0f} %"
        else:
            last = ", ".join(f"{tau:.3g}" for tau in each.time_constants) or "none"
        rows.append([
            str(len(each.sensors)), *(f"{error:.3g}" for error in each.errors),
            "" if gain is None else f"{100 * gain:.0f} %", last, ", ".join(each.sensors),
        ])  # fmt: skip
    own = found.collinearity
    high = ", high: weights of all together are badly known" * (own.condition > HIGH_CONDITION)
    parts = [
        f"{WORDS[found.criterion]}, {len(found.candidates)} candidates",
        aligned(rows),
        f"condition number of all candidates: {own.condition:.3g}{high}",
    ]
    parts += [f"say the same: {', '.join(group)}" for group in own.groups]
    return "\n".join(parts)


def draw_placement(found: PlacedSensors) -> Figure:
    """Error of each output against the number of sensors; which sensors each number takes."""
    names = [n for n in found.candidates if any(n in each.sensors for each in found.sets)]
    counts = [len(each.sensors) for each in found.sets]
    figure = new_figure("Sensors", 11.0, max(4.0, 1.6 + 0.26 * len(names)))
    left, right = figure.subplots(1, 2, width_ratios=[1.2, 1.0])
    for k, output in enumerate(found.outputs):
        errors = [each.errors[k] for each in found.sets]
        left.plot(counts, errors, marker="o", color=CYCLE[k % len(CYCLE)], label=plain(output))
    units = {channel_unit(output) for output in found.outputs}
    left.set(title="What is missed", xlabel="sensors", ylim=(0, None),
             ylabel=f"RMS error [{', '.join(sorted(units))}]")  # fmt: skip
    left.set_xticks(counts)
    left.legend()
    taken = np.array([[name in each.sensors for each in found.sets] for name in names])
    for row in range(len(names)):
        at = [counts[k] for k in np.flatnonzero(taken[row])]
        right.plot(at, [row] * len(at), "o", color=CYCLE[0], ms=8)
    right.set(title="Which they are", xlabel="sensors", ylim=(len(names) - 0.5, -0.5),
              xlim=(min(counts) - 0.5, max(counts) + 0.5))  # fmt: skip
    right.set_xticks(counts)
    right.set_yticks(range(len(names)), [plain(shortened(name, 24)) for name in names])
    return figure
