"""Two control heaters on the simulated frame, held by ``compensate``: Markdown tables.

``python benchmarks/heater_loops.py`` (``--seed N`` repeats a run). The plant writes a calibration
log with noise; `noise`, `calibrate`, `regularize` and `design` make the controllers; each is run by
``compensate`` as a process, one line of noisy temperature difference and measured powers for one
line of setpoints, around the plant. Deflections are those of the plant, without noise.

Beside them stand the bands that Fraser (1997), section 8.8, measured with his own controllers and
heaters, 60 % of them, and the least band that any heats leave on this plant, with the disturbance
known beforehand (`heater_control.py`).
"""

from __future__ import annotations

import argparse
import itertools
import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path

# One core; before numpy loads, here and in every command.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from heater_bench import DT, QUICK, Held, calibration_log, closed_loop, controller, ready_model
from heater_control import HELD, PUBLISHED, least_band, least_share
from numpy.typing import NDArray

from thermaltool.plants.controlled_frame import ControlledFrame, controlled_frame
from thermaltool.plants.frame import OUTPUTS

Array = NDArray[np.float64]
FULL = (250.0, 500.0)  # [W]
DURATIONS = (1200.0, 2400.0)  # [s]
# When the work may end, where it is not known [s].
ENDS = (1200.0, 1800.0, 2400.0)
PLANNED = "receding-horizon"
METHODS = ("state-lqr", "inversion", "output-lqr", PLANNED)
FAR, MIDDLE, NEAR = "dT_pair1_K", "dT_pair2_K", "dT_pair3_K"
# First peak that the source measured at a step of 0.5 with its nearer probes [um].
PEAKS = {FAR: 2.5, MIDDLE: 2.0, NEAR: 0.7}
# Short steps and ramps over 30 min, beyond Q = 1 from 5 to 10 min, then cooling, as its section
# 8.8.6 tells: (time [s], level), straight between; its band [um].
ARBITRARY = ((0, 0.6), (300, 0.6), (300, 1.3), (600, 1.3), (600, 0.2), (840, 0.2), (960, 0.8),
             (1200, 0.8), (1200, 0.0), (1500, 0.0), (1500, 0.5), (1800, 0.9))  # fmt: skip
ARBITRARY_BAND = 13.0
# Of each gain of a deflection, and of the time constants behind each heat.
GAIN_ERROR, TIME_ERROR = 0.2, 0.3
# A trial of stability: a step, then nothing [s].
STEP, REST, END = 1200.0, 2400.0, 600.0


def varied(frame: ControlledFrame, rng: np.random.Generator, corner: bool) -> ControlledFrame:
    """The frame with other gains and time constants behind each of its three heats.

    Parameters
    ----------
    frame : ControlledFrame
    rng : Generator
    corner : bool
        Errors as large as they become, each of any sign; else any between.
    """
    draw = (lambda n: rng.choice([-1.0, 1.0], n)) if corner else (lambda n: rng.uniform(-1, 1, n))
    inputs = frame.inputs.shape[1]
    slower = 1 + TIME_ERROR * draw(inputs)
    gains = np.ones((len(OUTPUTS), inputs))
    gains[-2:] = 1 + GAIN_ERROR * draw(2 * inputs).reshape(2, inputs)
    return replace(
        frame,
        rates=np.concatenate([frame.rates / each for each in slower]),
        inputs=np.vstack([
            np.where(np.arange(inputs) == k, frame.inputs / slower[k], 0.0) for k in range(inputs)
        ]),
        outputs=np.hstack([frame.outputs * gains[:, [k]] for k in range(inputs)]),
    )  # fmt: skip


