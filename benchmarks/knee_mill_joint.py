"""How much of a joint's departure ``calibrate --joint`` removes on the knee mill.

``python benchmarks/knee_mill_joint.py``: three machines (the plant; the plant with the cold
pressure that Fraser prints; the plant with deflections by heat alone, as Fraser takes a joint to
act), six calibrations of each, judged on inputs that none of them has seen but for Q 2. Sensors
are noisy (0.02 K, 0.2 µm, white), the truth is without noise. An error is the largest of a run.
Prints Markdown tables. With ``--more`` instead what further levels and logs that go on through the
cool-down are worth, on the plant.
"""

from __future__ import annotations

import argparse
import os
import warnings
from dataclasses import replace

# One core; before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import thermaltool as tt
from thermaltool.plants.jointed import DEFLECTIONS, JointedPlant
from thermaltool.plants.knee_mill import KneeMillGeometry, build

Array = NDArray[np.float64]
STEP = 20.0  # [s]
ROWS = 451  # of a step: 9000 s
TABLE_LOAD = 4448.0  # 1000 lb [N]
NOISE = {"K": 0.02, "degC": 0.02, "um": 0.2}
PRINTED_PRESSURE = 1.9  # 27 psi [kg/cm²]
HYSTERESIS = 0.5  # of the NC axis [µm]
SETTLED = 45  # rows after which an estimate has caught up with a step: 900 s
CONTACTS = tuple(f"T_joint{k}_degC" for k in (1, 2, 3, 4))
ROLES = {"drives": "Q_main_1", "sensors": "dT_main_K", "deflections": list(DEFLECTIONS)}
JUDGED = ("Q 1.5", "Q 2", "Q 3", "1000 lb, Q 1", "1000 lb, Q 2", "up and down", "random")
SEED = 1


def inputs(seed: int) -> dict[str, tuple[Array, float]]:
    """Heat of every run, and the force on the table [N]."""
    steps = {f"Q {q:g}": (np.full(ROWS, q), 0.0) for q in (0.5, 1.0, 1.5, 2.0, 3.0)}
    levels = np.random.default_rng(seed).uniform(0.0, 2.0, 12)
    return steps | {
        "1000 lb, Q 1": (np.ones(ROWS), TABLE_LOAD),
        "1000 lb, Q 2": (np.full(ROWS, 2.0), TABLE_LOAD),
        "up and down": (np.repeat([2.0, 0.0], ROWS), 0.0),
        "random": (np.repeat(levels, 60), 0.0),
        "stairs": (np.repeat([1.0, 2.0, 0.5], 270), 0.0),
        "Q 1, long": (np.ones(4 * ROWS), 0.0),
        **{f"Q {q:g}": (np.full(ROWS, q), 0.0) for q in (1.25, 1.75, 2.5)},
        **{f"Q {q:g}, off": (np.repeat([q, 0.0], ROWS), 0.0) for q in (0.5, 1.0, 2.0)},
    }


def machines() -> dict[str, JointedPlant]:
    """The plant, and two that differ in one thing each."""
    plant = build()
    by_heat = replace(plant.bodies, deflection_by_force=0 * plant.bodies.deflection_by_force)
    loose = build(KneeMillGeometry(clamping=PRINTED_PRESSURE))
    return {
        "45 kg/cm²": plant,
        "45 kg/cm², deflections by heat alone": replace(plant, bodies=by_heat),
        "1.9 kg/cm²": loose,
    }


def runs(plant: JointedPlant, seed: int) -> dict[str, tuple[pd.DataFrame, pd.DataFrame]]:
    """Every run without noise, and as it is read."""
    found = {}
    for k, (name, (heat, load)) in enumerate(inputs(seed).items()):
        rng = np.random.default_rng([seed, k])
        true = plant.simulate(heat, np.full(len(heat), 20.0), STEP, load)
        read = {
            c: y + NOISE[c.rsplit("_", 1)[1]] * rng.normal(size=len(y)) for c, y in true.items()
        }
        known = {"time_s": STEP * np.arange(len(heat)), "Q_main_1": heat}
        found[name] = pd.DataFrame(known | true), pd.DataFrame(known | read)
    return found


def calibrations(read: dict[str, pd.DataFrame]) -> dict[str, tt.Calibration]:
    """The linear model of Q = 1, and five with a joint."""
    three = [read["Q 0.5"], read["Q 1"], read["Q 2"]]
    return {
        "linear, Q 1": fitted(read["Q 1"], initial="rest", linear=True,
                              kinds=dict.fromkeys(DEFLECTIONS, "deflection")),
        "Q 0.5, 1, 2; T1": fitted(three, joint=CONTACTS[0]),
        "Q 0.5, 1, 2; T1 to T4": fitted(three, joint=CONTACTS),
        "Q 1, 2; T1 to T4": fitted(three[1:], joint=CONTACTS),
        "Q 1 for 36 000 s, Q 0.5, 2; T1 to T4": fitted(
            [read["Q 1, long"], read["Q 0.5"], read["Q 2"]], joint=CONTACTS
        ),
        "one run of 1, 2, 0.5; T1 to T4": fitted(read["stairs"], joint=CONTACTS),
    }  # fmt: skip


