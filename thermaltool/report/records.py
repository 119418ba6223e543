"""Figures of records as they are: logs, and the setpoints of a stream."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from thermaltool.errors import LogError
from thermaltool.estimation.batch import SIGMA
from thermaltool.logs import Log
from thermaltool.report.clock_axis import record_axis
from thermaltool.report.style import (
    COMPUTED,
    CYCLE,
    MEASURED,
    choose,
    legend_beside,
    panels,
    plain,
    quantity_label,
    trace_record,
    visible,
)
from thermaltool.signals.intervals import NORMAL_95
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
    drawn = [name for name in followed if name in log.columns]
    beside = {*setpoints, *followed, *(SIGMA + name for name in drawn)}
    units = _by_unit([name for name in names if name not in beside])
    count = len(setpoints) + len(units)
    figure, axes = panels(f"Setpoints, {Path(log.name).name}", [1.0] * count, 1.0 + 2.4 * count)
    for ax, name, deflection in zip(axes, setpoints, followed, strict=False):
        if deflection in log.columns:
            negative = -log.columns[deflection]
            label = f"−{deflection}, estimated"
            if SIGMA + deflection in names:
                _draw_band(ax, log, deflection, MEASURED, -1.0)
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
        for k, name in enumerate(n for n in names if _estimate_of(n) not in names):
            color = CYCLE[k % len(CYCLE)]
            if SIGMA + name in names:
                _draw_band(ax, log, name, color)
            trace_record(ax, log, log.columns[name], label=name, color=color,
                         ls=("-", "--", ":")[k // len(CYCLE) % 3])  # fmt: skip
        ax.set(ylabel=quantity_label(unit))
        legend_beside(ax)


def _estimate_of(name: str) -> str:
    """The estimate of which a channel is the standard error; empty where it is none."""
    return name.removeprefix(SIGMA) if name.startswith(SIGMA) else ""


def _draw_band(ax: Axes, log: Log, name: str, color: str, sign: float = 1.0) -> None:
    """The 95 % interval of an estimate, shaded."""
    value, half = sign * log.columns[name], NORMAL_95 * log.columns[SIGMA + name]
    time, low = visible(log.time, value - half, log.segments)
    other, high = visible(log.time, value + half, log.segments)
    high = np.interp(time, other[np.isfinite(other)], high[np.isfinite(other)])
    ax.fill_between(record_axis(log).of(time), low, high, color=color, alpha=0.25, lw=0,
                    label=plain(f"{name}, 95 %"))  # fmt: skip


def _by_unit(names: Sequence[str]) -> dict[str, list[str]]:
    units: dict[str, list[str]] = {}
    for name in names:
        units.setdefault(parse_channel(name).unit, []).append(name)
    return units
