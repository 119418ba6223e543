"""Faults of every kind, drawn at random, in the lines of a stream and in what it keeps.

`python tests/faults/streams.py --count 10000` runs as many and prints what went wrong;
`test_injected_faults.py` runs fewer. Each run draws its own seed and prints it.
"""

import argparse
import contextlib
import functools
import itertools
import json
import math
import random
import secrets
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

import numpy as np

from thermaltool.errors import ThermalToolError
from thermaltool.estimation.estimator import KalmanEstimator, SensorNoise
from thermaltool.estimation.pipeline import EstimatorPipeline
from thermaltool.estimation.plausible_change import plausible_changes
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.responses.rational import Rational2
from thermaltool.runtime import compensation, pipe
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.sensing import leave_one_out
from thermaltool.runtime.settings import Settings
from thermaltool.runtime.stream import open_stream

PERIOD, SLEW, STEP, LIMIT = 0.5, 4.0, 0.5, 90.0
SENSORS = ("T_near_degC", "T_far_degC", "T_wall_degC")
NAMES = ("time_s", *SENSORS)
HEADER_OF = {n: ",".join(NAMES[: 1 + n]).encode() for n in (1, 2, 3)}
# Limits hold in the tests for what a line may move: two periods at the slew rate, and the grid.
MOST = SLEW * 2 * PERIOD + 1.25 * STEP
WHOLE_PIPELINE, WHOLE_WITHOUT = EstimatorPipeline.of, leave_one_out.without


@functools.cache
def machine(sensors: int) -> Model:
    """A lumped machine with so many sensors, and a Kalman design; readings begin at 20 °C."""
    gains = [(6.0, 9.0, 120.0), (4.0, 15.0, 160.0), (2.0, 30.0, 200.0)][:sensors]
    bend = Rational2(60.0, 40.0, 30.0, 300.0)
    responses = [Rational2(0.3 * g, a, 0.7 * g, b) for g, a, b in gains]
    drives = (Drive("Q_main_W", "zero", 0.0, (0.0, 1.0)),)
    names = SENSORS[:sensors]
    spans = dict(zip(names, gains, strict=True))
    outputs = [Output(name, "sensor", 20.0, (0.0, spans[name][0])) for name in names]
    terms = [Term("Q_main_W", *each) for each in zip(names, responses, strict=True)]
    model = Model(
        drives,
        (*outputs, Output("d_z_um", "deflection", "first", (0.0, 90.0))),
        (*terms, Term("Q_main_W", "d_z_um", bend)),
        PERIOD,
    )
    noise = (SensorNoise(0.02, 0.01, 600.0),) * sensors
    estimator = KalmanEstimator(
        names,
        ("Q_main_W",),
        ("d_z_um",),
        tuple((k, 0, response.modes(PERIOD)) for k, response in enumerate(responses)),
        ((0, 0, bend.modes(PERIOD)),),
        (0.02,),
        noise,
    )
    changes = plausible_changes(model, dict(zip(names, names, strict=True)), noise, PERIOD)
    return model.with_design({**estimator.document(), "plausible_change": changes})


@functools.cache
def pipeline(sensors: int) -> EstimatorPipeline:
    return WHOLE_PIPELINE(machine(sensors))


@functools.cache
def without(estimator: KalmanEstimator, k: int) -> KalmanEstimator:
    return WHOLE_WITHOUT(estimator, k)


def warming(rng: np.random.Generator, sensors: int, rows: int) -> np.ndarray:
    """Readings of a heat that is switched, by steps of explicit Euler: shares no code."""
    heat, x = 0.0, np.zeros((3, 2))
    taus = np.array([(9.0, 120.0), (15.0, 160.0), (30.0, 200.0)])
    gains = np.array([(1.8, 4.2), (1.2, 2.8), (0.6, 1.4)])
    out = np.empty((rows, 3))
    for k in range(rows):
        if rng.random() < 0.01:
            heat = rng.random()
        x += PERIOD / taus * (gains * heat - x)
        out[k] = 20 + x.sum(axis=1)
    return (out + rng.normal(0, 0.02, out.shape))[:, :sensors].round(3)


