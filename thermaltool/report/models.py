"""Figures of models and designs: step responses with their uncertainty, the design's trade-off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.model import Model, Term
from thermaltool.report.style import (
    COMPUTED,
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
    quantity,
    time_unit,
)
from thermaltool.responses import Response
from thermaltool.responses.deflection import Deflection
from thermaltool.signals.intervals import NORMAL_95
from thermaltool.units import parse_channel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# A band below this share of the step is hidden by the line.
MIN_BAND_SHARE = 0.01
# Half-width of the noise band in the design's prediction, in standard deviations.
DESIGN_SIGMAS = 3.0


def draw_model(model: Model, name: str, channels: Sequence[str] = ()) -> Figure:
    """The step response of every term, with the 95 % band of its fitted parameters.

    Raises
    ------
    LogError
        A channel that is no output of the model.
    """
    outputs = choose((o.channel for o in model.outputs), channels, name)
    terms = [term for output in outputs for term in model.terms if term.output == output]
    title = f"Response of {Path(name).name} to a unit step"
    figure, axes = panels(title, [1.0] * len(terms), 0.8 + 2.6 * len(terms))
    time = np.linspace(0.0, max(settling_time(t.response) for t in terms), 600)
    unit, per = time_unit(time[-1])
    for ax, term in zip(axes, terms, strict=True):
        _draw_term(ax, term, time, per)
    axes[-1].set(xlabel=f"time since the step [{unit}]")
    return figure


def _draw_term(ax: Axes, term: Term, time: Array, per: float) -> None:
    response, step = term.response, term.response.step(time)
    drive = parse_channel(term.drive).unit
    unit = channel_unit(term.output) + ("" if drive == "1" else f"/{channel_unit(term.drive)}")
    ax.set(
        title=plain(f"{term.drive} → {term.output}  ({response.kind})"),
        ylabel=f"{quantity(parse_channel(term.output).unit)} [{unit}]",
    )
    if term.covariance is not None:
        half = NORMAL_95 * step_sigma(term, time)
        hidden = ", within the line" if half.max() < MIN_BAND_SHARE * np.ptp(step) else ""
        band = f"95 % of the fit, ± {half.max():.2g} {unit}\nat most{hidden}"
        ax.fill_between(time / per, step - half, step + half, color=MEASURED, alpha=0.6, lw=0,
                        label=band)  # fmt: skip
    ax.plot(time / per, step, color=COMPUTED, label="unit step")
    steady = response.dc_gain()
    ax.axhline(steady, color=MARK, lw=0.8, ls="--", label=f"steady {steady:.4g} {unit}")
    constants = [_seconds(tau) for tau in time_constants(response)]
    heading = "time constants" if len(constants) > 1 else "slowest time constant"
    ax.plot([], [], " ", label=f"{heading}\n{', '.join(constants)}")
    legend_beside(ax)


def time_constants(response: Response) -> list[float]:
    """What the response's rates amount to, longest first [s]; of a diffusive one the slowest."""
    if isinstance(response, Deflection):
        return sorted((1 / getattr(response, name) for name in response.searched), reverse=True)
    return [response.slowest()]


def settling_time(response: Response) -> float:
    """A time after which the step response stays within 2 % of its largest value [s]."""
    time = np.geomspace(1e-4, 10.0, 400) * response.slowest()
    step = response.step(time)
    away = np.abs(step - response.dc_gain()) > 0.02 * np.max(np.abs(step))
    return float(1.2 * time[min(int(np.flatnonzero(away)[-1]) + 1, len(time) - 1)])


def step_sigma(term: Term, time: Array) -> Array:
    """Standard deviation of the step response from the covariance of the parameters.

    First order, √(J C Jᵀ), J by central differences.

    Parameters
    ----------
    time : ndarray, shape (n,) [s]

    Returns
    -------
    ndarray, shape (n,) [unit of the output per unit of the drive]
    """
    covariance = np.asarray(term.covariance)
    jacobian = np.empty((len(time), len(term.covariance_names)))
    for k, name in enumerate(term.covariance_names):
        value = getattr(term.response, name)
        # Far below the spread: parameters that are not identified one by one stay in their range.
        h = 1e-4 * abs(value) or 1e-4 * float(np.sqrt(covariance[k, k])) or 1.0
        up, down = (replace(term.response, **{name: value + d}) for d in (h, -h))  # type: ignore[type-var]
        jacobian[:, k] = (up.step(time) - down.step(time)) / (2 * h)
    variance = np.einsum("ni,ij,nj->n", jacobian, covariance, jacobian)
    return np.sqrt(np.maximum(variance, 0.0))


