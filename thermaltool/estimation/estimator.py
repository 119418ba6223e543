"""Estimators: recursions from measured temperatures to heat and deflection.

Two forms. The Kalman form carries the responses as state space and the heat as a random walk; the
kernel form is the regularized inverse of the temperature response (Fraser 1997, ch. 5) followed by
the deflection response. Both are linear and end in the same `Recursion`, with constant work per
sample. This module needs numpy alone: it is what the stream runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np

from thermaltool.documents import finite, is_place, names
from thermaltool.errors import ModelError
from thermaltool.estimation.known_inputs import Feedforward, load_known_inputs
from thermaltool.estimation.linear_estimator import LinearEstimator
from thermaltool.estimation.start import Initial, require_decay, warm_covariance
from thermaltool.estimation.state_space import StateSpace
from thermaltool.responses.modes import Float, Hold, Modes
from thermaltool.responses.parallel import parallel
from thermaltool.responses.recursion import Recursion

# The Kalman gain varies slowly with the sample length: it is solved for on this relative grid.
GAIN_GRID = 0.01
# Gains on that grid that are kept: enough for every length from a clock step to 10⁷ s.
MAX_CACHED_GAINS = 4096


class Estimator(Protocol):
    """Names and recursion of an estimator; state and reading in, state and estimates out.

    `sensors` are the columns that it reads; `outputs`, the deflections, end the `estimates`.
    """

    @property
    def sensors(self) -> tuple[str, ...]:
        """Columns that are read."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """Deflections that are estimated."""

    @property
    def estimates(self) -> tuple[str, ...]:
        """All that is estimated, the deflections last."""

    def recursion(self, dt: float) -> Recursion:
        """From columns to estimates, over a sample of `dt` [s]."""

    def start(self, dt: float, readings: Float, settled: bool = False) -> Float:
        """State at the first readings; see `LinearEstimator.start`."""

    def at_rest(self, dt: float, readings: Float) -> Float:
        """What the sensors of a machine at rest read; see `LinearEstimator.at_rest`."""

    def run(self, time: Float, readings: Float, settled: bool = False) -> Float:
        """Estimates for a whole record; see `LinearEstimator.run`."""

    def document(self) -> dict[str, Any]:
        """As JSON."""


@dataclass(frozen=True)
class SensorNoise:
    """Noise of one sensor: white plus a stationary Ornstein-Uhlenbeck drift.

    Attributes
    ----------
    white : float [unit of the sensor, per sample]
    drift : float [unit of the sensor]
        Standard deviation of the drift; zero for none.
    drift_time : float [s]
    """

    white: float
    drift: float = 0.0
    drift_time: float = 1.0


@dataclass(frozen=True, eq=False)
class KalmanEstimator(LinearEstimator):
    """Heat as a random walk, responses as exact state space.

    Attributes
    ----------
    sensors, drives, outputs : tuple of str
    sensed : tuple of (int, int, Modes)
        (sensor, drive, response) for every term that ends in a sensor.
    followed : tuple of (int, int, Modes)
        (output, drive, response) for every other term.
    walk : tuple of float
        Random-walk rate of each drive [unit of the drive/√s].
    noise : tuple of SensorNoise
    """

    sensors: tuple[str, ...]
    drives: tuple[str, ...]
    outputs: tuple[str, ...]
    sensed: tuple[tuple[int, int, Modes], ...]
    followed: tuple[tuple[int, int, Modes], ...]
    walk: tuple[float, ...]
    noise: tuple[SensorNoise, ...]

    @property
    def estimates(self) -> tuple[str, ...]:
        """Drives, then deflections."""
        return self.drives + self.outputs

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "_gain", lru_cache(MAX_CACHED_GAINS)(self._solve_gain))

    def _build(self, dt: float) -> Recursion:
        """x ← (I − L Cs) F x + L y, for a sample of `dt` [s]."""
        space = self.state_space(dt)
        gain = self._gain(round(np.log(dt) / GAIN_GRID))  # type: ignore[attr-defined]
        kept = np.eye(len(space.F)) - gain @ space.H
        return Recursion(kept @ space.F, np.zeros_like(gain), gain, space.C)

    def state_space(self, dt: float) -> StateSpace:
        """Modes of every term, then the drives as random walks, then the sensors' drifts.

        Parameters
        ----------
        dt : float [s]
        """
        sensors, drives = len(self.sensors), len(self.drives)
        behind = [(sensors + to, drive, modes) for to, drive, modes in self.followed]
        holds: list[Hold] = ["zero"] * drives
        terms = parallel([*self.sensed, *behind], holds, sensors + len(self.outputs), dt)
        heat = len(terms.F)
        drift = heat + drives
        n = drift + sensors
        F, H, C = np.zeros((n, n)), np.zeros((sensors, n)), np.zeros((len(self.estimates), n))
        F[:heat, :heat], F[:heat, heat:drift] = terms.F, terms.G0
        H[:, :heat], C[drives:, :heat] = terms.C[:sensors], terms.C[sensors:]
        process = np.zeros(n)
        for k, walk in enumerate(self.walk):
            F[heat + k, heat + k] = C[k, heat + k] = 1.0
            process[heat + k] = walk**2 * dt
        for k, noise in enumerate(self.noise):
            F[drift + k, drift + k] = np.exp(-dt / noise.drift_time)
            H[k, drift + k] = 1.0
            process[drift + k] = noise.drift**2 * -np.expm1(-2 * dt / noise.drift_time)
        white = np.diag([noise.white**2 for noise in self.noise])
        return StateSpace(F, H, C, np.diag(process), white)

    def steady(self, dt: float) -> tuple[Float, Float]:
        """Steady covariance of the prediction, shape (n, n), and gain of the filter.

        Parameters
        ----------
        dt : float [s]
        """
        space = self.state_space(dt)
        P = space.predicted()
        return P, space.filter_gain(P)

    def start_covariance(self, dt: float, level: Sequence[float], initial: Initial) -> Float:
        """Covariance of the state at a first reading, of which nothing is known but the start.

        Parameters
        ----------
        dt : float [s]
        level : sequence of float, one for each drive
            Standard deviation of its heat there.
        initial : {"rest", "settled", "free"}
            The machine is at rest, has stood at that heat for long, or is warm of a heat that has
            wandered at that level; see `warm_covariance`.

        Raises
        ------
        FitError
            Settled or free, with a response that does not decay.
        """
        F, modal, drives = self.state_space(dt).F, self.modal, len(self.drives)
        heated = np.zeros((len(F), drives))
        heated[modal : modal + drives] = np.diag(level)
        if initial != "rest":
            require_decay(F[:modal, :modal])
            still = np.eye(modal) - F[:modal, :modal]
            heated[:modal] = np.linalg.solve(still, F[:modal] @ heated)
        P = heated @ heated.T
        drift = np.arange(modal + drives, len(F))
        P[drift, drift] = [noise.drift**2 for noise in self.noise]
        if initial == "free":
            return warm_covariance(self.state_space(dt), P, modal, level, self.walk, dt)
        return P

    @property
    def modal(self) -> int:
        """How many states are modes of a response; the drives come next."""
        return sum(modes.states for _, _, modes in (*self.sensed, *self.followed))

    def heated(self, dt: float) -> tuple[Float, dict[str, Float]]:
        """What the drives add to the state through the modes, and what reads outputs off these.

        Parameters
        ----------
        dt : float [s]

        Returns
        -------
        heated : ndarray, shape (n, n_drives)
            Part of ``recursion(dt).F``.
        rows : dict of channel to ndarray, shape (modal,)
        """
        space = self.state_space(dt)
        F, Cs, Cd = space.F, space.H, space.C
        modal, drives = self.modal, len(self.drives)
        # The gain sees what is added, and corrects it.
        added = np.zeros((len(F), drives))
        added[:modal] = F[:modal, modal : modal + drives]
        names = (*self.sensors, *self.estimates)
        rows = dict(zip(names, np.vstack([Cs, Cd])[:, :modal], strict=True))
        return added - self.recursion(dt).G1 @ Cs @ added, rows

    def _solve_gain(self, index: int) -> Float:
        return self.steady(float(np.exp(index * GAIN_GRID)))[1]

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "form": "kalman",
            "sensors": list(self.sensors),
            "drives": list(self.drives),
            "outputs": list(self.outputs),
            "sensed": _terms_document(self.sensed),
            "followed": _terms_document(self.followed),
            "walk_per_sqrt_s": list(self.walk),
            "noise": [
                {"white_sigma": n.white, "drift_sigma": n.drift, "drift_time_s": n.drift_time}
                for n in self.noise
            ],
        }


@dataclass(frozen=True, eq=False)
class KernelEstimator(LinearEstimator):
    """Regularized inverse, artificial delay, then the deflection responses.

    Q̂ = (filter · 1/H_R) ΔT with H_R = H + As/(s+c)² + 2Bs/(s+c)³, (5.55), (5.59). The estimate
    is taken to belong `delay` earlier and its last value held, so the deflection is the state that
    Q̂ has driven up to now − delay, carried over `delay` with Q̂ constant.

    Attributes
    ----------
    sensor, drive : str
    outputs : tuple of str
    inverse : Modes
        The filtered inverse as modes (its poles are the zeros of H_R and the filter's poles).
    followed : tuple of (int, int, Modes)
        (output, 0, response).
    delay : float [s]
    """

    sensor: str
    drive: str
    outputs: tuple[str, ...]
    inverse: Modes
    followed: tuple[tuple[int, int, Modes], ...]
    delay: float

    @property
    def sensors(self) -> tuple[str, ...]:
        """The one column that is read."""
        return (self.sensor,)

    @property
    def estimates(self) -> tuple[str, ...]:
        """The drive, then the deflections."""
        return (self.drive, *self.outputs)

    def _build(self, dt: float) -> Recursion:
        """For a sample of `dt` [s]; the temperature is a straight line between samples."""
        first = self.inverse.discretize(dt, "first")
        m = len(first.F)
        n = m + sum(modes.states for _, _, modes in self.followed)
        F, C = np.zeros((n, n)), np.zeros((1 + len(self.outputs), n))
        G0, G1 = np.zeros((n, 1)), np.zeros((n, 1))
        F[:m, :m], G0[:m], G1[:m], C[0, :m] = first.F, first.G0, first.G1, first.C[0]
        at = m
        for output, _, modes in self.followed:
            # The deflection advances with the heat known now: rows of the new inverse state.
            part, ahead = modes.discretize(dt), modes.discretize(self.delay)
            to = slice(at, at + len(part.F))
            F[to, to] = part.F
            F[to, :m] = part.G0 @ first.C @ first.F
            G0[to] = part.G0 @ first.C @ first.G0
            G1[to] = part.G0 @ first.C @ first.G1
            C[1 + output, to] += part.C[0] @ ahead.F
            C[1 + output, :m] += (part.C @ ahead.G0)[0, 0] * first.C[0]
            at += len(part.F)
        return Recursion(F, G0, G1, C)

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "form": "kernel",
            "sensors": [self.sensor],
            "drives": [self.drive],
            "outputs": list(self.outputs),
            "inverse": self.inverse.document(),
            "followed": _terms_document(self.followed),
            "delay_s": self.delay,
        }


def _terms_document(terms: tuple[tuple[int, int, Modes], ...]) -> list[dict[str, Any]]:
    return [{"to": to, "drive": drive, "modes": modes.document()} for to, drive, modes in terms]


def _terms(
    documents: list[dict[str, Any]], targets: tuple[str, ...], drives: tuple[str, ...]
) -> tuple[tuple[int, int, Modes], ...]:
    for d in documents:
        if not (is_place(d["to"], len(targets)) and is_place(d["drive"], len(drives))):
            raise ModelError(f"a term from {d['drive']!r} to {d['to']!r}, which are not there")
    return tuple((d["to"], d["drive"], Modes.from_document(d["modes"])) for d in documents)


def _above_zero(name: str, values: Sequence[float], owners: tuple[str, ...]) -> None:
    if len(values) != len(owners) or not all(0 < value < np.inf for value in values):
        raise ModelError(f"{name} must be a number above 0 for each of {', '.join(owners)}")


def load_estimator(document: dict[str, Any]) -> Estimator:
    """The estimator that `document` (the design of a model file) describes.

    Parameters
    ----------
    document : dict

    Raises
    ------
    ModelError
        Unknown form, or a part missing or not sound.
    """
    try:
        inner = _load_form(document)
        if "known" in document:
            return load_known_inputs(inner, document["known"])
        if not inner.sensors:
            raise ModelError("the design reads no column")
        return inner
    except (KeyError, TypeError, IndexError, ValueError, AttributeError) as error:
        raise ModelError(
            f"the design is not sound ({error}); run thermaltool regularize again"
        ) from error


def _load_form(document: dict[str, Any]) -> Estimator:
    sensors, drives, outputs = (names(document[k]) for k in ("sensors", "drives", "outputs"))
    if document["form"] == "kalman":
        noise = tuple(
            SensorNoise(*(finite(n[key]) for key in ("white_sigma", "drift_sigma", "drift_time_s")))
            for n in document["noise"]
        )
        walk = tuple(document["walk_per_sqrt_s"])
        _above_zero("walk_per_sqrt_s", walk, drives)
        _above_zero("white_sigma", [n.white for n in noise], sensors)
        _above_zero("drift_time_s", [n.drift_time for n in noise], sensors)
        return KalmanEstimator(
            sensors,
            drives,
            outputs,
            _terms(document["sensed"], sensors, drives),
            _terms(document["followed"], outputs, drives),
            walk,
            noise,
        )
    if document["form"] == "kernel":
        delay = float(document["delay_s"])
        if not 0 <= delay < np.inf:
            raise ModelError(f"delay_s cannot be {delay:g}")
        (sensor,), (drive,) = sensors, drives
        return KernelEstimator(
            sensor,
            drive,
            outputs,
            Modes.from_document(document["inverse"]),
            _terms(document["followed"], outputs, drives),
            delay,
        )
    if document["form"] == "feedforward":
        states = names(document.get("states", []))
        if states != outputs[len(outputs) - len(states) :]:
            raise ModelError(f"states that are no outputs: {', '.join(states)}")
        return Feedforward(outputs, states)
    raise ModelError(f"unknown form of estimator: {document['form']!r}")
