"""Thermal modes of a body as JSON document, table and sentences."""

from __future__ import annotations

from typing import Any

import numpy as np

from thermaltool.documents import jsonable
from thermaltool.model import Model
from thermaltool.placement.body import SolidBody
from thermaltool.placement.thermal_modes import NEAR_NODE, ThermalEigenmodes
from thermaltool.report.clock_axis import modes_unit
from thermaltool.report.text import aligned
from thermaltool.units import UNITS, parse_channel

# Modes of the table, at most; the document has all.
MAX_ROWS = 12
# A shape that varies by less is the same everywhere.
EVEN = 1e-6
# Part of a steady state that the modes leave out, above which that is said.
MAX_MISSING = 0.05
# Lengths of a body beyond which its unit is doubted [m].
MIN_LENGTH, MAX_LENGTH = 0.01, 30.0
# Part of the largest rise by which a heat may seem to cool on a mesh of linear elements.
MAX_COOLED = 0.02
# Part of a gain that one mode makes, above which what the modes leave of each other is doubted.
MAX_SHARE = 10.0


def mode_notes(modes: ThermalEigenmodes, body: SolidBody) -> list[str]:
    """What to know before using the modes, each a sentence."""
    notes = body_notes(modes, body)
    if not modes.is_complete:
        notes.append(
            f"weights are parts of the sum over these {len(modes.time_constants)} modes of "
            f"{modes.shapes.shape[0]}: more modes (--count) lower them"
        )
    return notes


def body_notes(modes: ThermalEigenmodes, body: SolidBody) -> list[str]:
    """Doubts of a mesh, and what few modes of it leave out, each a sentence."""
    notes = _doubts(modes, body)
    found = modes.contributions.sum(axis=1)
    for k, name in enumerate((*body.points, *body.deflections) if not modes.is_complete else ()):
        for h, heat in enumerate(body.heat):
            missing = abs(1 - found[k, h] / modes.gains[k, h]) if modes.gains[k, h] else 0.0
            if missing > MAX_MISSING:
                notes.append(
                    f"{name} by {heat}: these modes leave out {100 * missing:.0f} % of the "
                    "steady state"
                )
    return notes


def _doubts(modes: ThermalEigenmodes, body: SolidBody) -> list[str]:
    """Signs that the mesh is too coarse for the body, or its unit another."""
    doubts = []
    length = float(np.max(np.ptp(body.mesh.p, axis=1)))
    if not MIN_LENGTH <= length <= MAX_LENGTH:
        doubts.append(f"the body is {length:.3g} m long: is the unit of [mesh] right?")
    # Nothing that heat alone acts on is colder than what is around it.
    coldest, hottest = modes.steady_states.min(axis=0), modes.steady_states.max(axis=0)
    doubts += [
        f"{heat} cools parts of the body ({100 * low / high:.0f} % of the largest rise): the mesh "
        "is too coarse, or the unit of [mesh] wrong"
        for heat, low, high in zip(body.heat, coldest, hottest, strict=True)
        if low < -MAX_COOLED * high
    ]
    for k, name in enumerate((*body.points, *body.deflections)):
        for h, heat in enumerate(body.heat):
            largest = float(np.max(np.abs(modes.contributions[k, :, h])))
            gain = abs(modes.gains[k, h])
            if gain and largest > MAX_SHARE * gain:
                doubts.append(
                    f"{name} by {heat}: modes of up to {100 * largest / gain:.3g} % of the gain "
                    "cancel: the heat hardly reaches it, the mesh is too coarse or its unit wrong"
                )
    if np.any(modes.time_constants <= 0):
        doubts.append(
            "a time constant is not above zero: the mesh is too coarse, or its unit wrong"
        )
    return doubts


def reduction_notes(model: Model) -> list[str]:
    """How far a reduced model is from the mesh, one sentence."""
    low, high = model.outputs[0].fit["band_hz"]
    told = ", ".join(
        f"{each.channel} {100 * each.fit['reduction_error']:.2f} %" for each in model.outputs
    )
    return [
        f"model: off the mesh by at most {told} of its largest response, {low:.2g} to {high:.2g} Hz"
    ]


def _outputs(body: SolidBody) -> list[tuple[str, float]]:
    """Points and deflections, with the factor to their unit."""
    return [
        *((name, 1 / UNITS[parse_channel(name).unit][1]) for name in body.points),
        # Lengths are counted in micrometres.
        *((name, 1e6 / UNITS[parse_channel(name).unit][1]) for name in body.deflections),
    ]


def _watts(heat: str) -> float:
    """A unit of the heat [W]."""
    return UNITS[parse_channel(heat).unit][1]


def _extremes(modes: ThermalEigenmodes, body: SolidBody, j: int) -> list[tuple[float, list[float]]]:
    """Largest and smallest value of a shape, with their places [m]."""
    shape = modes.unit_shapes[:, j]
    return [(float(shape[k]), body.mesh.p[:, k].tolist())
            for k in (int(np.argmax(shape)), int(np.argmin(shape)))]  # fmt: skip


