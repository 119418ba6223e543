"""Does a report of `diagnose` say what `simulate` finds of the models that it read and wrote?

    python benchmarks/as_simulated.py DOCUMENT.json --model MODEL --written WRITTEN [--columns MAP]

Every figure of the first and the last model in the report (RMSE as `simulate` counts and with the
zero free, each output of each log) beside `simulate` of that file on that log. Prints a Markdown
table of one row; exits with 3, and the worst figure, where they differ by 1 % or more.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

# Relative difference of a figure in a report from the simulated one.
MAX_DIFFERENCE = 0.01
HEADING = "| report | logs | figures | differ from simulate by |\n|---|---|---|---|"

# Output to what `simulate --json` says of it.
Agreements = Mapping[str, Mapping[str, float | None]]


@dataclass(frozen=True)
class Compared:
    """A figure of a report, and what `simulate` finds.

    Attributes
    ----------
    log, output, figure : str
    reported, simulated : float or None
    """

    log: str
    output: str
    figure: str
    reported: float | None
    simulated: float | None

    @property
    def difference(self) -> float:
        """Relative; infinite where only one of them is a number."""
        if self.reported == self.simulated:
            return 0.0
        if not self.reported or not self.simulated:
            return math.inf
        found = abs(self.reported / self.simulated - 1.0)
        return found if math.isfinite(found) else math.inf


def compared(
    written: Iterable[Mapping[str, Any]],
    before: Callable[[str], Agreements],
    after: Callable[[str], Agreements] | None,
) -> list[Compared]:
    """The figures of the first and the last model of a report.

    Parameters
    ----------
    written : iterable of mapping
        The steps, as a report has them.
    before, after : callable
        What `simulate` says of a log, named by its digest, with the model as it came and as it was
        written; None where none was.
    """
    rows = list(written)
    last = max((row["step"] for row in rows), default=0)
    found = []
    for row in rows:
        models = [before] * (row["step"] == 0) + [after] * (row["step"] == last)
        for model in models:
            if model is None:
                continue
            real = model(row["log"])[row["output"]]
            found += [
                Compared(row["log"], row["output"], key, row[key], real[key])
                for key in ("rmse", "rmse_zero_free")
            ]
    return found


def largest(figures: Iterable[Compared]) -> float:
    """Largest relative difference; infinite where nothing was compared."""
    return max((each.difference for each in figures), default=math.inf)


@cache
def _simulated(model: Path, log: str, options: tuple[str, ...]) -> Agreements:
    command = [sys.executable, "-m", "thermaltool", "simulate", str(model), log, *options]
    done = subprocess.run([*command, "--json"], capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"simulate {model} {log}: {done.stderr.strip()}")
    said: Agreements = json.loads(done.stdout)
    return said


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("document", type=Path)
    parser.add_argument("--model", type=Path, required=True, help="that diagnose read")
    parser.add_argument("--written", type=Path, required=True, help="that it wrote")
    parser.add_argument("--columns", metavar="MAP")
    options = parser.parse_args()
    said = json.loads(options.document.read_text())
    logs = {
        log["sha256"]: log["name"]
        for role in ("logs", "validated_on", "sound", "calibrated_on")
        for log in said[role]
    }
    columns = ("--columns", options.columns) if options.columns else ()

    def with_model(model: Path) -> Callable[[str], Agreements]:
        return lambda log: _simulated(model, logs[log], columns)

    # Without a cause the file is the one that came; a model that would be worse is not written.
    after = None
    if not said["spoiled"]:
        if not options.written.exists():
            sys.exit(f"{options.written} is not there, and {options.document} says no reason")
        after = with_model(options.written)
    figures = compared(said["written"], with_model(options.model), after)
    off, named = largest(figures), {each.log for each in figures}
    print(HEADING)
    print(f"| {options.document.stem} | {len(named)} | {len(figures)} | {100 * off:.2g} % |")
    if off < MAX_DIFFERENCE:
        return 0
    if figures:
        worst = max(figures, key=lambda each: each.difference)
        print(f"{options.document}: {worst.figure} of {worst.output} in {logs[worst.log]} is "
              f"{worst.reported}, and by simulate {worst.simulated}", file=sys.stderr)  # fmt: skip
    return 3


if __name__ == "__main__":
    sys.exit(main())
