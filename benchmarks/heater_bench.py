"""The simulated frame with two control heaters on a bench: logs, the commands, and the closed loop.

For `heater_loops.py`. Everything between the plant and the plant goes through files and pipes: the
logs are CSV, the models and controllers what the commands write, and the loop is closed around
``thermaltool compensate`` as a process, one line out for one line in.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thermaltool.plants.controlled_frame import CONTROL_POWERS, ControlledFrame
from thermaltool.plants.duties import mixed
from thermaltool.plants.excitation import sample_times
from thermaltool.plants.noise import Sensor, read_sensors

Array = NDArray[np.float64]
MAIN, X, Y = "Q_main_1", "d_x_um", "d_y_um"
DT = 2.0  # [s]
QUICK = 0.7  # the control cycle of the source [s]
# As `plant frame` reads them.
SENSORS = {"K": Sensor(0.02, 0.008), "degC": Sensor(0.02, 0.008), "um": Sensor(0.2, decimals=2)}
AIR = 20.0  # [degC]
HOURS = 10.0  # of the calibration
IDLE = 1800.0  # [s]


TOOL = [sys.executable, "-c", "from thermaltool.cli import main; main()"]


def tool(*arguments: object) -> str:
    """What a command writes to stdout."""
    line = list(map(str, arguments))
    done = subprocess.run([*TOOL, *line], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"thermaltool {' '.join(line)}: {done.stderr}")
    return done.stdout


def write_log(path: Path, columns: dict[str, Array]) -> None:
    """A log as CSV."""
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows), ""]
    path.write_text("\n".join(lines), encoding="utf-8")


def calibration_log(frame: ControlledFrame, seed: int, path: Path, hours: float = HOURS) -> None:
    """All three heats on random duty cycles of their own, after an idle half hour."""
    clock = sample_times(3600 * hours, DT)
    streams = np.random.default_rng(seed).spawn(3)
    heats = np.round(np.column_stack([mixed(clock - IDLE, rng) for rng in streams]), 3)
    run, truth, powers = frame.start(), [], []
    for k in range(len(clock)):
        given = heats[k - 1] if k else np.zeros(3)
        power = run.advance(given[0], given[1:] * frame.full, DT) if k else np.zeros(2)
        powers.append(power)
        truth.append(list(run.outputs().values()))
    names = list(run.outputs())
    read = read_sensors(dict(zip(names, np.array(truth).T, strict=True)), SENSORS, DT, seed)
    # A power is the mean of the sample that it ends; a heat of the log acts until its next row.
    later = np.vstack([np.array(powers)[1:], np.zeros(2)])
    columns = {"time_s": clock, MAIN: heats[:, 0]}
    columns |= dict(zip(CONTROL_POWERS, np.round(later, 2).T, strict=True))
    write_log(path, columns | read)


def ready_model(
    folder: Path, log: Path, pair: str, cycles: Sequence[float] = (DT, QUICK)
) -> dict[float, Path]:
    """Models with an estimator that reads both powers, for samples of each length [s]."""
    noise, model = folder / "noise.json", folder / f"{pair}_model.json"
    tool("noise", log, "--stop", IDLE, "-o", noise)
    drives = [part for name in (MAIN, *CONTROL_POWERS) for part in ("--drive", name)]
    tool("calibrate", log, *drives, "--linear", "--sensor", pair, "--deflection", X,
         "--deflection", Y, "-o", model)  # fmt: skip
    measured = [part for name in CONTROL_POWERS for part in ("--measured", name)]
    made = {dt: folder / f"{pair}_{dt:g}.json" for dt in cycles}
    for dt, path in made.items():
        tool("regularize", model, "--noise", noise, *measured, "--form", "kalman", "--dt", dt,
             "-o", path)  # fmt: skip
    return made


def controller(ready: Path, full: float, method: str, *more: object) -> tuple[Path, float]:
    """The controller of a method, and the least heat that it asks for, limits aside [W]."""
    name = "_".join(map(str, (ready.stem, method, f"{full:g}", *more)))
    path = ready.with_name(f"{name}.json")
    control = [part for name in CONTROL_POWERS for part in ("--control", f"{name}:{full:g}")]
    report = tool("design", ready, *control, "--slew", 10 * full, "--method", method, *more,
                  "--json", "-o", path)  # fmt: skip
    asked = json.loads(report)["trials"][0]["least_asked"]
    return path, min(asked.values())


@dataclass(frozen=True)
class Held:
    """A closed loop.

    Attributes
    ----------
    time : ndarray, shape (n,) [s]
    deflections, powers : ndarray, shape (n, 2) [um, W]
        Of the plant, without noise, less what axes correct; powers as delivered in the sample that
        ends here.
    status : list of str
    replies : ndarray, shape (n,) [s]
        From a line to its answer.
    offsets : ndarray, shape (n, 2) [um]
        Set points of the axes after the line; zero where there are none.
    """

    time: Array
    deflections: Array
    powers: Array
    status: list[str]
    replies: Array
    offsets: Array

    def until(self, duration: float) -> Held:
        """Its first part."""
        n = int(np.searchsorted(self.time, duration, "right"))
        return Held(self.time[:n], self.deflections[:n], self.powers[:n], self.status[:n],
                    self.replies[:n], self.offsets[:n])  # fmt: skip

    @property
    def band(self) -> float:
        """Of the worse axis, zero included [um]."""
        return float(np.ptp(np.vstack([np.zeros(2), self.deflections]), axis=0).max())

    @property
    def peak(self) -> float:
        """Of the worse axis [um]."""
        return float(np.abs(self.deflections).max())

    @property
    def rms(self) -> float:
        """Of the worse axis [um]."""
        return float(np.sqrt(np.mean(self.deflections**2, axis=0)).max())

    def largest_move(self, rows: int) -> float:
        """Of a power within so many rows of the last third [W]."""
        last = self.powers[2 * len(self.powers) // 3 :]
        return max(float(np.ptp(last[i : i + rows], axis=0).max()) for i in range(len(last)))

    @property
    def saturated(self) -> float:
        """Share of the lines in which a limit keeps from the tolerance."""
        return self.status.count("saturated") / len(self.status)


def closed_loop(
    frame: ControlledFrame,
    path: Path,
    pair: str,
    levels: Sequence[float] | Array,
    seed: int,
    *more: str,
    dt: float = DT,
    fault: Callable[[float, Array], Array] | None = None,
) -> Held:
    """The plant held by ``compensate``, from rest; a level of heat for each sample.

    With a fault the heaters get what it makes of a time [s] and the setpoints. Axes of the
    controller take their offsets at once.
    """
    clock = dt * np.arange(len(levels) + 1)
    noise = read_sensors({pair: np.zeros(len(clock))}, SENSORS, dt, seed)[pair]
    run, power = frame.start(), np.zeros(2)
    moved, powers, status, replies, corrected = [], [], [], [], []
    given = axes = np.zeros(2)
    with subprocess.Popen(
        [*TOOL, "compensate", str(path), "--also", "status", *more],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        bufsize=1,
    ) as process:  # fmt: skip
        assert process.stdin
        assert process.stdout
        print(",".join(["time_s", pair, *CONTROL_POWERS]), file=process.stdin)
        for k, at in enumerate(clock):
            if k:
                heats = given if fault is None else fault(float(at), given)
                power = run.advance(float(levels[k - 1]), heats, dt)
            now = run.outputs()
            line = f"{at:.10g},{now[pair] + noise[k]:.3f},{power[0]:.2f},{power[1]:.2f}"
            began = time.perf_counter()
            print(line, file=process.stdin)
            if not k:
                names = process.stdout.readline().strip().split(",")
                offsets = [f"offset_{axis.partition('_')[2]}" for axis in (X, Y)]
            reply = process.stdout.readline().strip().split(",")
            replies.append(time.perf_counter() - began)
            answer = dict(zip(names, reply, strict=True))
            given = np.array([answer[name] for name in CONTROL_POWERS], float)
            # An axis moves on the line that says so: until then it stands where it was.
            moved.append(np.array([now[X], now[Y]]) + axes)
            axes = np.array([answer.get(name, 0.0) for name in offsets], float)
            corrected.append(axes)
            powers.append(power)
            status.append(reply[-1])
        process.stdin.close()
        process.stdout.read()
    return Held(
        clock, np.array(moved), np.array(powers), status, np.array(replies), np.array(corrected)
    )
