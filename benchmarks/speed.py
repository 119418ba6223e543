"""Speed as ratios measured in one run, a Markdown table of asked and measured. `make bench`.

Times are medians of `REPEATS`, in process as CPU time of the one thread, of commands as wall time.
Where a limit is a ratio, both sides are timed in turn, so that what else the machine does falls on
both. A line without a limit is there for information.
"""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

# One core for each process: the streaming command sets the same. Before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
# A user's Python keeps its bytecode.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import numpy as np
from stream import Figure, published_machine
from stream import figures as stream_figures

from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.estimation.estimator import load_estimator
from thermaltool.estimation.kernel import Kernel, Regularization, invert_modes, kernel_table
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.logs import write_table
from thermaltool.model import dumps, loads
from thermaltool.record import Record
from thermaltool.responses.modes import Float

REPEATS = 7
# Fraser 1997, linear structure, pair 1.
REGULARIZATION = Regularization(0.00644, 0.00135, 0.0859)
PERIOD = 0.5
TOOL = [sys.executable, "-c", "from thermaltool.cli import main; main()"]

# What a stage cannot do without: the parser of its options, numpy, and scipy where it fits.
FLOORS = {
    "check": "import click, numpy",
    "estimate": "import click, numpy",
    "simulate": "import click, numpy, scipy.special",
    "noise": "import click, numpy, scipy.optimize",
}


def medians(
    *actions: Callable[[], object],
    clock: Callable[[], float] = time.perf_counter,
    repeats: int = REPEATS,
) -> list[float]:
    """Median seconds of each action; they take turns, after one round that does not count."""

    def seconds(action: Callable[[], object]) -> float:
        begin = clock()
        action()
        return clock() - begin

    rounds = [[seconds(action) for action in actions] for _ in range(repeats + 1)]
    return np.median(rounds[1:], axis=0).tolist()


def python(code: str) -> Callable[[], object]:
    return lambda: subprocess.run([sys.executable, "-c", code], check=True)


def command(*arguments: object) -> Callable[[], object]:
    line = [*TOOL, *map(str, arguments)]
    return lambda: subprocess.run(line, check=True, capture_output=True)


def kernel_figures(model: Path, folder: Path) -> list[Figure]:
    """Model file to kernel of 1200 samples."""

    def in_process() -> Kernel:
        response = loads(model.read_text()).terms[0].response
        return kernel_table(response.transfer, REGULARIZATION, PERIOD, 1200)

    shape = [REGULARIZATION.A, REGULARIZATION.B, REGULARIZATION.c]
    whole = command("invert", model, "--regularization", *shape, "-o", folder / "kernel.parquet")
    (inside,), (outside,) = medians(in_process, clock=time.process_time), medians(whole)
    return [
        Figure("model file to kernel of 1200 samples", 1e3 * inside, "ms", 50),
        Figure("the whole command", 1e3 * outside, "ms"),
    ]


def convolution(kernel: Kernel, readings: np.ndarray) -> float:
    """Heat at the last reading by the sum over the window of the kernel."""
    recent = readings[: -len(kernel.weight) - 1 : -1]
    slope = (readings[-1] - readings[-2]) / PERIOD
    weight = kernel.weight[: len(recent)]
    return float(weight @ recent + kernel.A0 * readings[-1] + kernel.A1 * slope)


