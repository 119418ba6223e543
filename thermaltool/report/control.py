"""What ``design`` reports of a controller: its drives, and how it does on its own model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.control.design import ControlDesign
from thermaltool.control.trial import ControlTrial
from thermaltool.report.style import (
    COMPUTED,
    ERROR,
    MARK,
    MEASURED,
    channel_unit,
    choose,
    legend_beside,
    panels,
    plain,
    quantity_label,
)
from thermaltool.report.text import aligned
from thermaltool.units import parse_channel

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def band(values: Any) -> float:
    """What an output covers, zero included."""
    return float(max(np.max(values), 0.0) - min(np.min(values), 0.0))


def control_table(design: ControlDesign) -> str:
    """One row for each output of each trial, and the limits."""
    controller = design.controller
    limits = ", ".join(
        f"{drive.channel} 0 to {drive.maximum:g} (slew {drive.slew:g}/s)"
        for drive in controller.drives
    )
    plans = {
        "receding-horizon": f"horizon {controller.horizon:.4g} s"
        + (f", ends after {controller.duration:g} s" if controller.duration else ""),
        "inversion": f"lead {controller.lead:g} s",
    }
    rows = [["step of", "by", "over s", "output", "without", "held", "at a limit"]]
    rows += [
        [
            trial.disturbance,
            f"{trial.level:.4g}",
            f"{trial.time[-1]:.4g}",
            output,
            f"{band(trial.free[output]):.3g}",
            f"{band(trial.held[output]):.3g}",
            f"{trial.at_limit:.0%}",
        ]
        for trial in design.trials
        for output in trial.held
    ]
    axes = ", ".join(
        f"an axis corrects {channel} by up to ±{reach:g}"
        for channel, reach in controller.axes.items()
    )
    parts = controller.method, plans.get(controller.method, ""), limits, axes
    what = ", ".join(filter(None, parts))
    return f"{what}\n{aligned(rows, 1)}"


def control_notes(design: ControlDesign) -> tuple[str, ...]:
    """Where heat would have to be taken away, or holds nothing, and what would help."""
    return (*design.notes, *(note for trial in design.trials for note in _not_held(trial)))


def _not_held(trial: ControlTrial) -> list[str]:
    asked = [
        f"{channel} {power:.3g} after {at:.4g} s"
        for channel, (power, at) in trial.asked.items()
        if power < 0
    ]
    advice = f": {trial.needs}" if trial.needs else ""
    if trial.holds_nothing and not asked:
        heaters = ", ".join(trial.heats)
        return [f"nothing of a step of {trial.disturbance} is held by {heaters}{advice}"]
    if not trial.needs and not asked:
        return []
    return [
        f"a step of {trial.disturbance} asks for negative heat ({', '.join(asked)}), "
        f"which no heater gives{advice}"
    ]


def control_document(design: ControlDesign) -> dict[str, Any]:
    """HeaterController and trials as JSON, without the model."""
    controller = design.controller.document()
    return {
        **{key: value for key, value in controller.items() if key not in ("model", "sha256")},
        "trials": [
            {
                "disturbance": trial.disturbance,
                "level": trial.level,
                "duration_s": float(trial.time[-1]),
                "without": {name: band(values) for name, values in trial.free.items()},
                "held": {name: band(values) for name, values in trial.held.items()},
                "at_limit": trial.at_limit,
                "least_asked": {name: power for name, (power, _) in trial.asked.items()},
            }
            for trial in design.trials
        ],
        "notes": list(control_notes(design)),
    }


def draw_control(design: ControlDesign, channels: Sequence[str] = ()) -> Figure:
    """Outputs and heats of the trial in which the controller leaves most.

    Parameters
    ----------
    design : ControlDesign
    channels : sequence of str
        Outputs and drives that are drawn. Default: all.

    Raises
    ------
    LogError
        A channel that the controller does not have.
    """
    trial = max(design.trials, key=lambda each: max(map(band, each.held.values())))
    drives = {drive.channel: drive for drive in design.controller.drives}
    wanted = choose((*trial.held, *drives), channels, "controller")
    outputs, heated = (
        [each for each in all_of if each in wanted] for all_of in (trial.held, drives)
    )
    unit = channel_unit(trial.disturbance)
    title = f"{design.controller.method}: step of {trial.disturbance} by {trial.level:.4g}"
    title += f" {unit}" if unit != "1" else ""
    count = len(outputs) + len(heated)
    figure, axes = panels(title, [1.4] * len(outputs) + [1.0] * len(heated), 1.9 * count + 0.8)
    minutes = trial.time / 60
    for ax, output in zip(axes, outputs, strict=False):
        half = design.controller.tolerance[output]
        ax.axhspan(-half, half, color=COMPUTED, alpha=0.12, lw=0, label="tolerance")
        free, held = trial.free[output], trial.held[output]
        ax.plot(minutes, free, color=MEASURED, label=f"not held: {band(free):.3g}")
        ax.plot(minutes, held, color=COMPUTED, label=f"held: {band(held):.3g}")
        ax.set_ylabel(quantity_label(parse_channel(output).unit))
        legend_beside(ax, plain(output))
    for ax, channel in zip(axes[len(outputs) :], heated, strict=True):
        top = drives[channel].maximum
        ax.step(minutes, trial.heats[channel], where="pre", color=ERROR, label="set")
        for limit, label in ((0.0, None), (top, f"limits: 0, {top:g}")):
            ax.axhline(limit, color=MARK, lw=0.8, ls="--", label=label)
        ax.set_ylim(-0.08 * top, 1.08 * top)
        ax.set_ylabel(quantity_label(parse_channel(channel).unit))
        least, at = trial.asked[channel]
        asks = f"\nasks for {least:.3g}\nafter {at / 60:.3g} min" if least < 0 else ""
        legend_beside(ax, plain(channel) + asks)
    axes[-1].set_xlabel("time after the step, min")
    return figure
