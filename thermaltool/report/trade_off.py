"""Figure of a design of the estimator: its trade-off between lag and noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.model import Model
from thermaltool.report.style import (
    COMPUTED,
    ERROR,
    MARK,
    MEASURED,
    channel_unit,
    choose,
    new_figure,
    plain,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Half-width of the noise band in the design's prediction, in standard deviations.
DESIGN_SIGMAS = 3.0


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
