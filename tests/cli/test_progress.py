"""Progress and colours on a terminal, and nothing of them elsewhere."""

from __future__ import annotations

import io
import os
import pty
import re
import subprocess
import sys
import time

import click
import pytest

from thermaltool.cli import messages, progress

MAIN = [sys.executable, "-c", "from thermaltool.cli import main; main()"]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    monkeypatch.setattr(progress, "SILENT", 0.02)
    monkeypatch.setattr(progress, "PERIOD", 0.02)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    return Terminal()


def until(terminal: Terminal, text: str) -> None:
    """Wait for a text, far longer than it takes."""
    end = time.monotonic() + 20.0
    while text not in terminal.getvalue() and time.monotonic() < end:
        time.sleep(0.005)
    assert text in terminal.getvalue()


def test_a_line_goes_on_while_nobody_says_anything(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", terminal)
    with click.Context(click.Command("x")):
        say = progress.terminal_progress("fit")
        say("start 1 of 2")
        until(terminal, "fit, 0 s: start 1 of 2")
        written = len(terminal.getvalue())
        until(terminal, progress.CLEARED)
        while len(terminal.getvalue()) == written:
            time.sleep(0.005)
        messages.warn("a note")
        # The note has a line of its own.
        assert re.search(r"(^|\n|\x1b\[K)a note\n", terminal.getvalue())
        until(terminal, f"a note\n{progress.CLEARED}")
        say("done\n")
    assert re.sub(r"\x1b\[\d*m", "", terminal.getvalue()).endswith("fit, 0 s: done\n")


def test_the_line_is_gone_where_a_command_fails(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", terminal)

    def fail() -> None:
        with click.Context(click.Command("x")):
            progress.terminal_progress("fit")
            until(terminal, "fit, 0 s")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert terminal.getvalue().endswith(progress.CLEARED)


def test_what_is_quick_says_nothing(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(progress, "SILENT", 60.0)
    with click.Context(click.Command("x")):
        say = progress.terminal_progress("fit")
        say("start")
        say("done\n")
    assert terminal.getvalue() == ""


def test_no_line_off_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    found = io.StringIO()
    monkeypatch.setattr(sys, "stderr", found)
    monkeypatch.setattr(progress, "SILENT", 0.0)
    with click.Context(click.Command("x")):
        progress.terminal_progress("fit")("start")
        time.sleep(0.02)
    assert found.getvalue() == ""


def test_colours_where_a_terminal_has_them(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", terminal)
    assert progress.coloured("x", fg="red") == "\x1b[31mx\x1b[0m"
    monkeypatch.setenv("NO_COLOR", "1")
    assert progress.coloured("x", fg="red") == "x"
    monkeypatch.delenv("NO_COLOR")
    monkeypatch.setenv("TERM", "dumb")
    assert progress.coloured("x", fg="red") == "x"
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    monkeypatch.setenv("TERM", "xterm")
    assert progress.coloured("x", fg="red") == "x"


@pytest.mark.parametrize(("setting", "red"), [({}, True), ({"NO_COLOR": "1"}, False)])
def test_errors_are_red_on_a_terminal(setting: dict[str, str], red: bool) -> None:
    leader, follower = pty.openpty()
    environment = {k: v for k, v in os.environ.items() if k != "NO_COLOR"}
    try:
        subprocess.run([*MAIN, "check", "absent.csv"], stderr=follower, stdin=subprocess.DEVNULL,
                       env={**environment, "TERM": "xterm", **setting})  # fmt: skip
        told = os.read(leader, 4096).decode()
    finally:
        os.close(leader)
        os.close(follower)
    assert ("\x1b[31m" in told) == red
    assert "thermaltool check:" in told
