"""Figures of records as they are: logs, and the setpoints of a stream."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from thermaltool.errors import LogError
from thermaltool.logs import Log
from thermaltool.report.clock_axis import record_axis
from thermaltool.report.style import (
    COMPUTED,
    CYCLE,
    MEASURED,
    choose,
    legend_beside,
    panels,
    quantity_label,
    trace_record,
)
from thermaltool.units import parse_channel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# How simulate, compensate and forecast name their columns.
RESIDUAL, SETPOINT, FORECAST = "residual_", "offset_", "forecast_"


def draw_log(log: Log, channels: Sequence[str] = ()) -> Figure:
    """One panel per unit, all against one clock.

    Raises
    ------
    LogError
        No channels, or a channel that is not there.
    """
    names = choose(log.columns, channels, log.name)
    if not names:
        raise LogError("no channels besides the clock: nothing to draw", log.name)
    units = _by_unit(names)
    figure, axes = panels(Path(log.name).name, [1.0] * len(units), 1.0 + 2.4 * len(units))
    _draw_units(axes, log, units)
    record_axis(log).mark(axes[-1])
    return figure


def draw_setpoints(log: Log, channels: Sequence[str] = ()) -> Figure:
    """What ``compensate`` writes: each setpoint over the deflection it cancels, then the rest.

    Raises
    ------
    LogError
        A channel that is not there.
    """
    names = choose(log.columns, channels, log.name)
    setpoints = [name for name in names if name.startswith(SETPOINT)]
    followed = [deflection_of(name) for name in setpoints]
    units = _by_unit([n for n in names if n not in setpoints and n not in followed])
    count = len(setpoints) + len(units)
    figure, axes = panels(f"Setpoints, {Path(log.name).name}", [1.0] * count, 1.0 + 2.4 * count)
    for ax, name, deflection in zip(axes, setpoints, followed, strict=False):
        if deflection in log.columns:
            negative = -log.columns[deflection]
            label = f"−{deflection}, estimated"
            trace_record(ax, log, negative, color=MEASURED, lw=2.5, label=label)
        trace_record(ax, log, log.columns[name], color=COMPUTED, label=name)
        ax.set(ylabel=quantity_label(parse_channel(name).unit))
        legend_beside(ax)
    _draw_units(axes[len(setpoints) :], log, units)
    record_axis(log).mark(axes[-1])
    return figure


def deflection_of(setpoint: str) -> str:
    """The deflection that a setpoint cancels: ``offset_x_um`` gives ``d_x_um``."""
    return "d_" + setpoint.removeprefix(SETPOINT)


def _draw_units(axes: Iterable[Axes], log: Log, units: dict[str, list[str]]) -> None:
    for ax, (unit, names) in zip(axes, units.items(), strict=True):
        for k, name in enumerate(names):
            look = {"color": CYCLE[k % len(CYCLE)], "ls": ("-", "--", ":")[k // len(CYCLE) % 3]}
            trace_record(ax, log, log.columns[name], label=name, **look)
        ax.set(ylabel=quantity_label(unit))
        legend_beside(ax)


def _by_unit(names: Sequence[str]) -> dict[str, list[str]]:
    units: dict[str, list[str]] = {}
    for name in names:
        units.setdefault(parse_channel(name).unit, []).append(name)
    return units
