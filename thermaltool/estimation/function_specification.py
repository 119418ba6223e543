"""Beck's sequential function specification: each heat is the constant that fits r future rows.

The heat that has acted before a row is known; of a constant heat from there on, the least squares
fit to the next r readings is taken for one row (Beck, Blackwell and St. Clair 1985, sec. 4.4). The
machine is a state space, so a step is a prediction over r rows and a gain: linear work.
"""

from __future__ import annotations

import numpy as np

from thermaltool.errors import FitError, LogError
from thermaltool.estimation.parameter_rules import Path
from thermaltool.estimation.penalties import HeatProblem
from thermaltool.responses.modes import Float
from thermaltool.responses.recursion import Recursion

# Numbers of future rows that are tried, at most; no more where the residuals squared are so many
# times the noise's.
FUTURES, FAR_FROM_NOISE = 24, 9.0


class FunctionSpecification:
    """The estimator of one number of future rows.

    Parameters
    ----------
    problem : HeatProblem
    future : int
        r, of 1 and more.

    Raises
    ------
    FitError
        Unstable: the heat of a row is overshot by the next.
    """

    def __init__(self, problem: HeatProblem, future: int) -> None:
        machine, weights = problem.machine, [each.white**-2 for each in problem.estimator.noise]
        self.future, self.machine = future, machine
        seen, step = [], []
        power, driven = machine.F, machine.G0
        for _ in range(future):
            seen.append(machine.C @ power)
            step.append(machine.C @ driven)
            power, driven = machine.F @ power, machine.F @ driven + machine.G0
        responses = np.array(step)[:, :, 0]
        weighed = responses * weights
        self.gain = weighed / max(float(np.sum(weighed * responses)), 1e-300)
        self.predicted = np.einsum("is,isj->j", self.gain, np.array(seen))
        closed = machine.F - machine.G0 @ self.predicted[None, :]
        if np.max(np.abs(np.linalg.eigvals(closed))) >= 1:
            raise FitError(f"{future} future rows are too few: the heat of a row is overshot by "
                           "the next")  # fmt: skip
        self._recursion = Recursion(
            closed, machine.G0, np.zeros_like(machine.G0), -self.predicted[None, :]
        )

    def run(self, readings: Float, low: float = -np.inf, high: float = np.inf) -> Float:
        """Heat, shape (n,); of the last rows, which lack a future, the last one that has it.

        Parameters
        ----------
        readings : ndarray, shape (n, n_sensors)
        low, high : float
            Bounds of each heat, which the next ones know of.
        """
        there = len(readings) - self.future
        ahead = np.lib.stride_tricks.sliding_window_view(readings[1:], self.future, axis=0)
        wanted = np.einsum("ksi,is->k", ahead, self.gain)
        heat = np.empty(len(readings))
        if low == -np.inf and high == np.inf:
            heat[:there] = wanted + self._recursion.run(wanted[:, None])[0][:, 0]
        else:
            x, (F, G) = np.zeros(len(self.machine.F)), (self.machine.F, self.machine.G0[:, 0])
            for k in range(there):
                heat[k] = min(max(wanted[k] - self.predicted @ x, low), high)
                x = F @ x + G * heat[k]
        heat[there:] = heat[there - 1]
        return heat


def specification_path(
    problem: HeatProblem, readings: Float, low: float = -np.inf, high: float = np.inf
) -> Path:
    """Estimates over numbers of future rows, the most of them first.

    Parameters
    ----------
    problem : HeatProblem
    readings : ndarray, shape (n, n_sensors)
    low, high : float

    Raises
    ------
    LogError
        Too few rows.
    FitError
        No number is stable.
    """
    rows = len(readings)
    futures, found, misfits, freedom = [], [], [], []
    for future in np.unique(np.geomspace(1, max(rows // 4, 1), FUTURES).astype(int)).tolist():
        try:
            each = FunctionSpecification(problem, future)
        except FitError:
            continue
        heat = each.run(readings, low, high)
        futures.append(float(future))
        found.append(heat)
        misfits.append(problem.misfit(readings - problem.simulated(heat)))
        freedom.append(_freedom(each, problem, rows))
        if misfits[-1] > FAR_FROM_NOISE * readings.size and len(futures) > 3:
            break
    if len(futures) < 3:
        raise LogError(f"{rows} rows are too few for a choice of future rows; give --future")
    return Path(np.array(futures)[::-1], np.array(found)[::-1], np.array(misfits)[::-1],
                readings.size, np.array(freedom)[::-1], is_stepped=True)  # fmt: skip


def _freedom(method: FunctionSpecification, problem: HeatProblem, rows: int) -> float:
    """The trace of what leads from readings to fitted readings, by impulses in mid-record."""
    total, middle = 0.0, 2 * method.future
    length = 3 * method.future + 2
    for sensor in range(len(problem.estimator.sensors)):
        impulse = np.zeros((length, len(problem.estimator.sensors)))
        impulse[middle, sensor] = 1.0
        total += float(problem.simulated(method.run(impulse))[middle, sensor])
    return rows * total
