"""Delay, gain and hysteresis of an actuator from a log of its commands and what was read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar, nnls
from scipy.signal import cont2discrete, lfilter

from thermaltool.effects.dynamics import play
from thermaltool.errors import FitError

Array = NDArray[np.float64]

# Share of the reading's variance below which what fits is chance.
MIN_EXPLAINED = 0.05
# Fewer rows identify no actuator.
MIN_ROWS = 50
# Delays that are tried: up to this share of the log, at most so many samples.
MAX_DELAY_SHARE, MAX_DELAY = 1 / 10, 50
# Thresholds of plays are spread over this share of the range of the command.
THRESHOLD_SHARE = 0.5


@dataclass(frozen=True)
class IdentifiedActuator:
    """Delay, gain and play of an actuator, and how much of a log they explain.

    Attributes
    ----------
    delay : float [s]
    thresholds : tuple of float [unit of the command]
    weights : tuple of float [unit of the reading per unit of the command]
        Of plays from the first command on; those that the log gives none are left out.
    explained : float
        Share of the reading's variance.
    residual : float [unit of the reading]
        Root mean square of what is left.
    """

    delay: float
    thresholds: tuple[float, ...]
    weights: tuple[float, ...]
    explained: float
    residual: float


def identify_actuator(
    command: Array,
    reading: Array,
    period: float,
    natural: float = np.inf,
    damping: float = 0.707,
    plays: int = 1,
) -> IdentifiedActuator:
    """Fit reading = offset + slope·t + low-pass of Σ w_i P_{r_i}[command], delayed.

    For each delay the weights follow by non-negative least squares; the delay is searched in whole
    samples first, then within one.

    Parameters
    ----------
    command, reading : (n,) ndarray
        Evenly sampled; the command acts from its sample to the next.
    period : float [s]
    natural, damping : float [rad/s], [1]
        Of the low-pass behind the delay; inf for none.
    plays : int
        Play operators, with thresholds spread evenly over half the range of the command; 1 for a
        gain alone.

    Raises
    ------
    FitError
        A log that is short, where the command does not move, or that shows no answer.
    """
    command, reading = np.asarray(command, float), np.asarray(reading, float)
    if len(command) < MIN_ROWS or not np.isfinite([*command, *reading]).all():
        raise FitError(
            f"an actuator is identified from {MIN_ROWS} or more rows without missing values"
        )
    reach = float(np.ptp(command))
    if not reach:
        raise FitError("the command does not move: nothing to identify an actuator from")
    max_delay = min(int(len(command) * MAX_DELAY_SHARE), MAX_DELAY)
    thresholds = THRESHOLD_SHARE * reach * np.arange(plays) / plays
    # A threshold is half the distance of the flanks; all start from the first command.
    acts = play(command, 2 * thresholds, {"play": np.full(plays, command[0])}).T
    b, a = _low_pass(natural, damping, period)
    answers = lfilter(b, a, acts - acts[0], axis=0)

    def fit(delay: float) -> tuple[float, Array]:
        return _weights(_delayed(answers, delay), reading)

    whole = min(range(max_delay + 1), key=lambda d: fit(float(d))[0])
    ends = max(whole - 1.0, 0.0), whole + 1.0
    found = minimize_scalar(lambda d: fit(d)[0], bounds=ends, method="bounded")
    delay = float(found.x)
    loss, weights = fit(delay)
    total = _weights(np.zeros((len(reading), 0)), reading)[0]
    explained = 1 - loss / total if total else 0.0
    if explained < MIN_EXPLAINED or not weights[0] > 0:
        raise FitError(
            f"no answer to the command is seen in the reading ({100 * explained:.2g} % of its "
            "variance)"
        )
    kept = [k for k, w in enumerate(weights) if w > 0]
    return IdentifiedActuator(
        delay * period,
        tuple(float(thresholds[k]) for k in kept),
        tuple(float(weights[k]) for k in kept),
        explained,
        float(np.sqrt(loss / len(reading))),
    )


def _low_pass(natural: float, damping: float, period: float) -> tuple[Array, Array]:
    """Numerator and denominator in z⁻¹ of the low-pass with a held input, one sample late."""
    if not np.isfinite(natural):
        return np.array([0.0, 1.0]), np.array([1.0])
    system: Any = [natural**2], [1.0, 2 * damping * natural, natural**2]
    b, a, _ = cont2discrete(system, period, "zoh")
    return b.ravel(), a


def _delayed(x: Array, samples: float) -> Array:
    """Rows of `x` later by so many samples, between two of them in proportion; zero before."""
    whole = int(samples)
    part = samples - whole
    early = np.zeros_like(x)
    late = np.zeros_like(x)
    early[whole:] = x[: len(x) - whole]
    late[whole + 1 :] = x[: len(x) - whole - 1]
    return (1 - part) * early + part * late


def _weights(answers: Array, reading: Array) -> tuple[float, Array]:
    """Squared error and weights, beside an offset and a slope that are free."""
    n = len(reading)
    free, _ = np.linalg.qr(np.column_stack([np.ones(n), np.linspace(-1, 1, n)]))
    y = reading - free @ (free.T @ reading)
    if not answers.shape[1]:
        return float(y @ y), np.zeros(0)
    weights, norm = nnls(answers - free @ (free.T @ answers), y)
    return float(norm**2), weights
