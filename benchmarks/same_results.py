"""Results of every command before and after a change of the code: which numbers are not the same?

    python benchmarks/same_results.py record before --source ../old_checkout
    python benchmarks/same_results.py record after
    python benchmarks/same_results.py compare before after

``record`` runs the pipes of same_results.txt, which call every command on every sample and measured
log (about ten minutes), and keeps output, messages, exit code and files. ``compare`` prints each
number that differs by more than --relative of itself (in a column or list: of its largest value),
text that differs apart from numbers, and exit codes. Numbers printed for reading may differ by one
in their last digit. Expected differences stand in a file of lines ``pattern: reason``; a pattern
is that of an output (identify_*.out) or of a file. They are printed with their reason.
It ends with 3 where anything differs without one.
"""

from __future__ import annotations

import argparse
import csv
import difflib
import fnmatch
import json
import math
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
LIMIT = 1200  # seconds that a case may take, on a busy machine too
NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.]*\w)")
# Digests follow every rounding of what they stand for: they are no result.
DIGEST = re.compile(r"\b[0-9a-f]{12,64}\b")
# Lines shown of one case, output or file.
SHOWN = 12
# A difference below this is rounding around zero [unit of the number].
AROUND_ZERO = 1e-12
# A last digit that is more than this of its number is no rounding.
ROUNDED = 0.05

# Marks a record of some cases alone.
PARTIAL = "some_cases"

TOOL = """#!{python}
import sys
sys.path.insert(0, {source!r})
sys.argv[0] = "thermaltool"
from thermaltool.cli import main
main()
"""


# --- record


def record(target: Path, python: str, source: Path, data: Path, only: str | None) -> None:
    """Run the cases in ``target/files`` and keep each under ``target/results``."""
    cases = dict(read_pairs(HERE / "same_results.txt"))
    chosen = set(cases) if only is None else with_sources(cases, re.compile(only))
    files, tools = target / "files", target / "bin"
    for folder in (files / "effects", tools, target / "results"):
        folder.mkdir(parents=True)
    if only is not None:
        (target / PARTIAL).touch()
    (files / "samples").symlink_to(source / "data_samples")
    (files / "data").symlink_to(data)
    write_machines(files / "effects")
    tool = tools / "thermaltool"
    tool.write_text(TOOL.format(python=python, source=str(source)))
    tool.chmod(0o755)
    environment = {k: v for k, v in os.environ.items() if not k.startswith("THERMALTOOL")}
    environment |= {
        "PATH": f"{tools.resolve()}:{environment['PATH']}",
        "PYTHONPATH": str(source),
        **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"),
        "COLUMNS": "100",
        "TZ": "UTC",
    }
    whole = time.monotonic()
    for name, pipe in cases.items():
        if name not in chosen:
            continue
        begin = time.monotonic()
        try:
            done = subprocess.run(["bash", "-c", pipe], cwd=files, env=environment,
                                  stdin=subprocess.DEVNULL, capture_output=True,
                                  timeout=LIMIT)  # fmt: skip
            out, err, code = done.stdout, done.stderr, str(done.returncode)
        except subprocess.TimeoutExpired:
            out, err, code = b"", b"", f"more than {LIMIT} s"
        for suffix, content in (("out", out), ("err", err), ("code", code.encode())):
            (target / "results" / f"{name}.{suffix}").write_bytes(content)
        print(f"{time.monotonic() - begin:6.1f} s  {name}: exit {code}", flush=True)
    print(f"{len(chosen)} cases in {time.monotonic() - whole:.0f} s")


def read_pairs(path: Path) -> Iterator[tuple[str, str]]:
    """Lines ``name: text``; a line that begins with # is a comment."""
    for line in path.read_text().splitlines():
        if line.strip() and not line.startswith("#"):
            name, _, text = line.partition(":")
            yield name.strip(), text.strip()


