"""Shared fixtures: a small log, and the command line called in this process.

Also lets the tests import `reference`: other people's numbers, and simulators of our own.
"""

from __future__ import annotations

import io
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parent))


@dataclass(frozen=True)
class Result:
    """What a command leaves: exit code, stdout, stderr."""

    code: int
    out: str
    err: str

    @property
    def json(self):
        """stdout as JSON; NaN and Infinity are none."""
        return json.loads(self.out, parse_constant=pytest.fail)


@pytest.fixture
def thermaltool(monkeypatch):
    """``thermaltool("simulate", path, stdin="...")`` through `main`, exit codes included."""
    from thermaltool.cli import main

    def run(*arguments, stdin=""):
        streams = {
            name: io.TextIOWrapper(io.BytesIO(), encoding="utf-8") for name in ("out", "err")
        }
        data = stdin if isinstance(stdin, bytes) else stdin.encode()
        monkeypatch.setattr(sys, "argv", ["thermaltool", *map(str, arguments)])
        stdin = io.BufferedReader(io.BytesIO(data))  # as the real one: with `peek`
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(stdin, encoding="utf-8"))
        monkeypatch.setattr(sys, "stdout", streams["out"])
        monkeypatch.setattr(sys, "stderr", streams["err"])
        with pytest.raises(SystemExit) as stop:
            main()
        texts = {}
        for name, stream in streams.items():
            stream.flush()
            texts[name] = stream.buffer.getvalue().decode()
        monkeypatch.undo()
        return Result(stop.value.code, **texts)

    return run


@pytest.fixture(scope="session")
def small_log():
    """A warming machine as CSV: 240 rows at 10 s, heat 0, 1, 0.5; noise 0.01 K and 0.1 µm.

    The temperature by quadrature of Fraser's integral, the deflection by two time constants.
    """
    from reference import fraser1997
    from reference.ring import ring_step

    time = 10.0 * np.arange(240)
    heat = np.select([time < 100, time < 1300], [0.0, 1.0], 0.5)
    since = np.maximum(time[:, None] - time, 0.0)
    changes = np.diff(heat, prepend=0.0)
    lag = np.searchsorted(time, since)
    warm = ring_step(time, **fraser1997.MAIN)[lag] @ changes
    bend = (60 * -np.expm1(-since / 800) + 20 * -np.expm1(-since / 150)) @ changes
    rng = np.random.default_rng(20)
    warm += 0.01 * rng.standard_normal(len(time))
    bend += 0.1 * rng.standard_normal(len(time))
    lines = ["time_s,Q_main_1,dT_pair1_K,d_x_um,T_room_degC"]
    for row in zip(time, heat, warm, bend, strict=True):
        lines.append("{:g},{:g},{:.4f},{:.3f},21.5".format(*row))
    return "\n".join(lines) + "\n"


NOISE = {
    "format": "thermaltool-noise",
    "version": 1,
    "channels": {
        "dT_pair1_K": {
            "white_sigma": 0.01,
            "resolution": 0.0001,
            "drift": {"sigma": 0.02, "time_constant_s": 900.0},
        },
        "d_x_um": {"white_sigma": 0.1, "drift": None},
    },
}
# Pinned, so that nothing is searched.
KERNEL = ("--regularization", 0.01, 1e-4, 0.02, "--cutoff", 0.02, "--delay", 10)


@dataclass(frozen=True)
class Files:
    """The small log and what the commands made of it."""

    folder: Path
    log: Path
    model: Path
    noise: Path
    kalman: Path
    kernel: Path


@pytest.fixture
def files(tmp_path, made):
    """A copy of the session's files, free to be changed."""
    for name, text in made.items():
        (tmp_path / name).write_text(text)
    names = ("log.csv", "model.json", "noise.json", "kalman.json", "kernel.json")
    return Files(tmp_path, *(tmp_path / name for name in names))


@pytest.fixture(scope="session")
def made(tmp_path_factory, small_log):
    """Texts of log, noise, calibrated model and both designs, each made once."""
    from click.testing import CliRunner

    from thermaltool.cli import calibrate, regularize

    folder = tmp_path_factory.mktemp("made")
    texts = {"log.csv": small_log, "noise.json": json.dumps(NOISE)}
    for name, text in texts.items():
        (folder / name).write_text(text)

    def make(command, name, *arguments):
        arguments = [str(each) for each in (*arguments, "-o", folder / name, "-q")]
        result = CliRunner().invoke(command, arguments, catch_exceptions=False)
        assert result.exit_code == 0
        texts[name] = (folder / name).read_text()

    log, model, noise = (folder / name for name in ("log.csv", "model.json", "noise.json"))
    roles = ("--drive", "Q_main_1", "--sensor", "dT_pair1_K", "--deflection", "d_x_um")
    kinds = ("--response", "dT_pair1_K=conduction", "--response", "d_x_um=deflection")
    make(calibrate.command, "model.json", log, *roles, *kinds, "--starts", 2)
    design = (model, "--noise", noise, "--form")
    make(regularize.command, "kalman.json", *design, "kalman", "--walk", 0.02)
    make(regularize.command, "kernel.json", *design, "kernel", *KERNEL)
    return texts
