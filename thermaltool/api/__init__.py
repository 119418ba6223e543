"""The Python API: one file a stage, the functions that the commands call.

`thermaltool` offers all of them; each is loaded when it is first asked for.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from thermaltool.api.arma import *  # noqa: F403
    from thermaltool.api.calibration import *  # noqa: F403
    from thermaltool.api.compensator import *  # noqa: F403
    from thermaltool.api.diagnosis import *  # noqa: F403
    from thermaltool.api.estimation import *  # noqa: F403
    from thermaltool.api.identification import *  # noqa: F403
    from thermaltool.api.inputs import *  # noqa: F403
    from thermaltool.api.laplace_inversion import *  # noqa: F403
    from thermaltool.api.log_check import *  # noqa: F403
    from thermaltool.api.noise_report import *  # noqa: F403
    from thermaltool.api.orders import *  # noqa: F403
    from thermaltool.api.result import *  # noqa: F403
    from thermaltool.api.simulation import *  # noqa: F403

# module -> what it offers
PUBLIC = {
    "arma": ("ArmaFit", "SeriesForecast", "fit", "forecast"),
    "calibration": (
        "Calibration",
        "calibrate",
    ),
    "diagnosis": (
        "DiagnosisReport",
        "diagnose",
    ),
    "compensator": ("Compensator",),
    "estimation": ("DesignReport", "LogEstimate", "estimate", "regularize"),
    "identification": ("Identification", "identify"),
    "inputs": (
        "read_log",
        "read_model",
        "write_model",
    ),
    "laplace_inversion": (
        "LaplaceInversion",
        "invert_laplace",
    ),
    "log_check": (
        "LogCheck",
        "check",
    ),
    "noise_report": (
        "NoiseReport",
        "noise",
    ),
    "orders": ("OrderReport", "order"),
    "result": ("to_frame",),
    "simulation": (
        "Simulation",
        "simulate",
    ),
}

__all__ = [name for names in PUBLIC.values() for name in names]


def __getattr__(name: str) -> Any:
    for module, names in PUBLIC.items():
        if name in names:
            return getattr(importlib.import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