def with_sources(cases: dict[str, str], pattern: re.Pattern[str]) -> set[str]:
    """Cases whose name matches, and those that write what they read."""
    words = {name: set(re.findall(r"[\w./]+\.[a-z]+|\w+_\*", pipe)) for name, pipe in cases.items()}
    writers: dict[str, str] = {}
    for name, pipe in cases.items():
        for family in re.findall(r"-o (\w+_)\$\(", pipe):  # of a loop; read as family_*.json
            writers.setdefault(f"{family}*", name)
        for file in re.findall(r"(?:-o|--plot|--report|--figure|[^2]>) *([\w./$]+\.[a-z]+)", pipe):
            writers.setdefault(file, name)
    chosen = {name for name in cases if pattern.search(name)}
    grown = set(chosen)
    while grown:
        grown = {writers[w] for name in grown for w in words[name] if w in writers} - chosen
        chosen |= grown
    return chosen


def write_machines(folder: Path) -> None:
    """A model file for each effect of same_results_effects.json, and one without."""
    given = json.loads((HERE / "same_results_effects.json").read_text())
    (folder / "none.json").write_text(json.dumps(given["machine"]))
    for k, effect in enumerate(given["effects"]):
        model = {**given["machine"], "effects": [effect]}
        (folder / f"{k:02}_{effect['name']}.json").write_text(json.dumps(model))


# --- compare


@dataclass
class Comparison:
    """What was compared, and what differs: a line for each difference."""

    relative: float
    numbers: int = 0
    differing: int = 0
    last_digit: int = 0
    lines: list[str] = field(default_factory=list)

    def differ(self, line: str, count: int = 1) -> None:
        self.differing += count
        self.lines.append(line)

    def values(self, place: str, before: Any, after: Any) -> None:
        """Arrays of numbers; a line has the place where they differ most."""
        one, two = np.asarray(before, float), np.asarray(after, float)
        if one.shape != two.shape:
            self.differ(f"{place}: {one.size} numbers, then {two.size}")
            return
        self.numbers += one.size
        known = np.isfinite(one) & np.isfinite(two)
        scale = np.max(np.abs(one[known]), initial=0.0)
        wrong = np.zeros(one.shape, bool)
        wrong[known] = np.abs(two - one)[known] > self.relative * scale + AROUND_ZERO
        wrong[~known] = ~((one == two) | (np.isnan(one) & np.isnan(two)))[~known]
        if wrong.any():
            with np.errstate(invalid="ignore"):
                worst = np.unravel_index(
                    np.argmax(np.where(wrong, np.abs(two - one), -1)), one.shape
                )
            many = f"{wrong.sum()} of {one.size}, " if one.size > 1 else ""
            share = (two[worst] - one[worst]) / scale if scale else math.inf
            self.differ(f"{place}: {many}{one[worst]!s} -> {two[worst]!s} ({share:+.2g})",
                        int(wrong.sum()))  # fmt: skip

    def printed(self, place: str, before: str, after: str) -> None:
        """Two numbers as they are printed for reading."""
        self.numbers += 1
        one, two = float(before), float(after)
        unit = max(last_place(before), last_place(after))
        if one == two or abs(two - one) <= self.relative * abs(one):
            return
        if unit < 1 and abs(two - one) <= min(1.01 * unit, ROUNDED * abs(one)):
            self.last_digit += 1
            return
        share = (two - one) / one if one else math.inf
        self.differ(f"{place}: {before} -> {after} ({share:+.2g})")

    def json(self, place: str, before: Any, after: Any) -> None:
        """Documents, field by field."""
        if isinstance(before, dict) and isinstance(after, dict):
            for key in before | after:
                if key not in before or key not in after:
                    self.differ(f"{place}.{key}: only {'after' if key in after else 'before'}")
                else:
                    self.json(f"{place}.{key}", before[key], after[key])
        elif numeric(before) and numeric(after):
            self.values(place, as_numbers(before), as_numbers(after))
        elif isinstance(before, list) and isinstance(after, list):
            if len(before) != len(after):
                self.differ(f"{place}: {len(before)} entries, then {len(after)}")
            for k, (one, two) in enumerate(zip(before, after, strict=False)):
                self.json(f"{place}[{k}]", one, two)
        elif isinstance(before, str) and isinstance(after, str):
            self.text(place, before, after)
        elif type(before) is not type(after) or before != after:
            self.differ(f"{place}: {shorten(before)} -> {shorten(after)}")

    def text(self, place: str, before: str, after: str) -> None:
        """Text for reading: its numbers, and its words apart from them."""
        one, two = before.splitlines(), after.splitlines()
        words = difflib.SequenceMatcher(None, list(map(wording, one)), list(map(wording, two)),
                                        autojunk=False)  # fmt: skip
        for kind, a, b, c, d in words.get_opcodes():
            if kind == "equal":
                for old, new in zip(one[a:b], two[c:d], strict=True):
                    pairs = zip(figures(old), figures(new), strict=True)
                    for before_number, after_number in pairs:
                        where = f"{place}: {shorten(new.strip())}"
                        self.printed(where, before_number, after_number)
            else:
                for sign, lines in (("-", one[a:b]), ("+", two[c:d])):
                    for line in lines:
                        self.lines.append(f"{place}: {sign} {line}")
                self.differing += max(b - a, d - c)

    def table(self, place: str, before: list[list[str]], after: list[list[str]]) -> None:
        """Columns of CSV; a field that is no number counts as text."""
        if before[0] != after[0]:
            self.differ(f"{place}: columns {before[0]} -> {after[0]}")
            return
        if len(before) != len(after):
            self.differ(f"{place}: {len(before) - 1} rows, then {len(after) - 1}")
            return
        for k, name in enumerate(before[0]):
            one, two = ([row[k] if k < len(row) else "" for row in rows[1:]]
                        for rows in (before, after))  # fmt: skip
            try:
                self.values(f"{place}: {name}", *([float(x or "nan") for x in column]
                                                  for column in (one, two)))  # fmt: skip
            except ValueError:
                self.text(f"{place}: {name}", "\n".join(one), "\n".join(two))

    def content(self, place: str, before: bytes, after: bytes) -> None:
        """An output or a file, by what it holds."""
        if before == after:
            self.numbers += (
                len(figures(before.decode(errors="replace"))) if b"\0" not in before else 0
            )
            return
        if before[:4] == after[:4] == b"PAR1":
            columns = [parquet(content) for content in (before, after)]
            self.json(place, *columns)
            return
        if before[:4] == after[:4] == b"\x89PNG":
            self.picture(place, before, after)
            return
        try:
            one, two = before.decode(), after.decode()
        except UnicodeDecodeError:
            self.differ(f"{place}: {len(before)} bytes, then {len(after)}")
            return
        documents = [as_json(text) for text in (one, two)]
        if None not in documents:
            self.json(place, *documents)
        elif is_table(one) and is_table(two):
            self.table(place, *(list(csv.reader(text.splitlines())) for text in (one, two)))
        else:
            self.text(place, one, two)

    def picture(self, place: str, before: bytes, after: bytes) -> None:
        from io import BytesIO

        from matplotlib.image import imread

        one, two = imread(BytesIO(before)), imread(BytesIO(after))
        if one.shape != two.shape:
            self.differ(f"{place}: picture of {one.shape} -> {two.shape}")
        elif share := float(np.mean(np.any(np.abs(one - two) > 0.1, axis=-1))):
            self.differ(f"{place}: {100 * share:.2g} % of the picture is another")


