"""Cells that are no numbers in columns that nothing needs: missing values, and told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from thermaltool.errors import LogError
from thermaltool.logs.columns import ColumnMap


def spared_cells(
    problems: Sequence[LogError],
    channels: Mapping[str, str],
    mapping: ColumnMap,
    needed: Sequence[str],
) -> dict[str, LogError]:
    """The first fault of each column whose cells cannot be read and that nothing needs.

    Parameters
    ----------
    problems : sequence of LogError
        Of cells, and of whole lines, which have no column.
    channels : mapping
        Channel by column.
    mapping : ColumnMap
        What a needed channel is computed from is needed, too.
    needed : sequence of str
        Channels.

    Returns
    -------
    dict
        By column.
    """
    used = {*needed}
    for each in reversed(mapping.computed):
        used |= {*each.inputs} if each.name in used else set()
    found: dict[str, LogError] = {}
    for problem in problems:
        column = problem.column or ""
        if column in channels and channels[column] not in used:
            found.setdefault(column, problem)
    return found


def with_cure(problem: LogError) -> LogError:
    """The fault, of a single cell with what to do about it.

    Parameters
    ----------
    problem : LogError
    """
    if not problem.message.startswith("not a number: '"):
        return problem
    cure = "; check LOG -o FILE writes the log with such cells missing"
    return LogError(f"{problem.message}{cure}", problem.file, problem.line, problem.column)