def crossings(modes: ThermalEigenmodes, body: SolidBody, j: int) -> list[float]:
    """Nodes of a mode along a rod [m]; empty for a solid."""
    if body.section is None:
        return []
    order = np.argsort(body.mesh.p[0])
    x, shape = body.mesh.p[0][order], modes.unit_shapes[order, j]
    turns = np.flatnonzero(np.sign(shape[:-1]) * np.sign(shape[1:]) < 0)
    steps = np.diff(x)[turns] * shape[turns] / (shape[turns] - shape[turns + 1])
    return (x[turns] + steps).tolist()


def mode_document(modes: ThermalEigenmodes, body: SolidBody) -> dict[str, Any]:
    """Everything but the shapes of all nodes as plain data."""
    outputs = _outputs(body)
    found: dict[str, Any] = jsonable({
        "nodes": modes.shapes.shape[0],
        "complete": modes.is_complete,
        "modes": [
            {
                "time_constant_s": float(tau),
                "weights": {h: float(modes.weights[j, k]) for k, h in enumerate(body.heat)},
                "relative_weights": {
                    h: float(modes.relative_weights[j, k]) for k, h in enumerate(body.heat)
                },
                "shape": {p: float(modes.at_points[k, j]) for k, p in enumerate(body.points)},
                "extremes": [{"value": value, "at_m": at}
                             for value, at in _extremes(modes, body, j)],
                "nodes_m": crossings(modes, body, j),
            }
            for j, tau in enumerate(modes.time_constants)
        ],
        "gains": {
            name: {
                heat: {
                    "value": factor * _watts(heat) * float(modes.gains[k, h]),
                    "by_mode": (factor * _watts(heat) * modes.contributions[k, :, h]).tolist(),
                }
                for h, heat in enumerate(body.heat)
            }
            for k, (name, factor) in enumerate(outputs)
        },
        "notes": mode_notes(modes, body),
    })  # fmt: skip
    return found


def mode_table(modes: ThermalEigenmodes, body: SolidBody, name: str) -> str:
    """Time constants, weights, shapes at the points, and where the extremes are."""
    unit, length = modes_unit(modes.time_constants)
    count = len(modes.time_constants)
    what = "all modes" if modes.is_complete else f"the {count} slowest modes"
    parts = [f"{name}: {modes.shapes.shape[0]} nodes, {len(body.mesh.t.T)} elements, {what}"]
    shown = min(count, MAX_ROWS)
    rows = [["mode", f"time constant {unit}", *(f"weight {h} %" for h in body.heat), *body.points]]
    for j in range(shown):
        rows.append([
            str(j + 1), f"{modes.time_constants[j] / length:.4g}",
            *(f"{100 * part:.1f}" for part in modes.relative_weights[j]),
            *(_at_point(value) for value in modes.at_points[:, j]),
        ])  # fmt: skip
    if count > shown:
        rest = modes.relative_weights[shown:].sum(axis=0)
        rows.append([f"{shown + 1} to {count}", "", *(f"{100 * part:.1f}" for part in rest),
                     *[""] * len(body.points)])  # fmt: skip
    parts.append(aligned(rows))
    if body.points:
        parts.append("shapes at the points: largest value of the body 1; (…) near a node")
    parts.append(_extreme_table(modes, body))
    if body.points or body.deflections:
        parts.append(_gain_table(modes, body))
    return "\n\n".join(parts)


def _at_point(value: float) -> str:
    value = round(value, 2) + 0.0  # no −0.00
    return f"({value:.2f})" if abs(value) < NEAR_NODE else f"{value:.2f}"


def _extreme_table(modes: ThermalEigenmodes, body: SolidBody) -> str:
    """Where the dominant modes are largest and smallest, and where they are none."""
    dominant = sorted({j for h in range(len(body.heat)) for j in modes.dominant(h)})
    rows = [["dominant mode", "largest at m", "smallest at m", "value"]]
    rod = body.section is not None
    rows[0] += ["nodes at m"] * rod
    for j in dominant:
        (most, top), (least, bottom) = _extremes(modes, body, j)
        even = most - least < EVEN
        places = ("everywhere", "") if even else (_place(top), _place(bottom))
        nodes = ", ".join(f"{x:.3g}" for x in crossings(modes, body, j))
        rows.append([str(j + 1), *places, f"{least:.2f}", *[nodes] * rod])
    return aligned(rows)


def _place(at: list[float]) -> str:
    return ", ".join(f"{0.0 if abs(x) < 1e-12 else x:.3g}" for x in at)


def _gain_table(modes: ThermalEigenmodes, body: SolidBody) -> str:
    """Steady states, and the modes that make most of them."""
    rows = [["output", "heat", "gain", "unit", "by modes"]]
    for k, (name, factor) in enumerate(_outputs(body)):
        for h, heat in enumerate(body.heat):
            each, gain = modes.contributions[k, :, h], modes.gains[k, h]
            largest = np.argsort(-np.abs(each))[:3]
            told = ", ".join(f"{j + 1}: {100 * each[j] / gain:.0f} %" for j in largest if gain
                             and abs(each[j]) > 0.005 * abs(gain))  # fmt: skip
            unit = "K" if name in body.points else parse_channel(name).unit
            per = f"{unit}/{parse_channel(heat).unit}"
            rows.append([name, heat, f"{factor * _watts(heat) * gain:.4g}", per, told])
    return aligned(rows)
