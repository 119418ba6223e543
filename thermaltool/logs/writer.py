"""Writing tables: shortest numbers that read back the same, empty or null where missing."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, BinaryIO

import numpy as np

from thermaltool.documents import atomic_output
from thermaltool.errors import OutputError
from thermaltool.logs.table import format_of

# Below this many cells Python has formatted them before pyarrow is imported.
FAST_CELLS = 100_000
CHUNK_ROWS = 100_000


def write_table(
    columns: Mapping[str, np.ndarray], target: str, to_format: str | None = None
) -> None:
    """Write columns of numbers of one length as CSV, NDJSON or Parquet.

    NaN is an empty cell, null, or a Parquet null. Numbers have the shortest text that reads back
    the same, whole ones without a point.

    Parameters
    ----------
    columns : mapping of str to ndarray, shape (n,)
        Names (unit included) and values, in order.
    target : str
        A file, which appears complete or not at all; ``-`` is stdout.
    to_format : {"csv", "ndjson", "parquet"}, optional
        Default: by the file's suffix, else CSV.

    Raises
    ------
    OutputError
        The target cannot be written, or a value is infinite. `BrokenPipeError` passes: the
        reader has left.
    ValueError
        Columns of different lengths.
    """
    arrays = {name: _numeric(np.asarray(values)) for name, values in columns.items()}
    if len({array.shape for array in arrays.values()}) > 1:
        shapes = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
        raise ValueError(f"columns of different lengths: {shapes}")
    for name, array in arrays.items():
        infinite = np.flatnonzero(np.isinf(array))
        if infinite.size:
            raise OutputError(f"{target}: {name}: infinite value in row {infinite[0] + 1}")
    form = format_of(target, to_format)
    with atomic_output(target) as stream:
        if form == "parquet":
            _write_parquet(arrays, stream)
        elif form == "ndjson":
            import json

            keys = [json.dumps(name, ensure_ascii=False) + ": " for name in arrays]
            before = [("{" if i == 0 else ", ") + key for i, key in enumerate(keys)]
            stream.writelines(_lines(list(arrays.values()), before, "}\n", "null"))
        else:
            header = io.StringIO()
            csv.writer(header, lineterminator="\n").writerow(arrays)
            stream.write(header.getvalue().encode())
            before = ["," if i else "" for i in range(len(arrays))]
            # A lone empty cell would be an empty line, which readers skip.
            empty = "" if len(arrays) > 1 else '""'
            stream.writelines(_lines(list(arrays.values()), before, "\n", empty))


def _numeric(array: np.ndarray) -> np.ndarray:
    """Integers as they are, everything else as float64."""
    return array if array.dtype.kind in "iu" else array.astype(np.float64)


def _lines(
    arrays: Sequence[np.ndarray], before: Sequence[str], end: str, null: str
) -> Iterator[bytes]:
    """One line per row: each cell with its text `before` it, and the `end`; in large pieces."""
    if not arrays:
        return
    rows = len(arrays[0])
    lines = _fast_lines if rows * len(arrays) > FAST_CELLS else _short_lines
    for start in range(0, rows, CHUNK_ROWS):
        yield lines([a[start : start + CHUNK_ROWS] for a in arrays], before, end, null)


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


def _write_parquet(arrays: Mapping[str, np.ndarray], stream: BinaryIO) -> None:
    import pyarrow
    from pyarrow import parquet

    table = {name: pyarrow.array(array, from_pandas=True) for name, array in arrays.items()}
    parquet.write_table(pyarrow.table(table), stream)


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
