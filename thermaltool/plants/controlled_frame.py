"""The frame with two control heaters and their power supplies, in closed loop.

After Fraser (1997), sections 8.4 and 8.7.1: pads bend the structure back; each is fed by a voltage
controlled supply whose power an outer loop regulates by an RMS meter. Overshoot, settling time and
limit cycle of the loop are the printed ones. Where his pads sit is not: of 55 pairs of places on
the surface these can leave the smallest deflection in 20 min after a step of Q = 1, by an optimum
with the disturbance known beforehand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermaltool.plants.frame import (
    OUTPUTS,
    FrameGeometry,
    FramePlant,
    build,
    facet_centres,
    frame_mesh,
    outer_facets,
)
from thermaltool.plants.thermoelastic import Array, galerkin_modes, surface_heat

CONTROL_POWERS = ("Q_top_W", "Q_bottom_W")
_FACE = 1e-6  # how near to a face its facets lie [m]
# The outer loop integrates the error of the voltage that the power meter stands for; the supply
# follows with a lag. A step between levels overshoots by
# 45 to 50 % and is within 5 % after 2 s.
SUPPLY_LAG = 1 / 3  # [s]
LOOP_GAIN = 11.0  # [1/s]
# The dead band makes a limit cycle below 2 % of full power, period about 2 s.
DEAD_BAND = 0.004  # of the voltage [full scale]
_STEP = 0.02  # of the integration [s]


class HeaterSupply:
    """Voltage-controlled supplies behind an outer loop: wanted powers in, delivered powers out.

    Parameters
    ----------
    count : int
    """

    def __init__(self, count: int) -> None:
        self._command, self._voltage, self._supply = (np.zeros(count) for _ in range(3))

    def advance(self, wanted: Array, dt: float) -> Array:
        """Mean power delivered over `dt` [s], relative to full scale; what is below 0 is 0.

        Parameters
        ----------
        wanted : (n,) ndarray
            Relative to full scale.
        dt : float [s]
        """
        steps = max(round(dt / _STEP), 1)
        h, total = dt / steps, np.zeros(len(wanted))
        level = np.sqrt(np.clip(wanted, 0.0, 1.0))
        for _ in range(steps):
            error = level - self._supply
            self._command = np.clip(self._command + h * LOOP_GAIN * error, 0.0, 1.0)
            # The voltage follows once the command has crossed the dead band.
            low, high = self._command - DEAD_BAND, self._command + DEAD_BAND
            self._voltage = np.clip(np.clip(self._voltage, low, high), 0.0, 1.0)
            self._supply = self._supply + h * (self._voltage - self._supply) / SUPPLY_LAG
            total += self._supply**2
        return total / steps


@dataclass(frozen=True)
class ControlledFrame:
    """The frame in its thermal modes: disturbance and control heats in, `OUTPUTS` out.

    Attributes
    ----------
    rates : (k,) ndarray
        [1/s]
    inputs : (k, 3) ndarray
        Per unit of the disturbance Q, and of each control heater relative to full scale.
    outputs : (len(OUTPUTS), k) ndarray
    full : float
        Power of each control heater at full scale [W].
    """

    rates: Array
    inputs: Array
    outputs: Array
    full: float

    def step_responses(self, time: Array) -> Array:
        """Outputs after unit steps of each input, shape (len(time), len(OUTPUTS), 3).

        Parameters
        ----------
        time : (n,) ndarray [s]
        """
        grown = -np.expm1(-self.rates * time[:, None]) / self.rates
        return np.asarray((self.outputs * grown[:, None, :]) @ self.inputs)

    def start(self) -> ControlledFrameRun:
        """The frame at rest, heaters off."""
        return ControlledFrameRun(self)


class ControlledFrameRun:
    """The state of a `ControlledFrame`, advanced by samples of any length.

    Parameters
    ----------
    frame : ControlledFrame
    """

    def __init__(self, frame: ControlledFrame) -> None:
        self._frame, self._state = frame, np.zeros(len(frame.rates))
        self._supply = HeaterSupply(len(CONTROL_POWERS))

    def advance(self, disturbance: float, powers: Array, dt: float) -> Array:
        """Go on by `dt`; what the power meters read as the mean of this sample [W].

        Parameters
        ----------
        disturbance : float
            Q relative to full scale.
        powers : (2,) ndarray [W]
            Set points of the control heaters.
        dt : float [s]
        """
        given = self._supply.advance(powers / self._frame.full, dt)
        load = self._frame.inputs @ np.array([disturbance, *given])
        decay = np.exp(-self._frame.rates * dt)
        self._state = decay * self._state + (1 - decay) / self._frame.rates * load
        return given * self._frame.full

    def outputs(self) -> dict[str, float]:
        """`OUTPUTS` now, relative to rest, without noise."""
        return dict(zip(OUTPUTS, (self._frame.outputs @ self._state).tolist(), strict=True))


def controlled_frame(
    plant: FramePlant | None = None, geometry: FrameGeometry | None = None, full: float = 250.0
) -> ControlledFrame:
    """Assemble the frame with its control heaters, and reduce it to its modes.

    Parameters
    ----------
    plant : FramePlant, optional
        Of this geometry.
    geometry : FrameGeometry, optional
    full : float [W]
        Of each control heater.
    """
    geometry = geometry or FrameGeometry()
    plant = plant or build(geometry)
    loads = np.column_stack([plant.heat, *(full * pad for pad in control_pads(geometry))])
    observe = np.array([plant.rows[name] for name in OUTPUTS])
    thermal = plant.thermal
    return ControlledFrame(
        *galerkin_modes(thermal.capacity, thermal.conduction, loads, observe), full
    )


def control_pads(geometry: FrameGeometry) -> tuple[Array, Array]:
    """Nodal loads of 1 W on the top of the frame near its column, and under the base."""
    mesh = frame_mesh(geometry)
    outer = outer_facets(mesh, geometry)
    x, y, _ = facet_centres(mesh, outer)
    top = (y > geometry.height - _FACE) & (x < 1.5 * geometry.tube)
    bottom = (y < _FACE) & (x > geometry.tube) & (x < geometry.tool)
    return surface_heat(mesh, outer[top]), surface_heat(mesh, outer[bottom])