def window_figures() -> list[Figure]:
    """Cost of a sample: the recursion, which has no window, beside the sum over one."""
    response = published_machine().terms[0].response
    inverse = invert_modes(response.modes(PERIOD), REGULARIZATION)
    recursion = inverse.regular.discretize(PERIOD, "first")
    readings = response.step(PERIOD * np.arange(100_001))
    kernels = {
        n: kernel_table(response.transfer, REGULARIZATION, PERIOD, n) for n in (100, 100_000)
    }

    F, G0, G1, C = recursion.F, recursion.G0[:, 0], recursion.G1[:, 0], recursion.C[0]

    def advance(x: Float, now: int, count: int) -> tuple[Float, float]:
        for before, reading in itertools.pairwise(readings[now : now + count + 1].tolist()):
            x = F @ x + G0 * before + G1 * reading
            heat = C @ x + inverse.A0 * reading + inverse.A1 * (reading - before) / PERIOD
        return x, float(heat)

    early, first_heat = advance(np.zeros(len(F)), 0, 100)
    late, last_heat = advance(early, 100, 99_400)
    # The recursion carries everything since rest: so does a window that reaches back to it.
    whole = kernels[100_000]
    off = max(
        abs(convolution(whole, readings[: n + 1]) - heat)
        for n, heat in ((100, first_heat), (99_500, last_heat))
    )

    count = 400
    after_few, after_many, short, long = medians(
        lambda: advance(early, 100, count),
        lambda: advance(late, 99_500, count),
        lambda: [convolution(kernels[100], readings) for _ in range(count)],
        lambda: [convolution(kernels[100_000], readings) for _ in range(count)],
    )
    each = 1e6 / count
    return [
        Figure("recursion against the sum over all samples, Q̂", off, "1", 1e-3),
        Figure(
            "recursion, cost of a sample after 10⁵ over after 10²", after_many / after_few, "", 1.2
        ),
        Figure("recursion, cost of a sample", each * after_many, "µs"),
        Figure("sum over a window of 10², cost of a sample", each * short, "µs"),
        Figure("sum over a window of 10⁵, cost of a sample", each * long, "µs"),
    ]


def warming(samples: int) -> dict[str, Float]:
    """A log of the pair with noise, in steps of 1 mK."""
    time_s = PERIOD * np.arange(samples)
    noise = 0.02 * np.random.default_rng(0).standard_normal(samples)
    return {"time_s": time_s, "dT_pair1_K": np.round(noise - 8 * np.expm1(-time_s / 300), 3)}


def batch_figures(model: Path, folder: Path) -> list[Figure]:
    """A million samples at once."""
    columns = warming(1_000_000)
    time_s, readings = columns["time_s"], columns["dT_pair1_K"][:, None]
    estimator = load_estimator(dict(loads(model.read_text()).estimator_design()))
    log = folder / "million.parquet"
    write_table(columns, str(log), None)
    (inside,) = medians(lambda: estimator.run(time_s, readings), clock=time.process_time)
    whole = command("estimate", model, log, "-q", "-o", folder / "estimates.parquet")
    (outside,) = medians(whole, repeats=5)
    return [
        Figure("estimate of 10⁶ samples, in process", inside, "s", 2),
        Figure("the whole command, Parquet to Parquet", outside, "s"),
    ]