@dataclass
class Trial:
    """One stream: its lines, and what is done to it."""

    rng: random.Random
    numbers: np.random.Generator
    sensors: int
    lines: list[bytes] = field(default_factory=list)
    done: list[str] = field(default_factory=list)

    def somewhere(self) -> int:
        return self.rng.randrange(2, len(self.lines))

    def fields(self, at: int) -> list[bytes]:
        return self.lines[at].split(b",")

    def change(self, at: int, column: int, text: bytes) -> None:
        fields = self.fields(at)
        if column < len(fields):
            fields[column] = text
            self.lines[at] = b",".join(fields)


def stamp_ahead(t: Trial) -> None:
    t.change(t.somewhere(), 0, b"%g" % (10 ** t.rng.uniform(0, 9)))


def stamp_back(t: Trial) -> None:
    t.change(t.somewhere(), 0, b"%g" % t.rng.uniform(-100, 50))


def clock_set(t: Trial) -> None:
    at, by = t.somewhere(), t.rng.choice([-3600.0, -30.0, 30.0, 3600.0, 1.7e9])
    for k in range(at, len(t.lines)):
        try:
            t.change(k, 0, b"%.9g" % (float(t.fields(k)[0]) + by))
        except ValueError:
            continue


def bit_flips(t: Trial) -> None:
    for _ in range(t.rng.randrange(1, 20)):
        at = t.somewhere()
        line = bytearray(t.lines[at])
        if line:
            line[t.rng.randrange(len(line))] ^= 1 << t.rng.randrange(8)
            t.lines[at] = bytes(line).replace(b"\n", b"?")


def lost_lines(t: Trial) -> None:
    at = t.somewhere()
    del t.lines[at : at + t.rng.randrange(1, 60)]
    if len(t.lines) < 4:
        t.lines += [b"1e3,20,20,20"[: 7 + 3 * t.sensors]] * 3


def repeated_lines(t: Trial) -> None:
    at, count = t.somewhere(), t.rng.randrange(1, 40)
    t.lines[at:at] = t.lines[max(at - count, 1) : at]


def header_again(t: Trial) -> None:
    """Columns in another order from here on, and the header that says so."""
    at = t.somewhere()
    order = list(range(1 + t.sensors))
    t.rng.shuffle(order)
    moved = [t.fields(k) for k in range(at, len(t.lines))]
    t.lines[at:] = [
        b",".join(row[j] for j in order) if len(row) == len(order) else b",".join(row)
        for row in moved
    ]
    t.lines.insert(at, b",".join(NAMES[j].encode() for j in order))


def header_broken(t: Trial) -> None:
    t.lines.insert(t.somewhere(), b"time_s,T_nera_degC,T_far_degC")


def other_fields(t: Trial) -> None:
    at = t.somewhere()
    for k in range(at, min(at + t.rng.randrange(1, 30), len(t.lines))):
        t.lines[k] = t.rng.choice([t.lines[k] + b",7", t.lines[k].rpartition(b",")[0], b""])


def spike(t: Trial) -> None:
    at = t.somewhere()
    for k in range(at, min(at + t.rng.choice([1, 1, 2, 5]), len(t.lines))):
        t.change(k, 1, b"%g" % t.rng.uniform(15, 32))


def lasting_step(t: Trial) -> None:
    at, by = t.somewhere(), t.rng.choice([-5.0, 5.0, 3.0])
    for k in range(at, len(t.lines)):
        try:
            t.change(k, 1, b"%.3f" % (float(t.fields(k)[1]) + by))
        except (ValueError, IndexError):
            continue


def frozen(t: Trial) -> None:
    at = t.somewhere()
    value = t.fields(at)[-1]
    for k in range(at, len(t.lines)):
        t.change(k, t.sensors, value)


