"""``thermaltool compensate`` in a real pipe: lines per second, latency, memory, start-up.

    python benchmarks/stream.py            all of it, about a minute
    python benchmarks/stream.py --quick    shorter runs

Each figure stands beside the one that is wanted. The machine is the published pair 1 of Fraser
1997 with its x and y deflections, and a Kalman estimator of about fifty states.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import cast

import numpy as np

from thermaltool.estimation.estimator import KalmanEstimator, SensorNoise
from thermaltool.model import Drive, Model, Output, Term, dumps
from thermaltool.responses.conduction import Conduction
from thermaltool.responses.deflection import Deflection

COMPENSATE = [
    sys.executable,
    "-c",
    "from thermaltool.cli import main; main()",
    "compensate",
]
# What the machine itself takes for a line there and back: the least that any program can reach.
ECHO = [
    sys.executable,
    "-c",
    "import os\nwhile line := os.read(0, 65536): os.write(1, line)",
]


@dataclass(frozen=True)
class Figure:
    """One measured value, beside the wanted one where there is one."""

    name: str
    value: float
    unit: str
    wanted: float | None = None
    at_least: bool = False

    @property
    def reached(self) -> bool:
        if self.wanted is None:
            return True
        return self.value >= self.wanted if self.at_least else self.value <= self.wanted

    def __str__(self) -> str:
        text = f"{self.name:<44} {self.value:>10.4g} {self.unit:<8}"
        if self.wanted is not None:
            text += f" {'≥' if self.at_least else '≤'} {self.wanted:g}"
        return text if self.reached else f"{text}   NOT REACHED"


def published_machine() -> Model:
    """Pair 1 and its deflections (Fraser 1997), with an estimator."""
    pair = Conduction(K=3.498, a=0.01565, alpha=0.1173, r=5.12, r0=0.12)
    x = Deflection(10.546, 5.90e-4, 67.08, 9.14e-4, -0.0414, 0.00435)
    y = Deflection(100.43, 9.09e-4, 141.96, 1.57e-3, -0.01, 0.00903)
    estimator = KalmanEstimator(
        ("dT_pair1_K",),
        ("Q_main_1",),
        ("d_x_um", "d_y_um"),
        ((0, 0, pair.modes(0.5)),),
        ((0, 0, x.modes(0.5)), (1, 0, y.modes(0.5))),
        (0.02,),
        (SensorNoise(0.02, 0.03, 600.0),),
    )
    outputs = (
        Output("dT_pair1_K", "sensor", 0.0, (0.0, 9.0)),
        Output("d_x_um", "deflection", "first", (0.0, 80.0)),
        Output("d_y_um", "deflection", "first", (0.0, 250.0)),
    )
    terms = (
        Term("Q_main_1", "dT_pair1_K", pair),
        Term("Q_main_1", "d_x_um", x),
        Term("Q_main_1", "d_y_um", y),
    )
    drives = (Drive("Q_main_1", "zero", 0.0, (0.0, 1.0)),)
    return Model(drives, outputs, terms, 0.5).with_design(estimator.document())


def sensor_lines(count: int, seed: int = 1) -> list[bytes]:
    """A warming pair with noise, one line per half second."""
    time = 0.5 * np.arange(count)
    noise = 0.02 * np.random.default_rng(seed).standard_normal(count)
    readings = 8.0 * -np.expm1(-time / 300.0) + noise
    return [f"{t:.1f},{T:.4f}\n".encode() for t, T in zip(time, readings, strict=True)]


HEADER = b"time_s,dT_pair1_K\n"


def open_pipe(command: list[str]) -> subprocess.Popen[bytes]:
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)


def pipes_of(process: subprocess.Popen[bytes]) -> tuple[FileIO, FileIO]:
    """Both ends, without buffers."""
    return cast(FileIO, process.stdin), cast(FileIO, process.stdout)


def throughput(model: Path, count: int) -> float:
    """Lines per second from the first answer to the last, fed as fast as they are taken."""
    first, *lines = sensor_lines(count)
    process = open_pipe([*COMPENSATE, str(model)])
    source, sink = pipes_of(process)
    source.write(HEADER + first)
    while sink.readline().startswith(b"time_s"):
        pass
    feeder = threading.Thread(target=feed, args=(source, b"".join(lines)))
    begin = time.perf_counter()
    feeder.start()
    answers = sum(chunk.count(b"\n") for chunk in iter(lambda: sink.read(65536), b""))
    seconds = time.perf_counter() - begin
    feeder.join()
    sink.close()
    if process.wait() or answers != count:
        raise SystemExit(f"{answers} answers to {count} lines, exit code {process.returncode}")
    return count / seconds


def feed(sink: FileIO, data: bytes) -> None:
    with sink:
        view = memoryview(data)
        while view:
            view = view[sink.write(view) :]


def latencies(command: list[str], count: int, rate: float = 100.0) -> list[float]:
    """Seconds from writing each line to reading its answer, at `rate` lines/s, sorted."""
    process = open_pipe(command)
    source, sink = pipes_of(process)
    source.write(HEADER)
    sink.readline()
    found = []
    due = time.perf_counter()
    for line in sensor_lines(count):
        time.sleep(max(due - time.perf_counter(), 0.0))
        due += 1 / rate
        begin = time.perf_counter()
        source.write(line)
        os.read(sink.fileno(), 4096)
        found.append(time.perf_counter() - begin)
    source.close()
    sink.read()
    sink.close()
    process.wait()
    # The first line starts the estimator.
    return sorted(found[1:])


def peak_memory(model: Path, count: int) -> float:
    """Largest resident set of a stream of `count` lines [MB], as Linux counts it."""
    process = open_pipe([*COMPENSATE, str(model)])
    source, sink = pipes_of(process)
    feeder = threading.Thread(target=source.write, args=(HEADER + b"".join(sensor_lines(count)),))
    feeder.start()
    answers = 0
    while answers <= count:
        answers += sink.read(65536).count(b"\n")
    status = Path(f"/proc/{process.pid}/status").read_text()
    feeder.join()
    source.close()
    sink.read()
    sink.close()
    process.wait()
    return int(status.split("VmHWM:")[1].split()[0]) / 1024


def start_up(model: Path, repeats: int) -> float:
    """Header in to exit, over ``import numpy``: the median ratio of runs side by side."""
    ratios = []
    for _ in range(repeats):
        begin = time.perf_counter()
        subprocess.run([sys.executable, "-c", "import numpy"], check=True)
        between = time.perf_counter()
        subprocess.run([*COMPENSATE, str(model)], input=HEADER, capture_output=True, check=True)
        ratios.append((time.perf_counter() - between) / (between - begin))
    return statistics.median(ratios)


def figures(quick: bool = False) -> list[Figure]:
    """Everything that is promised of the stream, measured now."""
    with tempfile.TemporaryDirectory() as folder:
        model = Path(folder, "model.json")
        model.write_text(dumps(published_machine()))
        many = 30_000 if quick else 200_000
        few = 300 if quick else 1000
        # Of three runs the least disturbed: what else the machine does can only add.
        waits, echo = (
            min((latencies(command, few) for _ in range(3)), key=lambda w: w[int(0.99 * few)])
            for command in ([*COMPENSATE, str(model)], ECHO)
        )
        rates = [max(throughput(model, count) for _ in range(3)) for count in (many // 10, many)]
        return [
            Figure("lines per second in a pipe", rates[1], "1/s", 20_000, at_least=True),
            Figure("time per line, long stream over short", rates[0] / rates[1], "", 1.5),
            Figure("latency at 100 lines/s, p50", 1e3 * waits[few // 2], "ms"),
            Figure("latency at 100 lines/s, p99", 1e3 * waits[int(0.99 * few)], "ms", 1.0),
            Figure("the same of a bare echo, p99", 1e3 * echo[int(0.99 * few)], "ms"),
            Figure("peak memory", peak_memory(model, many), "MB", 50.0),
            Figure("start-up over import numpy", start_up(model, 3 if quick else 9), "", 3.0),
        ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="shorter runs")
    found = figures(parser.parse_args().quick)
    print(*found, sep="\n")
    sys.exit(0 if all(figure.reached for figure in found) else 3)


if __name__ == "__main__":
    main()
