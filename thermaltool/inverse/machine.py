"""The machine as a design sees it: responses as modes, noise of the sensors, a reference step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from thermaltool.errors import FitError, ModelError
from thermaltool.inverse.estimator import KalmanEstimator, KernelEstimator, SensorNoise
from thermaltool.inverse.kernel import Regularization, invert_modes
from thermaltool.model import Model
from thermaltool.responses.modes import Float, Modes

# Below this damping ratio the kernel of the regularized inverse rings.
LEAST_DAMPING = 0.3


@dataclass(frozen=True)
class Machine:
    """What a design needs of a model: responses as modes, and the level that counts.

    Attributes
    ----------
    sensors, drives, outputs : tuple of str
    sensed : tuple of (sensor, drive, Modes)
    followed : tuple of (output, drive, Modes)
    level : tuple of float
        Step of each drive for which the band is predicted.
    noise : tuple of SensorNoise
    dt : float [s]
    """

    sensors: tuple[str, ...]
    drives: tuple[str, ...]
    outputs: tuple[str, ...]
    sensed: tuple[tuple[int, int, Modes], ...]
    followed: tuple[tuple[int, int, Modes], ...]
    level: tuple[float, ...]
    noise: tuple[SensorNoise, ...]
    dt: float

    def kalman(self, walk: Sequence[float]) -> KalmanEstimator:
        """The Kalman form for given random-walk rates [unit of the drive/√s]."""
        return KalmanEstimator(
            self.sensors,
            self.drives,
            self.outputs,
            self.sensed,
            self.followed,
            tuple(walk),
            self.noise,
        )

    @staticmethod
    def of(model: Model, noise: Mapping[str, SensorNoise], dt: float) -> Machine:
        """The machine of a model document, for samples of `dt` [s].

        Parameters
        ----------
        noise : mapping of sensor channel to SensorNoise

        Raises
        ------
        ModelError
            No sensor or no deflection in the model, or the noise of a sensor is not given.
        """
        sensors = tuple(o.channel for o in model.sensors)
        outputs = tuple(o.channel for o in model.deflections)
        if not sensors or not outputs:
            raise ModelError(
                "the model has no deflection to estimate"
                if sensors
                else "the model has no sensor to estimate its drive from; where the drive itself "
                "is measured, thermaltool simulate gives the deflection"
            )
        for sensor in sensors:
            if sensor not in noise:
                raise ModelError(f"no noise for the sensor {sensor}; there is {', '.join(noise)}")
        used = [t.drive for t in model.terms if t.output in sensors]
        drives = tuple(d.channel for d in model.drives if d.channel in used)
        lost = [t.drive for t in model.terms if t.drive not in drives]
        if lost:
            raise ModelError(f"no sensor sees the drive {lost[0]}: it cannot be estimated")

        def terms(targets: tuple[str, ...]) -> tuple[tuple[int, int, Modes], ...]:
            return tuple(
                (targets.index(t.output), drives.index(t.drive), t.response.modes(dt))
                for t in model.terms
                if t.output in targets
            )

        spans = {d.channel: max(map(abs, d.range)) for d in model.drives}
        return Machine(
            sensors,
            drives,
            outputs,
            terms(sensors),
            terms(outputs),
            tuple(spans[name] for name in drives),
            tuple(noise[name] for name in sensors),
            dt,
        )

    @cached_property
    def clock(self) -> Float:
        """Times of the trial: six of the slowest time constants of the sensors, within reason."""
        slowest = max(1 / np.min(-modes.poles.real) for _, _, modes in self.sensed)
        samples = int(np.clip(6 * slowest / self.dt, 2000, 40000))
        return np.asarray(self.dt * np.arange(samples), float)

    @cached_property
    def trials(self) -> list[tuple[Float, Float]]:
        """For a step of each drive: readings (n, sensors) and deflections (n, outputs)."""
        trials = []
        for drive, level in enumerate(self.level):
            readings = np.zeros((len(self.clock), len(self.sensors)))
            truth = np.zeros((len(self.clock), len(self.outputs)))
            for table, terms in ((readings, self.sensed), (truth, self.followed)):
                for target, source, modes in terms:
                    if source == drive:
                        table[:, target] += level * modes.step(self.clock)
            trials.append((readings, truth))
        return trials

    def kernel(
        self, regularization: Regularization, cutoff: float, delay: float
    ) -> KernelEstimator:
        """The kernel form; one sensor, one drive."""
        (_, _, response), *others = self.sensed
        if others or len(self.drives) != 1:
            raise FitError("the kernel form takes one sensor and one drive; use --form kalman")
        inverse = invert_modes(response, regularization)
        if inverse.damping < LEAST_DAMPING:
            raise FitError(f"the kernel rings: damping ratio {inverse.damping:.2f}")
        return KernelEstimator(
            self.sensors[0],
            self.drives[0],
            self.outputs,
            inverse.filtered(cutoff),
            self.followed,
            delay,
        )
