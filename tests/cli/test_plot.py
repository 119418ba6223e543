"""``thermaltool plot`` from outside."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

MAIN = [sys.executable, "-c", "from thermaltool.cli import main; main()"]
LOG = "time_s,T_a_degC,d_x_um\n" + "".join(f"{2 * i},{20 + i / 7},{i}\n" for i in range(50))
PNG = b"\x89PNG"


def plot(*arguments: str | Path, stdin: str = "") -> subprocess.CompletedProcess[bytes]:
    command = [*MAIN, "plot", *map(str, arguments)]
    return subprocess.run(command, input=stdin.encode(), capture_output=True)


@pytest.mark.slow
def test_a_pipe_in_and_a_pipe_out() -> None:
    result = plot(stdin=LOG)
    assert result.returncode == 0
    assert result.stdout.startswith(PNG)
    assert result.stderr == b""


@pytest.mark.slow
def test_stdin_that_starts_with_a_brace_is_a_document() -> None:
    text = '\n{"time_s": [1, 2], "value_1": [1, 2], "error_1": [0, 0], "wanted": [1e-9, 1e-9]}\n'
    assert plot("-", stdin=text).stdout.startswith(PNG)
    lines = '{"time_s": 0, "T_a_degC": 1}\n{"time_s": 1, "T_a_degC": 2}\n'
    assert plot("-", "--from", "ndjson", stdin=lines).stdout.startswith(PNG)


def test_lines_of_json_are_no_document(thermaltool) -> None:
    lines = '{"time_s": 0, "T_a_degC": 1}\n{"time_s": 1, "T_a_degC": 2}\n'
    refused = thermaltool("plot", "-", stdin=lines)
    assert refused.code == 1
    assert "--from ndjson" in refused.err


def test_against_a_log(thermaltool, tmp_path: Path) -> None:
    log, figure = tmp_path / "log.csv", tmp_path / "figure.svg"
    log.write_text(LOG)
    result = thermaltool(
        "plot", "-", "--against", log, "--channel", "d_x_um", "-o", figure, stdin=LOG
    )
    assert (result.code, result.out, result.err) == (0, "", "")
    assert figure.read_bytes().startswith(b"<?xml")


def test_a_typo_is_a_gap_and_told(thermaltool, tmp_path: Path) -> None:
    figure = tmp_path / "figure.svg"
    log = LOG.replace("\n20,", "\n2O,", 1).replace("\n30,", "\n30,x", 1)
    refused = thermaltool("plot", "-", "-o", figure, stdin=log)
    assert (refused.code, refused.err) == (
        1,
        "thermaltool plot: <stdin>:12: time_s: not a number: '2O'\n",
    )
    log = LOG.replace("\n30,", "\n30,x", 1)
    for chosen in ((), ("--channel", "d_x_um")):
        result = thermaltool("plot", "-", *chosen, "-o", figure, stdin=log)
        assert result.code == 0
        told = "<stdin>:17: T_a_degC: not a number: 'x22.142857142857142'"
        assert result.err == f"{told}: taken as a missing value\n"
    table = "time_s,value_1,error_1\n0,1,0\n1,x,0\n"
    assert "not a number: 'x'" in thermaltool("plot", "-", stdin=table).err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("-o", "a.bmp"), "a.bmp: a figure's name ends in .png, .svg or .pdf"),
        (("--channel", "d_y_um"), "<stdin>: no channel d_y_um (near: d_x_um)"),
        (("absent.csv",), "absent.csv: cannot be read: No such file or directory"),
    ],
)
def test_errors_are_one_line(thermaltool, arguments: tuple[str, ...], message: str) -> None:
    result = thermaltool("plot", *arguments, stdin=LOG)
    assert result.code == 1
    assert result.out == ""
    assert result.err == f"thermaltool plot: {message}\n"


def test_a_failed_figure_leaves_the_old_one(thermaltool, tmp_path: Path) -> None:
    figure = tmp_path / "figure.png"
    figure.write_bytes(b"old")
    assert thermaltool("plot", "-o", figure, stdin="time_s,T_a_degC\n").code == 1
    assert figure.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [figure]


def test_stdin_twice(thermaltool) -> None:
    result = thermaltool("plot", "-", "--against", "-", stdin=LOG)
    assert result.code == 2
    assert "stdin can be only one of the files" in result.err


@pytest.mark.slow
def test_no_figure_onto_a_terminal(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text(LOG)
    leader, follower = pty.openpty()
    try:
        command = [*MAIN, "plot", str(log)]
        result = subprocess.run(command, stdout=follower, stderr=subprocess.PIPE)
    finally:
        os.close(leader)
        os.close(follower)
    assert result.returncode == 2
    assert b"stdout is a terminal: name a figure with -o" in result.stderr
