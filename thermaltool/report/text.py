"""Tables of plain text."""

from __future__ import annotations


def aligned(rows: list[list[str]]) -> str:
    """Columns aligned by blanks; the first row is the heading."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)