def draw_trade_off(
    report: Mapping[str, Any], name: str, model: Model | None = None, channels: Sequence[str] = ()
) -> Figure:
    """What ``regularize --json`` reports: per deflection and form, the band and what makes it.

    Parameters
    ----------
    model : Model, optional
        Gives the deflections their names and units, which the report does not hold.

    Raises
    ------
    ModelError
        The model has other deflections than the report, or there is none.
    LogError
        A channel that is no deflection of the model.
    """
    forms: Mapping[str, Any] = report["forms"]
    count = len(next(iter(forms.values()))["predicted"]["band"])
    if not count:
        raise ModelError(f"{name} is for the heat alone: there is no band of a deflection to draw")
    names = [f"deflection {k + 1}" for k in range(count)]
    units = ["unit of the deflection"] * count
    if model is not None:
        names = [o.channel for o in model.deflections]
        units = [channel_unit(channel) for channel in names]
        if len(names) != count:
            raise ModelError(f"{name} is about {count} deflections, the model has {len(names)}")
    chosen = [names.index(channel) for channel in choose(names, channels, name)]
    figure = new_figure(
        "Predicted error band after a full step: lag against noise",
        max(6.5, 1.5 + 4.5 * len(forms)),
        1.0 + 2.8 * len(chosen),
    )
    axes = figure.subplots(len(chosen), len(forms), sharex="col", sharey="row", squeeze=False)
    for row, k in zip(axes, chosen, strict=True):
        row[0].set(ylabel=f"{plain(names[k])} [{units[k]}]")
        for ax, (form, design) in zip(row, forms.items(), strict=True):
            _draw_form(ax, form, design, k)
            mark = " (chosen)" if form == report["chosen"] else ""
            ax.set_title(plain(f"{names[k]}, {form} form{mark}"))
    for ax, form in zip(axes[-1], forms, strict=True):
        ax.set(xlabel=_ABSCISSAE.get(form, _LAG)[0])
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def _lag(choice: Mapping[str, Any]) -> float:
    return float(choice["predicted"]["lag"])


def _delay(choice: Mapping[str, Any]) -> float:
    return float(choice["settings"]["delay_s"])


# form -> label and value of what its trade-off varies; the kernel's lag does not change.
_LAG = ("lag of the heat estimate [s]", _lag)
_ABSCISSAE = {"kalman": _LAG, "kernel": ("artificial delay θ [s]", _delay)}


def _draw_form(ax: Axes, form: str, design: Mapping[str, Any], output: int) -> None:
    value = _ABSCISSAE.get(form, _LAG)[1]
    choices = sorted(design["trade_off"], key=value)
    x = np.array([value(c) for c in choices])
    figures = {
        key: np.array([c["predicted"][key][output] for c in choices])
        for key in ("band", "lag_error", "noise_sigma")
    }
    noise = 2 * DESIGN_SIGMAS * figures["noise_sigma"]
    ax.plot(x, figures["band"], ".-", color=COMPUTED, lw=2.0, label="band")
    ax.plot(x, figures["lag_error"], "--", color=ERROR, label="largest lag error")
    ax.plot(x, noise, "-.", color=MEASURED, lw=1.6, label=f"noise, ±{DESIGN_SIGMAS:g} σ")
    ax.plot(value(design), design["predicted"]["band"][output], "o", ms=10, mfc="none", mew=2,
            color=MARK, ls="none", label="best of the form")  # fmt: skip
    if form == "kalman" and len(x) > 1:
        ax.set_xscale("log")
        ax.xaxis.set_major_formatter("{x:g}")
    ax.set_ylim(bottom=0.0)
    ax.margins(x=0.04)


def _seconds(value: float) -> str:
    return f"{value:,.0f} s".replace(",", " ") if value >= 100 else f"{value:.3g} s"
