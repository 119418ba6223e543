"""What heaters are set to: calibration steps and power spectra, as shares of the largest power.

After Mareš et al.: calibrations hold one power until the structure is settled; spectrum A holds
each of its steps until it is settled, too; spectrum B is random, with quick changes at its very
end. Levels and times are not printed: they are drawn, so that no study depends on one course.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from thermaltool.plants.excitation import Holds, held, step
from thermaltool.plants.noise import ornstein_uhlenbeck

Array = NDArray[np.float64]
Generator = np.random.Generator

HOUR, MINUTE = 3600.0, 60.0
STEP_HOLD = 8 * HOUR  # of each step of spectrum A
_LEVELS = np.arange(1, 8) / 7  # 10 to 70 W on the C-frame
_QUICK_SHARE = 0.1  # of spectrum B
_AIR_TIME = 4 * HOUR


def spectrum_a(time: Array, rng: Generator) -> Array:
    """The seven levels in any order, each held for 8 h."""
    order = itertools.cycle(rng.permutation(_LEVELS).tolist())
    return held(time, ((level, STEP_HOLD) for level in order))


def spectrum_b(time: Array, rng: Generator) -> Array:
    """Random levels held for 1 to 4 h, one in five off; the last tenth changes quickly."""
    turn = (1 - _QUICK_SHARE) * time[-1]
    slow = held(time, _random(rng, HOUR, 4 * HOUR))
    return np.where(time < turn, slow, quick(time - turn, rng))


def quick(time: Array, rng: Generator) -> Array:
    """Random levels held for 5 to 20 min, one in five off."""
    return held(time, _random(rng, 5 * MINUTE, 20 * MINUTE))


def mixed(time: Array, rng: Generator) -> Array:
    """Calibration in one run: all seven levels and none in any order, then again in another.

    Each is held for 10 to 100 min, shorter times more often, so that levels and rates mix.
    """

    def holds() -> Holds:
        while True:
            for level in rng.permutation(np.append(_LEVELS, 0.0)).tolist():
                yield level, _length(rng, 10 * MINUTE, 100 * MINUTE)

    return held(time, holds())


def _random(rng: Generator, shortest: float, longest: float) -> Holds:
    while True:
        level = 0.0 if rng.random() < 0.2 else float(rng.uniform(0.05, 1.0))
        yield level, _length(rng, shortest, longest)


def _length(rng: Generator, shortest: float, longest: float) -> float:
    return float(np.exp(rng.uniform(np.log(shortest), np.log(longest))))


DUTIES: dict[str, Callable[[Array, Generator], Array]] = {
    "step": step,
    "A": spectrum_a,
    "B": spectrum_b,
    "quick": quick,
    "mixed": mixed,
}


def settings(
    duty: str, heaters: tuple[bool, bool], largest: float, time: Array, seed: int
) -> Array:
    """What both heaters are set to, each on a course of its own.

    Parameters
    ----------
    duty : str
        A key of `DUTIES`.
    heaters : (bool, bool)
        Which of causal and stabilization are on.
    largest : float [W]
    time : (n,) ndarray [s]
        From the start of the duty.

    Returns
    -------
    (n, 2) ndarray [W], to 0.01 W
    """
    course = DUTIES[duty]
    streams = np.random.default_rng([seed, 1]).spawn(2)
    shares = [course(time, rng) * on for rng, on in zip(streams, heaters, strict=True)]
    return np.round(largest * np.column_stack(shares), 2)


def air(time: Array, mean: float, swing: float, seed: int) -> Array:
    """Temperature of the air, which starts at `mean` and drifts within hours by `swing` [degC]."""
    rng = np.random.default_rng([seed, 2])
    dt = float(time[1] - time[0])
    course = ornstein_uhlenbeck(len(time), dt, swing, _AIR_TIME, rng)
    return np.round(mean + course - course[0], 3)