def figures(text: str) -> list[str]:
    return NUMBER.findall(DIGEST.sub("digest", text))


def wording(line: str) -> str:
    """A line without its numbers, digests and blanks."""
    return " ".join(NUMBER.sub("#", DIGEST.sub("digest", line)).split())


def last_place(number: str) -> float:
    """Size of one unit in the last digit printed; 1 and more for whole numbers."""
    mantissa, _, exponent = number.lower().partition("e")
    decimals = len(mantissa.partition(".")[2])
    return 10.0 ** (int(exponent or 0) - decimals)


def numeric(value: Any) -> bool:
    """Whether it is a number, or a list of numbers (null where one is missing)."""
    if isinstance(value, bool):
        return False
    if isinstance(value, int | float):
        return True
    return isinstance(value, list) and bool(value) and (
        all(v is None or (numeric(v) and not isinstance(v, list)) for v in value)
        and any(v is not None for v in value)
    )  # fmt: skip


def as_numbers(value: Any) -> Any:
    return [math.nan if v is None else v for v in value] if isinstance(value, list) else value


def as_json(text: str) -> Any:
    """A JSON document, or the columns of lines of JSON; None for neither."""
    try:
        return json.loads(text)
    except ValueError:
        pass
    try:
        rows = [json.loads(line) for line in text.splitlines() if line]
    except ValueError:
        return None
    if not rows or not all(isinstance(row, dict) for row in rows):
        return None
    return {key: [row.get(key) for row in rows] for key in {k: None for row in rows for k in row}}


