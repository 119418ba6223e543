"""Thermal tests of ISO 230-3 as a table, as JSON and as a figure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.documents import jsonable
from thermaltool.report.clock_axis import span_of, time_unit
from thermaltool.report.style import (
    CYCLE,
    MARK,
    channel_unit,
    legend_beside,
    panels,
    plain,
    trace_record,
)
from thermaltool.report.text import aligned
from thermaltool.units import is_temperature, symbol

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from thermaltool.signals.intervals import Estimate
    from thermaltool.signals.thermal_tests import Probe, RangeFigure, RangeTest, Run

TITLES = {
    "etve": "environmental temperature variation error",
    "spindle": "thermal distortion caused by rotating spindle",
    "axis": "thermal distortion caused by moving linear axis",
}
# More temperatures than this say less than their colours.
MAX_TEMPERATURES = 7


def range_table(result: RangeTest) -> str:
    """One block per run: a row per quantity, a column per prescribed time."""
    blocks = [f"ISO 230-3: {TITLES[result.test]}, {result.record.name}", _probe_lines(result)]
    for run in result.runs:
        if result.speed_channel is not None and run.speed is not None:
            blocks.append(f"{_speed(result, run)}, {_hours(run.duration)} from {run.start:g} s")
        else:
            blocks.append(f"{_hours(run.duration)} from {run.start:g} s")
        blocks.append(_run_table(run, result.test))
    return "\n".join(blocks)


def _probe_lines(result: RangeTest) -> str:
    return "probes: " + ", ".join(
        f"{p.channel} along {p.axis}" + ("" if p.distance is None else f" at {p.distance:g} mm")
        for p in result.probes
    )


def _run_table(run: Run, test: str) -> str:
    times = list(dict.fromkeys(each.time for each in run.figures))
    found = {(each.quantity, each.time): each for each in run.figures}
    rows = [["", *(_heading(time, test) for time in times), ""]]
    for name in dict.fromkeys(each.quantity for each in run.figures):
        own = [found.get((name, time)) for time in times]
        unit = next(each.estimate.unit for each in own if each is not None)
        first = f"ETVE({name})" if test == "etve" else f"d({name})"
        rows.append([first, *(_cell(each) for each in own), _printed(unit)])
    return aligned(rows, texts=1)


def _heading(time: float | None, test: str) -> str:
    if time is None:
        return "whole"
    span = f"{time / 3600:g} h" if time >= 7200 or test == "etve" else f"{time / 60:g} min"
    return f"in {span}" if test == "etve" else span


def _cell(figure: RangeFigure | None) -> str:
    if figure is None:
        return ""
    e = figure.estimate
    digits = _digits(e)
    return f"{e.value:.{digits}f} ({e.low:.{digits}f} to {e.high:.{digits}f})"


def _digits(e: Estimate) -> int:
    """Decimals that tell the ends of an interval apart."""
    width = e.high - e.low
    return 2 if not width > 0 else int(min(max(1 - np.floor(np.log10(width)), 0), 4))


def _printed(unit: str) -> str:
    return "µm/m" if unit == "um/m" else symbol(unit)


def _speed(result: RangeTest, run: Run) -> str:
    assert result.speed_channel is not None
    return f"{result.speed_channel} {run.speed:g} {channel_unit(result.speed_channel)}"


def _hours(seconds: float) -> str:
    return f"{seconds / 3600:.3g} h" if seconds >= 7200 else f"{seconds / 60:.3g} min"


def range_document(result: RangeTest) -> dict[str, Any]:
    """The figures with their runs, probes, and how they were made."""
    document: dict[str, Any] = jsonable(
        {
            "standard": "ISO 230-3",
            "test": result.test,
            "log": result.record.name,
            "sha256": result.record.digest,
            "average_s": result.average,
            "coverage": 0.95,
            "drift_in_intervals": result.drift,
            "speed_channel": result.speed_channel,
            "probes": [_probe(p) for p in result.probes],
            "runs": [
                {
                    "start_s": run.start,
                    "duration_s": run.duration,
                    "speed": run.speed,
                    "figures": [_figure(each) for each in run.figures],
                }
                for run in result.runs
            ],
        }
    )
    return document


def _probe(probe: Probe) -> dict[str, Any]:
    return {"channel": probe.channel, "axis": probe.axis, "distance_mm": probe.distance}


def _figure(each: RangeFigure) -> dict[str, Any]:
    e = each.estimate
    return {
        "symbol": each.symbol,
        "quantity": each.quantity,
        "time_s": each.time,
        "value": e.value,
        "low": e.low,
        "high": e.high,
        "unit": e.unit,
    }


def draw_ranges(result: RangeTest) -> Figure:
    """Displacements, tilts, temperatures and the speed, one below the other."""
    log = result.record
    quantities = result.quantities()
    temperatures = [name for name in log.columns if is_temperature(name)]
    kinds = [unit for unit in ("um", "urad", "um/m") if unit in {u for u, _ in quantities.values()}]
    heights = [3.0 if unit == "um" else 2.0 for unit in kinds]
    heights += [2.0] * bool(temperatures) + [1.0] * (result.speed_channel is not None)
    title = f"ISO 230-3: {TITLES[result.test]}, {log.name}"
    figure, axes = panels(title, heights, 1.2 + 1.15 * sum(heights))
    for ax, unit in zip(axes, kinds, strict=False):
        word = {"um": "displacement", "urad": "tilt", "um/m": "expansion"}[unit]
        curves = {name: v for name, (u, v) in quantities.items() if u == unit}
        for colour, (name, values) in zip(CYCLE * len(curves), curves.items(), strict=False):
            known = values[np.isfinite(values)]
            from_start = values - (known[0] if len(known) else 0.0)
            trace_record(ax, log, from_start, label=name, color=colour)
        ax.set_ylabel(f"{word} [{_printed(unit)}]")
        legend_beside(ax)
    rest = axes[len(kinds) :]
    if temperatures:
        _draw_temperatures(rest[0], result, temperatures)
    if result.speed_channel is not None:
        name = result.speed_channel
        trace_record(rest[-1], log, log.column(name), color=MARK, drawstyle="steps-post")
        rest[-1].set_ylabel(f"speed\n[{channel_unit(name)}]")
    per_name, per = time_unit(span_of(log.time))
    for run in result.runs[1:]:
        for ax in axes:
            ax.axvline(run.start / per, color="0.6", linewidth=0.8, linestyle=":")
    axes[-1].set_xlabel(f"time [{per_name}]")
    return figure


def _draw_temperatures(ax: Axes, result: RangeTest, names: Sequence[str]) -> None:
    """Temperatures from where they begin; of many those that move most."""
    log = result.record
    known = {n: log.column(n) for n in names if np.isfinite(log.column(n)).any()}
    most = sorted(known, key=lambda n: -float(np.nanmax(known[n]) - np.nanmin(known[n])))
    for colour, name in zip(CYCLE, most[:MAX_TEMPERATURES], strict=False):
        values = known[name]
        from_start = values - values[np.isfinite(values)][0]
        trace_record(ax, log, from_start, label=plain(name), color=colour)
    ax.set_ylabel("temperature\nrise [K]")
    legend_beside(ax)
