"""The exam's results: a row for each machine, for each kind of trouble, and what went wrong."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
from as_simulated import MAX_DIFFERENCE
from exam_scoring import INDISTINGUISHABLE, NEAR, SURE, WORSE_SHARE, Score
from hidden_tables import REACHED, table_lines, wilson

NONE = "none"
# Power of the test that is told all below which a log does not show what is wrong.
BLIND = 0.5
# What is asked of every machine: first, in the group (shares), by size.
ASKED = {5.0: (0.85, 0.95), 15.0: (0.95, 0.95)}
MAX_SILENT, MAX_CLEAN, MIN_LOCATED, MAX_MISNAMED = 0.03, 0.03, 0.8, 0.05

_PAIRS = {
    frozenset({k.partition("/")[0], v}) for k, names in INDISTINGUISHABLE.items() for v in names
}
_INSTEAD = ", ".join(sorted(" and ".join(sorted(pair)) for pair in _PAIRS))
HOW_COUNTED = f"""\
- *Size*: RMS of what is changed, without noise and about its mean, over what the calibrated model
  leaves of a clean log (about its mean too; about the start that fits best where a machine may
  be warm when a log begins), at the output where that is largest. A log that
  reaches less than {100 * REACHED:.0f} % of its size counts for none; frozen and swapped
  sensors have the size that they have, which counts from 5 on.
- *In the group*: first, or in a group of at most three that the tool declares indistinguishable
  from its first cause or, where it names none, suspects; or one for the other of {_INSTEAD}
  (of a source, one that is not logged).
- *Wrong*: a first cause with evidence above {SURE:g} that is not in the group. *Silent*: no cause.
- Causes that are true of the machine itself (the bent characteristic of the chain's and the
  spindle's drive, the plate's commands that act before they are logged) are left out.
- *Unknown kinds* are called `unknown` (or by a name that such a cause has got since), or *located*:
  some cause has the right channel, or begins within {100 * NEAR:.0f} % of the log of the right
  instant. *Misnamed*: neither, and a cause with evidence above {SURE:g}.
- *Worse*: an output whose RMS by the written model is up by more than {100 * WORSE_SHARE:.0f} % and
  beyond noise, with its zero free or as `simulate` counts. The calibration log is counted
  apart: what is wrong now was not so then.
- *Told off*: largest relative difference between an RMS in the report and that of `simulate`.
- *Seen by a test told all*: mean power of a matched filter that knows the change to the row, but
  for what a start of the log would explain, where a machine may be warm when a log begins; 3 %
  false alarms, noise as the model leaves it in a clean log. *Blind*: its power is below one half.
- *Left over noise*: what the calibrated model leaves of a clean log, counted so, over the noise
  of a reading, at the worst output; median of the machines.
