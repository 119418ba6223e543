"""Noise of a log as JSON document, text table and figure."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.documents import NOISE, jsonable
from thermaltool.errors import LogError
from thermaltool.logs.clock import segments
from thermaltool.report.clock_axis import ClockAxis, clock_axis
from thermaltool.report.style import (
    COMPUTED,
    ERROR,
    MARK,
    Array,
    choose,
    new_figure,
    plain,
    say,
    trace,
)
from thermaltool.report.text import aligned
from thermaltool.signals.drift import DriftFit, model_allan, model_density
from thermaltool.signals.noise import NoiseEstimate
from thermaltool.signals.spectrum import thin
from thermaltool.units import symbol

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Results = Mapping[str, "NoiseEstimate | str"]  # a string says why there is no estimate

MAX_LISTED_OUTLIERS = 100
# Heights of a page, and of the largest and the smallest row [inch]: eight rows are a page.
PAGE, MAX_ROW, MIN_ROW = 15.0, 3.0, 1.8


def noise_document(
    log: str, period: float, units: Mapping[str, str], results: Results
) -> dict[str, Any]:
    """The document that the next stage reads; figures that are not available are None."""
    return NOISE.wrap(
        {
            "log": log,
            "sample_period_s": period,
            "channels": {name: _channel(units[name], result) for name, result in results.items()},
        }
    )


def _channel(unit: str, result: NoiseEstimate | str) -> dict[str, Any]:
    if isinstance(result, str):
        return {"unit": unit, "white_sigma": None, "drift": None, "notes": [result]}
    fit, allan, level = result.drift, result.allan, result.level_dependence
    thinned = None if result.spectrum is None else thin(result.spectrum)
    return {
        "unit": unit,
        "samples": result.samples,
        "sample_period_s": result.sample_period,
        "resolution": result.resolution,
        "white_sigma": fit.white_sigma,
        "white_sigma_interval": fit.white_interval,
        "white_sigma_upper_limit": not fit.white_resolved,
        "stretch_s": result.stretch,
        "separation_cutoff_Hz": result.separation_cutoff,
        "drift": {
            "sigma": fit.sigma,
            "sigma_interval": fit.sigma_interval,
            "time_constant_s": fit.time_constant,
            "time_constant_interval_s": fit.time_constant_interval,
            "rate_per_sqrt_s": fit.rate,
            "rate_interval": fit.rate_interval,
            "upper_bound": result.upper_bound,
            "allan": None
            if allan is None
            else {
                "tau_s": allan.tau.tolist(),
                "deviation": allan.deviation.tolist(),
                "low": allan.low.tolist(),
                "high": allan.high.tolist(),
            },
        },
        "level_dependence": {
            "slope": level.slope,
            "p_value": level.p_value,
            "levels": level.levels,
            "white_sigma": level.sigmas,
            "significant": level.significant,
        },
        "lines": [
            {"frequency_Hz": line.frequency, "amplitude": line.amplitude, "p_value": line.p_value}
            for line in result.lines
        ],
        "outlier_count": result.outlier_time.size,
        "outliers": [
            {"time_s": float(t), "value": float(v)}
            for t, v in zip(
                result.outlier_time[:MAX_LISTED_OUTLIERS],
                result.outlier_value[:MAX_LISTED_OUTLIERS],
                strict=True,
            )
        ],
        "spectrum": None
        if thinned is None
        else {"frequency_Hz": thinned[0].tolist(), "density": thinned[1].tolist()},
        "notes": list(result.notes),
    }


def to_json(document: dict[str, Any]) -> bytes:
    """Sorted, one line; what is not finite is null."""
    text = json.dumps(jsonable(document), sort_keys=True, allow_nan=False, ensure_ascii=False)
    return text.encode() + b"\n"


def noise_table(units: Mapping[str, str], results: Results) -> str:
    """One row per channel, its notes below. ``<`` marks an upper bound, ``-`` what is unknown."""
    head = ["channel", "unit", "resolution", "white", "±", "drift", "tau s", "rate /√s"]
    rows = [[*head, "lines", "outliers", "level"]]
    notes = []
    for name, result in results.items():
        if isinstance(result, str):
            rows.append([name, units[name], *["-"] * (len(rows[0]) - 2)])
            notes.append(f"{name}: {result}")
            continue
        fit, bound = result.drift, "<" if result.upper_bound else ""
        low, high = fit.white_interval
        detected = fit.time_constant is not None
        rows.append(
            [
                name,
                units[name],
                _number(result.resolution),
                ("" if fit.white_resolved else "<") + _number(fit.white_sigma),
                _number((high - low) / 2.0 if fit.white_resolved else None),
                bound + _number(fit.sigma) if detected else "none",
                _number(fit.time_constant),
                bound + _number(fit.rate) if detected else "-",
                str(len(result.lines)),
                str(result.outlier_time.size),
                "yes" if result.level_dependence.significant else "no",
            ]
        )
        notes += [f"{name}: {note}" for note in result.notes]
    return "\n".join([aligned(rows, 2), *([""] if notes else []), *notes])


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


@dataclass(frozen=True)
class _Curves:
    """Allan deviation and spectrum of a channel, measured and of the fitted model; None if absent.

    `allan` holds tau [s], deviation, low and high [unit]; `spectrum` frequency [Hz] and density
    [unit²/Hz]; `lines` frequencies [Hz].
    """

    unit: str
    allan: tuple[Array, Array, Array, Array] | None
    allan_model: Array | None
    spectrum: tuple[Array, Array] | None
    density_model: Array | None
    cutoff: float | None
    lines: Array

    @staticmethod
    def of_estimate(unit: str, result: NoiseEstimate) -> _Curves:
        a, spectrum = result.allan, result.spectrum
        return _Curves(
            symbol(unit),
            None if a is None else (a.tau, a.deviation, a.low, a.high),
            result.allan_model,
            None if spectrum is None else (spectrum.frequency, spectrum.density),
            result.density_model,
            result.separation_cutoff,
            np.array([line.frequency for line in result.lines]),
        )

    @staticmethod
    def of_document(channel: Mapping[str, Any]) -> _Curves:
        """The models are computed again from the fitted parameters."""
        period, drift = channel["sample_period_s"], channel["drift"]
        allan = spectrum = allan_model = density_model = None
        fit = DriftFit(
            white_sigma=channel["white_sigma"],
            white_interval=channel["white_sigma_interval"],
            white_resolved=not channel["white_sigma_upper_limit"],
            sigma=drift["sigma"],
            sigma_interval=drift["sigma_interval"],
            time_constant=drift["time_constant_s"],
            time_constant_interval=drift["time_constant_interval_s"],
            rate=drift["rate_per_sqrt_s"],
            rate_interval=drift["rate_interval"],
            at_bound=drift["upper_bound"],
        )
        if (a := drift["allan"]) is not None:
            tau, deviation, low, high = (
                np.array(a[key], float) for key in ("tau_s", "deviation", "low", "high")
            )
            allan = tau, deviation, low, high
            allan_model = model_allan(np.rint(tau / period).astype(np.int64), period, fit)
        if (s := channel["spectrum"]) is not None:
            frequency, density = (np.array(s[key], float) for key in ("frequency_Hz", "density"))
            spectrum = frequency, density
            density_model = model_density(frequency, period, fit)
        return _Curves(
            symbol(channel["unit"]),
            allan,
            allan_model,
            spectrum,
            density_model,
            channel["separation_cutoff_Hz"],
            np.array([line["frequency_Hz"] for line in channel["lines"]]),
        )


def draw_figure(
    log: str, units: Mapping[str, str], results: Results, epoch: str | None = None
) -> Figure:
    """Residual, Allan deviation and spectrum, one channel per row; eight on a page.

    Channels without noise are named at the top. `epoch` is the moment at which the clock is 0.
    """
    estimates = {name: r for name, r in results.items() if isinstance(r, NoiseEstimate)}
    noisy = {name: r for name, r in estimates.items() if r.residual.any()} or estimates
    figure, rows, bottom = _page(f"Noise of {Path(log).name}", noisy, 3)
    # Each channel has the stretch on which it is level: one axis for all.
    ends = [time for result in noisy.values() for time in result.time[[0, -1]].tolist()]
    axis = clock_axis(np.array([min(ends), max(ends)]), epoch)
    for row, (name, result) in zip(rows, noisy.items(), strict=True):
        curves = _Curves.of_estimate(units[name], result)
        _draw_residual(row[0], curves.unit, result, axis)
        _draw_allan(row[1], curves)
        _draw_spectrum(row[2], curves)
    _finish(figure, rows, [name for name in results if name not in noisy])
    axis.mark(bottom[0], ticks=5)
    bottom[1].set(xlabel="averaging time τ [s]")
    bottom[2].set(xlabel="frequency [Hz]")
    return figure


def draw_document(document: Mapping[str, Any], name: str, channels: Sequence[str] = ()) -> Figure:
    """Allan deviation and spectrum of what `noise_document` holds, one channel per row.

    Channels without noise are left out unless they are named.

    Raises
    ------
    LogError
        A channel that is not there, or no channel with noise.
    """
    known: Mapping[str, Any] = document["channels"]
    chosen = {n: known[n] for n in choose(known, channels, name) if known[n].get("drift")}
    if not channels:
        chosen = {n: channel for n, channel in chosen.items() if channel["drift"]["allan"]}
    if not chosen:
        raise LogError("no noise to draw", name)
    title = f"Noise of {Path(document['log']).name}"
    figure, rows, bottom = _page(title, chosen, 2)
    for row, part in zip(rows, chosen.values(), strict=True):
        curves = _Curves.of_document(part)
        _draw_allan(row[0], curves)
        _draw_spectrum(row[1], curves)
    _finish(figure, rows, [] if channels else [n for n in known if n not in chosen])
    bottom[0].set(xlabel="averaging time τ [s]")
    bottom[1].set(xlabel="frequency [Hz]")
    return figure


def _page(title: str, channels: Iterable[str], columns: int) -> tuple[Figure, Any, Any]:
    """A figure of a row for each channel, its axes, and those that have a label for x."""
    names = list(channels)
    each = min(MAX_ROW, max(MIN_ROW, PAGE / len(names)))
    figure = new_figure(title, 13.0, 1.3 + each * len(names))
    rows = figure.subplots(len(names), columns, squeeze=False, sharex="col")
    for row, name in zip(rows, names, strict=True):
        row[0].set_title(plain(name), loc="left", fontsize=10, fontweight="bold")
    for ax, heading in zip(rows[0][-2:], ("Allan deviation", "Spectrum"), strict=True):
        ax.set_title(heading, loc="right", fontsize=10)
    return figure, rows, rows[-1]


def _finish(figure: Figure, rows: Any, without: Sequence[str]) -> None:
    """One legend for all rows, and the channels that show no noise."""
    entries: dict[str, Any] = {}
    for ax in rows.flat:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if entries:
        figure.legend(list(entries.values()), list(entries), loc="outside lower center",
                      ncols=len(entries))  # fmt: skip
    if without:
        names = shorten(", ".join(without), 110, placeholder=" …")
        figure.text(0.99, 0.995, plain(f"no noise seen: {names}"), ha="right", va="top",
                    fontsize=9, color="0.4")  # fmt: skip


def _draw_residual(ax: Axes, unit: str, result: NoiseEstimate, axis: ClockAxis) -> None:
    ax.set(ylabel=f"residual [{unit}]")
    if not result.residual.any():
        say(ax, result.notes[0].replace(": ", ":\n"))
        return
    if result.separation_cutoff is not None:
        ax.text(0.01, 0.97, "slow signal taken off", transform=ax.transAxes, va="top", fontsize=8,
                color="0.4")  # fmt: skip
    parts = segments(result.time)
    trace(ax, result.time, result.residual, parts, axis=axis, lw=0.5, color=COMPUTED)
    if result.drift.white_sigma > 0.0:
        for side in (-2.0, 2.0):
            ax.axhline(side * result.drift.white_sigma, color=ERROR, lw=1.2, ls=":",
                       label="±2 white σ")  # fmt: skip


def _draw_allan(ax: Axes, curves: _Curves) -> None:
    ax.set(ylabel=f"deviation [{curves.unit}]")
    if curves.allan is None or curves.allan_model is None or not curves.allan[1].all():
        say(ax, "not available")
        return
    tau, deviation, low, high = curves.allan
    ax.fill_between(tau, low, high, color=COMPUTED, alpha=0.2, lw=0, label="95 %")
    ax.loglog(tau, deviation, ".-", ms=4, lw=1.0, color=COMPUTED, label="measured")
    ax.loglog(tau, curves.allan_model, "--", lw=1.4, color=ERROR, label="white + drift, fitted")
    if curves.cutoff is not None:
        ax.text(0.5, 0.97, "signal included", transform=ax.transAxes, va="top", ha="center",
                fontsize=8, color="0.4")  # fmt: skip
    _few_ticks(ax)


def _draw_spectrum(ax: Axes, curves: _Curves) -> None:
    ax.set(ylabel=f"density [{curves.unit}²/Hz]")
    if curves.spectrum is None or curves.density_model is None or not curves.spectrum[1].any():
        say(ax, "not available")
        return
    frequency, density = curves.spectrum
    ax.loglog(frequency, density, lw=0.7, color=COMPUTED)
    ax.loglog(frequency, curves.density_model, "--", lw=1.4, color=ERROR)
    if curves.cutoff is not None:
        right = max(curves.cutoff, frequency[0])
        ax.axvspan(frequency[0], right, color="0.9", label="taken as signal")
    if curves.lines.size:
        height = np.interp(curves.lines, frequency, density)
        ax.loglog(curves.lines, height, "v", ms=6, mfc="none", color=MARK, label="line")
    _few_ticks(ax)


def _few_ticks(ax: Axes) -> None:
    """Decades alone where there are two of them, else few numbers: rows are low."""
    from matplotlib.ticker import LogLocator, NullFormatter

    ax.xaxis.set_minor_formatter(NullFormatter())
    low, high = ax.get_ylim()
    if high / low > 30:
        ax.yaxis.set_minor_formatter(NullFormatter())
    else:
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
        ax.yaxis.set_major_formatter("{x:.0e}")
        ax.yaxis.set_minor_formatter(NullFormatter())
