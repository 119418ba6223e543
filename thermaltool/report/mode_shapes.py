"""Figures of thermal modes: shapes along a rod or over a solid, deflections, weights."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.placement.finite_elements import FiniteElements, Thermoelasticity
from thermaltool.placement.thermal_modes import ThermalEigenmodes
from thermaltool.report.clock_axis import modes_unit
from thermaltool.report.style import CYCLE, MARK, Array, legend_beside, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from thermaltool.placement.body import SolidBody

# Modes that are drawn, and bars of weights, at most.
MAX_SHAPES, MAX_BARS = 4, 12
# Largest displacement as part of the body's size in the figure of a solid.
EXAGGERATION = 0.08


def draw_modes(modes: ThermalEigenmodes, elements: FiniteElements, name: str) -> Figure:
    """Shapes of the modes with the largest weights, and the weights."""
    largest = np.argsort(-modes.relative_weights.max(axis=1))[:MAX_SHAPES]
    shown = sorted(int(j) for j in largest)
    if elements.body.section is not None:
        return _draw_rod(modes, elements, name, shown)
    deflected = ": surface, deflection exaggerated" if elements.body.deflections else ": surface"
    figure = new_figure(f"Thermal modes, {name}{deflected}, axes in m", 3.4 * len(shown), 7.0)
    grid = figure.add_gridspec(2, len(shown), height_ratios=[3, 2])
    body = elements.body
    elastic = Thermoelasticity(elements) if body.deflections else None
    for k, j in enumerate(shown):
        ax = figure.add_subplot(grid[0, k], projection="3d")
        _draw_solid(ax, modes, body, elastic, j)
    _draw_weights(figure.add_subplot(grid[1, :]), modes, list(body.heat))
    return figure


def mode_label(modes: ThermalEigenmodes, j: int) -> str:
    """Number and time constant of a mode."""
    unit, length = modes_unit(modes.time_constants)
    return f"mode {j + 1}, {modes.time_constants[j] / length:.3g} {unit}"


def _draw_rod(
    modes: ThermalEigenmodes, elements: FiniteElements, name: str, shown: list[int]
) -> Figure:
    body, x = elements.body, elements.body.mesh.p[0]
    order = np.argsort(x)
    held = bool(body.fixed) and all(m.expansion is not None for m in body.materials.values())
    elastic = Thermoelasticity(elements) if held else None
    figure = new_figure(f"Thermal modes, {name}", 11.0, 9.0 if held else 6.5)
    axes = figure.subplots(3 if held else 2, 1)
    axes[0].axhline(0.0, color=MARK, lw=0.8)
    for k, j in enumerate(shown):
        axes[0].plot(x[order], modes.unit_shapes[order, j], color=CYCLE[k],
                     label=mode_label(modes, j))  # fmt: skip
        if elastic is not None:
            # 1 K at the largest value of the temperature.
            moved = 1e6 * elastic.displacements(modes.unit_shapes[:, j])[0]
            axes[1].plot(x[order], moved[order], color=CYCLE[k], label=mode_label(modes, j))
    places = [float(at[0]) for at in body.points.values()]
    axes[0].plot(places, np.zeros(len(places)), "|", ms=12, color=MARK,
                 label="points" if places else "_")  # fmt: skip
    axes[0].set(title="Temperature", ylabel="shape, largest 1", xlabel="place [m]")
    legend_beside(axes[0])
    if held:
        axes[1].axhline(0.0, color=MARK, lw=0.8)
        axes[1].set(title="Deflection", ylabel="µm at a largest 1 K", xlabel="place [m]")
    _draw_weights(axes[-1], modes, list(body.heat))
    return figure


def _draw_solid(
    ax: Any, modes: ThermalEigenmodes, body: SolidBody, elastic: Thermoelasticity | None, j: int
) -> None:
    """The surface coloured by a shape; deformed by it where the body is elastic and held."""
    shape, places = modes.unit_shapes[:, j], body.mesh.p
    size = float(np.max(np.ptp(places, axis=1)))
    if elastic is not None:
        moved = elastic.displacements(shape)
        places = places + moved * EXAGGERATION * size / float(np.max(np.abs(moved)))
    draw_surface(ax, body.mesh, places, shape, (-1.0, 1.0), "RdBu_r", 1.0, "temperature, largest 1")
    ax.set_title(mode_label(modes, j))


def draw_surface(
    ax: Any,
    mesh: Any,
    places: Array,
    values: Array,
    limits: tuple[float, float],
    colours: str,
    opacity: float,
    label: str,
) -> None:
    """The surface of a solid in three dimensions, its facets coloured by nodal values.

    Parameters
    ----------
    ax : Axes3D
    mesh : skfem.Mesh
    places : ndarray, shape (3, n) [m]
        Of the nodes.
    values : ndarray, shape (n,)
    limits : (float, float)
        Values at the ends of the colours.
    colours : str
        Name of a map of matplotlib.
    opacity : float
        1 is opaque.
    label : str
        Of the values.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import MaxNLocator
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    facets = _rings(mesh)
    scale = ScalarMappable(Normalize(*limits), colours)
    surface = Poly3DCollection(
        places.T[facets.T],
        facecolors=scale.to_rgba(values[facets].mean(axis=0), alpha=opacity),
        edgecolors="none",
        linewidths=0.0,
    )
    ax.add_collection3d(surface)
    low, high = places.min(axis=1), places.max(axis=1)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set_box_aspect(np.maximum(high - low, 0.05 * float(np.max(high - low))))
    ax.tick_params(labelsize=7)
    for axis, length in zip((ax.xaxis, ax.yaxis, ax.zaxis), high - low, strict=True):
        axis.set_major_locator(MaxNLocator(4 if length > 0.5 * np.max(high - low) else 2))
    ax.figure.colorbar(scale, ax=ax, shrink=0.5, orientation="horizontal", pad=0.02, label=label)


