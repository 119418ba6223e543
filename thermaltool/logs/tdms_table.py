"""TDMS files of National Instruments, by npTDMS."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from thermaltool.errors import LogError
from thermaltool.logs.columns import ColumnMap
from thermaltool.logs.formats import load_library
from thermaltool.logs.frame_table import FrameTable
from thermaltool.logs.table import InputBytes
from thermaltool.record import hint


def open_table(source: InputBytes, mapping: ColumnMap) -> FrameTable:
    """The channels of one group: that of the map, else the one with the most values.

    Waveforms get the clock ``time_s`` of their properties.

    Raises
    ------
    LogError
        npTDMS is not installed; no TDMS file; no such group; channels of different lengths.
    """
    import pandas

    library = load_library("nptdms", source.name)
    try:
        groups = library.TdmsFile.read(io.BytesIO(source.data)).groups()
        group = _group(groups, mapping.table, source.name)
        channels = [each for each in group.channels() if len(each)]
        columns = {each.name: each[:] for each in channels}
    except LogError:
        raise
    except Exception as error:  # whatever a damaged file makes of the library
        raise LogError(f"truncated, or not TDMS: {error}", source.name) from error
    lengths = {len(values) for values in columns.values()}
    if len(lengths) > 1:
        raise LogError(f"channels of different lengths in the group {group.name}", source.name)
    steps = {each.properties.get("wf_increment") for each in channels}
    step = next(iter(steps)) if len(steps) == 1 else None
    if step and "time_s" not in columns:
        begins = {
            (each.properties.get("wf_start_time"), each.properties.get("wf_start_offset", 0.0))
            for each in channels
        }
        if len(begins) > 1:
            message = f"channels of the group {group.name} begin at different times: cut the file"
            raise LogError(message, source.name)
        ((_, offset),) = begins
        time = float(offset) + float(step) * np.arange(next(iter(lengths)))
        columns = {"time_s": time, **columns}
    units = {each.name: str(each.properties.get("unit_string", "")) for each in channels}
    return FrameTable(
        pandas.DataFrame(columns), mapping.dialect.missing, file=source.name, units=units
    )


def _group(groups: list[Any], wanted: str | None, file: str) -> Any:
    names = [each.name for each in groups]
    if wanted is not None and wanted not in names:
        raise LogError(f"no group {wanted}{hint(wanted, names)}", file)
    found = [each for each in groups if wanted in (None, each.name) and each.channels()]
    if not found:
        raise LogError("no group with channels", file)
    return max(found, key=lambda each: sum(len(channel) for channel in each.channels()))