class Bench:
    """The plant with heaters of one size, and its controllers.

    Parameters
    ----------
    frame : ControlledFrame
    readies : mapping of pair to paths of its models, by sample period [s]
    seed : int
    """

    def __init__(
        self, frame: ControlledFrame, readies: dict[str, dict[float, Path]], seed: int
    ) -> None:
        self.frame, self._readies, self._seed = frame, readies, seed
        self._asked: dict[Path, float] = {}

    def run(
        self, method: str, levels: Array, pair: str = FAR, duration: float | None = None,
        frame: ControlledFrame | None = None, dt: float = DT,
    ) -> tuple[Held, float]:  # fmt: skip
        """A closed loop, and the least heat that the method asks for [W]."""
        more = () if duration is None else ("--duration", f"{duration:g}")
        path, asked = controller(self._readies[pair][dt], self.frame.full, method, *more)
        self._seed += 1
        return closed_loop(frame or self.frame, path, pair, levels, self._seed, dt=dt), asked


def number(value: float) -> str:
    return f"{value:.1f}" if abs(value) < 100 else f"{value:.0f}"


def row(*cells: object) -> None:
    shown = (number(cell) if isinstance(cell, float) else str(cell) for cell in cells)
    print("| " + " | ".join(shown) + " |", flush=True)


def head(*cells: str) -> None:
    row(*cells)
    print("|---" * len(cells) + "|")


COLUMNS = ("band um", "peak um", "rms um", "of output-lqr", "top / bottom W", "saturated %",
           "least asked W", "p99 ms")  # fmt: skip


def figures(held: Held, asked: float, regulated: float) -> tuple[object, ...]:
    """The cells of `COLUMNS`."""
    powers = held.powers.mean(axis=0)
    return (
        held.band, held.peak, held.rms, f"{held.band / regulated:.2f}",
        f"{powers[0]:.0f} / {powers[1]:.0f}", f"{100 * held.saturated:.0f}", f"{asked:.0f}",
        1e3 * float(np.percentile(held.replies, 99)),
    )  # fmt: skip


def steps(bench: Bench) -> None:
    full = bench.frame.full
    shares = {}
    print(f"\n## Steps, {full:g} W in each heater, far probes\n")
    head("step", "over s", "method", *COLUMNS, "published", "60 %", "least", "")
    for level, published in PUBLISHED.items():
        longest = np.full(round(DURATIONS[-1] / DT), level)
        held = {method: bench.run(method, longest) for method in METHODS}
        bands = {d: held["output-lqr"][0].until(d).band for d in ENDS}
        shares[level] = least_share(bench.frame, level, bands)
        for duration in DURATIONS:
            regulated = held["output-lqr"][0].until(duration).band
            least = least_band(bench.frame, level, duration)[1]
            rows = {method: (run.until(duration), asked) for method, (run, asked) in held.items()}
            short = longest[: round(duration / DT)]
            rows[f"{PLANNED} --duration"] = bench.run(PLANNED, short, duration=duration)
            for method, (run, asked) in rows.items():
                band = run.peak if level == 1.5 else run.band
                verdict = ("yes" if band <= 0.6 * published else "no") if PLANNED in method else ""
                row(f"{level:g}", f"{duration:g}", method, *figures(run, asked, regulated),
                    published, 0.6 * published, least, verdict)  # fmt: skip
    ends = ", ".join(f"{end:g}" for end in ENDS)
    print(f"\nThe least part of the band of output-lqr that one course of heats keeps over {ends} "
          "s alike, with the step known beforehand: "
          + ", ".join(f"{share:.2f} at {level:g}" for level, share in shares.items()))  # fmt: skip


def probes(bench: Bench) -> None:
    print("\n## Probes, step of 0.5 over 600 s\n")
    head(
        "probes",
        "sample s",
        "method",
        "first peak um",
        "band um",
        "rms um",
        "published peak",
        "60 %",
        "",
    )
    for pair, published in PEAKS.items():
        for dt, method in itertools.product((DT, QUICK), METHODS[1:]):
            run, _ = bench.run(method, np.full(round(600 / dt), 0.5), pair, dt=dt)
            verdict = ("yes" if run.peak <= 0.6 * published else "no") if method == PLANNED else ""
            row(
                pair,
                f"{dt:g}",
                method,
                run.peak,
                run.band,
                run.rms,
                published,
                0.6 * published,
                verdict,
            )