def run_of(rows: int, seed: int, exponent: float = 1.0, beside: int = 0) -> Record:
    """The published machine on a random duty, with noise, the air and another motor beside it.

    Its heat goes with a power of the drive that is logged.
    """
    random = np.random.default_rng(seed)
    time_s = PERIOD * np.arange(rows)
    duty = np.repeat(random.random(rows // 400 + 1), 400)[:rows]
    outputs = published_machine().simulate(Record(time_s, {"Q_main_1": duty**exponent}))
    columns = {"Q_main_1": duty, "Q_pump_1": np.roll(duty, 700)}
    for k in range(beside):
        # Speeds, heats and temperatures in turn, each on a course of its own.
        name = (f"n_axis{k}_rpm", f"Q_aux{k}_W", f"T_place{k}_degC")[k % 3]
        steps = np.repeat(random.random(rows // 300 + 1), 300)[:rows]
        swing = 20 + np.cumsum(random.standard_normal(rows)) / 50
        columns[name] = swing if k % 3 == 2 else 100 * steps
    columns["T_air_degC"] = 20 + np.sin(time_s / 700) + 0.05 * random.standard_normal(rows)
    for name, values in outputs.items():
        columns[name] = values + (0.02 if name.startswith("dT") else 0.1) * random.standard_normal(
            rows
        )
    return Record(time_s, columns, digest=f"run {seed}")


def diagnose_figures() -> list[Figure]:
    """The whole catalogue on a log of 10⁴ rows and three outputs, calibrated on another one."""
    calm, clean, wrong = run_of(10_000, 1), run_of(10_000, 2), run_of(10_000, 3, 1.3)
    plan = CalibrationPlan(("Q_main_1",), ("dT_pair1_K",), ("d_x_um", "d_y_um"))
    model = calibrate([Record(calm.time, calm.columns)], plan)
    figures = []
    for name, log in (("nothing wrong", clean), ("power law of the drive", wrong)):
        (seconds,) = medians(
            lambda log=log: diagnose(model, [log]), clock=time.process_time, repeats=2
        )
        figures.append(Figure(f"diagnose, 10⁴ rows, 3 outputs, {name}", seconds, "s", 30))
    wide = run_of(10_000, 3, 1.3, beside=14)  # 20 channels
    begin = time.process_time()
    diagnose(model, [wide])
    seconds = time.process_time() - begin
    figures.append(Figure("diagnose, 10⁴ rows, 20 channels, power law", seconds, "s", 60))
    return figures


def start_figures() -> list[Figure]:
    click, help_text = medians(python("import click"), command("--help"))
    return [Figure("--help over import click", help_text / click, "", 3)]


def pipe_figures(model: Path, folder: Path) -> list[Figure]:
    """check | estimate | simulate | check | noise on 1000 rows, over the floors of the stages."""
    log = folder / "rows.csv"
    write_table(warming(1000), str(log), None)
    stages = [
        ["check", log, "-o", "-"],
        ["estimate", model, "-", "-q"],
        ["simulate", model, "-", "-q"],
        ["check", "-", "-o", "-"],
        ["noise", "-"],
    ]

    def pipe() -> None:
        feed, running = None, []
        for stage in stages:
            process = subprocess.Popen(
                [*TOOL, *map(str, stage)],
                stdin=feed,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
            if feed is not None:
                feed.close()
            feed = process.stdout
            running.append(process)
        assert feed is not None
        feed.read()
        feed.close()
        codes = [process.wait() for process in running]
        if any(codes):
            raise SystemExit(f"the pipe failed: {codes}")

    whole, *floors = medians(pipe, *(python(code) for code in FLOORS.values()))
    floor = dict(zip(FLOORS, floors, strict=True))
    total = sum(floor[str(stage[0])] for stage in stages)
    told = ", ".join(f"{name} {value:.2f}" for name, value in floor.items())
    return [
        Figure("five-stage pipe over the import floors of its stages", whole / total, "", 1.5),
        Figure("the pipe itself", whole, "s"),
        Figure(f"sum of the floors ({told})", total, "s"),
    ]


def row(figure: Figure) -> str:
    measured, asked, verdict = f"{figure.value:.4g} {figure.unit}".strip(), "–", ""
    if figure.wanted is not None:
        sign = "≥" if figure.at_least else "≤"
        asked = f"{sign} {figure.wanted:g} {figure.unit}".strip()
        verdict = "yes" if figure.reached else "NO"
    return f"| {figure.name} | {asked} | {measured} | {verdict} |"


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = folder / "model.json"
        model.write_text(dumps(published_machine()))
        groups = [
            lambda: kernel_figures(model, folder),
            stream_figures,
            window_figures,
            lambda: batch_figures(model, folder),
            diagnose_figures,
            start_figures,
            lambda: pipe_figures(model, folder),
        ]
        print("| what | asked | measured | reached |")
        print("|---|---|---|---|")
        reached = True
        for group in groups:
            for figure in group():
                print(row(figure), flush=True)
                reached &= figure.reached
    sys.exit(0 if reached else 3)


if __name__ == "__main__":
    main()
