"""Numbers as text: the shortest that reads back the same, many at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

# Below this many cells Python has formatted them before pyarrow is imported.
FAST_CELLS = 100_000
# Rows that are formatted at once: bounds the memory beside the table [rows].
CHUNK_ROWS = 100_000


def row_lines(
    arrays: Sequence[np.ndarray], before: Sequence[str], end: str, null: str
) -> Iterator[bytes]:
    """One line per row: each cell with its text `before` it, and the `end`; in large pieces."""
    if not arrays:
        return
    rows = len(arrays[0])
    lines = _fast_lines if rows * len(arrays) > FAST_CELLS and _has_pyarrow() else _short_lines
    for start in range(0, rows, CHUNK_ROWS):
        yield lines([a[start : start + CHUNK_ROWS] for a in arrays], before, end, null)


def _has_pyarrow() -> bool:
    """Whether an install has more than what streams need."""
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        return False
    return True


def _short_lines(arrays: Sequence[np.ndarray], before: Sequence[str], end: str, null: str) -> bytes:
    cells = [[number_text(value, null) for value in array.tolist()] for array in arrays]
    pattern = "".join(text.replace("%", "%%") + "%s" for text in before) + end
    return "".join([pattern % row for row in zip(*cells, strict=True)]).encode()


def _fast_lines(arrays: Sequence[np.ndarray], before: Sequence[str], end: str, null: str) -> bytes:
    """The same bytes by pyarrow."""
    import pyarrow
    from pyarrow import compute

    pieces: list[Any] = []
    for text, array in zip(before, arrays, strict=True):
        pieces += [text, compute.cast(pyarrow.array(array, from_pandas=True), pyarrow.string())]
    joined = compute.binary_join_element_wise(
        *pieces, end, "", null_handling="replace", null_replacement=null
    )
    # The strings of an Arrow array lie one behind the other: that is the text already.
    _, offsets, text = joined.buffers()
    return memoryview(text)[: np.frombuffer(offsets, np.int32)[len(joined)]].tobytes()


def number_text(value: float, null: str = "") -> str:
    """The shortest text that reads back as `value`; `null` for NaN.

    The layout is pyarrow's, so that a table looks the same however long it is: whole numbers have
    no point, exponents stand from 1e10 upward and below 1e-6.
    """
    if value != value:
        return null
    text = repr(value)
    if isinstance(value, int):
        return text
    if text.endswith(".0"):
        text = text[:-2]
    if 1e-4 <= abs(value) < 1e10 or value == 0:
        return text
    # The digits are those of `repr`: rounding anew to as many would miss ties.
    sign = "-" if value < 0 else ""
    mantissa, _, power = text.lstrip("-").partition("e")
    whole, _, fraction = mantissa.partition(".")
    digits = (whole + fraction).rstrip("0")
    exponent = int(power or 0) + len(whole) - 1
    if -6 <= exponent < 0:
        return f"{sign}0.{'0' * (-exponent - 1)}{digits}"
    point = "." if len(digits) > 1 else ""
    return f"{sign}{digits[0]}{point}{digits[1:]}e{exponent:+d}"


def decoded(data: bytes, encoding: str) -> tuple[str, str]:
    """A text of unknown origin, and the encoding that it has: its mark, UTF-8, or as given.

    Parameters
    ----------
    data : bytes
    encoding : str
        Of a text without a mark. Where that is UTF-8 and the text is not, Windows' cp1252.
    """
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    elif data.startswith(b"\xef\xbb\xbf"):
        encoding = "utf-8-sig"
    try:
        return data.decode(encoding), encoding
    except UnicodeError:
        return data.decode("cp1252", errors="replace"), "cp1252"
