"""The catalogue of physical causes, one file each.

A new cause is one file with a subclass of `Effect` and a line in `CATALOGUE`; ``tests/effects``
runs the shared checks on every cause listed here.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from thermaltool.documents import finite
from thermaltool.effects.effect import Effect
from thermaltool.errors import ModelError

# name -> class in thermaltool.effects.<name>; imported on use.
CATALOGUE: dict[str, str] = {
    "ambient_drift": "AmbientDrift",
    "second_source": "SecondSource",
    "drive_nonlinearity": "DriveNonlinearity",
    "transport_delay": "TransportDelay",
    "drive_gain": "DriveGain",
    "drive_gain_step": "DriveGainStep",
    "sensor_lag": "SensorLag",
    "sensor_gain": "SensorGain",
    "sensor_offset_step": "SensorOffsetStep",
    "sensor_drift": "SensorDrift",
    "sensor_conversion": "SensorConversion",
    "sensor_frozen": "SensorFrozen",
    "sensor_self_heating": "SensorSelfHeating",
    "logger_clock": "LoggerClock",
    "sensors_swapped": "SensorsSwapped",
    "convection_state": "ConvectionState",
    "switching_loss": "SwitchingLoss",
    "loss_change": "LossChange",
    "radiation": "Radiation",
    "heat_capacity": "HeatCapacity",
    "conductivity": "Conductivity",
    "latent_heat": "LatentHeat",
    "joint_contact": "JointContact",
    "stick_slip": "StickSlip",
    "hysteresis": "Hysteresis",
    "backlash": "Backlash",
    "actuator_saturation": "ActuatorSaturation",
    "periodic": "Periodic",
    "geometry_step": "GeometryStep",
    "part_temperature": "PartTemperature",
    "record_too_short": "RecordTooShort",
    "outliers": "Outliers",
    "noise_state": "NoiseState",
}

# What ``thermaltool correct`` and ``calibrate`` add to a model beside: module and class. No cause,
# so that no diagnosis tries them.
NO_CAUSES: dict[str, tuple[str, str]] = {
    "drive_curve": ("curve", "DriveCurve"),
    "output_curve": ("curve", "OutputCurve"),
    "natural_convection": ("natural_convection", "NaturalConvection"),
}


def effect_class(name: str) -> type[Effect]:
    """The class of a cause or a correction by name.

    Parameters
    ----------
    name : str
        Of the catalogue, or of what is no cause.

    Raises
    ------
    ModelError
        Unknown cause; the message lists the known ones.
    """
    if name in NO_CAUSES:
        module, class_name = NO_CAUSES[name]
    elif name in CATALOGUE:
        module, class_name = name, CATALOGUE[name]
    else:
        known = ", ".join((*CATALOGUE, *NO_CAUSES))
        raise ModelError(f"unknown effect {name!r}; known: {known}")
    cls: type[Effect] = getattr(
        importlib.import_module(f"thermaltool.effects.{module}"), class_name
    )
    return cls


class _Loaded(dict[str, float]):
    """Parameters of a file: which of them an effect needs shows where it asks for one."""

    def __init__(self, effect: str, parameters: Mapping[str, float]) -> None:
        super().__init__(parameters)
        self._effect = effect

    def __missing__(self, name: str) -> float:
        raise ModelError(f"{self._effect}: the parameter {name} is missing")


def load_effect(document: Mapping[str, Any]) -> Effect:
    """An effect from a model file.

    Parameters
    ----------
    document : mapping

    Raises
    ------
    ModelError
        Unknown cause, a parameter missing, unknown or not a finite number, or a channel beside its
        own that is no name.
    """
    cls = effect_class(document["name"])
    given = document["parameters"]
    names = document.get("covariance_names", given)
    parameters = _Loaded(cls.name, {name: finite(given[name]) for name in names})
    for name, value in parameters.items():
        known = cls.known.get(name.partition("[")[0])
        if known is None or (known.low > 0 and not value > 0):
            raise ModelError(f"{cls.name}: no parameter {name} = {value:g}")
    covariance = document.get("covariance")
    further = {name: document[name] for name in cls.further if name in document}
    for name, value in {"partner": document.get("partner"), **further}.items():
        if not isinstance(value, str | None):
            raise ModelError(f"{cls.name}: {name} is a name, not {value!r:.40}")
    return cls(
        document["channel"],
        parameters,
        document.get("log"),
        None if covariance is None else np.array(covariance, float),
        document.get("partner"),
        **further,
    )
