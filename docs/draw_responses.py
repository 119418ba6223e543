"""Draw what each parameter of each response does: docs/figures/response_*.png.

Run ``python docs/draw_responses.py``. One row for each kind: its unit-step response, with one
parameter at half, once and twice its value in each panel.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from thermaltool.responses import response_class

FIGURES = Path(__file__).with_name("figures")
COLOURS = ("#7fb3d5", "#0b3c5d", "#c0392b")
FACTORS = (0.5, 1.0, 2.0)


@dataclass(frozen=True)
class Drawing:
    """Values of the parameters of a kind; how long to look [s]; which are drawn, and as what."""

    kind: str
    values: dict[str, float]
    duration: float
    shown: dict[str, str]


DRAWINGS = (
    Drawing("rational1", {"K1": 10.0, "tau1": 1200.0, "delay": 600.0}, 9000, {
        "K1": "K1: gain", "tau1": "tau1: time constant", "delay": "delay: dead time",
    }),
    Drawing("rational2", {"K1": 18.0, "tau1": 2400.0, "K2": -8.0, "tau2": 600.0}, 9000, {
        "K1": "K1: gain of the slow part", "tau1": "tau1: its time constant",
        "K2": "K2: gain of the fast part,\nhere against the slow one",
        "tau2": "tau2: its time constant",
    }),
    Drawing("deflection", {
        "A": 60.0, "a": 0.0003, "B": 40.0, "b": 0.001, "D": -0.25, "d": 0.0025,
    }, 6000, {
        "A": "A: gain of the slow part", "a": "a: rate of the slow part",
        "D": "D: size of the transient", "d": "d: rate of the transient",
    }),
    Drawing("conduction", {"K": 3.5, "a": 0.0157, "alpha": 0.117, "r": 5.12, "r0": 0.12}, 3000, {
        "K": "K: gain", "a": "a: loss by convection", "alpha": "alpha: diffusivity",
        "r": "r: distance of the probe",
    }),
    Drawing("slab", {"K": 1.0, "tau": 3000.0, "biot": 0.5, "biot_far": 0.5, "depth": 0.4}, 9000, {
        "tau": "tau: diffusion time", "biot": "biot: loss of the heated face",
        "biot_far": "biot_far: loss of the far face", "depth": "depth: place of the probe",
    }),
    Drawing("rod", {"K": 1.0, "tau": 3000.0, "loss": 1.0, "probe": 0.5}, 9000, {
        "tau": "tau: diffusion time", "loss": "loss: of heat along the side",
        "probe": "probe: its place",
    }),
    Drawing("oscillation", {"K": 10.0, "D": 0.0, "omega": 2.0, "zeta": 0.2}, 20, {
        "K": "K: gain", "omega": "omega: natural frequency", "zeta": "zeta: damping",
    }),
)  # fmt: skip


def draw(drawing: Drawing) -> None:
    """One figure: a panel for each shown parameter."""
    panels = len(drawing.shown)
    figure, axes = plt.subplots(
        1, panels, figsize=(3.1 * panels, 2.9), sharey=True, layout="constrained"
    )
    time = np.linspace(-0.04 * drawing.duration, drawing.duration, 800)
    short = drawing.duration < 100
    for axis, (name, title) in zip(axes, drawing.shown.items(), strict=True):
        for factor, colour in zip(FACTORS, COLOURS, strict=True):
            values = drawing.values | {name: factor * drawing.values[name]}
            step = response_class(drawing.kind)(**values).step(time)
            axis.plot(
                time / (1 if short else 60), step, color=colour, label=f"value × {factor:g}", lw=1.8
            )
        axis.set_title(title, fontsize=10)
        axis.set_xlabel("time [s]" if short else "time [min]")
        axis.grid(alpha=0.3)
        axis.spines[["top", "right"]].set_visible(False)
    lines, labels = axes[0].get_legend_handles_labels()
    figure.legend(lines, labels, loc="outside lower center", ncols=3, frameon=False)
    axes[0].set_ylabel("answer to a unit step")
    figure.savefig(FIGURES / f"response_{drawing.kind}.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    for each in DRAWINGS:
        draw(each)
