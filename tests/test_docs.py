"""The pages of the commands say what --help says; the pages for Python show what Python shows."""

from __future__ import annotations

import doctest
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from thermaltool.cli import COMMANDS

DOCS = Path(__file__).parents[1] / "docs"


def test_pages_agree_with_help() -> None:
    done = subprocess.run(
        [sys.executable, DOCS / "commands.py", "--check"], capture_output=True, text=True
    )
    assert done.returncode == 0, f"{done.stderr}run make docs"


def test_every_page_has_an_example_and_the_short_help_option() -> None:
    for name in COMMANDS:
        text = (DOCS / "reference" / "commands" / f"{name}.md").read_text(encoding="utf-8")
        assert "Example: " in text
        assert "-h, --help" in text


NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
# Another BLAS may change the last digits that are printed, and an estimated error by more.
TOLERANCE = 0.03


class Outputs(doctest.OutputChecker):
    """Text has to agree, numbers in it nearly."""

    def check_output(self, want: str, got: str, optionflags: int) -> bool:
        if super().check_output(want, got, optionflags):
            return True
        texts = [NUMBER.sub("#", text) for text in (want, got)]
        if not super().check_output(*texts, optionflags):
            return False
        if "..." in want:
            return True
        pairs = zip(map(float, NUMBER.findall(want)), map(float, NUMBER.findall(got)), strict=True)
        return all(b == pytest.approx(a, rel=TOLERANCE, abs=1e-9) for a, b in pairs)


@pytest.mark.slow
@pytest.mark.parametrize("page", ["reference/python.md"])
def test_pages_for_python_show_what_python_shows(
    page: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(DOCS.parent)
    options = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    text = (DOCS / page).read_text(encoding="utf-8").replace("```", "")
    parsed = doctest.DocTestParser().get_doctest(text, {}, page, str(DOCS / page), 0)
    runner = doctest.DocTestRunner(Outputs(), optionflags=options)
    shown: list[str] = []
    runner.run(parsed, out=shown.append)
    assert runner.tries > 10
    assert not runner.failures, "".join(shown)


ROOT = DOCS.parent
PAGES = sorted([*DOCS.rglob("*.md"), *ROOT.glob("*.md"), *ROOT.glob("data_samples/*.md")])
LINK = re.compile(r"\]\(([^)\s]+)\)")
FENCE = re.compile(r"^ *```.*?^ *```", re.MULTILINE | re.DOTALL)


def prose(page: Path) -> str:
    """Text of a page without its blocks of code."""
    return FENCE.sub("", page.read_text(encoding="utf-8"))


def anchors(page: Path) -> set[str]:
    """What a link to a heading of `page` may say, as the site and the forges make it."""
    found: set[str] = set()
    for title in re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE):
        text = re.sub(r"[^\w\s-]", "", title.lower()).strip()
        found.add(re.sub(r"\s", "-", text))
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for link in LINK.findall(prose(page)):
        if "://" in link:
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), f"{page.name}: ({link}): no such file"
        if anchor:
            assert anchor in anchors(target), f"{page.name}: ({link}): no such heading"


def test_the_site_shows_every_page() -> None:
    shown = set(re.findall(r"[\w/-]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8")))
    pages = {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")}
    # The pages of the commands are reached by their table.
    commands = {f"reference/commands/{name}.md" for name in COMMANDS}
    assert shown == pages - commands


# The pages of the commands, a folder below, name the option --seed.
FOR_USERS = [
    page
    for part in ("tutorials", "how-to", "reference", "explanation")
    for page in (DOCS / part).glob("*.md")
]


@pytest.mark.parametrize("page", FOR_USERS, ids=lambda page: str(page.relative_to(DOCS)))
def test_pages_for_users_hold_no_seeds_and_no_processors(page: Path) -> None:
    words = r"\bseeds?\b|\bAMD\b|EPYC|Xeon|[Ee]arlier release|[Ss]ince the last"
    assert not re.search(words, prose(page)), f"{page.name}: that belongs into results/"


def test_no_text_names_a_page_that_is_not_there() -> None:
    named = re.compile(r"\bdocs/[\w/-]+\.(?:md|py|png)")
    rooms = ("thermaltool", "pipelines", "benchmarks", "tests", "docs", "data_samples")
    files = [path for room in rooms for path in (ROOT / room).rglob("*")]
    for path in [*files, *ROOT.glob("*.md"), ROOT / "Makefile"]:
        if path.suffix in {".py", ".mk", ".sh", ".md", ".toml"} or path.name == "Makefile":
            for name in named.findall(path.read_text(encoding="utf-8")):
                assert (ROOT / name).exists(), f"{path} names {name}"


BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# The others take longer.
QUICK_TUTORIAL = "pipe"
TUTORIALS = [
    pytest.param(page, marks=[] if page.stem == QUICK_TUTORIAL else pytest.mark.slow, id=page.stem)
    for page in sorted((DOCS / "tutorials").glob("*.md"))
]


def missing(wanted: str, shown: str) -> str:
    """The first piece between two "..." of `wanted` that `shown` lacks, numbers to a tenth."""
    shown, at = " ".join(shown.split()), 0
    for piece in (" ".join(each.split()) for each in wanted.split("...")):
        values = [pytest.approx(float(each), rel=0.1) for each in NUMBER.findall(piece)]
        pattern = f"({NUMBER.pattern})".join(map(re.escape, NUMBER.split(piece)))
        for found in re.finditer(pattern, shown[at:]):
            if [float(each) for each in found.groups()] == values:
                at += found.end()
                break
        else:
            return piece
    return ""


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS)
def test_tutorials_run_and_show_what_they_say(page: Path, tmp_path: Path) -> None:
    (tmp_path / "data_samples").symlink_to(ROOT / "data_samples")
    command = tmp_path / "bin" / "thermaltool"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m thermaltool "$@"\n')
    command.chmod(0o755)
    shown = ""
    for kind, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        if kind == "sh":
            done = subprocess.run(
                ["bash", "-euo", "pipefail", "-c", text],
                cwd=tmp_path, capture_output=True, text=True,
                env=os.environ | {"PATH": f"{command.parent}:{os.environ['PATH']}"},
            )  # fmt: skip
            shown = done.stdout + done.stderr
            assert done.returncode == (3 if "# exits with 3" in text else 0), shown
        elif kind == "text" and shown:
            assert not missing(text, shown), f"{missing(text, shown)}\n\nin\n\n{shown}"
            shown = ""