def is_table(text: str) -> bool:
    """CSV of one header and rows as wide."""
    rows = list(csv.reader(text.splitlines()))
    wide = len(rows[0]) if rows else 0
    names = wide > 1 and all(re.fullmatch(r"\w+", name) for name in rows[0])
    return names and all(len(row) == wide for row in rows)


def parquet(content: bytes) -> dict[str, list[Any]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    return dict(pq.read_table(pa.BufferReader(content)).to_pydict())


def shorten(value: Any) -> str:
    text = str(value)
    return text if len(text) < 100 else text[:97] + "..."


def compare(before: Path, after: Path, relative: float, reasons: Path | None, every: bool) -> int:
    """Print what differs; the number of differences without a reason."""
    known = list(read_pairs(reasons)) if reasons else []
    one, two = results(before), results(after)
    total = Comparison(relative)
    unexplained = 0
    places = one.keys() & two.keys()
    places |= set() if (after / PARTIAL).exists() else one.keys()
    places |= set() if (before / PARTIAL).exists() else two.keys()
    for place in sorted(places):
        found = Comparison(relative)
        if place not in one or place not in two:
            found.differ(f"{place}: only {'after' if place in two else 'before'}")
        elif place.endswith(".code"):
            codes = [folder[place].read_text() for folder in (one, two)]
            if codes[0] != codes[1]:
                found.differ(f"{place}: exit {codes[0]} -> {codes[1]}")
        else:
            found.content(place, one[place].read_bytes(), two[place].read_bytes())
        total.numbers += found.numbers
        total.last_digit += found.last_digit
        total.differing += found.differing
        if not found.lines:
            continue
        reason = next((text for pattern, text in known if fnmatch.fnmatch(place, pattern)), None)
        unexplained += found.differing if reason is None else 0
        shown = found.lines if every else found.lines[:SHOWN]
        print(*shown, sep="\n")
        if len(found.lines) > len(shown):
            print(f"{place}: ... and {len(found.lines) - len(shown)} more lines")
        if reason is not None:
            print(f"{place}: because {reason}")
    if unexplained < total.differing:
        print(f"{total.differing - unexplained} of the differences have a reason")
    print(f"{total.last_digit} differ by one in the last digit printed")
    cases = sum(place.endswith(".code") for place in places)
    print(f"{cases} cases, {total.numbers} numbers compared, {total.differing} differ")
    return unexplained


def results(folder: Path) -> dict[str, Path]:
    """What was recorded: ``case.out``, ``case.err``, ``case.code``, ``files/name``."""
    found = {path.name: path for path in (folder / "results").iterdir()}
    inputs = {"samples", "data"}
    for path in (folder / "files").rglob("*"):
        if path.is_file() and path.relative_to(folder / "files").parts[0] not in inputs:
            found[str(path.relative_to(folder))] = path
    if not found:
        raise SystemExit(f"{folder} holds no results")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    actions = parser.add_subparsers(dest="action", required=True)
    one = actions.add_parser("record", help="run the cases")
    one.add_argument("target", type=Path, help="new folder")
    one.add_argument("--python", default=sys.executable, help="interpreter (default: this one)")
    one.add_argument("--source", type=Path, default=HERE.parent, help="checkout that is run")
    one.add_argument("--data", type=Path, default=HERE.parents[1] / "shared" / "data",
                     help="the measured logs (default: ../shared/data)")  # fmt: skip
    one.add_argument("--only", metavar="REGEX", help="cases of these names, and what they need")
    two = actions.add_parser("compare", help="what differs between two records")
    two.add_argument("before", type=Path)
    two.add_argument("after", type=Path)
    two.add_argument("--relative", type=float, default=1e-9, help="rounding (default: 1e-9)")
    two.add_argument("--reasons", type=Path, help="lines of 'pattern: reason'")
    two.add_argument("--all", action="store_true", help="every line, not the first ones")
    given = parser.parse_args()
    if given.action == "record":
        record(given.target, given.python, given.source.resolve(), given.data.resolve(), given.only)
        return 0
    wrong = compare(given.before, given.after, given.relative, given.reasons, given.all)
    return 3 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