def arbitrary(bench: Bench) -> None:
    times, values = np.array(ARBITRARY, float).T
    duration = times[-1]
    levels = np.interp(DT * (np.arange(round(duration / DT)) + 0.5), times, values)
    coarse = levels.reshape(HELD, -1).mean(axis=1) if len(levels) % HELD == 0 else np.interp(
        duration / HELD * (np.arange(HELD) + 0.5), times, values)  # fmt: skip
    free, least = least_band(bench.frame, coarse, duration)
    print(f"\n## Arbitrary duty over {duration:g} s, {bench.frame.full:g} W, {free:.0f} um free\n")
    head("probes", "method", *COLUMNS, "published", "60 %", "least", "")
    for pair in (FAR, NEAR):
        runs = {method: bench.run(method, levels, pair) for method in METHODS[1:]}
        runs[f"{PLANNED} --duration"] = bench.run(PLANNED, levels, pair, duration)
        for method, (run, asked) in runs.items():
            reached = run.band <= 0.6 * ARBITRARY_BAND
            verdict = ("yes" if reached else "no") if PLANNED in method else ""
            row(pair, method, *figures(run, asked, runs["output-lqr"][0].band), ARBITRARY_BAND,
                0.6 * ARBITRARY_BAND, least, verdict)  # fmt: skip


def robust(bench: Bench, count: int, seed: int) -> None:
    print(
        f"\n## Gains off by up to {GAIN_ERROR:.0%}, time constants by up to {TIME_ERROR:.0%}: "
        f"{count} plants, step of 0.5 over {STEP:g} s, then nothing for {REST:g} s\n\n"
        "Half of the plants have all errors at their largest. *At the end*: the last "
        f"{END:g} s. *Free*: what the step alone has left there, heaters off. *Moves*: the largest "
        "part of full power by which a power moves within 60 s of the last third.\n"
    )
    head("method", "band over the step, median", "worst", "at the end um, median", "worst",
         "free um, worst", "at the end W, median", "worst", "moves, median", "worst")  # fmt: skip
    levels = np.repeat([0.5, 0.0], [round(STEP / DT), round(REST / DT)])
    for method in ("output-lqr", PLANNED):
        rng, found = np.random.default_rng(seed), []
        for k in range(count):
            frame = varied(bench.frame, rng, corner=k % 2 == 0)
            run, _ = bench.run(method, levels, frame=frame)
            moved, end = run.largest_move(round(60 / DT)), round(END / DT)
            steps = frame.step_responses(np.array([REST + STEP - END, REST - END]))
            left = 0.5 * np.abs(steps[0, -2:, 0] - steps[1, -2:, 0]).max()
            found.append((run.until(STEP).band, np.abs(run.deflections[-end:]).max(), left,
                          run.powers[-end:].max(), moved / bench.frame.full))  # fmt: skip
        middle, worst = np.median(found, axis=0), np.max(found, axis=0)
        row(method, middle[0], worst[0], middle[1], worst[1], worst[2], middle[3], worst[3],
            f"{middle[4]:.2f}", f"{worst[4]:.2f}")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, help="repeats a run")
    parser.add_argument("--plants", type=int, default=30, help="plants that differ from the model")
    given = parser.parse_args()
    seed = int(np.random.default_rng().integers(2**31)) if given.seed is None else given.seed
    began = time.perf_counter()
    print(f"# Two control heaters\n\nseed {seed}")
    with tempfile.TemporaryDirectory() as folder:
        frame = controlled_frame(full=FULL[0])
        log = Path(folder) / "run.csv"
        calibration_log(frame, seed, log)
        readies = {pair: ready_model(Path(folder), log, pair) for pair in PEAKS}
        for full in FULL:
            sized = replace(frame, inputs=frame.inputs * [1.0, *[full / FULL[0]] * 2], full=full)
            bench = Bench(sized, readies, seed)
            steps(bench)
            arbitrary(bench)
            if full == FULL[0]:
                probes(bench)
                robust(bench, given.plants, seed)
    print(f"\n{time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
