"""The pages of the commands say what --help says."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from thermaltool.cli import COMMANDS

DOCS = Path(__file__).parents[1] / "docs"


def test_pages_agree_with_help() -> None:
    done = subprocess.run(
        [sys.executable, DOCS / "commands.py", "--check"], capture_output=True, text=True
    )
    assert done.returncode == 0, f"{done.stderr}run make docs"


def test_every_page_has_an_example_and_the_short_help_option() -> None:
    for name in COMMANDS:
        text = (DOCS / "commands" / f"{name}.md").read_text(encoding="utf-8")
        assert "Example: " in text
        assert "-h, --help" in text