def _rings(mesh: Any) -> Array:
    """Corners of the facets on the surface, each in turn around it, shape (3 or 4, facets)."""
    facets = mesh.facets[:, mesh.boundary_facets()]
    if len(facets) == 3:
        return facets
    # Corners come sorted: around the centre they go by angle in the plane of the facet.
    corners = mesh.p[:, facets]
    rays = corners - corners.mean(axis=1, keepdims=True)
    first = rays[:, 0]
    normal = np.cross(first, rays[:, 1], axis=0)
    flat = np.linalg.norm(normal, axis=0) < 1e-9 * np.sum(first**2, axis=0)
    normal[:, flat] = np.cross(first, rays[:, 2], axis=0)[:, flat]
    across = np.cross(normal, first, axis=0)
    angles = np.arctan2(
        np.einsum("dcf,df->cf", rays, across / np.linalg.norm(across, axis=0)),
        np.einsum("dcf,df->cf", rays, first / np.linalg.norm(first, axis=0)),
    )
    return np.take_along_axis(facets, np.argsort(angles, axis=0), axis=0)


def _draw_weights(ax: Axes, modes: ThermalEigenmodes, heat: list[str]) -> None:
    count = min(MAX_BARS, len(modes.time_constants))
    width = 0.8 / len(heat)
    for k, name in enumerate(heat):
        at = np.arange(count) + (k - (len(heat) - 1) / 2) * width
        ax.bar(at, 100 * modes.relative_weights[:count, k], width, color=CYCLE[k % len(CYCLE)],
               label=plain(name))  # fmt: skip
    unit, length = modes_unit(modes.time_constants)
    labels = [f"{j + 1}\n{modes.time_constants[j] / length:.3g}" for j in range(count)]
    ax.set_xticks(np.arange(count), labels)
    ax.set(title="Weights |ξτ|", ylabel="% of the modes", xlabel=f"mode, time constant [{unit}]")
    ax.grid(False, axis="x")
    ax.legend()
