"""The pages of the commands say what --help says."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
spec = importlib.util.spec_from_file_location("commands", DOCS / "commands.py")
assert spec is not None
assert spec.loader is not None
commands = importlib.util.module_from_spec(spec)
spec.loader.exec_module(commands)


@pytest.mark.parametrize("name", ["README", *commands.COMMANDS])
def test_page_agrees_with_help(name: str) -> None:
    written = (DOCS / "commands" / f"{name}.md").read_text(encoding="utf-8")
    assert written == commands.pages()[f"{name}.md"], "run make docs"


def test_every_command_has_an_example_and_short_help_option() -> None:
    for name in commands.COMMANDS:
        text = commands.page(name)
        assert "Example: " in text
        assert "-h, --help" in text
