"""Write a page for each command from its --help (a test checks that they agree).

Run ``python docs/commands.py``, or with ``--check`` to only name the pages that differ.
"""

from __future__ import annotations

import sys
from pathlib import Path

import click

from thermaltool.cli import COMMANDS, group

PAGES = Path(__file__).parent / "reference" / "commands"


def page(name: str) -> str:
    """Markdown of one command."""
    command = group.get_command(click.Context(group), name)
    assert command is not None
    parent = click.Context(group, info_name="thermaltool", **group.context_settings)
    context = click.Context(
        command, info_name=name, parent=parent, terminal_width=90, max_content_width=90
    )
    context.help_option_names = ["-h", "--help"]
    context.show_default = True
    text = command.get_help(context)
    return f"# thermaltool {name}\n\n{COMMANDS[name]}\n\n```text\n{text}\n```\n"


def index() -> str:
    rows = "\n".join(f"| [{name}]({name}.md) | {what} |" for name, what in COMMANDS.items())
    times = "Times among the options are in seconds, or have their unit: 30s, 10min, 8h."
    return f"# Commands\n\n{times}\n\n| command | what it does |\n|---|---|\n{rows}\n"


def pages() -> dict[str, str]:
    """File name to text."""
    return {"README.md": index(), **{f"{name}.md": page(name) for name in COMMANDS}}


def main() -> int:
    """Write the pages; with ``--check`` only name those that differ, and exit 3."""
    checking = sys.argv[1:] == ["--check"]
    PAGES.mkdir(exist_ok=True)
    stale = []
    for name, text in pages().items():
        path = PAGES / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            stale.append(name)
            if not checking:
                path.write_text(text, encoding="utf-8")
    verb = "differ from --help" if checking else "written"
    print(f"pages {verb}: {', '.join(stale) or 'none'}", file=sys.stderr)
    return 3 if checking and stale else 0


if __name__ == "__main__":
    sys.exit(main())
