"""The Python API: one file a stage, the functions that the commands call.

`thermaltool` offers all of them; each is loaded when it is first asked for.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from thermaltool.api.arma import *  # noqa: F403
    from thermaltool.api.body_calibration import *  # noqa: F403
    from thermaltool.api.body_modes import *  # noqa: F403
    from thermaltool.api.body_placement import *  # noqa: F403
    from thermaltool.api.calibration import *  # noqa: F403
    from thermaltool.api.comparison import *  # noqa: F403
    from thermaltool.api.compensator import *  # noqa: F403
    from thermaltool.api.control_design import *  # noqa: F403
    from thermaltool.api.diagnosis import *  # noqa: F403
    from thermaltool.api.estimation import *  # noqa: F403
    from thermaltool.api.grey_box import *  # noqa: F403
    from thermaltool.api.identification import *  # noqa: F403
    from thermaltool.api.inputs import *  # noqa: F403
    from thermaltool.api.laplace_inversion import *  # noqa: F403
    from thermaltool.api.log_check import *  # noqa: F403
    from thermaltool.api.mode_identification import *  # noqa: F403
    from thermaltool.api.noise_report import *  # noqa: F403
    from thermaltool.api.orders import *  # noqa: F403
    from thermaltool.api.presentation import *  # noqa: F403
    from thermaltool.api.result import *  # noqa: F403
    from thermaltool.api.simulation import *  # noqa: F403
    from thermaltool.api.thermal_ranges import *  # noqa: F403
    from thermaltool.api.transient import *  # noqa: F403
    from thermaltool.logs.reader import read_log as read_log
    from thermaltool.record import Record as Record

# module of the package -> what it offers
PUBLIC = {
    "api.arma": ("ArmaFit", "SeriesForecast", "fit", "forecast"),
    "api.body_calibration": ("BodyCalibration", "calibrate_body"),
    "api.body_modes": ("BodyModes", "thermal_modes"),
    "api.body_placement": ("BodyPlacement", "place_on_body"),
    "api.calibration": ("Calibration", "calibrate"),
    "api.comparison": ("Comparison", "compare"),
    "api.compensator": ("Compensator",),
    "api.control_design": ("ControlReport", "design"),
    "api.diagnosis": ("DiagnosisReport", "diagnose"),
    "api.estimation": ("DesignReport", "LogEstimate", "estimate", "regularize"),
    "api.grey_box": ("GreyBox", "rc"),
    "api.identification": ("Identification", "identify"),
    "api.inputs": ("read_model", "write_model"),
    "api.laplace_inversion": ("LaplaceInversion", "invert_laplace"),
    "api.log_check": ("LogCheck", "check"),
    "api.mode_identification": ("LogModes", "identify_modes"),
    "api.noise_report": ("NoiseReport", "noise"),
    "api.orders": ("OrderReport", "order"),
    "api.presentation": ("Presentation", "present"),
    "api.result": ("to_frame",),
    "api.regression": ("RegressionReport", "regress"),
    "api.sensor_placement": ("SensorPlacement", "place"),
    "api.simulation": ("Simulation", "simulate"),
    "api.thermal_ranges": ("ThermalTest", "iso230"),
    "api.transient": ("SpectrumReport", "spectrum"),
    "logs.reader": ("read_log",),
    "record": ("Record",),
}

__all__ = [name for names in PUBLIC.values() for name in names]


def __getattr__(name: str) -> Any:
    for module, names in PUBLIC.items():
        if name in names:
            return getattr(importlib.import_module(f"thermaltool.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
