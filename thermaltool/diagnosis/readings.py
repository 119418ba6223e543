"""Noise of a reading where the rows of a log are averages of readings."""

from __future__ import annotations

import math

import numpy as np

from thermaltool.diagnosis.simulation import Series, SimulatedLogs
from thermaltool.effects.effect import Float
from thermaltool.fitting.averaging import Averages
from thermaltool.record import Record
from thermaltool.signals.resolution import resolution_step

# Second differences are none below this share of the largest; readings stand still where more than
# this share of them is none.
ROUNDING, MAX_STILL = 1e-9, 0.1


def hidden_in(log: Record, output: str) -> float:
    """White noise of a reading that a row does not show, being an average [unit of the output].

    Parameters
    ----------
    log : Record
    output : str
    """
    if not isinstance(log, Averages):
        return 0.0
    return log.noise.get(output, 0.0) * math.sqrt(1 - 1 / log.rows_each)


def hidden_noise(simulation: SimulatedLogs, output: str) -> float:
    """White noise of a reading that the rows of all logs do not show [unit of the output].

    Parameters
    ----------
    simulation : SimulatedLogs
    output : str
    """
    groups = simulation.groups[output]
    power = sum(
        hidden_in(log, output) ** 2 * len(rows)
        for log, rows in zip(simulation.logs, groups.rows, strict=True)
    )
    return math.sqrt(power / groups.count)


def as_readings(simulation: SimulatedLogs, output: str, series: Series) -> Float:
    """Rows that count, scaled so that their white noise is that of a reading, shape (n, ...).

    Parameters
    ----------
    simulation : SimulatedLogs
    output : str
    series : list of ndarray, shape (n_log, ...)
    """
    scaled = [
        each if log.row_readings == 1 else each * np.sqrt(log.row_readings)
        for log, each in zip(simulation.logs, series, strict=True)
    ]
    return simulation.groups[output].joined(scaled)


def stand_still(simulation: SimulatedLogs, output: str) -> bool:
    """Whether readings repeat so often that their differences say little of the noise.

    Parameters
    ----------
    simulation : SimulatedLogs
    output : str
    """
    logs = [log.columns[output] for log in simulation.logs if output in log.columns]
    seconds = np.abs(np.concatenate([np.diff(values, 2) for values in logs]))
    seconds = seconds[np.isfinite(seconds)]
    return not len(seconds) or bool(
        np.mean(seconds <= ROUNDING * seconds.max(initial=0.0)) > MAX_STILL
    )


def reading_step(log: Record, output: str) -> float:
    """Resolution of the readings behind the rows of a log; 0 for none [unit of the output].

    Parameters
    ----------
    log : Record
    output : str
    """
    if isinstance(log, Averages):
        return log.steps.get(output, 0.0)
    return resolution_step(log.column(output)) or 0.0
