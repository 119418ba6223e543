"""Every command that reads a log takes a bounded number of bytes a row."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
from memory import COMMANDS, documents, peaks, write_log

# Long enough that readers keep no more of a block than they do of long logs.
ROWS = (100_000, 300_000)
# Others take too long here.
QUICK = ("check", "noise", "simulate", "estimate")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("memory")


@pytest.fixture(scope="module")
def paths(folder):
    return documents(folder)


def bytes_a_row(name, folder, paths, rows=ROWS, averaged=0):
    logs = [folder / f"{n}.csv" for n in rows]
    for log, n in zip(logs, rows, strict=True):
        if not log.exists():
            write_log(log, n)
    few, many = peaks(replace(COMMANDS[name], averaged=averaged), tuple(logs), paths)
    return (many - few) / (rows[1] - rows[0])


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICK)
def test_a_row_takes_few_bytes(name, folder, paths):
    assert bytes_a_row(name, folder, paths) < COMMANDS[name].limit


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in COMMANDS if name not in QUICK])
def test_a_row_takes_no_more_bytes(name, folder, paths):
    assert bytes_a_row(name, folder, paths) < COMMANDS[name].limit


@pytest.mark.study
@pytest.mark.parametrize("name", ["calibrate", "diagnose"])
def test_all_rows_would_take_more(name, folder, paths):
    # What the limit is there for, and would show.
    rows = (20_000, 40_000)
    taken = bytes_a_row(name, folder, paths, rows, averaged=100_000)
    assert taken > 5 * COMMANDS[name].limit
