"""A folder with small logs of one simulated machine, and the command line run in it.

The machine is two lags of numpy alone: heat in W, a temperature that follows by 0.1 K/W, a
deflection that follows by 0.5 um/W.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

SAMPLES = Path(__file__).parents[1] / "data_samples"
ROWS, PERIOD_S = 700, 10.0
GAIN_K_PER_W, GAIN_UM_PER_W, AIR_DEGC = 0.1, 0.5, 20.0
# A command that says nothing for so long hangs [s].
MAX_SECONDS = 120


@dataclass(frozen=True)
class Done:
    """What a command leaves: exit code, stdout, stderr."""

    code: int
    out: str
    err: str

    @property
    def table(self) -> np.ndarray:
        """stdout as a table of numbers with names."""
        return np.genfromtxt(self.out.splitlines(), delimiter=",", names=True)


@dataclass(frozen=True)
class Stumble:
    """One stumble: its place in the list, its words, what was seen, and how it is tried."""

    number: str
    words: str
    was: str
    look: Callable[[Bench], tuple[str, bool]]

    def tried(self, bench: Bench) -> tuple[str, bool]:
        """What is seen now, and whether that is right; a command that fails is not."""
        try:
            now, ok = self.look(bench)
        except FailedError as error:
            return f"failed: {error}", False
        return now.replace("|", "\\|"), bool(ok)


class FailedError(Exception):
    """A command that should have run, and what it said last."""


def lag(drive: np.ndarray, tau: float, dt: float = PERIOD_S) -> np.ndarray:
    """A first-order lag of a drive that is held between rows, from rest."""
    decay = np.exp(-dt / tau)
    out = np.zeros(len(drive))
    for k in range(1, len(drive)):
        out[k] = decay * out[k - 1] + (1 - decay) * drive[k - 1]
    return out


def steps(rows: int = ROWS, seed: int = 16) -> np.ndarray:
    """Heat that steps every 50 rows, from none to at most 200 W, all of it at first."""
    heat = np.repeat(np.random.default_rng(seed).uniform(0, 200, -(-rows // 50)), 50)[:rows]
    heat[:50], heat[50:150] = 0.0, 200.0
    return np.round(heat, 1)


def warmed(heat: np.ndarray) -> np.ndarray:
    """How much warmer the head is than the air [K]."""
    return GAIN_K_PER_W * (0.6 * lag(heat, 300.0) + 0.4 * lag(heat, 2000.0))


def bent(heat: np.ndarray) -> np.ndarray:
    """How far the head has moved [um]."""
    return GAIN_UM_PER_W * lag(heat, 1500.0)


class Bench:
    """Logs, models and designs in a folder of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.noise = np.random.default_rng(1997)

    def tool(self, *arguments: object, stdin: str | bytes = "", fails: bool = False,
             env: dict[str, str] | None = None) -> Done:  # fmt: skip
        """Runs ``thermaltool`` in the folder; what was not to fail and does is `FailedError`."""
        data = stdin.encode() if isinstance(stdin, str) else stdin
        call = [sys.executable, "-m", "thermaltool", *map(str, arguments)]
        path = os.pathsep.join([str(SAMPLES.parent), os.environ.get("PYTHONPATH", "")])
        threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": path}
        try:
            done = subprocess.run(
                call, input=data, capture_output=True, cwd=self.folder,
                timeout=MAX_SECONDS, env=os.environ | threads | (env or {}),
            )  # fmt: skip
        except subprocess.TimeoutExpired as error:
            raise FailedError(f"{arguments[0]}: no end within {MAX_SECONDS} s") from error
        result = Done(done.returncode, done.stdout.decode(errors="replace"),
                      done.stderr.decode(errors="replace"))  # fmt: skip
        if "Traceback" in result.err or "unexpected error" in result.err:
            raise FailedError(f"{arguments[0]}: {last(result.err)}")
        if result.code not in (0, 3) and not fails:
            raise FailedError(f"{arguments[0]}: {last(result.err)}")
        return result

    def write(self, name: str, **columns: np.ndarray) -> Path:
        """A CSV log of these columns; missing values are empty cells, texts as they are."""
        rows = zip(*columns.values(), strict=True)
        lines = [",".join(columns), *(",".join(map(cell, row)) for row in rows), ""]
        path = self.folder / name
        path.write_text("\n".join(lines))
        return path

    def columns(self, seed: int = 16, noise: bool = True) -> dict[str, np.ndarray]:
        """The machine's log over random steps of its heat."""
        heat = steps(seed=seed)
        size = 1.0 if noise else 0.0
        air = AIR_DEGC + 0.02 * size * self.noise.standard_normal(ROWS)
        gauge = 0.2 * size * self.noise.standard_normal(ROWS)
        return {
            "time_s": PERIOD_S * np.arange(ROWS),
            "Q_main_W": heat,
            "T_head_degC": np.round(air + warmed(heat), 3),
            "d_z_um": np.round(bent(heat) + gauge, 2),
        }

    def calibrated(self, log: Path, model: str, *more: object, outputs: str = "Td") -> Path:
        """A model of `log`, kinds given: of the temperature (T), the deflection (d), or both."""
        header = log.read_text().partition("\n")[0].split(",")
        head = next((name for name in header if name.startswith("d_z_")), "")
        call: list[object] = ["calibrate", log, "--drive", "Q_main_W", "-q", "-o", model]
        if "T" in outputs:
            call += ["--sensor", "T_head_degC", "--response", "T_head_degC=rational2"]
        if "d" in outputs:
            call += ["--deflection", head, "--response", f"{head}=rational1"]
        self.tool(*call, "--linear", *more)
        return self.folder / model

    @cached_property
    def log(self) -> Path:
        """The machine's log in um."""
        return self.write("log.csv", **self.columns())

    @cached_property
    def idle(self) -> Path:
        """The noise of a machine that does nothing."""
        still = self.columns(noise=True)
        heat = still["Q_main_W"]
        rest = {
            "T_head_degC": np.round(still["T_head_degC"] - warmed(heat), 3),
            "d_z_um": np.round(still["d_z_um"] - bent(heat), 2),
        }
        self.write("idle.csv", **{**still, "Q_main_W": 0 * heat, **rest})
        self.tool("noise", "idle.csv", "-o", "noise.json")
        return self.folder / "noise.json"

    @cached_property
    def model(self) -> Path:
        """The machine's model."""
        return self.calibrated(self.log, "model.json")

    @cached_property
    def design(self) -> Path:
        """Its estimator: heat from the temperature."""
        self.tool("regularize", self.model, "--noise", self.idle, "--form", "kalman",
                  "-q", "-o", "design.json")  # fmt: skip
        return self.folder / "design.json"

    def streamed(self, *options: object, log: Path | None = None) -> np.ndarray:
        """Set points of `compensate` over a log, without the safe line at the end."""
        done = self.tool("compensate", self.design, log or self.log, "-q", *options)
        return done.table[:-1]


def cell(value: object) -> str:
    """A value of a CSV log."""
    return value if isinstance(value, str) else "" if value != value else repr(float(value))


def last(text: str) -> str:
    """The last line of what a command said."""
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1].strip() if lines else "nothing said"


def said(text: str, words: str) -> str:
    """The line that holds `words`, or what was said last."""
    return next((line.strip() for line in text.splitlines() if words in line), last(text))
