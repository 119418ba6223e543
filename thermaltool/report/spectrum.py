"""A time-constant spectrum and its networks as JSON document, tables and figure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.documents import jsonable
from thermaltool.fitting.spectrum.find import SpectralLine, ThermalSpectrum
from thermaltool.fitting.spectrum.lines import MAX_LINES
from thermaltool.report.style import (
    COMPUTED,
    ERROR,
    MARK,
    MEASURED,
    Array,
    envelope,
    new_figure,
    plain,
)
from thermaltool.report.text import aligned
from thermaltool.report.transfer import MIN_P_VALUE, estimate_document, with_interval
from thermaltool.units import parse_channel, symbol

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# A line whose interval reaches below this part of its resistance may be none.
NOTHING = 1e-3
# Noise below this part of the range is that of the computation.
ROUNDING = 1e-6
# Axis of the structure function beyond the first and the last capacity, by this factor.
CAPACITY_MARGIN = 10.0


def spectrum_notes(found: ThermalSpectrum) -> list[str]:
    """What to know before using the spectrum, each a sentence."""
    notes, (short, long) = [], found.transient.reach
    taus = found.time_constants
    if taus[0] < short:
        notes.append(
            f"the fastest time constant, {taus[0]:.3g} s, is shorter than the first row behind the "
            f"step ({short:.3g} s): what happens before it counts as one; where the step was "
            "between two rows, --step-at says when"
        )
    if taus[-1] > long:
        notes.append(
            f"the slowest time constant, {taus[-1]:.3g} s, is longer than the record behind the "
            f"step ({long:.3g} s): the steady state is extrapolated"
        )
    for line in found.lines:
        if line.resistance.low < NOTHING * line.resistance.value:
            notes.append(
                f"{line.time_constant.value:.3g} s: the log does not tell this line from its "
                "neighbours"
            )
    noise = float(np.sqrt(found.fit.variance)) / float(np.ptp(found.transient.rise))
    if noise > ROUNDING and found.whiteness.p_value < MIN_P_VALUE:
        notes.append(
            f"what the lines leave is not white (p {found.whiteness.p_value:.2g}): the intervals "
            "are too narrow"
        )
    if len(found.lines) == MAX_LINES < len(found.fits):
        notes.append(f"a spectrum of more than {MAX_LINES} lines: these are the best {MAX_LINES}")
    return notes


def _line(line: SpectralLine) -> dict[str, Any]:
    return {
        "time_constant_s": estimate_document(line.time_constant),
        "resistance_K_per_W": estimate_document(line.resistance),
        "stretch_s": [line.stretch[0], line.stretch[1] if np.isfinite(line.stretch[1]) else None],
        "alone": {
            "time_constant_s": estimate_document(line.time_constant_alone),
            "resistance_K_per_W": estimate_document(line.resistance_alone),
        },
    }


def spectrum_document(found: ThermalSpectrum) -> dict[str, Any]:
    """Everything as plain data; what is unbounded is null."""
    resistance, capacity = found.structure.cumulative()
    document = {
        "output": found.transient.output,
        "rows": len(found.transient.time),
        "rms_K": float(np.sqrt(np.mean((found.transient.rise - found.fitted) ** 2))),
        "noise_K": float(np.sqrt(found.fit.variance)),
        "offset_K": found.fit.offset,
        "resistance_K_per_W": float(np.sum(found.fit.resistances)),
        "lines": [_line(line) for line in found.lines],
        "foster": {
            "resistance_K_per_W": found.fit.resistances.tolist(),
            "capacity_J_per_K": found.capacities.tolist(),
        },
        "cauer": {
            "resistance_K_per_W": found.ladder.resistances.tolist(),
            "capacity_J_per_K": found.ladder.capacities.tolist(),
        },
        "spectrum": {
            "time_constant_s": found.grid.tolist(),
            "resistance_per_decade_K_per_W": found.density.tolist(),
        },
        "cumulative": {
            "time_constant_s": found.cumulative.time_constants.tolist(),
            "resistance_K_per_W": found.cumulative.value.tolist(),
            "low": found.cumulative.low.tolist(),
            "high": found.cumulative.high.tolist(),
        },
        "structure_function": {
            "resistance_K_per_W": resistance.tolist(),
            "capacity_J_per_K": capacity.tolist(),
        },
        "residuals": {"white_p": found.whiteness.p_value},
        "candidates": [{"lines": len(f.logs), "bic": f.criteria.bic} for f in found.fits],
        "notes": spectrum_notes(found),
    }
    plain_data: dict[str, Any] = jsonable(document)
    return plain_data


def spectrum_columns(found: ThermalSpectrum) -> dict[str, Array]:
    """One row for each line: time constant, resistance, both networks; NaN where unbounded."""

    def bounded(values: list[float]) -> Array:
        ends = np.array(values, float)
        return np.where(np.isfinite(ends), ends, np.nan)

    taus = [line.time_constant for line in found.lines]
    resistances = [line.resistance for line in found.lines]
    return {
        "tau_s": np.array([e.value for e in taus]),
        "tau_low_s": bounded([e.low for e in taus]),
        "tau_high_s": bounded([e.high for e in taus]),
        "R_foster_K/W": np.array([e.value for e in resistances]),
        "R_foster_low_K/W": bounded([e.low for e in resistances]),
        "R_foster_high_K/W": bounded([e.high for e in resistances]),
        "C_foster_J/K": found.capacities,
        "R_cauer_K/W": found.ladder.resistances,
        "C_cauer_J/K": found.ladder.capacities,
    }


def spectrum_table(found: ThermalSpectrum, drive: str) -> str:
    """Lines with their intervals, and both networks."""
    n = len(found.lines)
    total, noise = float(np.sum(found.fit.resistances)), float(np.sqrt(found.fit.variance))
    head = (
        f"{found.transient.output} by {drive}: {n} line{'s' * (n > 1)}, {total:.5g} K/W, noise "
        f"{noise:.2g} K, {len(found.transient.time)} rows"
    )
    rows = [["", "time constant s", "R K/W", "C J/K"]]
    rows += [
        [str(k + 1), with_interval(line.time_constant), with_interval(line.resistance),
         f"{capacity:.5g}"]
        for k, (line, capacity) in enumerate(zip(found.lines, found.capacities, strict=True))
    ]  # fmt: skip
    ladder = [["Cauer", "C J/K", "R K/W"]]
    ladder += [
        [str(k + 1), f"{capacity:.5g}", f"{resistance:.5g}"]
        for k, (capacity, resistance) in enumerate(
            zip(found.ladder.capacities, found.ladder.resistances, strict=True)
        )
    ]
    return "\n\n".join([head, aligned(rows), aligned(ladder)])


def draw_spectrum(found: ThermalSpectrum, log: str, drive: str) -> Figure:
    """Transient, spectrum, cumulative resistance and structure function."""
    output = found.transient.output
    figure = new_figure(f"Time-constant spectrum, {output} by {drive}, {log}", 11.0, 7.5)
    (a, b), (c, d) = figure.subplots(2, 2)
    _draw_transient(a, found)
    _draw_density(b, found)
    _draw_cumulative(c, found)
    _draw_structure(d, found)
    return figure


def _draw_transient(ax: Axes, found: ThermalSpectrum) -> None:
    since = found.transient.time - found.transient.steps[0]
    there = since > 0
    unit = symbol(parse_channel(found.transient.output).unit)
    ax.plot(*envelope(since[there], found.transient.rise[there]), ".", ms=6, color=MEASURED,
            label="measured")  # fmt: skip
    ax.plot(*envelope(since[there], found.fitted[there]), color=COMPUTED, lw=1.0,
            label=f"{len(found.lines)} lines")  # fmt: skip
    name = plain(found.transient.output)
    ax.set(xscale="log", title="Transient", xlabel="time since the first step [s]",
           ylabel=f"{name} [{'K' if unit == 'mK' else unit}]")  # fmt: skip
    ax.legend()


def _draw_density(ax: Axes, found: ThermalSpectrum) -> None:
    ax.fill_between(found.grid, found.density, color=COMPUTED, alpha=0.25, lw=0)
    ax.plot(found.grid, found.density, color=COMPUTED, label="smooth spectrum (left)")
    ax.set(xscale="log", title="Spectrum", xlabel="time constant [s]",
           ylabel="R [K/W per decade]", ylim=(0, None))  # fmt: skip
    lines = ax.twinx()
    lines.grid(False)
    for k, line in enumerate(found.lines):
        tau, r = line.time_constant, line.resistance
        high = r.high if np.isfinite(r.high) else r.value
        lines.errorbar(tau.value, r.value, xerr=[[tau.value - tau.low], [tau.high - tau.value]],
                       yerr=[[r.value - r.low], [high - r.value]], fmt="o", ms=4, color=ERROR,
                       elinewidth=1, label="" if k else "lines, 95 % (right)")  # fmt: skip
    lines.set(ylabel="R [K/W]", ylim=(0, None))
    handles = [*ax.get_legend_handles_labels()[0], *lines.get_legend_handles_labels()[0]]
    ax.legend(handles=handles, loc="upper left")


def _draw_cumulative(ax: Axes, found: ThermalSpectrum) -> None:
    c = found.cumulative
    total = float(np.sum(found.fit.resistances))
    high = np.where(np.isfinite(c.high), c.high, 10 * total)
    ax.fill_between(c.time_constants, c.low, high, color=COMPUTED, alpha=0.2, lw=0,
                    label="95 %, whatever the spectrum")  # fmt: skip
    ax.plot(c.time_constants, c.value, color=COMPUTED, label="smooth spectrum")
    taus = np.concatenate([found.grid[:1], found.time_constants, found.grid[-1:]])
    sums = np.concatenate([[0.0], np.cumsum(found.fit.resistances), [total]])
    ax.step(taus, sums, where="post", color=ERROR, label="lines")
    ax.set(xscale="log", title="Cumulative resistance", xlabel="time constant [s]",
           ylabel="R up to it [K/W]", ylim=(0, 1.25 * total))  # fmt: skip
    ax.legend(loc="upper left")


def _draw_structure(ax: Axes, found: ThermalSpectrum) -> None:
    ax.plot(*found.structure.cumulative(), color=COMPUTED, label="smooth spectrum")
    resistance, capacity = found.ladder.cumulative()
    ax.step(resistance, capacity, where="post", color=ERROR, label="Cauer ladder of the lines")
    ax.axvline(resistance[-1], color=MARK, lw=0.8, ls=":")
    # Behind the last line only ambient follows, whose capacity has no end.
    low, high = capacity[0] / CAPACITY_MARGIN, capacity[-1] * CAPACITY_MARGIN
    ax.set(yscale="log", ylim=(low, high), title="Cumulative structure function",
           xlabel="R from the node [K/W]", ylabel="C from the node [J/K]")  # fmt: skip
    ax.legend(loc="upper left")
