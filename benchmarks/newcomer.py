"""How long a newcomer takes from a clone to a figure of a log of their own; and the demo.

``python benchmarks/newcomer.py`` clones this repository into an empty folder, installs it by the
README's commands, writes a log as a workshop's logger does (its own names, Windows encoding, a gap,
a mistyped cell), and runs the README's two commands on it; then `make demo` in another clone. It
prints seconds on the wall and of the processors, and the load. The exit code is 1 where a command
fails, or where both of these are above five minutes, two for the demo: beside the work of others
the wall says little.
"""

from __future__ import annotations

import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
# What is asked for [s]: a figure of one's own log, and the demo.
OWN_FIGURE, DEMO = 300.0, 120.0
# The log's own commands stand in this section of the README.
SECTION = "## Your own log"


def own_log(path: Path) -> None:
    rng = np.random.default_rng()
    time_s, heat = 10.0 * np.arange(500), np.repeat([0.0, 350.0, 120.0, 0.0, 350.0], 100)
    warm = bend = 0.0
    lines = ["Zeit;Heizung (W);Spindel vorne;Raum;Z-Taster [µm];Bemerkung"]
    for k, (t, q) in enumerate(zip(time_s, heat, strict=True)):
        warm += (0.05 * q - warm) * 10 / 900
        bend += (2.1 * warm - bend) * 10 / 400
        cells = [f"{8 + int(t) // 3600:02d}:{int(t) // 60 % 60:02d}:{int(t) % 60:02d}"]
        values = (
            q,
            21 + warm + rng.normal(0, 0.03),
            21 + rng.normal(0, 0.05),
            bend + rng.normal(0, 0.1),
        )
        cells += [f"{value:.2f}".replace(".", ",") for value in values]
        if k == 77:
            cells[2] = "3l,52"
        if not 150 <= k < 180:
            lines.append(";".join([*cells, "Start" if k == 5 else ""]))
    path.write_bytes("\r\n".join([*lines, ""]).encode("cp1252"))


class Stopwatch:
    """Seconds on the wall and of the processors since it was made."""

    def __init__(self) -> None:
        self._begin, self._used = time.monotonic(), self._children()

    @staticmethod
    def _children() -> float:
        found = resource.getrusage(resource.RUSAGE_CHILDREN)
        return found.ru_utime + found.ru_stime

    @property
    def wall(self) -> float:
        return time.monotonic() - self._begin

    @property
    def least(self) -> float:
        return min(self.wall, self._children() - self._used)

    def __str__(self) -> str:
        used = self._children() - self._used
        return f"{self.wall:.0f} s on the wall, {used:.0f} s of processors"


def bash(folder: Path, text: str) -> subprocess.Popen[bytes]:
    """A command as a user types it: nothing of this process's Python is seen there."""
    clean = {k: v for k, v in os.environ.items()
             if not k.startswith(("PYTHON", "VIRTUAL_ENV", "OMP_", "OPENBLAS_"))}  # fmt: skip
    return subprocess.Popen(["bash", "-euc", text], cwd=folder, env=clean)


def own_figure(folder: Path) -> bool:
    readme = (ROOT / "README.md").read_text()
    (commands,) = re.findall(r"```sh\n(.*?)```", readme.partition(SECTION)[2].partition("## ")[0],
                             re.DOTALL)  # fmt: skip
    watch = Stopwatch()
    bash(folder, f"git clone -q '{ROOT}' clone").wait()
    install = "python3 -m venv .venv; source .venv/bin/activate; pip install -q '.[all]'"
    bash(folder / "clone", install).wait()
    print(f"installed: {watch}", flush=True)
    own_log(folder / "my log.csv")
    # What is wrong with the log is told by exit code 3.
    check, plot = commands.strip().splitlines()
    told = bash(folder, f"source clone/.venv/bin/activate; {check}").wait()
    drawn = bash(folder, f"source clone/.venv/bin/activate; {plot}").wait()
    print(f"a figure of one's own log: {watch}", flush=True)
    made = (folder / "log.png").exists()
    return told == 3 and drawn == 0 and made and watch.least < OWN_FIGURE


def demo(folder: Path) -> bool:
    bash(folder, f"git clone -q '{ROOT}' again; cd again; make .venv/.ready").wait()
    watch, first = Stopwatch(), None
    run = bash(folder / "again", "make demo > demo.log")
    while run.poll() is None:
        if first is None and any((folder / "again/demo/figures").glob("*.png")):
            first = watch.wall
        time.sleep(0.1)
    print(f"make demo, installed: first figure after {first or 0:.0f} s, all of it {watch}")
    return run.returncode == 0 and first is not None and watch.least < DEMO


def main() -> None:
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before")
    with tempfile.TemporaryDirectory() as folder:
        good = own_figure(Path(folder)) & demo(Path(folder))
    print(f"load {os.getloadavg()[0]:.1f} after")
    sys.exit(not good)


if __name__ == "__main__":
    main()
