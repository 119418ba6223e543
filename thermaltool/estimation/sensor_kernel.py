"""The kernel of one sensor of a model: from its reading to the drive behind it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from thermaltool.documents import Part, finite
from thermaltool.errors import ModelError
from thermaltool.estimation.cascade import lagged_modes
from thermaltool.estimation.kernel import Kernel, Regularization, invert_modes, kernel_table
from thermaltool.estimation.permanent_effects import (
    check_supported,
    permanent_effects,
    reading_columns,
    reading_maps,
    sensor_time_constants,
)
from thermaltool.estimation.variable_cooling import cooling_effects
from thermaltool.model import Model, Term, with_acting_terms
from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.modes import Complex, Float


@dataclass(frozen=True)
class SensorKernel:
    """The kernel of the regularized inverse for one sensor.

    Attributes
    ----------
    sensor : str
    kernel : Kernel
    steady_state_kept : float
        Share of the steady state that the window keeps.
    notes : tuple of str
        What its input is, where that is not the bare reading.
    """

    sensor: str
    kernel: Kernel
    steady_state_kept: float
    notes: tuple[str, ...]

    def columns(self) -> dict[str, Float]:
        """The table: the weights, with the singular weights in every row."""
        weight, (A0, A1) = self.kernel.weight, (self.kernel.A0, self.kernel.A1)
        return {
            "time_s": self.kernel.time,
            "weight_1": weight,
            "A0_1": np.full(len(weight), A0),
            "A1_s": np.full(len(weight), A1),
        }

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "A0": self.kernel.A0,
            "A1_s": self.kernel.A1,
            "error": self.kernel.error,
            "steady_state_kept": self.steady_state_kept,
            "time_s": self.kernel.time.tolist(),
            "weight": self.kernel.weight.tolist(),
        }


def sensor_kernel(
    model: Model,
    sensor: str | None = None,
    regularization: Regularization | None = None,
    dt: float | None = None,
    window: int = 1200,
) -> SensorKernel:
    """The kernel that leads from a sensor to its drive.

    Parameters
    ----------
    model : Model
    sensor : str, optional
        The only one by default.
    regularization : Regularization, optional
        That of the model's design by default.
    dt : float, optional [s]
        That of the model by default.
    window : int
        Number of weights.

    Raises
    ------
    ModelError
        No such sensor, or one of several drives; a schedule, a delay, or another effect that has
        no kernel; no regularization.
    FitError
        The inverse is unstable.
    """
    model = with_acting_terms(model)
    chosen = _sensor(model, sensor)
    read = model.design.get("known", {}).get("columns", ()) if model.design else ()
    measured = {known["channel"] for known in read}
    term = _term(model, chosen, measured)
    shape = regularization or _designed(model, chosen)
    response, lags = term.response, sensor_time_constants(model, chosen)
    period = dt or model.sample_period
    for effect in cooling_effects(model):
        raise ModelError(f"a kernel cannot follow the model's effect {effect.name}")
    check_supported(model, sorted(measured))
    modes = response.modes(period)
    if isinstance(modes, DelayedModes):
        raise ModelError(f"{chosen}: a response with a delay has no causal inverse")
    if modes.direct:
        raise ModelError(f"{chosen}: a response with direct feedthrough has no kernel")
    invert_modes(lagged_modes(modes, *lags), shape)  # raises where the inverse is unstable

    def transfer(s: Complex) -> Complex:
        late = np.prod([1 + s * time_constant for time_constant in lags], axis=0)
        return np.asarray(response.transfer(s) / late)

    kernel = kernel_table(transfer, shape, period, window)
    kept = float((kernel.weight.sum() + kernel.A0) * response.dc_gain())
    notes = []
    if reading_maps(model, chosen) or reading_columns(model)[chosen] != chosen:
        notes.append(
            f"{chosen}: ΔT is the truth behind the reading, as the model's effects have it"
        )
    if measured or any(e.paths(chosen) for e in permanent_effects(model)):
        notes.append(f"{chosen}: ΔT is without what known columns add to it")
    return SensorKernel(chosen, kernel, kept, tuple(notes))


def _sensor(model: Model, sensor: str | None) -> str:
    names = [o.channel for o in model.sensors]
    if not names:
        raise ModelError("the model has no sensor: a kernel goes from a sensor to its drive")
    if sensor is None and len(names) != 1:
        raise ModelError(f"the model has the sensors {', '.join(names)}: choose one with --sensor")
    return sensor or names[0]


def _term(model: Model, sensor: str, measured: set[str]) -> Term:
    """The one term that leads from a drive to the sensor, beside those that are measured."""
    terms = [t for t in model.terms if t.output == sensor and t.drive not in measured]
    if any(term.band is not None for term in terms):
        raise ModelError(f"{sensor}: a schedule has no kernel")
    names = [o.channel for o in model.sensors]
    if sensor not in names or len(terms) != 1:
        raise ModelError(f"{sensor} is not a sensor with one drive; there are {', '.join(names)}")
    return terms[0]


def _designed(model: Model, sensor: str) -> Regularization:
    """The regularization of the model's design for this sensor."""
    design = {} if model.design is None else model.estimator_design()
    of_sensor = design if design.get("sensors") == [sensor] else {}
    settings = Part(of_sensor.get("settings", {}), "design.settings")
    if not {"A", "B", "c"} <= set(settings.names()):
        raise ModelError(
            "no regularization: run thermaltool regularize --form kernel, or give --regularization"
        )
    return Regularization(*(settings.read(name, finite) for name in ("A", "B", "c")))
