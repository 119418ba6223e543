"""MATLAB files (.mat): version 5 by scipy, version 7.3 (HDF5) by h5py."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from thermaltool.errors import LogError
from thermaltool.logs.columns import ColumnMap
from thermaltool.logs.formats import load_library
from thermaltool.logs.frame_table import FrameTable
from thermaltool.logs.table import InputBytes
from thermaltool.record import hint

# Structs in structs; what h5py finds below is no log.
MAX_STRUCTS = 8


def open_table(source: InputBytes, mapping: ColumnMap) -> FrameTable:
    """The vectors of one length: the most frequent one, the longer of two.

    Fields of a struct are ``struct.field``, columns of a matrix ``matrix_1`` and so on. The map
    can name one variable as its table.

    Raises
    ------
    LogError
        No MATLAB file; h5py is not installed; no such variable; no vector (objects such as
        timetables have none: save their columns as vectors).
    """
    import pandas

    hdf = b"HDF\r\n" in source.data[:1024]
    try:
        variables = _hdf(source) if hdf else _version_5(source)
    except LogError:
        raise
    except Exception as error:  # whatever a damaged file makes of the library
        raise LogError(f"truncated, or no MATLAB file: {error}", source.name) from error
    if mapping.table is not None:
        if mapping.table not in variables:
            raise LogError(
                f"no variable {mapping.table}{hint(mapping.table, variables)}", source.name
            )
        chosen = variables[mapping.table]
        variables = chosen if isinstance(chosen, dict) else {mapping.table: chosen}
    columns = dict(_vectors(variables))
    counts = Counter(len(values) for values in columns.values() if len(values) > 1)
    if not counts:
        message = "no vector: save columns of a table or timetable as vectors of their own"
        raise LogError(message, source.name)
    length = max(counts, key=lambda each: (counts[each], each))
    kept = {name: values for name, values in columns.items() if len(values) == length}
    return FrameTable(pandas.DataFrame(kept), mapping.dialect.missing, file=source.name)


def _version_5(source: InputBytes) -> dict[str, Any]:
    from scipy.io import loadmat

    file: Any = io.BytesIO(source.data)
    found = loadmat(file, simplify_cells=True)
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _hdf(source: InputBytes) -> dict[str, Any]:
    library = load_library("h5py", source.name)
    with library.File(io.BytesIO(source.data), "r") as file:
        found = _group(file, library, 0)
    return {name: value for name, value in found.items() if not name.startswith("#")}


def _group(group: Any, library: Any, depth: int) -> dict[str, Any]:
    """Datasets of an HDF5 group as MATLAB has them: it writes the transpose."""
    found: dict[str, Any] = {}
    for name, item in group.items():
        if isinstance(item, library.Group):
            if depth < MAX_STRUCTS and not name.startswith("#"):
                found[name] = _group(item, library, depth + 1)
        elif item.dtype.kind in "iufb" and not _is_text(item):
            found[name] = np.squeeze(np.asarray(item).T)
    return found


def _is_text(item: Any) -> bool:
    return item.attrs.get("MATLAB_class", b"") in (b"char", "char")


def _vectors(variables: Mapping[str, Any], prefix: str = "") -> list[tuple[str, np.ndarray]]:
    found: list[tuple[str, np.ndarray]] = []
    for name, value in variables.items():
        if isinstance(value, dict):
            found += _vectors(value, f"{prefix}{name}.")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "iufb":
            if value.ndim == 1:
                found.append((prefix + name, value.astype(float)))
            elif value.ndim == 2:
                columns = value.T.astype(float)
                found += [(f"{prefix}{name}_{k}", each) for k, each in enumerate(columns, 1)]
    return found
