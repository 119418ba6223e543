"""Two control heaters on the simulated frame where something is not as designed: Markdown tables.

``python benchmarks/heater_cases.py`` (``--seed N`` repeats a run). Axes that correct a part,
heaters that fail, and machines whose gains and time constants differ from the model's while a step
stays to the end. The loop is that of `heater_loops.py`: around ``compensate`` as a process,
deflections are the plant's. *Least* is the optimum of `heater_control.py`, with step and failure
known beforehand.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

# One core; before numpy loads, here and in every command.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from heater_bench import X, Y, calibration_log, closed_loop, controller, ready_model
from heater_control import least_band
from heater_loops import FAR, GAIN_ERROR, PLANNED, TIME_ERROR, head, number, row, varied
from numpy.typing import NDArray

from thermaltool.plants.controlled_frame import ControlledFrame, controlled_frame
from thermaltool.status import FAULT

Array = NDArray[np.float64]
FULL = 250.0  # [W]
CYCLE = 4.0  # between lines [s]
LEVEL = 0.5
# The step beside axes, and the ranges of x and y [um].
BESIDE = 2400.0  # [s]
RANGES = ((0, 0), (10, 0), (0, 10), (10, 10), (0, 30), (30, 30), (60, 120))
# The step amid which a heater fails, and when [s].
FAILING, FAILS = 1200.0, 300.0
# A step that stays, and its last part [s].
STAYS, END = 3600.0, 600.0


def held_step(duration: float, level: float = LEVEL) -> Array:
    return np.full(round(duration / CYCLE), level)


def beside_axes(frame: ControlledFrame, ready: Path, seed: int) -> None:
    print(f"\n## NC axes beside heaters, {FULL:g} W each, over {BESIDE:g} s\n")
    head("step", "axis of x, y um", "left um, x", "y", "least, worse of both",
         "offsets up to um, x", "y", "top / bottom W", "axes alone leave, x", "y")  # fmt: skip
    for level in (LEVEL, 2 * LEVEL):
        steps = frame.step_responses(np.linspace(0, BESIDE, 200))[:, -2:, 0] * level
        for k, ranges in enumerate(RANGES):
            pairs = zip((X, Y), ranges, strict=True)
            more = [part for name, um in pairs if um for part in ("--axis", f"{name}={um}")]
            path, _ = controller(ready, FULL, PLANNED, "--duration", f"{BESIDE:g}", *more)
            run = closed_loop(frame, path, FAR, held_step(BESIDE, level), seed + k, dt=CYCLE)
            least = least_band(frame, level, BESIDE, axes=np.array(ranges, float))[1]
            bands = np.ptp(np.vstack([np.zeros(2), run.deflections]), axis=0)
            powers, moved = run.powers.mean(axis=0), np.abs(run.offsets).max(axis=0)
            alone = np.maximum(np.abs(steps).max(axis=0) - ranges, 0.0)
            row(f"{level:g}", f"±{ranges[0]}, ±{ranges[1]}", float(bands[0]), float(bands[1]),
                least, float(moved[0]), float(moved[1]), f"{powers[0]:.0f} / {powers[1]:.0f}",
                float(alone[0]), float(alone[1]))  # fmt: skip


def failing(frame: ControlledFrame, ready: Path, seed: int) -> None:
    path, _ = controller(ready, FULL, PLANNED)
    sound = closed_loop(frame, path, FAR, held_step(FAILING), seed, dt=CYCLE)
    at = round(FAILS / CYCLE)
    print(f"\n## A heater that fails {FAILS:g} s after a step of {LEVEL:g}, {FAILING:g} s in all\n")
    head("fails", "told after s", "band um", "least um", "top / bottom at the end W")
    row("none", "-", sound.band, least_band(frame, LEVEL, FAILING)[1],
        " / ".join(map(number, map(float, sound.powers[-1]))))  # fmt: skip
    for heater, name in enumerate(("top", "bottom")):
        last = float(sound.powers[at, heater])
        for what, given in (("off", 0.0), (f"at {last:.0f} W", last), ("on", FULL)):

            def stuck(now: float, wanted: Array, k: int = heater, power: float = given) -> Array:
                if now <= FAILS:
                    return wanted
                return np.where(np.arange(len(wanted)) == k, power, wanted)

            run = closed_loop(frame, path, FAR, held_step(FAILING), seed, dt=CYCLE, fault=stuck)
            faults = [now for now, status in zip(run.time, run.status, strict=True)
                      if status == FAULT]  # fmt: skip
            told = number(float(faults[0]) - FAILS) if faults else "not"
            least = least_band(frame, LEVEL, FAILING, (heater, given / FULL, FAILS))[1]
            row(f"{name} stuck {what}", told, run.band, least,
                " / ".join(map(number, map(float, run.powers[-1]))))  # fmt: skip


def staying(frame: ControlledFrame, ready: Path, count: int, seed: int) -> None:
    print(
        f"\n## Gains off by up to {GAIN_ERROR:.0%}, time constants by up to {TIME_ERROR:.0%}: "
        f"{count} plants, a step of {LEVEL:g} that stays for {STAYS:g} s\n\n"
        "Half of the plants have all errors at their largest; *the model's own* has none. *Free*: "
        "the band with heaters off. *Grows*: of the worse deflection, by the last "
        f"{END:g} s. *Moves*: the largest part of full power by which a power moves within 60 s of "
        "the last third.\n"
    )
    head("method", "plants", "band um, median", "worst", "of free, worst", "grows um, median",
         "worst", "moves, median", "worst")  # fmt: skip
    end = round(END / CYCLE)
    for method in ("output-lqr", PLANNED):
        path, _ = controller(ready, FULL, method)
        rng = np.random.default_rng(seed)
        plants = {
            "the model's own": [frame],
            f"{count} others": [varied(frame, rng, k % 2 == 0) for k in range(count)],
        }
        for name, machines in plants.items():
            found = []
            for k, each in enumerate(machines):
                run = closed_loop(each, path, FAR, held_step(STAYS), seed + k, dt=CYCLE)
                moved = run.largest_move(round(60 / CYCLE))
                free = LEVEL * np.ptp(
                    each.step_responses(np.linspace(0, STAYS, 200))[:, -2:, 0], axis=0
                )
                grows = np.ptp(run.deflections[-end:], axis=0).max()
                found.append((run.band, run.band / free.max(), grows, moved / FULL))
            middle, worst = np.median(found, axis=0), np.max(found, axis=0)
            row(method, name, middle[0], worst[0], f"{worst[1]:.2f}", middle[2], worst[2],
                f"{middle[3]:.2f}", f"{worst[3]:.2f}")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, help="repeats a run")
    parser.add_argument("--plants", type=int, default=20, help="plants that differ from the model")
    given = parser.parse_args()
    seed = int(np.random.default_rng().integers(2**31)) if given.seed is None else given.seed
    began = time.perf_counter()
    print(f"# Axes, heaters that fail, machines that differ\n\nseed {seed}")
    with tempfile.TemporaryDirectory() as folder:
        frame = controlled_frame(full=FULL)
        log = Path(folder) / "run.csv"
        calibration_log(frame, seed, log)
        ready = ready_model(Path(folder), log, FAR, (CYCLE,))[CYCLE]
        beside_axes(frame, ready, seed)
        failing(frame, ready, seed)
        staying(frame, ready, given.plants, seed)
    print(f"\n{time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
