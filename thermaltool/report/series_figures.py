"""Figures of series: orders, spectrum and roots of an ARMA model, forecasts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.errors import UnitError
from thermaltool.logs import Log
from thermaltool.record import Record
from thermaltool.report.clock_axis import clock_axis, record_axis
from thermaltool.report.records import FORECAST
from thermaltool.report.style import (
    COMPUTED,
    CYCLE,
    ERROR,
    MARK,
    MEASURED,
    Array,
    channel_unit,
    choose,
    legend_beside,
    new_figure,
    panels,
    plain,
    quantity_label,
    trace,
)
from thermaltool.signals.intervals import NORMAL_95
from thermaltool.timeseries.model import ArmaModel
from thermaltool.timeseries.polynomials import characteristic_roots
from thermaltool.timeseries.roots import modes
from thermaltool.units import parse_channel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NAMES = {"aic": "AIC", "aicc": "AICc", "bic": "BIC", "gao": "Gao's AIC"}
# How forecast names the ends of an interval.
INTERVAL = ("low_", "high_")
# Samples of the series that are drawn before a forecast: so many times its steps, and at least.
HISTORY_STEPS, LEAST_HISTORY = 5, 60


def draw_orders(document: Mapping[str, Any]) -> Figure:
    """Criteria above their best against the AR order, one curve for each MA order.

    Orders by exact likelihood have a point, the others are from one regression.

    Parameters
    ----------
    document : mapping
        What ``order --json`` writes.
    """
    best: Mapping[str, Any] = document["best"]
    max_p = max(entry["p"] for entry in document["table"])
    series = f" of {document['series']}" if document.get("series") else ""
    figure = new_figure(f"Orders{series}", 4.6 * len(best), 4.2)
    axes = figure.subplots(1, len(best), squeeze=False)[0]
    for ax, (name, order) in zip(axes, best.items(), strict=True):
        shown = {(e["p"], e["q"]): e[name] - order["value"] for e in document["table"]}
        exact = {(e["p"], e["q"]) for e in document["table"] if e["exact"]}
        orders = range(max_p + 1)
        for k, q in enumerate(sorted({q for _, q in shown})):
            look = {"color": CYCLE[k % len(CYCLE)], "ls": ("-", "--", ":")[k // len(CYCLE) % 3]}
            line = np.array([shown.get((p, q), np.nan) for p in orders])
            sure = np.array([(p, q) in exact for p in orders])
            ax.plot(orders, line, lw=0.7, alpha=0.5, **look)
            ax.plot(
                orders, np.where(sure, line, np.nan), marker=".", ms=8, label=f"q = {q}", **look
            )
        ax.plot(order["p"], 0.0, "o", ms=9, mfc="none", color=MARK, label="best")
        title = f"{_NAMES.get(name, name)}: best {order['p']},{order['q']}"
        ax.set(title=plain(title), xlabel="AR order p", xlim=(-0.5, max_p + 0.5))
        ax.xaxis.get_major_locator().set_params(integer=True)
        ax.set_yscale("symlog", linthresh=10.0)
        ax.set_ylim(-1.5, 2.0 * max(*shown.values(), 5.0))
    axes[0].set(ylabel="criterion above its best, linear up to 10")
    axes[-1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8,
                    title="point: exact,\nelse approximate", title_fontsize=8)  # fmt: skip
    return figure


def spectral_density(model: ArmaModel, frequency: Array) -> tuple[Array, Array]:
    """One-sided density of the (differenced) series, and the standard error of its logarithm.

    S(f) = 2 σ² Δ |1 + Σ ma_j z⁻ʲ|² / |1 − Σ ar_i z⁻ⁱ|², z = e^(2πi f Δ); that of the coefficients
    to first order.

    Parameters
    ----------
    model : ArmaModel
    frequency : ndarray, shape (n,) [Hz]

    Returns
    -------
    density : ndarray, shape (n,) [unit²/Hz]
    error : ndarray, shape (n,)
        NaN where the coefficients are undetermined.
    """
    p, q = model.ar.size, model.ma.size
    lag = np.exp(-2j * np.pi * np.outer(frequency * model.period_s, np.arange(1, max(p, q, 1) + 1)))
    ar, ma = 1.0 - lag[:, :p] @ model.ar, 1.0 + lag[:, :q] @ model.ma
    density = 2.0 * model.sigma2 * model.period_s * np.abs(ma) ** 2 / np.abs(ar) ** 2
    slope = np.hstack([2 * (lag[:, :p] / ar[:, None]).real, 2 * (lag[:, :q] / ma[:, None]).real])
    if model.covariance is None:
        return density, np.full(len(frequency), np.nan)
    variance = np.einsum("ni,ij,nj->n", slope, model.covariance, slope)
    return density, np.sqrt(np.maximum(variance, 0.0))


def draw_arma(model: ArmaModel) -> Figure:
    """Spectral density with its 95 % band, and AR and MA roots in the unit circle.

    Parameters
    ----------
    model : ArmaModel
    """
    title = f"ARMA({model.ar.size},{model.ma.size}) of {model.channel}"
    if model.difference:
        title += f", difference {model.difference}"
    figure = new_figure(title, 11.0, 4.6)
    left, right = figure.subplots(1, 2, width_ratios=(1.4, 1.0))
    half = 0.5 / model.period_s
    frequency = np.geomspace(half / 1000, half, 800)
    density, error = spectral_density(model, frequency)
    if np.isfinite(error).all():
        spread = np.exp(np.minimum(NORMAL_95 * error, 50.0))
        left.fill_between(frequency, density / spread, density * spread, color=MEASURED, alpha=0.6,
                          lw=0, label="95 %")  # fmt: skip
    left.loglog(frequency, density, color=COMPUTED, label="model")
    for k, mode in enumerate(mode for mode in modes(model) if mode.natural is not None):
        natural = mode.natural.value / (2 * np.pi) if mode.natural else 0.0
        left.axvline(natural, color=ERROR, ls="--", lw=0.9,
                     label="" if k else "natural frequencies")  # fmt: skip
    unit = _unit(model.channel)
    left.set(title="Spectral density", xlabel="frequency [Hz]", ylabel=f"density [{unit}²/Hz]",
             ylim=(0.5 * density.min(), 2 * density.max()))  # fmt: skip
    left.legend(loc="best", fontsize=8)
    _draw_roots(right, model)
    return figure


def _draw_roots(ax: Axes, model: ArmaModel) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    ax.plot(np.cos(angle), np.sin(angle), color="0.6", lw=0.8)
    for label, style, color, roots in (
        ("AR: poles", "x", COMPUTED, characteristic_roots(model.ar)),
        ("MA: zeros", "o", ERROR, characteristic_roots(-model.ma)),
    ):
        if roots.size:
            ax.plot(roots.real, roots.imag, style, ms=8, mew=1.8, mfc="none", color=color,
                    label=label)  # fmt: skip
    ax.set(title="Roots, inside the unit circle", xlabel="real part", ylabel="imaginary part",
           aspect="equal")  # fmt: skip
    if model.ar.size or model.ma.size:
        legend_beside(ax)


def _unit(channel: str) -> str:
    """Printed unit of a series, whose column may have any name."""
    try:
        return channel_unit(channel)
    except UnitError:
        return "unit"


@dataclass(frozen=True)
class ForecastCurve:
    """Forecasts of a channel with their interval, shape (n,) each; times in [s]."""

    channel: str
    time: Array
    value: Array
    low: Array
    high: Array


def draw_forecasts(forecasts: Sequence[ForecastCurve], history: Record | None = None) -> Figure:
    """Forecasts with their shaded intervals, after the end of the series where it is known.

    Parameters
    ----------
    forecasts : sequence of ForecastCurve
    history : Record, optional
        The series, on the clock of the forecasts.
    """
    figure, axes = panels(f"Forecast of {', '.join(f.channel for f in forecasts)}",
                          [1.0] * len(forecasts), 0.8 + 3.4 * len(forecasts))  # fmt: skip
    shown = _shown(forecasts[0], history)
    whole = forecasts[0].time if shown is None else np.append(shown.time, forecasts[0].time)
    axis = clock_axis(np.sort(whole)) if history is None else record_axis(history)
    if not axis.dated:
        axis = clock_axis(np.sort(whole))
    for ax, found in zip(axes, forecasts, strict=True):
        ax.fill_between(axis.of(found.time), found.low, found.high, color=COMPUTED, alpha=0.25,
                        lw=0, label="interval")  # fmt: skip
        if shown is not None and found.channel in shown.columns:
            trace(ax, shown.time, shown.columns[found.channel], axis=axis, color=MEASURED, lw=1.6,
                  label="measured")  # fmt: skip
        trace(ax, found.time, found.value, axis=axis, color=COMPUTED, label="forecast")
        try:
            ax.set(ylabel=quantity_label(parse_channel(found.channel).unit))
        except UnitError:
            ax.set(ylabel=plain(found.channel))
        legend_beside(ax)
    axis.mark(axes[-1])
    return figure


def _shown(forecast: ForecastCurve, history: Record | None) -> Record | None:
    """The rows of a history that are drawn: its end before the forecast, and what goes with it."""
    if history is None:
        return None
    rows = max(HISTORY_STEPS * len(forecast.time), LEAST_HISTORY)
    first = max(int(np.searchsorted(history.time, forecast.time[0])) - rows, 0)
    kept = slice(first, int(np.searchsorted(history.time, forecast.time[-1], side="right")))
    columns = {name: values[kept] for name, values in history.columns.items()}
    return Record(history.time[kept], columns, name=history.name)


def draw_forecast_table(table: Log, log: Log | None, channels: Sequence[str] = ()) -> Figure:
    """What ``forecast`` writes, after the end of its log where that is given.

    Raises
    ------
    LogError
        A channel that is not forecast.
    """
    known = [name.removeprefix(FORECAST) for name in table.columns if name.startswith(FORECAST)]
    wanted = choose(known, channels, table.name)
    found = [
        ForecastCurve(
            name, table.time, *(table.column(f"{k}{name}") for k in (FORECAST, *INTERVAL))
        )
        for name in wanted
    ]
    return draw_forecasts(found, log)
