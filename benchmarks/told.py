"""Does a report of `diagnose` tell what `simulate` finds of the models that it read and wrote?

    python benchmarks/told.py DOCUMENT.json --model MODEL --written WRITTEN [--columns MAP]

Every figure of the first and the last model in the report (RMSE as `simulate` counts and with the
zero free, each output of each log) beside `simulate` of that file on that log. Prints a
Markdown table of one row; exits with 3 where they differ by 1 % or more.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

# What a told figure may be off.
MOST = 0.01
HEADING = "| report | logs | figures | told and simulated differ by |\n|---|---|---|---|"

# Output to what `simulate --json` says of it.
Agreements = Mapping[str, Mapping[str, float]]


def differences(
    written: Iterable[Mapping[str, Any]],
    before: Callable[[str], Agreements],
    after: Callable[[str], Agreements] | None,
) -> list[float]:
    """Relative differences of told RMSE from simulated ones, first and last step.

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
            for key in ("rmse", "rmse_zero_free"):
                if row[key] is not None and real[key]:
                    found.append(abs(row[key] / real[key] - 1.0))
    return found


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
    parser.add_argument("--written", type=Path, required=True, help="that it wrote, if it did")
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

    # Without a cause the file is the one that came.
    after = with_model(options.written) if options.written.exists() else None
    found = differences(said["written"], with_model(options.model), after)
    named = {row["log"] for row in said["written"]}
    worst = max(found, default=0.0)
    print(HEADING)
    print(f"| {options.document.stem} | {len(named)} | {len(found)} | {100 * worst:.2g} % |")
    return 3 if worst >= MOST else 0


if __name__ == "__main__":
    sys.exit(main())
