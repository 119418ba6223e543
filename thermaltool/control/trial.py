"""A controller on its own model: a step of each disturbance, held and not held."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from thermaltool.control.controller import HeaterController
from thermaltool.control.law_choice import disturbance_levels, law_of
from thermaltool.control.laws import AT_LIMIT
from thermaltool.control.prediction import ControlPrediction
from thermaltool.control.receding import beyond
from thermaltool.responses.modes import Float
from thermaltool.status import SATURATED

# Samples of a trial at the most.
TRIAL_SAMPLES = 400
# A controller that leaves more than this part of the worst output holds nothing.
HELD_AT_LEAST = 0.99


@dataclass(frozen=True)
class ControlTrial:
    """A step of one disturbance on the model, known at once.

    Attributes
    ----------
    disturbance : str
    level : float [unit of the disturbance]
    time : ndarray, shape (n,) [s]
    free, held : mapping of output to ndarray, shape (n,)
        Outputs without control, and with it, less what an axis corrects.
    heats : mapping of drive to ndarray, shape (n,)
        Held since the moment before.
    tolerance : mapping of output to float
        As for `HeaterController`.
    at_limit : float
        Share of the time in which the law asks for more or less than there is.
    asked : mapping of drive to (float, float) [unit of the drive, s]
        The least that is asked for where there are no limits, and when.
    needs : str
        What would help where heat is asked to be taken away, or where nothing is held; empty else.
    """

    disturbance: str
    level: float
    time: Float
    free: Mapping[str, Float]
    held: Mapping[str, Float]
    heats: Mapping[str, Float]
    at_limit: float
    asked: Mapping[str, tuple[float, float]]
    tolerance: Mapping[str, float]
    needs: str = ""

    @property
    def holds_nothing(self) -> bool:
        """Whether the step goes beyond a tolerance, and the heaters leave it as it is."""
        free, held = (
            max(
                np.ptp(np.append(values, 0.0)) / self.tolerance[name] for name, values in of.items()
            )
            for of in (self.free, self.held)
        )
        return bool(free > 1 and held > HELD_AT_LEAST * free)


def tried_step(
    controller: HeaterController, prediction: ControlPrediction, disturbance: int, duration: float
) -> ControlTrial:
    """A step of one disturbance over `duration` [s], by a law that knows it at once."""
    levels = np.array(disturbance_levels(controller.model, prediction))
    start = prediction.held(np.where(np.arange(len(levels)) == disturbance, levels, 0.0))
    dt = max(controller.period, duration / TRIAL_SAMPLES)
    time = np.arange(max(round(duration / dt), 1) + 1, dtype=float) * dt
    reach = dt * np.array([drive.slew for drive in controller.drives])

    def course(limited: bool) -> tuple[Float, Float, Float, float]:
        """Outputs, heats, what is asked for, and the share of samples at a limit."""
        law = law_of(controller, prediction.estimator)
        (A, B), z = prediction.transition(dt), start
        outputs, heats, asked, saturated = [prediction.readout @ z], [], [], 0
        given = np.zeros(len(controller.drives))
        for moment in time[:-1]:
            decision = law.decide(z, dt, float(moment), given)
            if limited:
                given = np.clip(decision.powers, given - reach, given + reach)
            else:
                given = decision.asked
            z = A @ z + B @ given
            outputs.append(prediction.readout @ z)
            heats.append(given)
            asked.append(decision.asked)
            saturated += decision.status == SATURATED
        return np.array(outputs), np.array(heats), np.array(asked), saturated / len(asked)

    held, heats, _, at_limit = course(limited=True)
    # Without limits the law shows what it would have of the heaters.
    asked = course(limited=False)[2]
    free = np.array([prediction.free(float(moment)) @ start for moment in time])
    held = beyond(held, np.array([controller.axes.get(each, 0.0) for each in controller.tolerance]))
    least, worst = asked.min(axis=0), asked.argmin(axis=0)
    shares = least / [drive.maximum for drive in controller.drives]
    outputs, channels = tuple(controller.tolerance), controller.channels
    trial = ControlTrial(
        prediction.disturbances[disturbance],
        float(levels[disturbance]),
        time,
        dict(zip(outputs, free.T, strict=True)),
        dict(zip(outputs, held.T, strict=True)),
        {name: np.append(0.0, heat) for name, heat in zip(channels, heats.T, strict=True)},
        at_limit,
        {
            channel: (float(least[k]), float(time[worst[k]]))
            for k, channel in enumerate(channels)
        },
        controller.tolerance,
    )  # fmt: skip
    at = len(time) - 1
    if np.any(shares < -AT_LIMIT):
        at = int(worst[np.argmin(shares)]) + 1
    elif not trial.holds_nothing:
        return trial
    return replace(trial, needs=_missing_heater(prediction, free[at], float(time[at]), controller))


def _missing_heater(
    prediction: ControlPrediction, free: Float, time: float, controller: HeaterController
) -> str:
    """Where heat is asked to be taken away: the heater that is missing, and outputs to leave.

    The deflections `free` are to be cancelled by heats that have been on since the step. What heats
    above zero leave of them is the direction in which no heater bends.
    """
    scale = np.array(list(controller.tolerance.values()))
    steps = prediction.steps(np.array(time)) / scale[:, None]
    rest = free / scale + steps @ least_heats(steps, -free / scale)
    outputs, sentences = tuple(controller.tolerance), []
    if np.abs(rest).max() > 1:
        moved = ", ".join(
            f"{channel} by {-value * size:+.0f}"
            for channel, value, size in zip(outputs, rest, scale, strict=True)
            if abs(value) > 1
        )
        sentences.append(f"a heater that moves {moved} [unit of the output] would hold it")
    elif controller.method == "state-lqr":
        # A weight of states asks for it whatever is held.
        return "the other methods need none"
    alone = [
        channel
        for k, channel in enumerate(outputs)
        if len(outputs) > 1 and np.any(steps[k] * free[k] < 0)
    ]
    if alone and controller.method != "state-lqr":
        sentences.append(f"{' or '.join(alone)} alone (--hold) needs none")
    return "; ".join(sentences)


def least_heats(steps: Float, wanted: Float) -> Float:
    """The heats above zero that come nearest to wanted outputs: min ‖S u − w‖ over u ≥ 0.

    Parameters
    ----------
    steps : ndarray, shape (m, n)
    wanted : ndarray, shape (m,)
    """
    return np.asarray(nnls(steps, wanted)[0])
