"""Figures of transforms: the kernel of the inverse, and numerical Laplace inversions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.errors import LogError
from thermaltool.model import Model, Term
from thermaltool.report.clock_axis import ClockAxis, clock_axis
from thermaltool.report.style import (
    COMPUTED,
    ERROR,
    MARK,
    Array,
    choose,
    panels,
    trace,
)
from thermaltool.units import parse_channel, per, printed

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_kernel(
    kernel: Mapping[str, Any],
    name: str,
    model: Model | None = None,
    channels: Sequence[str] = (),
) -> Figure:
    """What ``invert`` writes: the weights, and how their sum comes to the steady state.

    Parameters
    ----------
    kernel : mapping
        time_s and weight, shape (n,); A0, A1_s; steady_state_kept where the report has it.
    model : Model, optional
        Gives 1/H(0), to which the sum goes.
    """
    time, weight = np.asarray(kernel["time_s"], float), np.asarray(kernel["weight"], float)
    if not len(time):
        raise LogError("no weights: nothing to draw", name)
    total = kernel["A0"] + np.cumsum(weight)
    if model is None:
        choose(["weight_1"], channels, name)
        kept = kernel.get("steady_state_kept")
        target, unit = total[-1] / kept if kept else None, "drive per sensor unit"
    else:
        term = _inverted_term(model, name, channels)
        target = 1 / term.response.dc_gain()
        unit = printed(per(parse_channel(term.drive).unit, parse_channel(term.output).unit))
    title = f"Kernel of the inverse model, {Path(name).name}"
    figure, (top, bottom) = panels(title, (1.0, 1.0), 6.0)
    top.set(
        title=f"Weight of each sample.  A0 = {kernel['A0']:.5g},  A1 = {kernel['A1_s']:.5g} s",
        ylabel=f"weight [{unit}]",
    )
    trace(top, time, weight, color=COMPUTED)
    bottom.set(
        title="A0 + weights up to this age: a steady reading counts with the last value",
        ylabel=f"sum [{unit}]",
        xlabel="age of the sample [s], logarithmic",
    )
    trace(bottom, time, total, color=COMPUTED, label="A0 + Σ weights")
    if target is not None:
        bottom.axhline(target, color=MARK, lw=0.9, ls="--", label=f"1/H(0) = {target:.4g}")
    share = f", {100 * total[-1] / target:.2f} % of 1/H(0)" if target else ""
    bottom.plot(
        time[-1], total[-1], "o", color=ERROR, label=f"whole window: {total[-1]:.4g}{share}"
    )
    bottom.legend(loc="best")
    if len(time) > 1:
        bottom.set_xscale("symlog", linthresh=float(time[1]))
        decades = np.arange(np.ceil(np.log10(time[1])), np.floor(np.log10(time[-1])) + 1)
        bottom.set_xticks([0.0, *10.0**decades])
        bottom.xaxis.set_major_formatter("{x:g}")
    return figure


def _inverted_term(model: Model, name: str, channels: Sequence[str]) -> Term:
    """The term of the model whose inverse the kernel is."""
    sensors = choose((o.channel for o in model.sensors), channels, name)
    terms = [term for term in model.terms if term.output in sensors]
    if len(sensors) != 1 or len(terms) != 1:
        raise LogError(f"choose one sensor with --channel: {', '.join(sensors)}", name)
    return terms[0]


def draw_inversion(result: Mapping[str, Any], name: str, channels: Sequence[str] = ()) -> Figure:
    """What ``laplace`` writes: the inverse transform, and its estimated error.

    Parameters
    ----------
    result : mapping
        time_s, value_1, error_1, and `wanted`, the error that was wanted, if known; shape (n,),
        None or NaN where there is no answer.
    """
    choose(["value_1"], channels, name)
    time, value, error = (
        np.array(result[key], dtype=float) for key in ("time_s", "value_1", "error_1")
    )
    if not len(time):
        raise LogError("no times: nothing to draw", name)
    order = np.argsort(time, kind="stable")
    time, value, error = time[order], value[order], error[order]
    title = f"Inverse Laplace transform, {Path(name).name}"
    figure, (top, bottom) = panels(title, (2.0, 1.0), 6.0)
    axis = ClockAxis("time [s]", 1.0) if _geometric(time) else clock_axis(time)
    top.set(title="Value", ylabel="value [1]")
    trace(top, time, value, axis=axis, color=COMPUTED)
    positive = np.where(error > 0, error, np.nan)
    trace(bottom, time, positive, axis=axis, color=ERROR)
    worst = "" if np.isnan(error).all() else f", at most {np.nanmax(error):.1e}"
    bottom.set(title=f"Estimated error{worst}", ylabel="error [1]")
    axis.mark(bottom)
    if np.isfinite(positive).any():
        bottom.set_yscale("log")
    if "wanted" in result:
        wanted = np.array(result["wanted"], dtype=float)[order]
        trace(bottom, time, wanted, axis=axis, color=MARK, lw=0.9, ls="--", label="wanted")
        bottom.legend()
    if _geometric(time):
        bottom.set_xscale("log")
    return figure


def _geometric(time: Array) -> bool:
    """The times are spread over decades more evenly than over seconds."""
    if len(time) < 3 or time[0] <= 0:
        return False
    steps, ratios = np.diff(time), np.diff(np.log(time))
    return bool(np.std(ratios) * np.mean(steps) < np.std(steps) * np.mean(ratios))
