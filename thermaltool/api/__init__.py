"""The Python API: one file a stage, the functions that the commands call.

`thermaltool` offers all of them; each is loaded when it is first asked for.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from thermaltool.api.inputs import read_log
    from thermaltool.api.laplace_inversion import LaplaceInversion, invert_laplace
    from thermaltool.api.log_check import LogCheck, check
    from thermaltool.api.noise_report import NoiseReport, noise

_MODULES = {
    "LaplaceInversion": "laplace_inversion",
    "LogCheck": "log_check",
    "NoiseReport": "noise_report",
    "check": "log_check",
    "invert_laplace": "laplace_inversion",
    "noise": "noise_report",
    "read_log": "inputs",
}

__all__ = [
    "LaplaceInversion",
    "LogCheck",
    "NoiseReport",
    "check",
    "invert_laplace",
    "noise",
    "read_log",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
