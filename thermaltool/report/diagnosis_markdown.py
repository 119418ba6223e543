"""The whole report of a diagnosis in Markdown, its figures beside it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from thermaltool.documents import write_whole
from thermaltool.report.diagnosis import summary
from thermaltool.report.diagnosis_tables import sections
from thermaltool.report.diagnosis_words import ROLES, Document, names_of

if TYPE_CHECKING:
    from thermaltool.record import Record

GLOSSARY = """\
- *Noise* is the white noise of a reading, estimated on the same log. *Slow discrepancy* is what
  the model gets wrong without having a name: its size and how fast it changes.
- *Rest is white*: whether what noise and slow discrepancy leave is unpredictable.
  *Independent rows* say as much about a mean as all rows, whose errors follow each other.
- *Heating* and *cooling*: the output moves away from rest, or back to it.
- *Evidence* is the fall of BIC when the cause is added, under white noise plus a slow
  discrepancy, after a correction for the number of causes tried. From 10 (odds of 150, decisive) a
  cause is tried on unseen rows.
- *Gain* is what the cause takes off the residual, by the written models without it and with it,
  the zero of each log free, with its 95 % interval; one that includes zero is not claimed.
- *Detectable* is the RMS change of an output that this log would have shown.
"""


def write_report(
    path: str,
    document: Document,
    curves: Sequence[tuple[str, Record]],
    check: Callable[[str], None] = lambda target: None,
) -> None:
    """Write the report in Markdown, its figures beside it as PNG.

    Parameters
    ----------
    path : str
    document : mapping
        The diagnosis as JSON.
    curves : sequence of (output, Record)
        See `thermaltool.report.diagnosis_figures.pictures`.
    check : callable
        Takes the file of each figure before it is written, and may refuse it.
    """
    from thermaltool.report.diagnosis_figures import pictures

    drawn = {f"{os.path.splitext(path)[0]}_{p.name}.png": p for p in pictures(curves, document)}
    figures = [(os.path.basename(target), picture.what) for target, picture in drawn.items()]
    markdown = to_markdown(document, figures).encode()
    for target in drawn:
        check(target)
    # Figures first: the report appears when what it shows is there.
    for target, picture in drawn.items():
        write_whole(picture.png, target)
    write_whole(markdown, path)


def to_markdown(document: Document, figures: Sequence[tuple[str, str]]) -> str:
    """The whole report.

    Parameters
    ----------
    figures : sequence of (str, str)
        File relative to the report, and what it shows.
    """
    lines = [f"# {document['model']} on {names_of(document['logs'])}", ""]
    for sentence in summary(document):
        lines += [_escaped(sentence), ""]
    for file, what in figures:
        lines += [f"![{what}](<{file}>)", ""]
    for section in sections(document):
        lines += [f"## {section.title}", "", *_markdown_table(section.rows), ""]
    lines += ["## Words", "", GLOSSARY.rstrip(), ""]
    lines += ["## Inputs", ""]
    for key, role in ROLES.items():
        lines += [f"- {role}: `{log['name']}`, SHA-256 `{log['sha256']}`" for log in document[key]]
    return "\n".join(lines) + "\n"


def _markdown_table(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    heading, *body = rows
    yield _row(heading)
    yield _row(["---"] * len(heading))
    yield from map(_row, body)


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(_escaped(cell).replace('|', chr(92) + '|') for cell in cells)} |"


def _escaped(text: str) -> str:
    """Underscores and stars of channel names as they stand."""
    return text.replace("_", "\\_").replace("*", "\\*").replace("<", "&lt;")
