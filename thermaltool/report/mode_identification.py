"""Thermal modes of measured logs as JSON document, table, sentences and figure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.documents import jsonable
from thermaltool.errors import counted
from thermaltool.placement.mode_identification import IdentifiedModes
from thermaltool.report.clock_axis import modes_unit
from thermaltool.report.network import mode_warnings
from thermaltool.report.style import CYCLE, legend_beside, new_figure, plain
from thermaltool.report.text import aligned
from thermaltool.report.transfer import estimate_document, gain_unit, interval_text, with_interval
from thermaltool.signals.intervals import Estimate
from thermaltool.units import printed

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def identified_notes(modes: IdentifiedModes) -> list[str]:
    """What to know before using the modes, each a sentence."""
    return mode_warnings(modes.network.outputs[0], modes.duration)


def identified_document(modes: IdentifiedModes) -> dict[str, Any]:
    """Everything as plain data."""
    found: dict[str, Any] = jsonable({
        "time_constants_s": [estimate_document(e) for e in modes.time_constants],
        "channels": {
            output.target: {
                "noise": float(np.sqrt(output.sigma2)),
                "drives": {
                    drive: {
                        "unit": printed(gain_unit(output.target, drive)),
                        "weights": [estimate_document(e) for e in output.weight_estimates(i)],
                        "relative_weights": [
                            {"value": e.value, "interval": [e.low, e.high]}
                            for e in modes.relative_weight_estimates(k, i)
                        ],
                    }
                    for i, drive in enumerate(output.names)
                },
            }
            for k, output in enumerate(modes.network.outputs)
        },
        "at_rest": modes.at_rest,
        "candidates": [{"modes": c.modes, "bic": c.bic} for c in modes.candidates],
        "limit": modes.limit,
        "notes": identified_notes(modes),
    })  # fmt: skip
    return found


def identified_columns(modes: IdentifiedModes) -> dict[str, list[Any]]:
    """One row for each channel, drive and mode."""
    rows: dict[str, list[Any]] = {}
    for k, output in enumerate(modes.network.outputs):
        for i, drive in enumerate(output.names):
            parts = zip(modes.time_constants, output.weight_estimates(i),
                        modes.relative_weight_estimates(k, i), strict=True)  # fmt: skip
            for tau, weight, part in parts:
                row = {
                    "channel": output.target, "drive": drive, "tau_s": tau.value,
                    "tau_low_s": tau.low, "tau_high_s": tau.high, "weight": weight.value,
                    "weight_low": weight.low, "weight_high": weight.high,
                    "relative_weight": part.value, "relative_weight_low": part.low,
                    "relative_weight_high": part.high,
                }  # fmt: skip
                for name, value in row.items():
                    rows.setdefault(name, []).append(value)
    return rows


def identified_table(modes: IdentifiedModes) -> str:
    """Time constants, and the weight of each in every channel."""
    unit, length = modes_unit(modes.network.time_constants)
    outputs = modes.network.outputs
    head = (
        f"{counted(len(modes.time_constants), 'mode')} shared by "
        f"{counted(len(outputs), 'channel')}, {sum(o.rows for o in outputs)} readings"
    )
    taus = [["mode", f"time constant {unit}"]]
    for j, e in enumerate(modes.time_constants):
        scaled = Estimate(e.value / length, e.low / length, e.high / length)
        taus.append([str(j + 1), with_interval(scaled)])
    numbers = range(1, len(modes.time_constants) + 1)
    weights = [["channel", "by", *(f"weight {j} %" for j in numbers), "noise"]]
    sizes = [["channel", "by", "per", *(f"steady state {j}" for j in numbers)]]
    for k, output in enumerate(outputs):
        for i, drive in enumerate(output.names):
            weights.append([
                output.target, drive,
                *(_percent(e) for e in modes.relative_weight_estimates(k, i)),
                f"{np.sqrt(output.sigma2):.2g}",
            ])  # fmt: skip
            sizes.append([output.target, drive, printed(gain_unit(output.target, drive)),
                          *(with_interval(e) for e in output.weight_estimates(i))])  # fmt: skip
    parts = [head, aligned(taus), aligned(weights), aligned(sizes)]
    if modes.candidates:
        bics = ", ".join(f"{c.modes}: {c.bic:.1f}" for c in modes.candidates)
        parts.append(f"number of modes by evidence, BIC {bics}")
    if modes.limit:
        parts.append(f"no more: {modes.limit}")
    return "\n\n".join(parts)


def _percent(e: Estimate) -> str:
    return f"{100 * e.value:.1f} ({100 * e.low:.1f} to {100 * e.high:.1f})"


def draw_identified(modes: IdentifiedModes, log: str) -> Figure:
    """Weights of every mode in every channel, with their intervals."""
    outputs = modes.network.outputs
    pairs = [(k, i) for k, o in enumerate(outputs) for i in range(len(o.names))]
    unit, length = modes_unit(modes.network.time_constants)
    figure = new_figure(f"Thermal modes, {log}", 11.0, 4.5)
    ax = figure.subplots()
    count = len(modes.time_constants)
    width = 0.8 / count
    for j, tau in enumerate(modes.time_constants):
        each = [modes.relative_weight_estimates(k, i)[j] for k, i in pairs]
        at = np.arange(len(pairs)) + (j - (count - 1) / 2) * width
        value = np.array([e.value for e in each])
        error = np.array([e.high - e.value for e in each])
        scaled = Estimate(tau.value / length, tau.low / length, tau.high / length)
        ax.bar(at, 100 * value, width, yerr=100 * error, color=CYCLE[j % len(CYCLE)], capsize=2,
               label=f"{scaled.value:.3g} {unit} ({interval_text(scaled)})")  # fmt: skip
    several = len(outputs[0].names) > 1
    labels = [outputs[k].target + (f"\nby {outputs[k].names[i]}" if several else "")
              for k, i in pairs]  # fmt: skip
    ax.set_xticks(np.arange(len(pairs)), [plain(label) for label in labels],
                  rotation=30 if len(pairs) > 5 else 0)  # fmt: skip
    ax.set(title="Weights of the modes, 95 %", ylabel="% of the channel", ylim=(0, None))
    ax.grid(False, axis="x")
    legend_beside(ax, title="time constant")
    return figure
