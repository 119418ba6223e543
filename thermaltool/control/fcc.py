"""Forecasting compensatory control: act ahead of one's own delay (Gao 2000, chapters 4.5 and 5).

The reading contains the action. What it would be without is reconstructed with a model of the
actuator, forecast over the delay, and cancelled: the action is chosen so that the model's reading
is opposite to the forecast at one horizon, which is the minimum-variance action for the shortest
horizon that the action reaches and a calmer one beyond (Ydstie, extended-horizon control, 1984).
A model of the wrong gain costs no accuracy in the end: what it leaves unexplained is forecast too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from thermaltool.control.hysteresis import PrandtlIshlinskii
from thermaltool.timeseries.recursive.arma import MAX_READING

# A reading that leaves the last one by so many times the usual change is refused, up to so many in
# a row: then the level has changed, and is followed. Learnt over so many samples.
GATE_CHANGES, MAX_REFUSED, USUAL_SAMPLES = 15.0, 3, 50
# A delay of more samples is another sample period.
MAX_DELAY_SAMPLES = 20_000
# The default horizon is the first at which the low-pass has answered by this part.
HORIZON_ANSWER = 0.5


class Forecaster(Protocol):
    """What the uncompensated error will be."""

    def update(self, error: float) -> object:
        """Take the error of this sample."""
        ...

    def miss(self) -> None:
        """This sample's error did not come."""
        ...

    def forget_lags(self) -> None:
        """Samples before now are of another time."""
        ...

    def ahead(self, steps: int) -> float | None:
        """The error `steps` samples from now; None where nothing is known of it."""
        ...


@dataclass(frozen=True)
class ActuatorModel:
    """From command to reading.

    Attributes
    ----------
    hysteresis : PrandtlIshlinskii
        From command to action [unit of the reading], gain included; one play of threshold 0 for
        a gain alone.
    delay : float [s]
        Of measuring, computing and acting, from a command to the begin of its answer.
    natural : float [rad/s]
        Of the second-order low-pass behind the delay; inf for none.
    damping : float [1]
    """

    hysteresis: PrandtlIshlinskii
    delay: float
    natural: float = math.inf
    damping: float = 0.707

    def __post_init__(self) -> None:
        if not 0 <= self.delay < math.inf:
            raise ValueError(f"delay of {self.delay:g} s")
        if not self.natural > 0 or not self.damping > 0:
            raise ValueError("the low-pass has no natural frequency or damping above 0")


class Ahead(NamedTuple):
    """Position at a horizon: weights of position, rate, a new action, and the actions so far."""

    position: float
    rate: float
    fresh: float
    actions: list[float]


@dataclass
class ActuatorState:
    """The answer of an actuator model to the actions taken, sample by sample.

    Parameters
    ----------
    model : ActuatorModel
    period : float [s]
    """

    model: ActuatorModel
    period: float

    def __post_init__(self) -> None:
        whole = math.floor(self.model.delay / self.period + 1e-9)
        if whole > MAX_DELAY_SAMPLES:
            raise ValueError(
                f"a delay of {self.model.delay:g} s is {whole} samples: at most "
                f"{MAX_DELAY_SAMPLES} (take a longer period)"
            )
        self.whole = whole
        # The part of a sample's action that comes one sample later still.
        self._late = max(self.model.delay / self.period - whole, 0.0)
        self._a, self._b = second_order(self.model.natural, self.model.damping, self.period)
        self.forget(0.0)

    def forget(self, action: float) -> None:
        """The actuator has stood at `action` for long."""
        self.position, self.rate = action, 0.0
        self.actions = [action] * (self.whole + 2)  # newest first

    def take(self, action: float) -> float:
        """The reading's part at the next sample, with `action` from this sample on."""
        self.actions.insert(0, action)
        self.actions.pop()
        self.position, self.rate = self._after(self.position, self.rate, self.actions)
        return self.position

    def _after(self, y: float, v: float, actions: list[float]) -> tuple[float, float]:
        """State one sample on; `actions` newest first, the first from this sample on."""
        acts = (1 - self._late) * actions[self.whole] + self._late * actions[self.whole + 1]
        (a, b, c, d), (e, f) = self._a, self._b
        return a * y + b * v + e * acts, c * y + d * v + f * acts

    def ahead(self, steps: int) -> Ahead:
        """What comes `steps` samples on, as weights of what is and of a new action."""
        late, whole, none = self._late, self.whole, [0.0] * len(self.actions)
        position, rate, pulse = (1.0, 0.0), (0.0, 1.0), self._b
        answers = []  # to a pulse, by its age
        for _ in range(steps):
            answers.append(pulse[0])
            position, rate, pulse = (self._after(y, v, none) for y, v in (position, rate, pulse))

        def by_then(sample: int) -> float:
            """The answer to what acts at a sample from now, 1 to `steps`."""
            return answers[steps - sample] if 1 <= sample <= steps else 0.0

        # What is taken acts `whole` samples later, its late part one more.
        actions = [
            (1 - late) * by_then(whole - k) + late * by_then(whole + 1 - k)
            for k in range(len(self.actions))
        ]
        fresh = math.fsum(map(by_then, range(whole + 2, steps + 1)))
        fresh += (1 - late) * by_then(whole + 1)
        return Ahead(position[0], rate[0], fresh, actions)

    def held(self, action: float, ahead: Ahead) -> float:
        """The reading's part there, if `action` stays from this sample on."""
        y = ahead.position * self.position + ahead.rate * self.rate + ahead.fresh * action
        for weight, acted in zip(ahead.actions, self.actions, strict=True):
            y += weight * acted
        return y

    def default_horizon(self) -> int:
        """The first horizon at which a new action has come by `HORIZON_ANSWER`."""
        probe, steps = ActuatorState(self.model, self.period), 1
        while probe.take(1.0) < HORIZON_ANSWER:
            steps += 1
        return steps


