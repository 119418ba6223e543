"""Noise of a log as JSON document, text table and figure."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.errors import OutputError
from thermaltool.signals.noise import NoiseEstimate
from thermaltool.signals.spectrum import thin

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Results = Mapping[str, "NoiseEstimate | str"]  # a string says why there is no estimate

_OUTLIERS_LISTED = 100
_FIGURES = ("png", "svg", "pdf")
_DATA, _MODEL, _MARK = "#4878a8", "#c1432b", "#222222"


def noise_document(
    log: str, period: float, units: Mapping[str, str], results: Results
) -> dict[str, Any]:
    """The document that the next stage reads; figures that are not available are None."""
    return {
        "format": "thermaltool-noise",
        "version": 1,
        "log": log,
        "sample_period_s": period,
        "channels": {name: _channel(units[name], result) for name, result in results.items()},
    }


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
                result.outlier_time[:_OUTLIERS_LISTED],
                result.outlier_value[:_OUTLIERS_LISTED],
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
    text = json.dumps(_finite(document), sort_keys=True, allow_nan=False, ensure_ascii=False)
    return text.encode() + b"\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


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
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join(
            cell.ljust(width) if k < 2 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    return "\n".join([*lines, *([""] if notes else []), *notes])


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def figure_format(path: str) -> str:
    """Format by suffix.

    Raises
    ------
    OutputError
        Where the suffix is none of .png, .svg, .pdf.
    """
    suffix = Path(path).suffix.lower().lstrip(".")
    if suffix not in _FIGURES:
        raise OutputError(f"{path}: a figure's name ends in .png, .svg or .pdf")
    return suffix


def draw_figure(log: str, units: Mapping[str, str], results: Results) -> Figure:
    """Residual, Allan deviation and spectrum, one channel per row."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    estimates = {name: r for name, r in results.items() if isinstance(r, NoiseEstimate)}
    figure = Figure(figsize=(13.0, 0.6 + 3.0 * len(estimates)), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(f"Noise of {Path(log).name}")
    axes = figure.subplots(len(estimates), 3, squeeze=False)
    for row, (name, result) in zip(axes, estimates.items(), strict=True):
        _draw_residual(row[0], name, units[name], result)
        _draw_allan(row[1], units[name], result)
        _draw_spectrum(row[2], units[name], result)
    return figure


def _draw_residual(ax: Axes, name: str, unit: str, result: NoiseEstimate) -> None:
    what = "about the mean" if result.separation_cutoff is None else "without slow signal"
    ax.set(title=f"{name}, {what}", xlabel="time [s]", ylabel=f"residual [{unit}]")
    if not result.residual.any():
        _say(ax, result.notes[0].replace(": ", ":\n"))
        return
    ax.plot(result.time, result.residual, lw=0.5, color=_DATA, rasterized=True)
    if result.drift.white_sigma > 0.0:
        for side in (-2.0, 2.0):
            ax.axhline(side * result.drift.white_sigma, color=_MODEL, lw=1.0, ls="--")
        ax.plot([], [], color=_MODEL, lw=1.0, ls="--", label=r"±2 white σ")
        ax.legend(loc="upper right", fontsize=8)


def _draw_allan(ax: Axes, unit: str, result: NoiseEstimate) -> None:
    allan = result.allan
    ax.set(title="Allan deviation", xlabel="averaging time τ [s]", ylabel=f"deviation [{unit}]")
    if allan is None or result.allan_model is None or not allan.deviation.all():
        _say(ax, "not available")
        return
    label = "measured" if result.separation_cutoff is None else "measured, signal included"
    ax.fill_between(allan.tau, allan.low, allan.high, color=_DATA, alpha=0.25, label="95 %")
    ax.loglog(allan.tau, allan.deviation, ".-", ms=4, lw=1.0, color=_DATA, label=label)
    ax.loglog(
        allan.tau, result.allan_model, "--", lw=1.4, color=_MODEL, label="white + drift, fitted"
    )
    ax.grid(True, which="major", alpha=0.3)
    ax.legend(loc="best", fontsize=8)


def _draw_spectrum(ax: Axes, unit: str, result: NoiseEstimate) -> None:
    spectrum = result.spectrum
    ax.set(title="Spectrum", xlabel="frequency [Hz]", ylabel=f"density [{unit}²/Hz]")
    if spectrum is None or result.density_model is None or not spectrum.density.any():
        _say(ax, "not available")
        return
    ax.loglog(spectrum.frequency, spectrum.density, lw=0.7, color=_DATA, label="Welch")
    ax.loglog(
        spectrum.frequency, result.density_model, "--", lw=1.4, color=_MODEL, label="white + drift"
    )
    ax.xaxis.set_minor_formatter("")
    if result.separation_cutoff is not None:
        ax.axvspan(
            spectrum.frequency[0],
            max(result.separation_cutoff, spectrum.frequency[0]),
            color="0.9",
            label="taken as signal",
        )
    if result.lines:
        at = np.array([line.frequency for line in result.lines])
        height = np.interp(at, spectrum.frequency, spectrum.density)
        ax.loglog(at, height, "v", ms=6, mfc="none", color=_MARK, label="line")
    ax.grid(True, which="major", alpha=0.3)
    ax.legend(loc="best", fontsize=8)


def _say(ax: Axes, text: str) -> None:
    ax.text(0.5, 0.5, text, ha="center", va="center", transform=ax.transAxes, color="0.4")
    ax.set_xticks([])
    ax.set_yticks([])
