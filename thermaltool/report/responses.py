"""Figures of a model's responses: step and frequency response with their bands, poles, zeros."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.effects.convection_state import ConvectionState
from thermaltool.model import (
    Model,
    OperatingPoint,
    Term,
    characteristics,
    deviations,
    operating_points,
    step_at_rate,
    with_known_spread,
)
from thermaltool.report.clock_axis import time_unit
from thermaltool.report.presentation import at_level, duration, with_interval
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
    say,
)
from thermaltool.responses import Response
from thermaltool.signals.intervals import NORMAL_95
from thermaltool.units import parse_channel, per, printed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

# A band below this share of the step is hidden by the line.
MIN_BAND_SHARE = 0.01
# More terms than this are drawn together, one panel for each output.
MAX_ROWS = 6
# Below this share of its largest magnitude a frequency response is not drawn.
MIN_MAGNITUDE = 1e-3
# What is left of coefficients that cancel.
ROUNDING = 1e-10


def draw_model(model: Model, name: str, channels: Sequence[str] = ()) -> Figure:
    """Step response, frequency response, poles and zeros of every term, with 95 % bands.

    A model of many terms: the step response to each drive, of the size that the calibration has
    seen, one panel for each output.

    Raises
    ------
    LogError
        A channel that is no output of the model.
    """
    outputs = choose((o.channel for o in model.outputs), channels, name)
    terms = [term for output in outputs for term in model.terms if term.output == output]
    if len(terms) > MAX_ROWS:
        return _draw_together(model, name, outputs)
    figure = new_figure(
        f"Responses of {Path(name).name}{_without(model)}", 14.0, 0.6 + 3.6 * len(terms)
    )
    rows = figure.subfigures(len(terms), 1, squeeze=False)[:, 0]
    span = _span(model, terms)
    for row, term in zip(rows.tolist(), terms, strict=True):
        _draw_term(row, term, operating_points(model, term), span, model.sample_period)
    return figure


def _without(model: Model) -> str:
    """What the drawn responses leave out, for a title."""
    left = dict.fromkeys(
        e.channel for e in model.effects if isinstance(e, ConvectionState) and e.table is None
    )
    return f", without the change of the loss rate by {', '.join(left)}" if left else ""


def _span(model: Model, terms: Sequence[Term]) -> float:
    """A time within which all step responses settle, at all levels at which they are told [s]."""
    return max(
        settling_time(term.response, point.rate)
        for term in terms
        for point in operating_points(model, term)
    )


def _draw_term(figure: SubFigure, term: Term, points: Sequence[OperatingPoint], span: float,
               period: float) -> None:  # fmt: skip
    """One row: steps at every level, the frequency response and the poles at the first."""
    first = points[0]
    # Bands are drawn at the first level.
    term = with_known_spread(term, first)
    found = characteristics(term, first.rate)
    known = [with_interval(each) for each in found.time_constants]
    told = [f"gain {found.gain}", *known]
    if found.delay.value:
        told.append(f"delay {with_interval(found.delay)}")
    level = at_level(first)
    heading = f"{term.drive} → {term.output}  ({found.kind}{level}): {', '.join(told[:3])}"
    figure.suptitle(plain(heading), x=0.01, ha="left", fontsize=11)
    grid = figure.add_gridspec(2, 3, width_ratios=(1.2, 1.0, 0.9))
    step, magnitude = figure.add_subplot(grid[:, 0]), figure.add_subplot(grid[0, 1])
    phase = figure.add_subplot(grid[1, 1], sharex=magnitude)
    _draw_step(step, term, points, span)
    _draw_bode(magnitude, phase, term, first.rate, period)
    _draw_poles(figure.add_subplot(grid[:, 2]), term, first.rate)


def _draw_step(ax: Axes, term: Term, points: Sequence[OperatingPoint], span: float) -> None:
    time = np.linspace(0.0, span, 600)
    label, length = time_unit(span)
    first, *others = points
    step, half = _step_and_band(term, time, first)
    unit = _gain_unit(term.drive, term.output)
    if term.covariance is not None:
        hidden = ", within the line" if half.max() < MIN_BAND_SHARE * np.ptp(step) else ""
        ax.fill_between(time / length, step - half, step + half, color=MEASURED, alpha=0.6, lw=0,
                        label=f"95 %, ± {half.max():.2g} {unit} at most{hidden}")  # fmt: skip
    ax.plot(time / length, step, color=COMPUTED, label=plain(f"unit step{at_level(first)}"))
    for k, point in enumerate(others):
        ax.plot(time / length, step_at_rate(term.response, time, point.rate),
                color=CYCLE[1 + k % (len(CYCLE) - 1)], ls=("--", ":", "-.")[k % 3],
                label=plain(at_level(point).removeprefix(", ")))  # fmt: skip
    gain = characteristics(term, first.rate).gain.value
    ax.axhline(gain, color=MARK, lw=0.8, ls="--", label="steady state")
    ax.set(title="Step response", ylabel=f"{plain(term.output)} [{unit}]",
           xlabel=f"time since the step [{label}]")  # fmt: skip
    ax.legend(loc="best", fontsize=8)


def _gain_unit(drive: str, output: str) -> str:
    """Printed unit of the output per unit of the drive; 1 for a ratio."""
    return printed(per(parse_channel(output).unit, parse_channel(drive).unit)) or "1"


def _draw_bode(top: Axes, bottom: Axes, term: Term, rate: float, period: float) -> None:
    """Magnitude in the unit of the gain, and phase, over the frequency."""
    response = term.response
    frequency = np.geomspace(0.02 / response.slowest(), 0.5 / period, 400) / (2 * np.pi)
    s = np.asarray(rate + 2j * np.pi * frequency, complex)
    value = response.transfer(s)
    size = np.abs(value)
    if not size.max() > 0:
        # A response of no gain, such as that of a speed at the level zero.
        say(top, "no gain")
        bottom.set_axis_off()
        return
    low = np.flatnonzero(size < MIN_MAGNITUDE * size.max())
    kept = slice(0, int(low[0]) + 1 if len(low) else None)
    frequency, s, value, size = frequency[kept], s[kept], value[kept], size[kept]
    phase = np.degrees(np.unwrap(np.angle(value)))
    # d ln H: its real part is that of the logarithm of the magnitude, its imaginary part of phase.
    relative = deviations(term, lambda each: each.transfer(s) / value)
    if term.covariance is not None:
        spread = np.exp(np.minimum(NORMAL_95 * np.linalg.norm(relative.real, axis=-1), 50.0))
        half = np.degrees(NORMAL_95 * np.linalg.norm(relative.imag, axis=-1))
        band: dict[str, Any] = {"color": MEASURED, "alpha": 0.6, "lw": 0, "label": "95 %"}
        top.fill_between(frequency, size / spread, size * spread, **band)
        bottom.fill_between(frequency, phase - half, phase + half, **band)
        top.legend(loc="best", fontsize=8)
    top.loglog(frequency, size, color=COMPUTED)
    top.set_ylim(0.5 * size.min(), 2.0 * size.max())
    bottom.semilogx(frequency, phase, color=COMPUTED)
    middle = (phase.max() + phase.min()) / 2
    reach = max(np.ptp(phase), 30.0) * 0.6
    bottom.set_ylim(middle - reach, middle + reach)
    top.set(title="Frequency response", ylabel=f"magnitude [{_gain_unit(term.drive, term.output)}]")
    top.tick_params(labelbottom=False)
    bottom.set(xlabel="frequency [Hz]", ylabel="phase [°]")


def _draw_poles(ax: Axes, term: Term, rate: float) -> None:
    """Poles and zeros in the plane of s; both axes logarithmic but about zero."""
    ax.set(title="Poles and zeros", xlabel="real part [1/s]", ylabel="imaginary part [1/s]")
    found = poles_and_zeros(term.response)
    if found is None:
        say(ax, "heat conduction acts on all time scales:\nno finite number of poles")
        return
    poles, zeros = (each - rate for each in found)
    for label, style, color, values in (("poles", "x", COMPUTED, poles),
                                        ("zeros", "o", ERROR, zeros)):  # fmt: skip
        if len(values):
            ax.plot(values.real, values.imag, style, ms=8, mew=1.8, mfc="none", color=color,
                    label=label)  # fmt: skip
    for each in characteristics(term, rate).time_constants:
        if each.high > each.low:
            ax.plot([-1 / each.low, -1 / each.high], [0, 0], color=COMPUTED, lw=4, alpha=0.3)
    ax.axvline(0.0, color=MARK, lw=0.8)
    ax.axhline(0.0, color=MARK, lw=0.8)
    sizes = np.abs(np.concatenate([poles, zeros]))
    sizes = sizes[sizes > 0]
    near, far = 0.5 * sizes.min(), 3.0 * sizes.max()
    ax.set_xscale("symlog", linthresh=near, linscale=0.5)
    ax.set_xlim(-far, far if np.any(zeros.real > 0) else near)
    ax.set_xticks(_decades(near, far, ax.get_xlim()[1] > near))
    if np.any(poles.imag) or np.any(zeros.imag):
        ax.set_yscale("symlog", linthresh=near, linscale=0.5)
        ax.set_ylim(-far, far)
        ax.set_yticks(_decades(near, far, True))
    else:
        ax.set_ylim(-1.0, 1.0)
        ax.set_yticks([0.0])
    ax.minorticks_off()
    ax.legend(loc="upper left", fontsize=8)


def _decades(near: float, far: float, both: bool) -> list[float]:
    """Zero and some decades beyond `near`, on both sides of it or below it."""
    powers = np.arange(np.ceil(np.log10(2 * near)), np.floor(np.log10(far)) + 1)
    above = (10.0 ** powers[:: max(1, len(powers) // 2)]).tolist()
    return [*(-each for each in reversed(above)), 0.0, *(above if both else [])]


def poles_and_zeros(response: Response) -> tuple[Any, Any] | None:
    """Poles and zeros of a response without its delay, complex [1/s]; None where it is diffusive.

    A double pole is there twice.
    """
    if not response.kind.startswith(("rational", "oscillation", "deflection", "joint")):
        return None
    # Of a finite sum of modes the sample period does not matter.
    modes = response.modes(1.0)
    numerator = np.zeros(1, complex)
    fractions: list[tuple[complex, complex, complex]] = []
    for p, w, v in zip(modes.poles, modes.weights, modes.double, strict=True):
        fractions.append((p, w, v))
        if p.imag:
            fractions.append((p.conjugate(), w.conjugate(), np.conjugate(v)))
    poles = np.array([p for p, _, v in fractions for _ in range(2 if v else 1)])
    for p, w, v in fractions:
        others = list(poles)
        others.remove(p)
        numerator = np.polyadd(numerator, w * np.poly(others))
        if v:
            others.remove(p)
            numerator = np.polyadd(numerator, v * np.poly(others))
    numerator = np.polyadd(numerator, modes.direct * np.poly(poles))
    # Leading coefficients that cancel leave rounding.
    size = np.abs(numerator) * np.abs(poles).max() ** np.arange(len(numerator))[::-1]
    whole = np.where(size < ROUNDING * size.max(), 0.0, numerator.real)
    return poles, np.roots(np.trim_zeros(whole, "f"))


def settling_time(response: Response, rate: float = 0.0) -> float:
    """A time after which the step response stays within 2 % of its largest value [s].

    Parameters
    ----------
    response : Response
    rate : float, optional [1/s]
        By which all modes decay faster.
    """
    slowest = 1 / max(1 / response.slowest() + rate, 1e-3 / response.slowest())
    time = np.geomspace(1e-4, 10.0, 400) * slowest + getattr(response, "delay", 0.0)
    step = step_at_rate(response, time, rate)
    gain = float(response.transfer(np.array([rate + 0j]))[0].real) if rate else response.dc_gain()
    away = np.flatnonzero(np.abs(step - gain) > 0.02 * np.max(np.abs(step)))
    last = min(int(away[-1]) + 1, len(time) - 1) if len(away) else 0
    return float(1.2 * time[last])


def _draw_together(model: Model, name: str, outputs: Sequence[str]) -> Figure:
    """The step response to each drive, as large as it was seen, one panel for each output."""
    title = f"What each drive of {Path(name).name} does: steps as large as the calibration has seen"
    title += _without(model)
    figure, axes = panels(title, [1.0] * len(outputs), 1.0 + 4.4 * len(outputs))
    sizes = {d.channel: max(d.range, key=abs) for d in model.drives}
    span = _span(model, [term for term in model.terms if term.output in outputs])
    time, (label, length) = np.linspace(0.0, span, 600), time_unit(span)
    for ax, output in zip(axes, outputs, strict=True):
        terms = [term for term in model.terms if term.output == output]
        terms.sort(key=lambda t: -abs(t.response.dc_gain() * sizes[t.drive]))
        told_at = [(term, point) for term in terms for point in operating_points(model, term)]
        for k, (term, point) in enumerate(told_at):
            size = sizes[term.drive]
            color = CYCLE[k % len(CYCLE)]
            told = f"{size:+.3g} {channel_unit(term.drive)}{at_level(point)}"
            step, half = (size * each for each in _step_and_band(term, time, point))
            half = np.abs(half)
            ax.fill_between(time / length, step - half, step + half, color=color, alpha=0.15, lw=0)
            ax.plot(time / length, step, color=color, ls=("-", "--", ":")[k // len(CYCLE) % 3],
                    label=plain(f"{term.drive}, {told}"))  # fmt: skip
        ax.axhline(0.0, color=MARK, lw=0.6)
        ax.set(title=plain(f"{output}, bands 95 %"),
               ylabel=quantity_label(parse_channel(output).unit))  # fmt: skip
        legend_beside(ax)
    axes[-1].set(xlabel=f"time since the step [{label}]")
    return figure


def _step_and_band(term: Term, time: Array, point: OperatingPoint) -> tuple[Array, Array]:
    """Unit step response, and half of its 95 % band; zero where the spread is not known."""
    of = partial(step_at_rate, time=time, rate=point.rate)
    known = with_known_spread(term, point)
    half = NORMAL_95 * np.linalg.norm(deviations(known, of), axis=-1)
    return of(term.response), np.asarray(half)


def draw_step_responses(models: Mapping[str, Model], channels: Sequence[str] = ()) -> Figure:
    """The step responses of several models, one panel for each drive and output.

    Raises
    ------
    LogError
        A channel that is no output of them.
    """
    known = dict.fromkeys(o.channel for model in models.values() for o in model.outputs)
    wanted = choose(known, channels, next(iter(models)))
    places = dict.fromkeys(
        (t.drive, t.output) for o in wanted for m in models.values() for t in m.terms
        if t.output == o
    )  # fmt: skip
    figure, axes = panels("Step responses", [1.0] * len(places), 0.8 + 2.8 * len(places))
    drawn = {
        name: [t for t in model.terms if (t.drive, t.output) in places]
        for name, model in models.items()
    }
    span = max(_span(models[name], own) for name, own in drawn.items() if own)
    time, (label, length) = np.linspace(0.0, span, 600), time_unit(span)
    for ax, (drive, output) in zip(axes, places, strict=True):
        for k, (name, model) in enumerate(models.items()):
            look: dict[str, Any] = {
                "color": CYCLE[k % len(CYCLE)],
                "ls": ("-", "--", ":", "-.")[k % 4],
            }
            told_at = [
                (term, point)
                for term in model.terms
                if (term.drive, term.output) == (drive, output)
                for point in operating_points(model, term)
            ]
            for term, point in told_at:
                step, half = _step_and_band(term, time, point)
                ax.fill_between(time / length, step - half, step + half, color=look["color"],
                                alpha=0.25, lw=0)  # fmt: skip
                each = characteristics(with_known_spread(term, point), point.rate)
                tau = 1 / (1 / term.response.slowest() + point.rate)
                told = f"{each.gain.value:.4g} {each.gain.unit}, {duration(tau)}{at_level(point)}"
                ax.plot(time / length, step, **look,
                        label=plain(f"{name}\n{told}"))  # fmt: skip
        ax.set(title=plain(f"{drive} → {output}, bands 95 %"),
               ylabel=f"{plain(output)} [{_gain_unit(drive, output)}]")  # fmt: skip
        legend_beside(ax)
    axes[-1].set(xlabel=f"time since the step [{label}]")
    return figure