- A log on which a command fails counts as answered wrong, a clean one as named."""


def percent(hits: Sequence[bool], interval: bool = False) -> str:
    if not hits:
        return "–"
    text = f"{sum(hits)}/{len(hits)}"
    if interval:
        low, high = wilson(sum(hits), len(hits))
        text += f" ({100 * sum(hits) / len(hits):.0f} %, {100 * low:.0f} to {100 * high:.0f})"
    return text


def sized(scores: Sequence[Score], size: float) -> list[Score]:
    """Logs of a catalogued cause that reach this size."""
    here = [s for s in scores if s.trial.group == f"size {size:g}"]
    return [s for s in here if s.failure or s.size >= REACHED * size]


def natural(scores: Sequence[Score]) -> list[Score]:
    """Logs of what has no strength, where it is as large as is wanted."""
    here = of_group(scores, "natural")
    return [s for s in here if s.failure or s.size >= REACHED * s.trial.size]


def of_group(scores: Sequence[Score], group: str) -> list[Score]:
    return [s for s in scores if s.trial.group == group]


def plants_of(scores: Sequence[Score]) -> Iterator[tuple[str, list[Score]]]:
    """The scores of each machine, and all."""
    for name in dict.fromkeys(s.trial.plant for s in scores):
        yield name, [s for s in scores if s.trial.plant == name]
    yield "all", list(scores)


def known_rows(scores: Sequence[Score], sizes: Sequence[float]) -> Iterator[list[str]]:
    """How known trouble is named on each machine."""
    for name, here in plants_of(scores):
        row = [name, percent([_is_named(s) for s in of_group(here, "clean")])]
        for size in sizes:
            found = sized(here, size)
            row += [percent([hit(s) for s in found]) for hit in _KNOWN.values()]
        yield [*row, percent([s.first for s in natural(here)])]


def other_rows(scores: Sequence[Score]) -> Iterator[list[str]]:
    """Unknown trouble, what is written, and failures, on each machine."""
    for name, here in plants_of(scores):
        strangers, done = of_group(here, "unknown"), [s for s in here if not s.failure]
        yield [
            name,
            *(percent([hit(s) for s in strangers]) for hit in (_called, _told, _misnamed, _silent)),
            percent([_worse(s) for s in done]),
            percent([s.worse("calibration") for s in done]),
            percent([s.refused for s in done]),
            f"{100 * max((s.told_off for s in done), default=np.nan):.2g} %",
            percent([bool(s.failure) for s in here]),
            percent([s.power < BLIND for s in here if np.isfinite(s.power)]),
            f"{np.median([s.left for s in done] or [np.nan]):.3g} ×",
        ]


OTHER = [
    "machine",
    "unknown: called",
    "or located",
    "misnamed",
    "silent",
    "written worse",
    "worse on calibration",
    "refused",
    "told off",
    "failed",
    "blind",
    "left over noise",
]


def _first(s: Score) -> bool:
    return s.first


def _grouped(s: Score) -> bool:
    return s.grouped


def _silent(s: Score) -> bool:
    return s.silent


def _wrong(s: Score) -> bool:
    return s.wrong or bool(s.failure)


def _is_named(s: Score) -> bool:
    return bool(s.causes) or bool(s.failure)


def _called(s: Score) -> bool:
    return s.called


def _told(s: Score) -> bool:
    return s.called or s.located


def _misnamed(s: Score) -> bool:
    return s.misnamed


def _worse(s: Score) -> bool:
    return s.worse("diagnosed") or s.worse("validation")


def _differs(s: Score) -> bool:
    return s.told_off >= MAX_DIFFERENCE


_KNOWN: dict[str, Callable[[Score], bool]] = {
    "first": _first,
    "group": _grouped,
    "silent": _silent,
    "wrong": _wrong,
}


def known_heading(sizes: Sequence[float]) -> list[str]:
    each = [f"{what} {size:g} ×" for size in sizes for what in _KNOWN]
    return ["machine", "clean named", *each, "natural first"]


def kind_rows(scores: Sequence[Score], sizes: Sequence[float]) -> Iterator[list[str]]:
    kinds = sorted({s.trial.kind for s in scores if s.trial.kind and s.trial.group != "unknown"})
    for kind in kinds:
        here = [s for s in scores if s.trial.kind == kind]
        row = [kind]
        for size in sizes:
            row.append(percent([s.first for s in sized(here, size)]))
        row.append(percent([s.first for s in natural(here)]))
        least = min(5.0, *sizes)
        large = [s for size in sizes if size >= least for s in sized(here, size)] + natural(here)
        row.append(_named(s for s in large if not s.first))
        yield row


def stranger_rows(scores: Sequence[Score]) -> Iterator[list[str]]:
    here = of_group(scores, "unknown")
    for kind in sorted({s.trial.kind for s in here}):
        of = [s for s in here if s.trial.kind == kind]
        hits = (_called, _told, _misnamed, _silent)
        yield [kind, *(percent([hit(s) for s in of]) for hit in hits), _named(of)]


def _named(scores: Iterator[Score] | Sequence[Score]) -> str:
    names = Counter(
        "failed" if s.failure else s.causes[0].name if s.causes else NONE for s in scores
    )
    return ", ".join(f"{name} {count}" for name, count in names.most_common()) or "–"


def requirements(scores: Sequence[Score]) -> Iterator[tuple[str, str, str, bool]]:
    """What is asked, of the worst machine where it is asked of each; measured; whether reached."""
    plants = list(dict.fromkeys(s.trial.plant for s in scores))

    def line(
        what: str,
        here: Callable[[Sequence[Score]], list[Score]],
        hit: Callable[[Score], bool],
        asked: float,
        at_most: bool,
        each: bool = False,
    ) -> Iterator[tuple[str, str, str, bool]]:
        parts = [[s for s in scores if s.trial.plant == p] for p in plants] if each else [scores]
        shares = [(np.mean([hit(s) for s in here(p)]), k) for k, p in enumerate(parts) if here(p)]
        if not shares:
            return
        worst = (max if at_most else min)(shares)
        found = here(parts[worst[1]])
        text = percent([hit(s) for s in found], interval=True)
        if each:
            text += f", {plants[worst[1]]}"
        reached = bool(worst[0] <= asked if at_most else worst[0] >= asked)
        yield what, f"{'≤' if at_most else '≥'} {100 * asked:g} %", text, reached

    def done(p: Sequence[Score]) -> list[Score]:
        return [s for s in p if not s.failure]

    for size, (first, group) in ASKED.items():

        def of(p: Sequence[Score], size: float = size) -> list[Score]:
            return sized(p, size)

        def seen(p: Sequence[Score], size: float = size) -> list[Score]:
            return [s for s in sized(p, size) if not s.power < BLIND]

        text, bound = f"{size:g} ×", "not blind, worst machine"
        yield from line(f"{text}: first, worst machine", of, _first, first, False, True)
        yield from line(f"{text}: first, {bound}", seen, _first, first, False, True)
        yield from line(f"{text}: in the group, worst machine", of, _grouped, group, False, True)
        yield from line(f"{text}: in the group, {bound}", seen, _grouped, group, False, True)
        yield from line(f"{text}: silent", of, _silent, MAX_SILENT, True)
    clean, unknown = (partial(of_group, group=name) for name in ("clean", "unknown"))
    yield from line("clean logs named", clean, _is_named, MAX_CLEAN, True)
    yield from line("unknown kinds called or located", unknown, _told, MIN_LOCATED, False)
    yield from line("unknown kinds misnamed", unknown, _misnamed, MAX_MISNAMED, True)
    yield from line("written model worse", done, _worse, 0.0, True)
    yield from line("report and simulate differ by 1 % or more", done, _differs, 0.0, True)


def tables(scores: Sequence[Score], sizes: Sequence[float], seed: int) -> Iterator[str]:
    lines = [[what, asked, measured, "yes" if reached else "**no**"]
             for what, asked, measured, reached in requirements(scores)]  # fmt: skip
    yield from table_lines(["what", "asked", "measured", "reached"], lines)
    seconds = [s.seconds for s in scores if np.isfinite(s.seconds)]
    powers = [s.power for s in scores if np.isfinite(s.power)]
    yield (
        f"\nSeed {seed}, {len(scores)} logs of "
        f"{len({(s.trial.plant, s.trial.machine) for s in scores})} machines; "
        f"{np.median(seconds) if seconds else np.nan:.1f} s of CPU time for a diagnosis (median; "
        f"{max(seconds, default=np.nan):.0f} at most). Seen by a test told all: "
        f"{100 * np.mean(powers) if powers else np.nan:.1f} %; blind in "
        f"{percent([p < BLIND for p in powers])}.\n"
    )
    yield HOW_COUNTED + "\n"
    yield from table_lines(known_heading(sizes), known_rows(scores, sizes))
    yield ""
    yield from table_lines(OTHER, other_rows(scores))
    yield ""
    yield from table_lines(
        ["first", *(f"{size:g} ×" for size in sizes), "natural", "named instead, from 5 × on"],
        kind_rows(scores, sizes),
    )
    yield ""
    yield from table_lines(
        ["unknown kind", "called", "or located", "misnamed", "silent", "named first"],
        stranger_rows(scores),
    )
