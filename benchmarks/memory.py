"""Memory of every command that reads a log, in bytes a row, beside what is asked: a Markdown table.

``python benchmarks/memory.py [COMMAND ...]``: peaks of a process of its own at two lengths of one
log, so that what does not grow with the log drops out. The tests hold the same limits at shorter
logs. Ends with 3 when a limit is missed.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow
import pyarrow.csv
from scipy.signal import lfilter

import thermaltool as tt
from thermaltool.documents import write_json

# Rows of the two logs.
ROWS = (300_000, 1_000_000)
DRIVE, SENSOR, DEFLECTION = "Q_main_1", "dT_pair1_K", "d_y_um"
CHANNELS = f"--drive {DRIVE} --sensor {SENSOR} --deflection {DEFLECTION}"
# A process begins with the peak of the one that started it, so that a small one has to.
MEASURE = """
import resource, subprocess, sys
done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
sys.exit(done.returncode)
"""
# A log has four columns of 8 bytes.
LOG = 32.0


@dataclass(frozen=True)
class Command:
    """A command, and the memory that a row may take.

    Attributes
    ----------
    line : str
        Arguments; {log}, {out} and the documents of `documents` by name.
    limit : float [bytes a row]
    rows : tuple of int
        Lengths of the two logs.
    averaged : int
        Rows from which `calibrate` and `diagnose` average, in place of their limit; 0 for that.
    """

    line: str
    limit: float
    rows: tuple[int, int] = ROWS
    averaged: int = 0


COMMANDS = {
    "check": Command("check {log} -o {out}.csv", LOG + 250),
    "noise": Command("noise {log} -o {out}.json", LOG + 300),
    "calibrate": Command("calibrate {log} " + CHANNELS + " -q -o {out}.json", LOG + 200),
    "simulate": Command("simulate {model} {log} -q -o {out}.csv", LOG + 250),
    "estimate": Command("estimate {design} {log} -q -o {out}.csv", LOG + 250),
    "forecast": Command("forecast {arma} {log} -o {out}.csv", LOG + 250),
    "plot": Command("plot {log} -o {out}.png", LOG + 250),
    "order": Command("order {log} -C d_y_um --max-p 4 --max-q 2", LOG + 400),
    "fit": Command("fit {log} -C d_y_um --order 2,1 -o {out}.json", LOG + 300),
    "identify": Command(
        f"identify {{log}} --input {DRIVE} --output {SENSOR} -q -o {{out}}.json", LOG + 450
    ),
    "diagnose": Command("diagnose {model} {log} -q -o {out}.json", LOG + 200),
}


def frame_of(rows: int) -> pd.DataFrame:
    """A seeded log of a machine of two lags each, on a random duty cycle, sampled every second.

    Parameters
    ----------
    rows : int
    """
    rng = np.random.default_rng(20261123)
    switched = rng.random(rows) < 1 / 600
    levels = rng.choice([0.0, 0.25, 0.5, 1.0], int(switched.sum()) + 1)
    levels[0] = 0.0
    u = levels[np.cumsum(switched)]

    def lag(tau: float) -> np.ndarray:
        kept = np.exp(-1 / tau)
        return np.asarray(lfilter([0.0, 1 - kept], [1.0, -kept], u))

    rise = 5 * lag(120.0) + 3 * lag(900.0) + 0.01 * rng.standard_normal(rows)
    bend = 20 * lag(300.0) + 30 * lag(1500.0) + 0.05 * rng.standard_normal(rows)
    columns = {DRIVE: u, SENSOR: np.round(rise, 5), DEFLECTION: np.round(bend, 4)}
    return pd.DataFrame({"time_s": np.arange(float(rows)), **columns})


def write_log(path: Path, rows: int) -> Path:
    """The log of `frame_of` as CSV, long enough for the fast reader.

    Parameters
    ----------
    path : Path
    rows : int
    """
    pyarrow.csv.write_csv(pyarrow.Table.from_pandas(frame_of(rows)), str(path))
    return path


def documents(folder: Path) -> dict[str, str]:
    """What commands read beside the log, found on a short one.

    Parameters
    ----------
    folder : Path
    """
    # Of some of the slowest time constants: `diagnose` judges by no shorter one.
    frame = frame_of(12_000)
    kinds = {SENSOR: "rational2", DEFLECTION: "rational2"}
    fit = tt.calibrate(frame, DRIVE, sensors=SENSOR, deflections=DEFLECTION, kinds=kinds,
                       linear=True, initial="rest", starts=1, warn=_silent)  # fmt: skip
    design = tt.regularize(fit, tt.noise(frame), form="kalman", walk=0.01, delay=0.0, warn=_silent)
    series = tt.fit(frame[:2000], DEFLECTION, (2, 1), warn=_silent)
    paths = {name: str(folder / f"{name}.json") for name in ("model", "design", "arma")}
    tt.write_model(fit, paths["model"])
    tt.write_model(design, paths["design"])
    write_json(series.document(), paths["arma"])
    return paths


def _silent(message: str) -> None:
    """No notice."""


def peak(line: str, averaged: int = 0) -> int:
    """Largest resident memory of a command in a process of its own [bytes].

    Parameters
    ----------
    line : str
    averaged : int
        See `Command`.
    """
    limit = f"import thermaltool.fitting.averaging as a; a.MAX_ROWS = {averaged}; "
    code = (limit if averaged else "") + "from thermaltool.cli import main; main()"
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", MEASURE, sys.executable, "-c", code, *shlex.split(line)],
        stdin=subprocess.DEVNULL, capture_output=True, text=True, env=environment, check=False,
    )  # fmt: skip
    if done.returncode not in (0, 3):  # 3: the log did not pass
        raise RuntimeError(f"{line}: ended with {done.returncode}: {done.stderr}")
    return int(done.stdout) * (1 if sys.platform == "darwin" else 1024)


def peaks(command: Command, logs: tuple[Path, Path], paths: dict[str, str]) -> tuple[int, int]:
    """Largest resident memory with either log [bytes].

    Parameters
    ----------
    command : Command
    logs : tuple of Path
    paths : mapping of name to path
        `documents`.
    """
    out = str(logs[0].parent / "out")
    few, many = (
        peak(command.line.format(log=log, out=out, **paths), command.averaged) for log in logs
    )
    return few, many


def main() -> int:
    """Print the table.

    Returns
    -------
    int
        3 when a limit is missed.
    """
    missed = False
    print("| command | rows | peak [MB] | bytes a row | limit |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = documents(folder)
        for title in sys.argv[1:] or COMMANDS:
            command = COMMANDS[title]
            few, many = (folder / f"{rows}.csv" for rows in command.rows)
            for path, rows in zip((few, many), command.rows, strict=True):
                if not path.exists():
                    write_log(path, rows)
            small, large = peaks(command, (few, many), paths)
            slope = (large - small) / (command.rows[1] - command.rows[0])
            missed |= slope > command.limit
            cells = (
                f"`{title}`",
                "{:,}, {:,}".format(*command.rows),
                f"{small / 1e6:.0f}, {large / 1e6:.0f}",
                f"{slope:.0f}",
                f"{command.limit:.0f}",
            )
            print(f"| {' | '.join(cells)} |", flush=True)
    return 3 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
