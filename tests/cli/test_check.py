"""``thermaltool check`` from outside."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

SOUND = "time_s,T_a_degC\n" + "".join(f"{2 * i},{20 + i / 7}\n" for i in range(50))
BAD = "# c\ntime_s,T_a_degC,T_b_degF\n0,--,1\n1,-300,2\n2,1\n1.5,3,4\n"


def check(*arguments: str, log: str = "") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from thermaltool.cli import main; main()", "check"]
    return subprocess.run([*command, *arguments], input=log, capture_output=True, text=True)


def test_a_sound_log() -> None:
    result = check(log=SOUND)
    assert result.returncode == 0
    assert result.stdout.splitlines()[0] == "<stdin>: 50 rows, 98 s, 1 segment"
    assert result.stdout.splitlines()[-1] == "nothing wrong"
    assert result.stderr == ""


def test_everything_wrong_is_told_in_one_run() -> None:
    result = check(log=BAD)
    assert result.returncode == 3
    lines = result.stdout.partition("wrong:\n")[2].splitlines()
    for start in (
        "<stdin>:2: T_b_degF: unknown unit 'degF'",
        "<stdin>:3: T_a_degC: not a number: '--'",
        "<stdin>:5: 2 cells where the header has 3",
        "<stdin>:4: T_a_degC: -300 degC is below absolute zero",
    ):
        assert any(line.startswith(start) for line in lines), start


def test_a_backward_clock() -> None:
    result = check(log="time_s,T_a_degC\n0,1\n2,1.5\n1,2\n2,2\n")
    assert result.returncode == 3
    assert "<stdin>:4: time_s: the clock goes backward: 1 s after 2 s" in result.stdout


def test_json_has_no_nan() -> None:
    result = check("--json", log="time_s,T_a_degC\n0,\n")
    assert result.returncode == 3
    document = json.loads(result.stdout, parse_constant=lambda word: pytest.fail(word))
    assert document["rows"] == 1
    assert document["clock"]["period"] is None
    assert document["channels"][0]["maximum"] is None
    assert document["findings"] == [
        {"kind": "missing", "message": "missing value", "line": 2, "column": "T_a_degC"}
    ]


def test_header_only() -> None:
    result = check(log="time_s,T_a_degC\n")
    assert result.returncode == 3
    assert "no rows" in result.stdout


def test_no_log_at_all(tmp_path: Path) -> None:
    for result in (check(log=""), check(str(tmp_path)), check(str(tmp_path / "absent.csv"))):
        assert result.returncode == 1
        assert result.stdout == ""
        assert result.stderr.startswith("thermaltool check: ")
        assert result.stderr.count("\n") == 1


def test_the_log_goes_on_in_the_pipe(tmp_path: Path) -> None:
    result = check("-o", "-", "--resample", "1", "--to", "ndjson", log=SOUND)
    assert result.returncode == 0
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert [row["time_s"] for row in rows] == list(range(99))
    assert rows[1]["T_a_degC"] == pytest.approx(20 + 0.5 / 7)
    assert "nothing wrong" in result.stderr
    target = tmp_path / "out.parquet"
    result = check("-o", str(target), log=SOUND)
    assert "nothing wrong" in result.stdout
    assert target.exists()


def test_resample_without_a_place_to_write() -> None:
    result = check("--resample", "1", log=SOUND)
    assert result.returncode == 2
    assert "--resample needs -o" in result.stderr
