"""Design of the estimator from the model and the measured noise.

Both forms are judged alike, by what they do to the deflection or to the heat: the error that a
step of heat leaves while the estimate catches up (lag), and the error that the sensors' noise
leaves for good. Of the deflection the design minimizes the width of the band that holds both; a
heat that steps is wrong by the whole step at first, so that its mean squared error counts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import minimize
from scipy.signal import lfilter

from thermaltool.errors import FitError
from thermaltool.estimation.design_model import DesignModel
from thermaltool.estimation.estimator import Estimator
from thermaltool.estimation.kernel import Regularization
from thermaltool.responses.modes import Float

# What a design is for; None for the deflection where the model has one, else the heat.
Criterion = Literal["heat", "deflection", "both"]

# Half-width of the noise band [standard deviations]: 99.7 % of a normal error.
NOISE_BAND = 3.0
# Random-walk rates that are tried [share of the level per √s]: four a decade, then the neighbours
# of the best once more.
MIN_WALK_RATE, MAX_WALK_RATE, WALK_RATES, REFINED_WALK_RATES = 1e-4, 1.0, 17, 8
# The kernel form is searched between these, of A·half/dc, B/(A c), c·half, cutoff·half and
# delay/half, half being the time of half the step response [1].
KERNEL_LOW, KERNEL_HIGH = (0.03, 0.05, 1.0, 2.0, 0.005), (2.0, 20.0, 20.0, 30.0, 0.25)
# Points of a space-filling sample, from the best of which so many simplex searches start.
KERNEL_SAMPLES, KERNEL_STARTS = 400, 3
# The objective where there is no usable inverse: far above any band relative to the deflection.
UNUSABLE = 1e3
# Delays that are shown around the best [shares of it].
SHOWN_DELAYS = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)


@dataclass(frozen=True)
class Prediction:
    """What an estimator will do on the model that it was designed for.

    Attributes
    ----------
    band : tuple of float, one for each deflection [unit of the deflection]
        Width of the error band after a step of the reference level, noise included.
    lag_error : tuple of float
        Largest error while the estimate catches up.
    noise_sigma : tuple of float
        Standard deviation of the deflection error in steady state.
    heat_sigma : tuple of float, one for each drive
    heat_rmse : tuple of float, one for each drive
        Root of the mean squared error after a step of the reference level, noise included.
    lag : float [s]
        Until the heat estimate passes half of a step.
    settling : float [s]
        From a step until the error of every deflection (where there is none, of the heat) stays
        inside what noise leaves.
    """

    band: tuple[float, ...]
    lag_error: tuple[float, ...]
    noise_sigma: tuple[float, ...]
    heat_sigma: tuple[float, ...]
    heat_rmse: tuple[float, ...]
    lag: float
    settling: float


def predict(estimator: Estimator, problem: DesignModel) -> Prediction:
    """Band, lag and noise of an estimator on its own model.

    A step of each drive in turn (the widest counts) gives the lag error; the response to an
    impulse on each sensor gives the noise.

    Parameters
    ----------
    estimator : Estimator
    problem : DesignModel
    """
    dt, heats = problem.dt, len(problem.drives)
    recursion = estimator.recursion(dt)
    variance = np.zeros(len(estimator.estimates))
    for k, noise in enumerate(problem.noise):
        impulse = np.zeros((len(problem.clock), len(problem.sensors)))
        impulse[1, k] = 1.0
        h = recursion.run(impulse)[0][1:]
        stays = np.exp(-dt / noise.drift_time)
        drifted = lfilter([1.0], [1.0, -stays], h, axis=0)
        variance += noise.white**2 * np.sum(h**2, axis=0)
        variance += noise.drift**2 * (1 - stays**2) * np.sum(drifted**2, axis=0)
    sigma = np.sqrt(variance)
    high = NOISE_BAND * sigma[heats:]
    low, lag, settling = -high, 0.0, 0.0
    worst, squared = np.zeros(len(problem.outputs)), np.zeros(heats)
    for drive, (readings, truth) in enumerate(problem.trials):
        estimates = recursion.run(readings)[0]
        bias = estimates[:, heats:] - truth
        high, low = np.maximum(high, bias.max(axis=0)), np.minimum(low, bias.min(axis=0))
        worst = np.maximum(worst, np.abs(bias).max(axis=0))
        missed = estimates[:, :heats] - problem.level[drive] * (np.arange(heats) == drive)
        squared = np.maximum(squared, np.mean(missed[1:] ** 2, axis=0))
        below = estimates[:, drive] / problem.level[drive] < 0.5
        lag = max(lag, float(np.argmin(below)) * dt)
        # Without a deflection the heat has to settle.
        error, left = (bias, sigma[heats:]) if problem.outputs else (missed, sigma[:heats])
        outside = np.flatnonzero(np.any(np.abs(error) > NOISE_BAND * left, axis=1))
        settling = max(settling, float(outside[-1]) * dt if len(outside) else 0.0)
    return Prediction(
        band=tuple((high - low).tolist()),
        lag_error=tuple(worst.tolist()),
        noise_sigma=tuple(sigma[heats:].tolist()),
        heat_sigma=tuple(sigma[:heats].tolist()),
        heat_rmse=tuple(np.sqrt(variance[:heats] + squared).tolist()),
        lag=lag,
        settling=settling,
    )


def relative_band(prediction: Prediction, problem: DesignModel) -> float:
    """Band as a share of the deflection that the reference step makes, the widest output.

    Parameters
    ----------
    prediction : Prediction
    problem : DesignModel
    """
    size = np.zeros(len(problem.outputs))
    for output, drive, modes in problem.followed:
        size[output] += abs(problem.level[drive] * modes.dc_gain())
    return float(np.max(np.array(prediction.band) / np.maximum(size, 1e-300), initial=0.0))


def relative_heat_error(prediction: Prediction, problem: DesignModel) -> float:
    """Error of the heat as a share of the reference step, the drive that fares worst.

    Parameters
    ----------
    prediction : Prediction
    problem : DesignModel
    """
    levels = np.maximum(np.abs(problem.level), 1e-300)
    return float(np.max(np.array(prediction.heat_rmse) / levels))


def objective_of(
    prediction: Prediction, problem: DesignModel, criterion: Criterion | None
) -> float:
    """What a design minimizes: the relative band of the deflection, the relative error of the heat.

    With "both" the larger one counts.

    Parameters
    ----------
    prediction : Prediction
    problem : DesignModel
    criterion : "heat", "deflection", "both" or None
        None for the deflection where there is one, else the heat.

    Raises
    ------
    FitError
        The deflection of a model without one.
    """
    if criterion in ("deflection", "both") and not problem.outputs:
        raise FitError(f"--criterion {criterion}: the model has no deflection; give heat")
    deflection = relative_band(prediction, problem)
    if criterion == "deflection" or (criterion is None and problem.outputs):
        return deflection
    heat = relative_heat_error(prediction, problem)
    return max(heat, deflection) if criterion == "both" else heat


@dataclass(frozen=True)
class DesignChoice:
    """One point of a trade-off: the settings, the estimator and what it will do."""

    settings: dict[str, float]
    estimator: Estimator
    prediction: Prediction
    objective: float


def design_kalman(
    problem: DesignModel,
    walk: float | None = None,
    progress: Callable[[str], None] = lambda message: None,
    criterion: Criterion | None = None,
) -> list[DesignChoice]:
    """Kalman designs over random-walk rates; the chosen one has the smallest objective.

    Rates run from 10⁻⁴ to 1 of the reference level per √s, the same share for every drive, and
    are refined around the best.

    Parameters
    ----------
    walk : float, optional
        The one rate to use [share of the level per √s].
    criterion : "heat", "deflection", "both" or None
        As for `objective_of`.
    """

    def at(share: float) -> DesignChoice:
        progress(f"kalman form, walk {share:.2g}")
        estimator = problem.kalman([share * abs(level) for level in problem.level])
        prediction = predict(estimator, problem)
        return DesignChoice(
            {"walk_per_sqrt_s": share},
            estimator,
            prediction,
            objective_of(prediction, problem, criterion),
        )

    if walk is not None:
        return [at(walk)]
    choices = [at(float(share)) for share in np.geomspace(MIN_WALK_RATE, MAX_WALK_RATE, WALK_RATES)]
    best = min(range(len(choices)), key=lambda k: choices[k].objective)
    low, high = max(best - 1, 0), min(best + 1, len(choices) - 1)
    first, last = (choices[k].settings["walk_per_sqrt_s"] for k in (low, high))
    choices += [at(float(share)) for share in np.geomspace(first, last, REFINED_WALK_RATES)[1:-1]]
    return sorted(choices, key=lambda choice: choice.settings["walk_per_sqrt_s"])


def design_kernel(
    problem: DesignModel,
    pinned: Mapping[str, float] | None = None,
    progress: Callable[[str], None] = lambda message: None,
    criterion: Criterion | None = None,
) -> list[DesignChoice]:
    """Kernel designs over the artificial delay; the chosen one has the smallest objective.

    A, B, c, the filter's cutoff and the delay are searched by the simplex method from the best of
    a space-filling sample; unstable and ringing inverses are outside. The other delays show the
    trade-off of lag against noise around the best.

    Parameters
    ----------
    pinned : mapping, optional
        Any of ``A``, ``B``, ``c``, ``cutoff_Hz``, ``delay_s`` that are not to be searched.
    criterion : "heat", "deflection", "both" or None
        As for `objective_of`.

    Raises
    ------
    FitError
        More than one sensor or drive, or no stable inverse without ringing.
    """
    # Slow to import, and the Kalman form needs none of it.
    from scipy.stats import qmc

    pinned = dict(pinned or {})
    response = problem.single()
    if pinned.keys() >= {"A", "B", "c"}:
        # Says why, where the pinned shape has no usable inverse.
        problem.kernel(
            Regularization(pinned["A"], pinned["B"], pinned["c"]), 0.25 / problem.dt, 0.0
        )
    dc = response.dc_gain()
    half = float(np.interp(0.5, response.step(problem.clock) / dc, problem.clock))

    def settings(theta: Float) -> dict[str, float]:
        """From logarithms of A·half/dc, B/(A c), c·half, cutoff·half and delay/half."""
        A, B, c, cutoff, delay = np.exp(theta)
        free = {
            "A": A * dc / half,
            "B": B * (A * dc / half) * (c / half),
            "c": c / half,
            "cutoff_Hz": min(cutoff / half, 0.25 / problem.dt),
            "delay_s": delay * half,
        }
        return {name: float(pinned.get(name, value)) for name, value in free.items()}

    def choice(values: dict[str, float]) -> DesignChoice:
        regularization = Regularization(values["A"], values["B"], values["c"])
        estimator = problem.kernel(regularization, values["cutoff_Hz"], values["delay_s"])
        prediction = predict(estimator, problem)
        return DesignChoice(
            values, estimator, prediction, objective_of(prediction, problem, criterion)
        )

    def objective(theta: Float) -> float:
        try:
            return choice(settings(theta)).objective
        except FitError:
            return UNUSABLE

    if len(pinned) == 5:
        return [choice(pinned)]
    low = np.log(KERNEL_LOW)
    high = np.log(KERNEL_HIGH)
    sample = low + (high - low) * qmc.Halton(5, scramble=False).random(KERNEL_SAMPLES)[1:]
    sizes = np.array([objective(theta) for theta in sample])
    if np.min(sizes) == UNUSABLE:
        raise FitError("no stable regularization without ringing was found; use --form kalman")
    best = (UNUSABLE, sample[0])
    for number, k in enumerate(np.argsort(sizes)[:KERNEL_STARTS]):
        progress(f"kernel form, start {number + 1} of {KERNEL_STARTS}")
        found = minimize(
            objective,
            sample[k],
            method="Nelder-Mead",
            options={"maxfev": 250, "xatol": 0.02, "fatol": 1e-6},
        )
        best = min(best, (float(found.fun), found.x), key=lambda each: each[0])
    values = settings(best[1])
    shifts = (1.0,) if "delay_s" in pinned else SHOWN_DELAYS
    return [choice({**values, "delay_s": values["delay_s"] * shift}) for shift in shifts]


def best_choice(choices: Sequence[DesignChoice]) -> DesignChoice:
    """The one with the smallest objective.

    Parameters
    ----------
    choices : sequence of DesignChoice
    """
    return min(choices, key=lambda each: each.objective)
