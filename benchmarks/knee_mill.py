"""The knee mill's joint: how far from proportion, on five meshes and four sample periods.

``python benchmarks/knee_mill.py``: steps of Q = 0.5, 1 and 2 and of Q = 1 with 1000 lb on the end
of the table, 9000 s, without noise. The departure is the largest difference from the response to
Q = 1 times Q. Prints Markdown tables, the last one of
what of it the temperatures make and what the forces of the contact.
"""

from __future__ import annotations

import argparse
import os
import time

# One core; before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from numpy.typing import NDArray

from thermaltool.plants.jointed import JointedPlant
from thermaltool.plants.knee_mill import KneeMillGeometry, build

Array = NDArray[np.float64]
DURATION = 9000.0  # [s]
TABLE_LOAD = 4448.0  # 1000 lb [N]
CASES = {"Q 0.5": (0.5, 0.0), "Q 1": (1.0, 0.0), "Q 2": (2.0, 0.0), "1000 lb": (1.0, TABLE_LOAD)}
# Of its output, the last two, and the upper contact temperature.
SHOWN = {"x": -2, "y": -1, "T_joint1": 1}


def respond(plant: JointedPlant, level: float, load: float, dt: float) -> tuple[Array, int, float]:
    """Outputs every 100 s, most iterations of a step, largest residual [µm]."""
    run = plant.start(dt, load)
    every = round(100.0 / dt)
    outputs = [run.outputs()]
    for _ in range(round(DURATION / 100.0)):
        for _ in range(every):
            run.advance(level, 0.0)
        outputs.append(run.outputs())
    return np.array(outputs), run.iterations, run.residual


def row(plant: JointedPlant, dt: float) -> str:
    """Cells of one line: deflections at Q = 2, departures, iterations, residual, CPU time."""
    started = time.process_time()
    runs = {name: respond(plant, *case, dt) for name, case in CASES.items()}
    cpu = (time.process_time() - started) / len(CASES)
    reference = runs["Q 1"][0]
    largest = np.max(np.abs(runs["Q 2"][0]), axis=0)
    cells = [f"{largest[SHOWN['x']]:.1f} / {largest[SHOWN['y']]:.1f}"]
    for name in ("Q 0.5", "Q 2", "1000 lb"):
        departure = np.max(np.abs(runs[name][0] - CASES[name][0] * reference), axis=0)
        cells.append(" / ".join(f"{departure[k]:.2f}" for k in SHOWN.values()))
    share = 100 * np.max(np.abs(runs["Q 2"][0] - 2 * reference), axis=0) / largest
    cells.append(f"{share[SHOWN['x']]:.1f} / {share[SHOWN['y']]:.1f}")
    cells.append(f"{max(each[1] for each in runs.values())}")
    cells.append(f"{max(each[2] for each in runs.values()):.1e}")
    cells.append(f"{cpu:.1f}")
    return " | ".join(cells)


def parts(plant: JointedPlant, level: float, dt: float) -> tuple[Array, Array]:
    """Deflections x, y by the temperatures and by the forces of the contact, every step [µm]."""
    run = plant.start(dt)
    by_heat, by_force = [], []
    for _ in range(round(DURATION / dt)):
        by_heat.append(plant.bodies.deflection_by_heat @ run.rise)
        by_force.append(plant.bodies.deflection_by_force @ run.contact.force)
        run.advance(level, 0.0)
    return np.array(by_heat), np.array(by_force)


def print_parts(clamping: float, dt: float) -> None:
    """One line for each level: what of the departure is heat, and what is force."""
    plant = build(KneeMillGeometry(clamping=clamping))
    reference = parts(plant, 1.0, dt)
    for level in (0.5, 2.0):
        found = zip(parts(plant, level, dt), reference, strict=True)
        off = [each - level * one for each, one in found]
        cells = (sum(off), *off)
        shown = (" / ".join(f"{v:.2f}" for v in np.max(np.abs(each), axis=0)) for each in cells)
        print(f"| {clamping:g} | {level:g} | {' | '.join(shown)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--meshes", type=float, nargs="+", default=[1.0, 1.5, 2.0, 2.5, 3.0])
    parser.add_argument("--periods", type=float, nargs="+", default=[100.0, 50.0, 20.0, 10.0])
    given = parser.parse_args()
    columns = (
        "Q 2: x / y µm | Q 0.5 off: x / y µm / T_joint1 K | Q 2 off | 1000 lb off | "
        "Q 2 off % of x / y | iterations | residual µm | CPU s per run"
    )
    rule = "|".join(["---"] * 8)
    print(f"| refinement | nodes | pairs | {columns} |\n|---|---|---|{rule}|")
    for refinement in given.meshes:
        plant = build(KneeMillGeometry(refinement=refinement))
        size = f"{plant.heat.size} | {plant.bodies.joint.area.size}"
        print(f"| {refinement:g} | {size} | {row(plant, 50.0)} |", flush=True)
    plant = build()
    print(f"\n| step s | {columns} |\n|---|{rule}|")
    for dt in given.periods:
        print(f"| {dt:g} | {row(plant, dt)} |", flush=True)
    print(
        "\n| clamping kg/cm² | Q | off: x / y µm | by the temperatures | by the contact's forces |"
    )
    print("|---|---|---|---|---|")
    for clamping in (45.0, 1.9):
        print_parts(clamping, 50.0)


if __name__ == "__main__":
    main()