def nonsense(t: Trial) -> None:
    words = [b"", b"nan", b"inf", b"-1e308", b"85.0", b"-127", b"--", b"1_0", b"1e400", b"\xff"]
    at = t.somewhere()
    for k in range(at, min(at + t.rng.randrange(1, 60), len(t.lines))):
        t.change(k, t.rng.randrange(0, 1 + t.sensors), t.rng.choice(words))


FAULTS = [
    stamp_ahead, stamp_back, clock_set, bit_flips, lost_lines, repeated_lines, header_again,
    header_broken, other_fields, spike, lasting_step, frozen, nonsense,
]  # fmt: skip


def damage(path: Path, rng: random.Random) -> str:
    """Something bad happens to one of the files that a stream keeps."""
    names = [name for name in path.parent.iterdir() if name.name.startswith(path.name)]
    if not names:
        return "nothing kept"
    target = rng.choice(sorted(names))
    data = bytearray(target.read_bytes())
    what = rng.choice(["flip", "cut", "empty", "gone"])
    if what == "gone":
        target.unlink()
    elif data:
        if what == "flip":
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        target.write_bytes(
            bytes(data if what == "flip" else data[: len(data) // 2 * (what == "cut")])
        )
    return f"{what} {target.suffix}"


class Killed(BaseException):
    """As kill -9: nothing runs after it."""


def run_stream(
    text: bytes, folder: Path, sensors: int, kept: bool, kill_at: int | None, end: str = "safe"
) -> list[tuple[float, float]]:
    """Lines (time, set point) that a stream wrote; raises what it raised."""
    settings = Settings(
        limits=(-LIMIT, LIMIT), slew=SLEW, step=STEP, end=end,
        checkpoint=str(folder / "state") if kept else None, checkpoint_every=20.0,
    )  # fmt: skip
    messages = Messages(lambda line: None)
    process = compensation.offsets(machine(sensors), settings, messages)
    (folder / "in").write_bytes(text)
    with (
        open(folder / "in", "rb") as source,
        open(folder / "out", "wb") as sink,
        contextlib.ExitStack() as killing,
    ):
        stream = open_stream(process, settings, source.fileno(), sink.fileno(), messages)
        # The ramp at the end takes no time: its pauses move the clock.
        passed = [0.0]
        stream.now = lambda: time.monotonic() + passed[0]

        def pause(seconds: float) -> bool:
            passed[0] += seconds
            return True

        killing.enter_context(mock.patch.object(stream.pipe, "pause", pause))
        if kill_at is not None:
            whole, written = stream.pipe.write, 0

            def dying(data: bytes) -> None:
                nonlocal written
                written += data.count(b"\n")
                if written > kill_at:
                    # Half of what leaves at once has left.
                    whole(b"".join(data.splitlines(True)[: data.count(b"\n") // 2]))
                    raise Killed
                whole(data)

            killing.enter_context(mock.patch.object(stream.pipe, "write", dying))
            killing.enter_context(mock.patch.object(stream, "_finish"))
            killing.enter_context(mock.patch.object(stream, "_approach"))
        try:
            stream.run()
        except Killed:
            pass
        finally:
            # What the kernel does at the death of a process.
            if stream.restart.journal is not None:
                stream.restart.journal.close()
            checkpoint = stream.restart.checkpoint
            if checkpoint is not None and checkpoint._writer is not None:
                checkpoint._writer.join()
    lines = (folder / "out").read_text().splitlines()[1:]
    return [(float(a or "nan"), float(b)) for a, b in (line.split(",") for line in lines)]


def trial(seed: int, number: int, folder: Path) -> tuple[list[str], list[str]]:
    """What was done in one trial, and what went wrong."""
    rng = random.Random(f"{seed}/{number}")
    t = Trial(rng, np.random.default_rng([seed, number]), rng.choice([1, 1, 2, 3]))
    rows = rng.randrange(60, 260)
    readings = warming(t.numbers, t.sensors, rows)
    t.lines = [HEADER_OF[t.sensors]]
    t.lines += [
        b"%g,%s" % (k * PERIOD, b",".join(b"%.3f" % x for x in row))
        for k, row in enumerate(readings)
    ]
    for fault in rng.sample(FAULTS, rng.randrange(1, 4)):
        fault(t)
        t.done.append(fault.__name__)
    wrong: list[str] = []
    kept = rng.random() < 0.6
    kill_at = rng.randrange(1, rows) if kept and rng.random() < 0.6 else None
    end = rng.choice(["safe", "ramp"])
    t.done.append(f"end {end}")
    before = None
    parts = [(t.lines, kill_at)]
    if kill_at is not None:
        t.done.append("kill")
        again = rng.choice([kill_at, kill_at + 5, 1])
        parts.append(([t.lines[0], *t.lines[min(again, len(t.lines) - 2) :]], None))
    for n, (lines, kill) in enumerate(parts):
        if n and rng.random() < 0.4:
            t.done.append(damage(folder / "state", rng))
        try:
            out = run_stream(b"\n".join(lines) + b"\n", folder, t.sensors, kept, kill, end)
        except ThermalToolError:
            out = read_out(folder)
        known = before if not damaged_journal(t.done) else None
        wrong += check(out, known, kill is None, at_once=end == "safe")
        before = out[-1][1] if out else before
    return t.done, wrong


def damaged_journal(done: list[str]) -> bool:
    """Whether nothing can know where the actuator stood."""
    return any(".setpoints" in each for each in done)


def read_out(folder: Path) -> list[tuple[float, float]]:
    lines = (folder / "out").read_text().splitlines()[1:]
    return [(float(a or "nan"), float(b)) for a, b in (line.split(",") for line in lines)]


def check(
    out: list[tuple[float, float]], before: float | None, ends: bool, at_once: bool = True
) -> list[str]:
    """What no stream may do."""
    wrong = []
    values = [value for _, value in out]
    if not all(map(math.isfinite, values)) or any(abs(v) > LIMIT for v in values):
        wrong.append("beyond the limits")
    if ends and (not values or values[-1] != 0.0):
        wrong.append("no safe line at the end")
    # The safe line at the end may be at once; where it is the only one, too.
    moving = values[:-1] if ends and at_once else values
    if before is not None:
        moving = [before, *moving]
    steps = [abs(b - a) for a, b in itertools.pairwise(moving)]
    if steps and max(steps) > MOST + 1e-9:
        wrong.append(f"a step of {max(steps):g} um")
    return wrong


def inject(count: int, seed: int, patience: float = math.inf) -> tuple[int, Counter, list[str]]:
    """So many trials: how many ran, how often each fault was drawn, and what went wrong."""
    drawn: Counter = Counter()
    failures: list[str] = []
    begin, ran = time.monotonic(), 0
    # Gains are solved for once: they are nearly all the time of a trial.
    # Few lines at once, as they come from a machine: a state is kept between them.
    with (
        mock.patch.object(EstimatorPipeline, "of", lambda model: pipeline(len(model.sensors))),
        mock.patch.object(leave_one_out, "without", without),
        mock.patch.object(pipe, "READ_SIZE", 512),
    ):
        for number in range(count):
            if time.monotonic() - begin > patience:
                break
            with tempfile.TemporaryDirectory() as folder:
                done, wrong = trial(seed, number, Path(folder))
            ran += 1
            drawn.update(done)
            failures += [f"trial {number} ({', '.join(done)}): {each}" for each in wrong]
    return ran, drawn, failures


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=secrets.randbelow(2**31))
    arguments = parser.parse_args()
    print(f"seed {arguments.seed}")
    ran, drawn, failures = inject(arguments.count, arguments.seed)
    print(f"{ran} streams; faults drawn: {json.dumps(drawn)}")
    print(f"{len(failures)} failures", *failures[:20], sep="\n")
    sys.exit(3 if failures else 0)
