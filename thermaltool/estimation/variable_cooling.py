"""An estimator for a machine that loses heat, or goes its course, at a rate of its state.

Every mode decays faster by e^(−rate·dt) in a sample, as `simulate_response` has it; the gain is
that of the model's own loss. A sample in which the machine's own time goes faster is a longer one.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from thermaltool.effects.effect import Effect
from thermaltool.errors import FitError, ModelError
from thermaltool.estimation.estimator import Estimator, KalmanEstimator
from thermaltool.estimation.known_inputs import KnownInputEstimator
from thermaltool.estimation.permanent_effects import (
    permanent_effects,
    refuse,
    sensor_time_constants,
)
from thermaltool.model import Model, state_rates
from thermaltool.record import Record
from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.modes import Float
from thermaltool.responses.recursion import Recursion
from thermaltool.responses.sample_clock import CLOCK_STEP

# The steady state of a loss that depends on it is repeated until it changes by less than this share
# of itself, and at most so often.
STEADY_STATE_TOLERANCE, MAX_STEADY_STATE_ITERATIONS = 1e-9, 200
# The machine's own time goes faster by a whole number of steps of this size (as a logarithm), for
# which recursions are kept ready.
PACE_STEP = 0.01
# Beyond this exponent of a sample [1] the loss is not followed: e^100 is no decay.
MAX_EXPONENT = 100.0


# How a calibration leaves out a law of its own.
WITHOUT = "; calibrate --linear makes a model without"


def cooling_effects(model: Model) -> tuple[Effect, ...]:
    """The effects by which a model's loss of heat changes.

    Parameters
    ----------
    model : Model
    """
    return tuple(e for e in permanent_effects(model) if e.side == "state")


def check_cooling_supported(model: Model, measured: tuple[str, ...]) -> None:
    """Refuse by name what no estimator can follow.

    Parameters
    ----------
    model : Model
    measured : tuple of str
        Drives that are read.

    Raises
    ------
    ModelError
    """
    outputs, drives = ([each.channel for each in ends] for ends in (model.outputs, model.drives))
    fed = set(drives) <= set(measured)
    for effect in cooling_effects(model):
        read = effect.needs()
        if fed:
            if any(channel in outputs for channel in read):
                refuse(effect, "where every drive is measured, no column tells the state")
            if not read and effect.channel not in outputs:
                refuse(effect, "no column and no output tells the state")
            if type(effect).pace is not Effect.pace and _are_late(model):
                refuse(effect, f"not supported beside a dead time of a measured drive{WITHOUT}")
            continue
        if measured:
            refuse(effect, f"not supported beside a measured drive ({measured[0]}){WITHOUT}")
        if any(channel in drives for channel in effect.needs()):
            refuse(effect, "it counts when the drive is off, and an estimate of it never is quite")
        if any(channel in outputs for channel in effect.needs()):
            refuse(effect, "it counts by the reading of a sensor, and estimates start from that")
        if not effect.needs() and effect.channel not in outputs:
            refuse(effect, "no column and no output tells the state")
        for sensor in model.sensors:
            if sensor_time_constants(model, sensor.channel):
                refuse(effect, f"not supported beside a lag of the sensor {sensor.channel}")


def _are_late(model: Model) -> bool:
    """Whether a response has a dead time: what is on its way counts in samples of one length."""
    return any(isinstance(t.response.modes(model.sample_period), DelayedModes) for t in model.terms)


@dataclass(frozen=True, eq=False, kw_only=True)
class VariableLossEstimator(ABC):
    """An estimator whose modes decay faster by the rate that `losses` tell.

    Attributes
    ----------
    linear : Estimator
        The same at the model's own loss, with known columns or without.
    losses : tuple of Effect
    """

    linear: Estimator
    losses: tuple[Effect, ...]
    _columns: dict[str, int] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        if isinstance(self.linear, KnownInputEstimator):
            first = len(self.linear.inner.sensors)
            known = enumerate(self.linear.known, first)
            self._columns.update({k.channel: i for i, k in known if k.role == "state"})

    @property
    def sensors(self) -> tuple[str, ...]:
        """Columns that are read."""
        return self.linear.sensors

    @property
    def outputs(self) -> tuple[str, ...]:
        """Deflections that are estimated."""
        return self.linear.outputs

    @property
    def estimates(self) -> tuple[str, ...]:
        """Those of `linear`."""
        return self.linear.estimates

    def recursion(self, dt: float) -> Recursion:
        """At the model's own loss.

        Parameters
        ----------
        dt : float [s]
        """
        return self.linear.recursion(dt)

    def document(self) -> dict[str, Any]:
        """As JSON: the document of `linear`."""
        return self.linear.document()

    @abstractmethod
    def advance(self, ticks: int, x: Float, first: Float, before: Float, now: Float) -> Float:
        """The state after a sample of `ticks` clock steps that ends with the readings `now`.

        Parameters
        ----------
        ticks : int
            Length of the sample [clock steps].
        x : ndarray, shape (n,)
        first, before, now : ndarray, shape (m,)
            The columns that are read at the first sample, before this one and at its end.

        Raises
        ------
        FitError
            The loss is not a finite number any more.
        """

    @abstractmethod
    def settled(self, dt: float, readings: Float) -> Float:
        """The state in which a machine that has stood at `readings` for ever is.

        Parameters
        ----------
        dt : float [s]
        readings : ndarray, shape (m,)

        Raises
        ------
        ModelError
            There is none that the loss leaves alone.
        """

    def start(self, dt: float, readings: Float, settled: bool = False) -> Float:
        """State at the first readings; see `LinearEstimator.start`.

        Parameters
        ----------
        dt : float [s]
        readings : ndarray, shape (m,)
        settled : bool
        """
        return self.settled(dt, readings) if settled else self.linear.start(dt, readings)

    def at_rest(self, dt: float, readings: Float) -> Float:
        """What the sensors of a machine at rest read; see `LinearEstimator.at_rest`.

        Parameters
        ----------
        dt : float [s]
        readings : ndarray, shape (m,)
        """
        return self.linear.at_rest(dt, readings)

    def run(self, time: Float, readings: Float, settled: bool = False) -> Float:
        """Estimates for a whole record; see `LinearEstimator.run`.

        Parameters
        ----------
        time : ndarray, shape (n,) [s]
        readings : ndarray, shape (n, m)
        settled : bool
            At the first readings; else at rest there.
        """
        ticks = np.round(np.diff(time) / CLOCK_STEP).astype(np.int64).tolist()
        out = np.zeros((len(time), len(self.estimates)))
        if len(time) < 2:
            return out
        dt = ticks[0] * CLOCK_STEP
        x = self.start(dt, readings[0], settled)
        C = self.recursion(dt).C
        out[0] = C @ x
        for k, each in enumerate(ticks):
            x = self.advance(each, x, readings[0], readings[k], readings[k + 1])
            out[k + 1] = C @ x
        return out


def steady_state(x: Float, sample: Callable[[Float], tuple[Float, Float]]) -> Float:
    """The state that a sample leaves as it is, whose matrix depends on the state.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Where to begin.
    sample : callable
        F, shape (n, n), and what is added, shape (n,), of a sample at a state.

    Raises
    ------
    ModelError
        There is none.
    """
    for _ in range(MAX_STEADY_STATE_ITERATIONS):
        F, added = sample(x)
        new = np.asarray(np.linalg.solve(np.eye(len(F)) - F, added), float)
        if np.max(np.abs(new - x)) <= STEADY_STATE_TOLERANCE * np.max(np.abs(new)):
            return new
        x = (x + new) / 2
    raise ModelError("no settled state: the loss of heat depends too much on it")


def other_clock(ticks: int) -> FitError:
    """That a sample of so many clock steps keeps inputs of a dead time on another clock.

    Parameters
    ----------
    ticks : int
    """
    return FitError(
        f"a sample of {ticks * CLOCK_STEP:g} s: what is on its way through a dead time is kept on "
        "another clock; design for this one (regularize --dt)"
    )


def own_ticks(ticks: int, pace: float) -> int:
    """Clock steps of a sample in the machine's own time, of a factor for which one is kept.

    Parameters
    ----------
    ticks : int
        Of the sample [clock steps].
    pace : float
        How much faster the machine's own time goes.
    """
    return max(round(ticks * math.exp(PACE_STEP * round(math.log(pace) / PACE_STEP))), 1)


def followed(exponent: float) -> float:
    """The exponent of a sample, refused where it cannot be followed.

    Parameters
    ----------
    exponent : float [1]

    Raises
    ------
    FitError
    """
    if not abs(exponent) < MAX_EXPONENT:
        raise FitError(f"the loss of heat cannot be followed: e^{exponent:g} in a sample")
    return exponent


@dataclass(frozen=True, eq=False, kw_only=True)
class VariableCoolingEstimator(VariableLossEstimator):
    """A Kalman form whose modes decay faster by the rate that `losses` tell.

    Attributes
    ----------
    kalman : KalmanEstimator
        What `linear` is, without known columns.
    """

    kalman: KalmanEstimator

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "_parts", lru_cache(maxsize=64)(self._take_apart))

    def _take_apart(self, ticks: int) -> tuple[Recursion, Float, dict[str, Float]]:
        """The recursion, its part from heat to modes, and what reads outputs off the modes."""
        dt = ticks * CLOCK_STEP
        whole = self.linear.recursion(dt)
        heated, rows = self.kalman.heated(dt)
        below = np.zeros((len(whole.F) - len(heated), heated.shape[1]))
        return whole, np.vstack([heated, below]), rows

    def rate(
        self, x: Float, first: Float, now: Float, rows: dict[str, Float]
    ) -> tuple[float, float]:
        """By how much every mode decays faster at this state [1/s], and how much its time does.

        Parameters
        ----------
        x : ndarray, shape (n,)
        first, now : ndarray, shape (m,)
            The columns that are read, at the first sample and at this one.
        """
        modal = self.kalman.modal
        columns = {name: np.array([first[k], now[k]]) for name, k in self._columns.items()}
        outputs = {name: np.array([0.0, row @ x[:modal]]) for name, row in rows.items()}
        signals = Record(np.zeros(2), columns)
        rate, pace = state_rates([(effect, None) for effect in self.losses], signals, outputs)
        return float(rate[-1]), float(pace[-1])

    def advance(self, ticks: int, x: Float, first: Float, before: Float, now: Float) -> Float:
        _, _, rows = self._parts(ticks)  # type: ignore[attr-defined]
        rate, pace = self.rate(x, first, before, rows)
        r, heated, _ = self._parts(own_ticks(ticks, pace))  # type: ignore[attr-defined]
        exponent = followed(rate * ticks * CLOCK_STEP)
        state: Float = self._matrix(r.F, heated, exponent) @ x + r.G0 @ before + r.G1 @ now
        return state

    def _matrix(self, F: Float, heated: Float, exponent: float) -> Float:
        """A held drive acts, on the mean, half a sample later than its first moment."""
        modal, drives = self.kalman.modal, len(self.kalman.drives)
        lossy = F.copy()
        lossy[:, :modal] *= np.exp(-exponent)
        lossy[:, modal : modal + drives] += np.expm1(-exponent / 2) * heated
        return lossy

    def settled(self, dt: float, readings: Float) -> Float:
        ticks = round(dt / CLOCK_STEP)
        whole, _, rows = self._parts(ticks)  # type: ignore[attr-defined]

        def sample(x: Float) -> tuple[Float, Float]:
            rate, pace = self.rate(x, readings, readings, rows)
            r, heated, _ = self._parts(own_ticks(ticks, pace))  # type: ignore[attr-defined]
            return self._matrix(r.F, heated, rate * dt), (r.G0 + r.G1) @ readings

        return steady_state(whole.settled(readings), sample)
