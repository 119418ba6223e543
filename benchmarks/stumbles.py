"""What stopped or misled users once, tried again with the command line as they typed it.

``python benchmarks/stumbles.py`` (in make study) makes a small log for each stumble, runs the
commands, and prints a Markdown table: the stumble, what was seen then, what is seen now, and
whether that is as it should be. The exit code is 1 where a stumble is back; --only takes those
whose number begins so.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import stumbles_blocked
import stumbles_faults
import stumbles_looking
import stumbles_stream
import stumbles_wrong
from stumbles_bench import Bench, Stumble

STUMBLES: list[Stumble] = [
    *stumbles_wrong.STUMBLES,
    *stumbles_blocked.STUMBLES,
    *stumbles_looking.STUMBLES,
    *stumbles_stream.STUMBLES,
    *stumbles_faults.STUMBLES,
]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="numbers that begin so: 1, or 2.3")
    arguments = parser.parse_args()
    wrong = 0
    print("| | stumble | was | is | |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder))
        for stumble in STUMBLES:
            if not stumble.number.startswith(arguments.only):
                continue
            now, ok = stumble.tried(bench)
            wrong += not ok
            verdict = "ok" if ok else "**back**"
            print(f"| {stumble.number} | {stumble.words} | {stumble.was} | {now} | {verdict} |",
                  flush=True)  # fmt: skip
    if wrong:
        sys.exit(1)


if __name__ == "__main__":
    main()
