"""How deflections go on from an estimator's state under heats that are chosen: exact over any time.

The estimator of a model (`thermaltool.estimation`) knows now the state of every response. Ahead of
now nothing is read: heats that are estimated stay as they are, measured drives stay at their last
reading, and the control drives are chosen. Over a time τ, however long,

    z(τ) = A(τ) z + B(τ) u,  y = C z,

with one u held throughout; what stretches of several heats do follows by superposition of steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import ModelError
from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.known_inputs import Feedforward, KnownInputEstimator
from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.modes import Float, Hold, Modes
from thermaltool.responses.parallel import InputPath, parallel
from thermaltool.responses.recursion import Recursion


@dataclass(frozen=True)
class ControlPrediction:
    """The part of an estimator's state that deflections depend on, and its future.

    z holds the modes behind the estimated heats, these heats, the modes behind the measured drives
    and the other measured drives' last readings.

    Attributes
    ----------
    estimator : KnownInputEstimator
        Reads the control drives beside its sensors.
    controls : tuple of str
        Drives that are chosen.
    outputs : tuple of str
        Deflections that are held, among those of the estimator.

    Raises
    ------
    ModelError
        A control drive that the estimator does not read, a dead time, another form of estimator.
    """

    estimator: KnownInputEstimator
    controls: tuple[str, ...]
    outputs: tuple[str, ...]
    # Places of z in the state of the estimator, and of the other drives among its columns.
    _places: NDArray[np.intp] = field(init=False, repr=False)
    _others: tuple[int, ...] = field(init=False, repr=False)
    _chosen: tuple[int, ...] = field(init=False, repr=False)
    _free: dict[float, Float] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        estimator, inner = self.estimator, self.estimator.inner
        columns = [known.channel for known in estimator.known]
        for channel in self.controls:
            if channel not in columns:
                raise ModelError(
                    f"the power of {channel} is not measured: run thermaltool regularize "
                    f"--measured {channel}"
                )
        if not isinstance(inner, KalmanEstimator | Feedforward):
            raise ModelError(
                "a controller takes the Kalman form: run thermaltool regularize --form kalman"
            )
        for path in (*self._followed, *estimator.to_outputs):
            if isinstance(path[2], DelayedModes):
                raise ModelError(
                    f"a dead time of {path[2].delay:g} s in {estimator.outputs[path[0]]}: a "
                    "controller of heaters takes none"
                )
        chosen = tuple(columns.index(channel) for channel in self.controls)
        others = tuple(k for k in range(len(columns)) if k not in chosen)
        sensed = _states(inner.sensed) if isinstance(inner, KalmanEstimator) else 0
        followed = _states(self._followed) + len(self._drives)
        # Behind them each sensor has the state of its drift, then come the known inputs' paths.
        behind = sensed + followed + len(inner.sensors) + _states(estimator.to_sensors)
        places = [
            *range(sensed, sensed + followed),
            *range(behind, behind + _states(estimator.to_outputs)),
        ]
        object.__setattr__(self, "_places", np.array(places, np.intp))
        object.__setattr__(self, "_others", others)
        object.__setattr__(self, "_chosen", chosen)

    @property
    def _followed(self) -> tuple[tuple[int, int, Modes], ...]:
        inner = self.estimator.inner
        return inner.followed if isinstance(inner, KalmanEstimator) else ()

    @property
    def _drives(self) -> tuple[str, ...]:
        inner = self.estimator.inner
        return inner.drives if isinstance(inner, KalmanEstimator) else ()

    @property
    def disturbances(self) -> tuple[str, ...]:
        """What is held ahead of now: estimated heats, then the other measured drives."""
        known = self.estimator.known
        return (*self._drives, *(known[k].channel for k in self._others))

    def state(self, x: Float, readings: Sequence[float]) -> Float:
        """z of an estimator's state and the last readings of its known columns.

        Parameters
        ----------
        x : ndarray, shape (n,)
        readings : sequence of float
            As `KnownInputEstimator` takes them, sensors first.
        """
        first = len(self.estimator.inner.sensors)
        return np.concatenate([x[self._places], [readings[first + k] for k in self._others]])

    def held(self, disturbances: Sequence[float] | Float) -> Float:
        """z at rest where these disturbances have just begun.

        Parameters
        ----------
        disturbances : sequence of float, or ndarray, shape (m,)
            In the order of `disturbances`.
        """
        z, drives = np.zeros(self.states), len(self._drives)
        at = _states(self._followed)
        z[at : at + drives] = disturbances[:drives]
        z[self.states - len(self._others) :] = disturbances[drives:]
        return z

    @property
    def states(self) -> int:
        """Number of states z."""
        return len(self._places) + len(self._others)

    def transition(self, time: float) -> tuple[Float, Float]:
        """A and B over `time` [s]: shapes (n, n) and (n, number of controls).

        Parameters
        ----------
        time : float [s]
        """
        followed, known = self._parts(time)
        m, drives, k = len(followed.F), len(self._drives), len(known.F)
        gain = known.G0 + known.G1
        A, B = np.zeros((self.states, self.states)), np.zeros((self.states, len(self.controls)))
        A[:m, :m], A[:m, m : m + drives] = followed.F, followed.G0
        A[m : m + drives, m : m + drives] = np.eye(drives)
        at = m + drives
        A[at : at + k, at : at + k], A[at : at + k, at + k :] = known.F, gain[:, self._others]
        A[at + k :, at + k :] = np.eye(len(self._others))
        B[at : at + k] = gain[:, self._chosen]
        return A, B

    @cached_property
    def readout(self) -> Float:
        """C: from z to `outputs`, shape (number of outputs, n)."""
        followed, known = self._parts(1.0)
        rows = [self.estimator.outputs.index(each) for each in self.outputs]
        m, drives = len(followed.F), len(self._drives)
        C = np.zeros((len(rows), self.states))
        C[:, :m] = followed.C[rows]
        C[:, m + drives : m + drives + len(known.F)] = known.C[rows]
        return C

    def free(self, time: float) -> Float:
        """What z makes of the outputs after `time` [s] without control, shape (outputs, n)."""
        if time not in self._free:
            self._free[time] = self.readout @ self.transition(time)[0]
        return self._free[time]

    def steps(self, times: Float) -> Float:
        """What a unit of each control since time 0 adds, shape (*times.shape, outputs, controls).

        Parameters
        ----------
        times : ndarray, any shape [s]
            Zero before time 0.
        """
        found = np.zeros((*times.shape, len(self.outputs), len(self.controls)))
        for target, source, path in self.estimator.to_outputs:
            output = self.estimator.outputs[target]
            if source in self._chosen and output in self.outputs:
                at = self.outputs.index(output), self._chosen.index(source)
                found[..., *at] += path.step(times) if isinstance(path, Modes) else path
        return found

    def slowest(self) -> float:
        """The slowest time constant through which a control acts [s]."""
        return max(
            float(np.max(-1 / path.poles.real))
            for _, source, path in self.estimator.to_outputs
            if source in self._chosen and isinstance(path, Modes) and len(path.poles)
        )

    def _parts(self, time: float) -> tuple[Recursion, Recursion]:
        """Over `time` [s]: what estimated heats do to the outputs, and what known inputs do."""
        outputs = len(self.estimator.outputs)
        heats: list[Hold] = ["zero"] * len(self._drives)
        followed = parallel(self._followed, heats, outputs, time)
        holds: list[Hold] = ["zero"] * len(self.estimator.known)
        return followed, parallel(self.estimator.to_outputs, holds, outputs, time)


def _states(paths: Sequence[InputPath]) -> int:
    """States of these paths side by side."""
    return sum(path.states if isinstance(path, Modes) else 1 for _, _, path in paths)
