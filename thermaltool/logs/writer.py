"""Writing tables: shortest numbers that read back the same, empty or null where missing."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from thermaltool.documents import atomic_output
from thermaltool.errors import OutputError
from thermaltool.logs.formats import load_format, written_format_of


def write_table(
    columns: Mapping[str, np.ndarray], target: str, to_format: str | None = None
) -> None:
    """Write columns of numbers of one length in one of the formats.

    NaN is an empty cell, null, or a Parquet null. Numbers have the shortest text that reads back
    the same, whole ones without a point.

    Parameters
    ----------
    columns : mapping of str to ndarray, shape (n,)
        Names (unit included) and values, in order.
    target : str
        A file, which appears complete or not at all; ``-`` is stdout.
    to_format : str, optional
        A key of `thermaltool.logs.formats.FORMATS`. Default: by the file's suffix, else CSV.

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
    form = load_format(written_format_of(target, to_format))
    with atomic_output(target) as stream:
        form.write_columns(arrays, stream)


def _numeric(array: np.ndarray) -> np.ndarray:
    """Integers as they are, everything else as float64."""
    return array if array.dtype.kind in "iu" else array.astype(np.float64)
