"""``thermaltool completion``, and what its scripts ask for."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

MAIN = [sys.executable, "-c", "from thermaltool.cli import main; main()"]


@pytest.mark.parametrize(
    ("shell", "word"),
    [("bash", "complete -o nosort -F"), ("zsh", "#compdef thermaltool"), ("fish", "complete ")],
)
def test_a_script_for_each_shell(thermaltool, shell: str, word: str) -> None:
    result = thermaltool("completion", shell)
    assert (result.code, result.err) == (0, "")
    assert word in result.out
    assert f"_THERMALTOOL_COMPLETE={shell}_complete" in result.out


def test_another_shell_is_an_error_of_usage(thermaltool) -> None:
    assert thermaltool("completion", "tcsh").code == 2


@pytest.mark.parametrize(
    ("line", "place", "found"),
    [
        ("thermaltool pre", 1, ["plain,present"]),
        ("thermaltool calibrate --initial ", 3, ["plain,auto", "plain,rest", "plain,free"]),
        ("thermaltool present mod", 2, ["file,mod"]),
    ],
)
def test_commands_options_and_files_are_completed(line: str, place: int, found: list[str]) -> None:
    asked = {"COMP_WORDS": line, "COMP_CWORD": str(place)}
    environment = {**os.environ, "_THERMALTOOL_COMPLETE": "bash_complete", **asked}
    result = subprocess.run(MAIN, env=environment, capture_output=True, text=True)
    assert result.stdout.split() == found
