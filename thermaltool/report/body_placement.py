"""Places for sensors on a finite-element model: JSON document, text and figure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.placement.body_candidates import BodySensors, largest_heats
from thermaltool.report.mode_shapes import draw_surface
from thermaltool.report.placement import WORDS, draw_errors, sets_document, sets_table
from thermaltool.report.style import CYCLE, MARK, Array, new_figure, plain
from thermaltool.report.text import aligned

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AXES = ("x m", "y m", "z m")
STEADY = "steady state of all heats [K above the air]"


def body_placement_document(found: BodySensors) -> dict[str, Any]:
    """What ``place BODY.toml --json`` writes."""
    return {
        "criterion": found.criterion,
        "outputs": list(found.outputs),
        "candidates": len(found.sites.names),
        "reading_noise_K": found.reading_noise,
        "sets": sets_document(found.sets, found.outputs),
        "places_m": {name: found.sites.places[k].tolist() for name, k in found.chosen.items()},
    }


def body_placement_table(found: BodySensors) -> str:
    """Errors and sensors for each number of sensors; where they are."""
    places = [
        [name, *(f"{x:.4g}" for x in found.sites.places[k]), f"{found.sites.distance[k]:.4g}"]
        for name, k in found.chosen.items()
    ]
    dimensions = len(places[0]) - 2
    return "\n".join([
        f"{WORDS[found.criterion]}, {len(found.sites.names)} candidates, readings "
        f"with {found.reading_noise:g} K of noise",
        sets_table(found.sets, found.outputs, found.criterion),
        "",
        aligned([["sensor", *AXES[:dimensions], "from the heat m"], *places]),
    ])  # fmt: skip


def draw_body_placement(found: BodySensors) -> Figure:
    """Error against the number of sensors; the largest set on the body."""
    last = found.sets[-1].sensors
    places = found.sites.places[[found.chosen[name] for name in last]]
    figure = new_figure(f"Sensors, {found.name}", 12.0, 5.5)
    grid = figure.add_gridspec(1, 2, width_ratios=[1.0, 1.3])
    draw_errors(figure.add_subplot(grid[0]), found.sets, found.outputs)
    body = found.body
    warm = found.modes.steady_states @ largest_heats(body)
    title = f"Where the {len(last)} are" if len(last) > 1 else "Where it is"
    if body.section is not None:
        _draw_rod(figure.add_subplot(grid[1]), body.mesh.p[0], warm, places[:, 0], last, title)
        return figure
    ax: Any = figure.add_subplot(grid[1], projection="3d")
    # Sensors on the far side are seen, too.
    ax.computed_zorder = False
    limits = float(warm.min()), float(warm.max())
    draw_surface(ax, body.mesh, body.mesh.p, warm, limits, "YlOrRd", 0.5, STEADY)
    ax.scatter(*places.T, s=60, color=CYCLE[0], edgecolors="white", depthshade=False, zorder=5)
    for name, at in zip(last, places, strict=True):
        ax.text(*at, f"  {plain(name)}", fontsize=8, zorder=10)
    ax.set_title(f"{title}, axes in m")
    return figure


def _draw_rod(
    ax: Any, x: Array, warm: Array, places: Array, sensors: tuple[str, ...], title: str
) -> None:
    order = np.argsort(x)
    level = warm[order]
    ax.plot(x[order], level, color=MARK, label="steady state")
    at = np.interp(places, x[order], level)
    ax.plot(places, at, "o", ms=8, color=CYCLE[0], label="sensors")
    for name, where, value in zip(sensors, places, at, strict=True):
        ax.annotate(plain(name), (where, value), xytext=(4, 8), textcoords="offset points",
                    fontsize=8)  # fmt: skip
    ax.set(title=title, xlabel="place [m]", ylabel=STEADY, ylim=(0, None))
    ax.legend()