def second_order(
    natural: float, damping: float, period: float
) -> tuple[tuple[float, float, float, float], tuple[float, float]]:
    """Exact recursion of position and rate/ω of ω²/(s² + 2ζωs + ω²) for a held input.

    Returns the rows of A, then B; for ω = inf the position is the input.
    """
    if natural == math.inf:
        return (0.0, 0.0, 0.0, 0.0), (1.0, 0.0)
    x = natural * period
    decay, root = math.exp(-damping * x), math.sqrt(abs(1 - damping**2))
    if damping < 1 - 1e-9:
        cosine, sine = math.cos(root * x), math.sin(root * x) / root
    elif damping > 1 + 1e-9:
        cosine, sine = math.cosh(root * x), math.sinh(root * x) / root
    else:
        cosine, sine = 1.0, x
    a = decay * (cosine + damping * sine)
    b = decay * sine
    d = decay * (cosine - damping * sine)
    return (a, b, -b, d), (1 - a, b)


class Answer(NamedTuple):
    """What a sample gave: the wanted command, the error without the action, and its forecast."""

    wanted: float
    error: float
    forecast: float


@dataclass
class ReadingGate:
    """Keeps out readings that stand alone.

    Attributes
    ----------
    refused : int
        In all.
    """

    refused: int = field(default=0, init=False)
    _last: float | None = field(default=None, init=False)
    _square: float = field(default=0.0, init=False)
    _heard: int = field(default=0, init=False)
    _row: int = field(default=0, init=False)

    def passes(self, error: float) -> bool:
        """Whether to believe it; errors without the action, one for each sample."""
        if not -MAX_READING < error < MAX_READING:
            self.refused += 1
            return False
        change = 0.0 if self._last is None else error - self._last
        usual = self._heard >= USUAL_SAMPLES and self._square > 0
        if usual and change * change > GATE_CHANGES**2 * self._square and self._row < MAX_REFUSED:
            self._row += 1
            self.refused += 1
            return False
        # A new level says nothing of the usual change.
        if not self._row:
            self._heard += 1
            weight = max(1 / self._heard, 1 / (20 * USUAL_SAMPLES))
            self._square += weight * (change * change - self._square)
        self._row, self._last = 0, error
        return True

    def forget(self) -> None:
        """After a gap."""
        self._last = None


@dataclass
class ForecastingControl:
    """Error in, wanted command out.

    Attributes
    ----------
    model : ActuatorModel
    forecaster : Forecaster
    period : float [s]
    horizon : int
        Samples ahead at which the error is to be zero, above the delay; 0 for
        `ActuatorState.default_horizon`.
    command : float
        Where the actuator has stood for long.
    error : float
        The last error without the action.

    Raises
    ------
    ValueError
        A horizon within the delay.
    """

    model: ActuatorModel
    forecaster: Forecaster
    period: float
    horizon: int = 0
    command: float = 0.0
    error: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        self._answer = ActuatorState(self.model, self.period)
        self.horizon = self.horizon or self._answer.default_horizon()
        if self.horizon <= self._answer.whole:
            raise ValueError(
                f"a horizon of {self.horizon} samples is within the delay: at least "
                f"{self._answer.whole + 1}"
            )
        self._ahead = self._answer.ahead(self.horizon)
        hysteresis = self.model.hysteresis
        self._acts = PrandtlIshlinskii(hysteresis.thresholds, hysteresis.weights)
        self._inverse = hysteresis.inverse()
        self._action = self._act(self.command)
        self._answer.forget(self._action)
        self.gate = ReadingGate()

    def step(self, reading: float | None, taken: float) -> Answer:
        """The command to be had from this sample on.

        Parameters
        ----------
        reading : float or None
            None where it did not come: the forecast goes on without it.
        taken : float
            The command that was in fact put out at the sample before, after limits.
        """
        self._action = self._act(taken)
        self._answer.take(self._action)
        if reading is None or not self.gate.passes(reading - self._answer.position):
            self.forecaster.miss()
        else:
            self.error = reading - self._answer.position
            self.forecaster.update(self.error)
        ahead = self.forecaster.ahead(self.horizon)
        # Until something is known of it the error is expected to stay.
        forecast = self.error if ahead is None or not math.isfinite(ahead) else ahead
        response = self._answer.held(self._action, self._ahead)
        action = self._action - (forecast + response) / self._ahead.fresh
        return Answer(self._inverse.value(action), self.error, forecast)

    def forget_lags(self, taken: float) -> None:
        """After a gap in which the actuator has settled at `taken`."""
        self._action = self._act(taken)
        self._answer.forget(self._action)
        self.gate.forget()
        self.forecaster.forget_lags()

    def _act(self, command: float) -> float:
        action = self._acts.take(command)
        self._inverse.take(action)
        return action
