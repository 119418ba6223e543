"""Figure of a model on a log: measured, simulated, residual, and the tests of the residual.

What a model leaves is white (no correlation with its own past) and independent of the inputs where
nothing is left to explain (Ljung 1999, 16.6).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.fitting.error_model import known_runs, long_runs
from thermaltool.fitting.residuals import correlation_tests
from thermaltool.logs import Log
from thermaltool.model import Model, started_outputs
from thermaltool.report.clock_axis import record_axis, time_unit
from thermaltool.report.pairs import Pair, draw_both, draw_error
from thermaltool.report.style import (
    COMPUTED,
    MARK,
    MEASURED,
    Array,
    choose,
    new_figure,
    plain,
    say,
    shortened,
)
from thermaltool.signals.intervals import NORMAL_95
from thermaltool.signals.whiteness import correlation_function
from thermaltool.units import parse_channel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

# Heights of the curves, the error and the correlations of an output [inch].
CURVES, ERROR_HEIGHT, CORRELATIONS = 2.7, 1.35, 2.3
# Inputs whose correlation with a residual is drawn: those with the largest.
MAX_INPUTS = 3
# Letters of all titles side by side.
TITLE_LETTERS = 90
# Lags up to this share of the rows, and up to so many of the slowest time constants; lags at least.
MAX_LAG_SHARE, MAX_LAG_TIMES, LEAST_LAGS = 0.25, 2.0, 25


def draw_comparison(model: Model, log: Log, channels: Sequence[str] = ()) -> Figure:
    """A model's outputs for the drives in a log against the measured ones, and what is left.

    Below each residual its auto-correlation and its cross-correlation with the inputs, with 95 %
    bounds.

    Raises
    ------
    ModelError
        A drive of the model is not in the log.
    LogError
        A channel that is no output of the model.
    """
    outputs = {output.channel: output for output in model.outputs}
    simulated = model.simulate(log)
    started = started_outputs(model, log, simulated)
    wanted = choose(outputs, channels, log.name)
    heights = [
        CURVES + (ERROR_HEIGHT + CORRELATIONS if name in log.columns else 0.4) for name in wanted
    ]
    figure = new_figure(f"The model on {Path(log.name).name}", 11.0, 0.6 + sum(heights))
    parts = figure.subfigures(len(wanted), 1, squeeze=False, height_ratios=heights)[:, 0]
    for part, name in zip(parts, wanted, strict=True):
        unit, title = parse_channel(name).unit, f"{name}, from rest"
        if name not in log.columns:
            ax = part.subplots()
            draw_both(ax, log, Pair(title, unit, simulated[name], None), "simulated")
            record_axis(log).mark(ax)
            continue
        computed = started[name].computed
        measured = log.columns[name] - started[name].zero.value
        above, below = part.subfigures(
            2, 1, height_ratios=(CURVES + ERROR_HEIGHT, CORRELATIONS)
        ).tolist()
        top, bottom = above.subplots(2, 1, sharex=True, height_ratios=(2.0, 1.0))
        pair = Pair(title, unit, computed, measured)
        draw_both(top, log, pair, "simulated")
        draw_error(bottom, log, pair, "measured − simulated")
        record_axis(log).mark(bottom)
        _draw_tests(below, model, log, name, measured - computed)
    return figure


def _draw_tests(figure: SubFigure, model: Model, log: Log, output: str, residual: Array) -> None:
    """Auto-correlation of a residual, and its cross-correlation with the inputs."""
    terms = [t for t in model.terms if t.output == output and t.drive in log.columns]
    drives = list(dict.fromkeys(t.drive for t in terms))
    known = residual + sum(0.0 * log.columns[name] for name in drives)
    runs = [
        slice(part.start + run.start, part.start + run.stop)
        for part in log.segments
        for run in known_runs(known[part])
    ]
    runs = [runs[k] for k in long_runs([known[run] for run in runs])]
    rows = max((run.stop - run.start for run in runs), default=0)
    slowest = max(term.response.slowest() for term in terms) if terms else 0.0
    lags = int(min(MAX_LAG_SHARE * rows, max(MAX_LAG_TIMES * slowest / log.period, LEAST_LAGS)))
    if lags < 2:
        say(figure.subplots(), "too few rows in a row for a correlation")
        return
    errors = [residual[run] for run in runs]
    delays = {t.drive: round(getattr(t.response, "delay", 0.0) / log.period) for t in terms}
    inputs = {name: [log.columns[name][run] for run in runs] for name in drives}
    tests = correlation_tests(errors, inputs, delays)
    errors = [error - np.mean(error) for error in errors]
    found = {}
    for name, values in inputs.items():
        level = np.mean(np.concatenate(values))
        found[name] = correlation_function(errors, [u - level for u in values], lags)
    strongest = sorted(found, key=lambda name: -float(np.nanmax(np.abs(found[name][0]), initial=0)))
    shown = [name for name in found if name in strongest[:MAX_INPUTS]]
    axes = figure.subplots(1, 1 + len(shown), squeeze=False, sharey=True)[0]
    own, _ = correlation_function(errors, errors, lags)
    unit, per = time_unit(lags * log.period)
    lag = np.arange(-lags, lags + 1, dtype=float) * (log.period / per)
    white = NORMAL_95 / np.sqrt(sum(map(len, errors)))
    _draw_correlation(axes[0], lag[lags + 1 :], own[lags + 1 :], white)
    axes[0].set(title=f"Whiteness{_p_value(tests.white_p)}\nof the residual",
                ylabel="auto-correlation", xlabel=f"lag [{unit}]")  # fmt: skip
    if len(shown) < len(found):
        figure.suptitle(f"the {len(shown)} of {len(found)} inputs with the largest correlation",
                        x=0.99, ha="right", fontsize=9, color="0.4")  # fmt: skip
    for k, (ax, name) in enumerate(zip(axes[1:], shown, strict=True)):
        correlation, deviation = found[name]
        _draw_correlation(ax, lag, correlation, NORMAL_95 * deviation)
        p_value = _p_value(tests.independent_p[name])
        short = shortened(name, TITLE_LETTERS // len(axes))
        ax.set(title=plain(f"Independence{p_value}\nof {short}"),
               ylabel="" if k else "cross-correlation",
               xlabel=f"lag behind the input [{unit}]")  # fmt: skip
    for ax in axes:
        ax.title.set_fontsize(9.5)


def _draw_correlation(ax: Axes, lag: Array, correlation: Array, bound: float) -> None:
    if not np.isfinite(correlation).all():
        say(ax, "one of the two does not vary")
        return
    ax.axhspan(-bound, bound, color=MEASURED, alpha=0.35, lw=0, label="95 % bound")
    style: dict[str, Any] = {"marker": ".", "ms": 3} if len(lag) < 120 else {}
    ax.plot(lag, correlation, color=COMPUTED, lw=0.8, **style)
    ax.axhline(0.0, color=MARK, lw=0.6)
    largest = max(float(np.max(np.abs(correlation))), bound)
    low, high = ax.get_ylim()
    reach = 1.15 * largest
    ax.set_ylim(min(low, -reach), max(high, reach))
    ax.legend(loc="best", fontsize=8)


def _p_value(p: float) -> str:
    """A p-value as it stands in a title; empty where there is none."""
    if not np.isfinite(p):
        return ""
    return ", p < 0.001" if p < 1e-3 else f", p = {p:.2g}"
