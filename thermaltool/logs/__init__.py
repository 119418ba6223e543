"""Logs: tables of measured channels against one clock, read from and written to files and pipes."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from thermaltool.logs.clock import Sampling, resample
    from thermaltool.logs.draft import draft_map
    from thermaltool.logs.log import Log
    from thermaltool.logs.reader import read_log
    from thermaltool.logs.writer import write_table

# Loaded when it is asked for: the table of formats and the maps of a stream need none of it.
_MODULES = {
    "Log": "log",
    "Sampling": "clock",
    "draft_map": "draft",
    "read_log": "reader",
    "resample": "clock",
    "write_table": "writer",
}
__all__ = ["Log", "Sampling", "draft_map", "read_log", "resample", "write_table"]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
