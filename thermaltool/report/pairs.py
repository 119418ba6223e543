"""Figures of what was computed against what was measured: both, and their difference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from thermaltool.errors import LogError
from thermaltool.logs import Log
from thermaltool.model import Zero, relative, zero_beside
from thermaltool.report.clock_axis import record_axis
from thermaltool.report.records import RESIDUAL, SETPOINT, deflection_of
from thermaltool.report.style import (
    COMPUTED,
    ERROR,
    MEASURED,
    Array,
    choose,
    legend_beside,
    panels,
    plain,
    quantity_label,
    trace_record,
    with_unit,
)
from thermaltool.signals.agreement import agreement
from thermaltool.units import counts_from_first, parse_channel, symbol

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Pair:
    """A computed channel and, where there is one, what was measured of it; shape (n,) each."""

    title: str
    unit: str
    computed: Array
    measured: Array | None


def draw_simulation(log: Log, channels: Sequence[str] = ()) -> Figure:
    """What ``simulate`` writes: outputs, and residuals where the output was measured.

    Raises
    ------
    LogError
        A channel that is not there.
    """
    pairs = []
    for name in choose((n for n in log.columns if not n.startswith(RESIDUAL)), channels, log.name):
        computed, residual = log.columns[name], log.columns.get(RESIDUAL + name)
        measured = None if residual is None else computed + residual
        pairs.append(Pair(name, _unit(name), computed, measured))
    return draw_pairs(f"Simulated and measured, {Path(log.name).name}", log, pairs, "simulated")


def draw_estimate(
    log: Log,
    reference: Log,
    channels: Sequence[str] = (),
    zeros: Mapping[str, Zero] = MappingProxyType({}),
) -> Figure:
    """What ``estimate`` writes, against the log that holds the truth.

    The zero of displacements, angles and absolute temperatures is arbitrary: they count from
    `zeros`, without these from the level of measured minus estimated over the first rows.

    Raises
    ------
    LogError
        The two have no channel or no time in common, or a channel is not there.
    """
    common = [name for name in log.columns if name in reference.columns]
    if not common:
        raise LogError(
            f"no channel in common with {reference.name} (there are: {', '.join(log.columns)})",
            log.name,
        )
    pairs = [
        Pair(_titled(name), _unit(name), log.columns[name],
             _measured(log.time, log.columns[name], reference, name, zeros.get(name)))
        for name in choose(common, channels, log.name)
    ]  # fmt: skip
    title = f"{Path(log.name).name} against {Path(reference.name).name}"
    return draw_pairs(title, log, pairs, "estimated")


def draw_compensation(log: Log, reference: Log, channels: Sequence[str] = ()) -> Figure:
    """Setpoints against the measured deflections: what stays after the correction.

    Raises
    ------
    LogError
        The reference lacks every deflection that is corrected, or a channel is not there.
    """
    setpoints = [name for name in log.columns if name.startswith(SETPOINT)]
    known = [name for name in setpoints if deflection_of(name) in reference.columns]
    if not known:
        wanted = ", ".join(map(deflection_of, setpoints))
        raise LogError(f"none of the deflections that are corrected: {wanted}", reference.name)
    # The safe setpoint that ends a stream at the time of its last line corrects nothing.
    counts = np.append(True, np.diff(log.time) > 0)
    # The last row is where the stream has ended, be it at a time of its own.
    counts[-1] = len(log) == 1
    pairs = []
    for name in choose(known, channels, log.name):
        deflection = deflection_of(name)
        against = np.where(counts, -log.columns[name], np.nan)
        # What is given out counts from rest: an error of its zero is one.
        measured = _at(log.time, reference, deflection)
        if counts_from_first(deflection):
            measured = relative(measured, "first")
        pairs.append(Pair(f"{_titled(deflection)}, and {name}", _unit(name), against, measured))
    title = f"{Path(log.name).name} against {Path(reference.name).name}"
    return draw_pairs(title, log, pairs, "−setpoint", "what is left:\nmeasured + setpoint")


def draw_pairs(
    title: str, log: Log, pairs: Sequence[Pair], what: str, difference: str | None = None
) -> Figure:
    """Per channel: measured and computed above, their difference with its band below.

    Parameters
    ----------
    log : Log
        The clock of the pairs.
    what : str
        What the computed channels are called: "simulated", "estimated".
    difference : str, optional
        What measured minus computed is called.
    """
    heights = [h for pair in pairs for h in ((2.0,) if pair.measured is None else (2.0, 1.0))]
    figure, axes = panels(title, heights, 0.8 + 1.35 * sum(heights))
    following = iter(axes)
    for pair in pairs:
        draw_both(next(following), log, pair, what)
        if pair.measured is not None:
            draw_error(next(following), log, pair, difference or f"measured − {what}")
    record_axis(log).mark(axes[-1])
    return figure


def draw_both(ax: Axes, log: Log, pair: Pair, what: str) -> None:
    """Both traces, the rougher one below so that neither hides the other.

    Parameters
    ----------
    log : Log
        The clock of the pair.
    what : str
        What the computed channel is called.
    """
    ax.set(title=plain(pair.title), ylabel=quantity_label(pair.unit))
    above = 0.0
    if pair.measured is not None:
        above = np.sign(_roughness(pair.computed) - _roughness(pair.measured))
        trace_record(ax, log, pair.measured, color=MEASURED, lw=2.5, zorder=3.0 + 0.5 * above,
                     label="measured")  # fmt: skip
    trace_record(ax, log, pair.computed, color=COMPUTED, zorder=3.0 - 0.5 * above, label=what)
    legend_beside(ax)


def draw_error(ax: Axes, log: Log, pair: Pair, label: str) -> None:
    """Measured minus computed, with its band.

    Parameters
    ----------
    log : Log
        The clock of the pair, which was measured.
    label : str
        What the error is called.
    """
    unit, measured, computed = pair.unit, pair.measured, pair.computed
    assert measured is not None
    trace_record(ax, log, measured - computed, color=ERROR, lw=0.8, label=label)
    judged = agreement(measured, computed)
    ax.set(ylabel=f"error [{symbol(unit)}]")
    ax.margins(y=0.15)
    if judged.rows:
        error = measured - computed
        band, rms = (with_unit(value, symbol(unit)) for value in (judged.band, judged.rmse))
        ax.axhspan(np.nanmin(error), np.nanmax(error), color="0.92", zorder=0,
                   label=f"band {band}\nRMS {rms}")  # fmt: skip
    legend_beside(ax)


def _roughness(values: Array) -> float:
    """Mean change from row to row; zero where nothing is there."""
    steps = np.abs(np.diff(values))
    return float(np.mean(steps[np.isfinite(steps)])) if np.isfinite(steps).any() else 0.0


def _unit(channel: str) -> str:
    return parse_channel(channel).unit


def _titled(channel: str) -> str:
    return f"{channel}, from rest" if counts_from_first(channel) else channel


def _measured(
    time: Array, computed: Array, reference: Log, channel: str, zero: Zero | None
) -> Array:
    """A channel of the reference at the times of a result, from rest where its zero is free."""
    values = _at(time, reference, channel)
    if not counts_from_first(channel):
        return values
    return values - (zero or zero_beside(time, values, computed, "first")).value


def _at(time: Array, reference: Log, channel: str) -> Array:
    """A channel of the reference at the times of a result, NaN outside its record."""
    values = reference.columns[channel]
    if np.array_equal(time, reference.time):
        return values
    there = np.isfinite(values)
    if not there.any() or time[-1] < reference.time[0] or time[0] > reference.time[-1]:
        raise LogError("no time in common with the result", reference.name, column=channel)
    return np.interp(time, reference.time[there], values[there], left=np.nan, right=np.nan)
