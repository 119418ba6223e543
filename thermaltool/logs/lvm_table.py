"""LabVIEW measurement files (.lvm): text with a header of its own, and one for each segment."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from thermaltool.errors import LogError
from thermaltool.logs.columns import ColumnMap
from thermaltool.logs.frame_table import FrameTable
from thermaltool.logs.table import InputBytes
from thermaltool.logs.text import decoded

END_OF_HEADER = "***End_of_Header***"
SEPARATORS = {"Tab": "\t", "Comma": ","}


@dataclass(frozen=True)
class Segment:
    """A header of a segment as `fields`, its `names`, and its rows with their `lines`."""

    fields: dict[str, list[str]]
    names: list[str]
    rows: list[list[str]]
    lines: list[int]


def open_table(source: InputBytes, mapping: ColumnMap) -> FrameTable:
    """The channels of an .lvm file, with the clock ``time_s`` of its X values.

    The X values of further segments count from the start of the first, unless they are absolute.

    Raises
    ------
    LogError
        No such file, or segments with other channels than the first.
    """
    import pandas

    text, _ = decoded(source.data, mapping.dialect.encoding)
    head, segments = _segments(text, source.name)
    decimal = head.get("Decimal_Separator", ["."])[0] or "."
    names = segments[0].names
    if any(each.names != names for each in segments):
        raise LogError("segments of different channels: cut the file", source.name)
    absolute = head.get("Time_Pref", [""])[:1] == ["Absolute"]
    start = None if absolute else _moment(segments[0].fields) or _moment(head)
    time: list[float] = []
    rows: list[list[str]] = []
    lines: list[int] = []
    for each in segments:
        begins = _moment(each.fields)
        later = (begins - start).total_seconds() if begins and start else 0.0
        time += [later + x for x in _x_values(head, each, decimal, source.name)]
        rows += each.rows
        lines += each.lines
    keep = [k for k, name in enumerate(names) if name not in ("X_Value", "Comment")]
    kept = {names[k]: [row[k].replace(decimal, ".") or None for row in rows] for k in keep}
    units = dict(
        zip([names[k] for k in keep], segments[0].fields.get("Y_Unit_Label", []), strict=False)
    )
    frame = pandas.DataFrame({"time_s": time, **kept}, dtype=object).astype({"time_s": float})
    return FrameTable(
        frame,
        mapping.dialect.missing,
        file=source.name,
        lines=lines,
        header_line=min(lines, default=2) - 1,
        units=units,
    )


def _segments(text: str, file: str) -> tuple[dict[str, list[str]], list[Segment]]:
    """The header of the file and its segments."""
    separator = "\t"
    headers: list[dict[str, list[str]]] = [{}]
    segments: list[Segment] = []
    state = "header"
    for line, row in enumerate(text.splitlines(), 1):
        if not row.strip():
            continue
        if state == "rows" and row.startswith(("Channels", "***")):
            headers.append({})
            state = "header"
        if row.startswith(END_OF_HEADER):
            separator = SEPARATORS.get(headers[0].get("Separator", ["Tab"])[0], "\t")
            state = "names" if len(headers) > 1 else "header"
            if len(headers) == 1:
                headers.append({})
            continue
        cells = [cell.strip() for cell in row.split(separator)]
        if state == "header":
            if cells[0].startswith("LabVIEW") or cells[0].startswith("***"):
                continue
            # Before its separator is known the first header has tabs or commas.
            key, *values = cells if len(cells) > 1 else row.replace(",", "\t", 1).split("\t")
            headers[-1][key.strip()] = [value.strip() for value in values]
        elif state == "names":
            segments.append(Segment(headers[-1], _named(cells), [], []))
            state = "rows"
        else:
            names = segments[-1].names
            if any(cells[len(names) :]):
                message = f"{len(cells)} cells where the header has {len(names)}"
                raise LogError(message, file, line)
            segments[-1].rows.append((cells + [""] * len(names))[: len(names)])
            segments[-1].lines.append(line)
    if not segments:
        raise LogError("no LabVIEW measurement file: no row of names behind its header", file)
    return headers[0], segments


def _named(cells: list[str]) -> list[str]:
    while len(cells) > 1 and not cells[-1]:
        cells.pop()
    seen: dict[str, int] = {}
    names = []
    for cell in cells:
        seen[cell] = seen.get(cell, 0) + 1
        names.append(cell if seen[cell] == 1 or cell == "X_Value" else f"{cell} {seen[cell]}")
    return names


def _x_values(head: dict[str, list[str]], segment: Segment, decimal: str, file: str) -> list[float]:
    if head.get("X_Columns", ["One"])[0] != "No" and "X_Value" in segment.names:
        at = segment.names.index("X_Value")
        clocks = [k for k, name in enumerate(segment.names) if name == "X_Value"]
        for row, line in zip(segment.rows, segment.lines, strict=True):
            if any(row[k] != row[at] for k in clocks):
                raise LogError("channels with clocks of their own: export them apart", file, line)
        try:
            return [_number(row[at], decimal) for row in segment.rows]
        except ValueError as error:
            raise LogError(f"X_Value: {error}", file) from error
    try:
        first, step = (
            _number(segment.fields.get(key, [default])[0], decimal)
            for key, default in (("X0", "0"), ("Delta_X", "1"))
        )
    except ValueError as error:
        raise LogError(f"X0 or Delta_X: {error}", file) from error
    return [first + step * k for k in range(len(segment.rows))]


def _number(text: str, decimal: str) -> float:
    return float(text.replace(decimal, "."))


def _moment(fields: dict[str, list[str]]) -> datetime | None:
    """When a header says that it begins."""
    day, clock = (next(iter(fields.get(key, [])), "") for key in ("Date", "Time"))
    try:
        # LabVIEW writes more digits of a second than there are microseconds.
        whole, _, part = clock.replace(",", ".").partition(".")
        begun = datetime.strptime(f"{day} {whole}", "%Y/%m/%d %H:%M:%S")
        return begun.replace(microsecond=int(part[:6].ljust(6, "0") or 0))
    except ValueError:
        return None