def further(read: dict[str, pd.DataFrame]) -> dict[str, tt.Calibration]:
    """The linear model of Q = 1, and four from more than three steps."""
    levels = {
        "Q 0.5, 1, 2": ("Q 0.5", "Q 1", "Q 2"),
        "Q 0.5, 1, 1.25, 1.75, 2": ("Q 0.5", "Q 1", "Q 1.25", "Q 1.75", "Q 2"),
        "Q 0.5, 1, 1.25, 2, 2.5, 3": ("Q 0.5", "Q 1", "Q 1.25", "Q 2", "Q 2.5", "Q 3"),
        "Q 0.5, 1, 2, each off for 9000 s": ("Q 0.5, off", "Q 1, off", "Q 2, off"),
    }
    linear = fitted(read["Q 1"], initial="rest", linear=True,
                    kinds=dict.fromkeys(DEFLECTIONS, "deflection"))  # fmt: skip
    return {"linear, Q 1": linear} | {
        name: fitted([read[each] for each in logs], joint=CONTACTS) for name, logs in levels.items()
    }


def fitted(data: object, **options: object) -> tt.Calibration:
    return tt.calibrate(data, **ROLES, **options, warn=lambda message: None)


def off(fit: tt.Calibration, true: pd.DataFrame, read: pd.DataFrame) -> Array:
    """Truth minus what the model has from the heat and what is read, every row [µm]."""
    record = tt.read_log(read)
    found = fit.model.simulate(record)
    return np.column_stack([true[o] - found[o] for o in DEFLECTIONS])


def estimated(model: object, log: pd.DataFrame) -> Array:
    """Deflections as they are estimated row by row from temperatures [µm]."""
    frame = tt.estimate(model, log.drop(columns=["Q_main_1"]), warn=lambda message: None).frame
    return frame[list(DEFLECTIONS)].to_numpy()


def axis(setpoints: Array) -> Array:
    """Where an axis with play is that follows setpoints."""
    at, place = np.zeros(setpoints.shape[1]), []
    for row in setpoints:
        at = np.clip(at, row - HYSTERESIS / 2, row + HYSTERESIS / 2)
        place.append(at)
    return np.array(place)


def pair(values: Array, form: str = "{:.2f}") -> str:
    return " / ".join(form.format(v) for v in values)


def largest(error: Array) -> Array:
    return np.max(np.abs(error), axis=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--more", action="store_true", help="further levels, and cooling")
    given = parser.parse_args()
    seed = given.seed
    warnings.simplefilter("ignore")
    rule = "|".join(["---"] * len(JUDGED))
    for machine, plant in list(machines().items())[: 1 if given.more else None]:
        every = runs(plant, seed)
        read = {name: noisy for name, (_, noisy) in every.items()}
        fits = further(read) if given.more else calibrations(read)
        usual = {name: largest(off(fits["linear, Q 1"], *every[name])) for name in JUDGED}
        print(f"\n### {machine}\n\n| calibrated from | told by | {' | '.join(JUDGED)} |")
        print(f"|---|---|{rule}|")
        for name, fit in fits.items():
            told = [e.partner or e.channel for e in fit.model.effects]
            cells = []
            for case in JUDGED:
                left = largest(off(fit, *every[case]))
                share = "" if not told else f" ({pair(100 * (1 - left / usual[case]), '{:.0f}')} %)"
                cells.append(pair(left) + share)
            print(f"| {name} | {', '.join(told)} | {' | '.join(cells)} |", flush=True)
        if not given.more:
            online(fits["Q 0.5, 1, 2; T1"], every, seed)


def online(
    fit: tt.Calibration, every: dict[str, tuple[pd.DataFrame, pd.DataFrame]], seed: int
) -> None:
    """Estimated from temperatures, and behind the axis."""
    rng = np.random.default_rng([seed, 99])
    idle = pd.DataFrame({"time_s": STEP * np.arange(720)})
    for channel in ("dT_main_K", CONTACTS[0]):
        idle[channel] = 0.02 * rng.normal(size=720) + (20.0 if channel in CONTACTS else 0.0)
    design = tt.regularize(
        fit, tt.noise(idle, warn=lambda message: None), warn=lambda message: None
    )
    print(f"\n| estimated, from {SETTLED * STEP:g} s on | error | by noise of the sensors | "
          "left behind the axis |\n|---|---|---|---|")  # fmt: skip
    for case in ("Q 1.5", "Q 3", "1000 lb, Q 1", "1000 lb, Q 2"):
        true, read = every[case]
        found, quiet = estimated(design, read), estimated(design, true)
        actual = true[list(DEFLECTIONS)].to_numpy()
        parts = (actual - found, found - quiet, actual + axis(-found))
        print(
            f"| {case} | {' | '.join(pair(largest(part[SETTLED:])) for part in parts)} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
