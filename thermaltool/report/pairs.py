"""Figures of what was computed against what was measured: both, and their difference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from thermaltool.errors import LogError
from thermaltool.logs import Log
from thermaltool.model import Model, beside, relative, started_outputs
from thermaltool.report.records import RESIDUAL, SETPOINT, deflection_of, label_time
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


def draw_comparison(model: Model, log: Log, channels: Sequence[str] = ()) -> Figure:
    """A model's outputs for the drives in a log, against the measured ones.

    Raises
    ------
    ModelError
        A drive of the model is not in the log.
    LogError
        A channel that is no output of the model.
    """
    outputs = {output.channel: output for output in model.outputs}
    simulated = model.simulate(log)
    pairs = []
    started = started_outputs(model, log, simulated)
    for name in choose(outputs, channels, log.name):
        computed, measured = simulated[name], None
        if name in started:
            computed = started[name].computed
            measured = log.columns[name] - started[name].zero.value
        pairs.append(Pair(f"{name}, from rest", _unit(name), computed, measured))
    return draw_pairs(f"The model on {Path(log.name).name}", log, pairs, "simulated")


def draw_estimate(log: Log, reference: Log, channels: Sequence[str] = ()) -> Figure:
    """What ``estimate`` writes, against the log that holds the truth.

    The zero of displacements, angles and absolute temperatures is arbitrary: they count from the
    level of measured minus estimated over the first rows.

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
             _measured(log.time, log.columns[name], reference, name))
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
        _draw_both(next(following), log, pair, what)
        if pair.measured is not None:
            error = pair.measured - pair.computed
            label = difference or f"measured − {what}"
            ax = next(following)
            trace_record(ax, log, error, color=ERROR, lw=0.8, label=label)
            _mark_band(ax, pair.unit, pair.measured, pair.computed)
    label_time(axes[-1], log)
    return figure


def _draw_both(ax: Axes, log: Log, pair: Pair, what: str) -> None:
    """Both traces, the rougher one below so that neither hides the other."""
    ax.set(title=plain(pair.title), ylabel=quantity_label(pair.unit))
    above = 0.0
    if pair.measured is not None:
        above = np.sign(_roughness(pair.computed) - _roughness(pair.measured))
        trace_record(ax, log, pair.measured, color=MEASURED, lw=2.5, zorder=3.0 + 0.5 * above,
                     label="measured")  # fmt: skip
    trace_record(ax, log, pair.computed, color=COMPUTED, zorder=3.0 - 0.5 * above, label=what)
    legend_beside(ax)


def _mark_band(ax: Axes, unit: str, measured: Array, computed: Array) -> None:
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


def _measured(time: Array, computed: Array, reference: Log, channel: str) -> Array:
    """A channel of the reference at the times of a result, from rest where its zero is free."""
    values = _at(time, reference, channel)
    if not counts_from_first(channel):
        return values
    return beside(values, computed)


def _at(time: Array, reference: Log, channel: str) -> Array:
    """A channel of the reference at the times of a result, NaN outside its record."""
    values = reference.columns[channel]
    if np.array_equal(time, reference.time):
        return values
    there = np.isfinite(values)
    if not there.any() or time[-1] < reference.time[0] or time[0] > reference.time[-1]:
        raise LogError("no time in common with the result", reference.name, column=channel)
    return np.interp(time, reference.time[there], values[there], left=np.nan, right=np.nan)
