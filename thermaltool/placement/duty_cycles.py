"""Duty cycles from logs: how candidates read and a machine bends over one of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from thermaltool.errors import FitError, counted
from thermaltool.fitting.data import Array
from thermaltool.model import rest_level
from thermaltool.placement.candidates import DutyCycle
from thermaltool.record import Record
from thermaltool.signals.detrend import difference_sigma
from thermaltool.signals.resolution import resolution_step
from thermaltool.units import drive_reference, hold_of

# Noise of a sensor of which a log shows none, as part of its range.
LEAST_NOISE = 1e-4
# Rows with readings of all that a log has at least.
LEAST_ROWS = 10


def reading_noise(logs: Sequence[Record], channel: str) -> float:
    """White noise of a reading by the logs, the largest of them [unit of the channel].

    Parameters
    ----------
    logs : sequence of Record
    channel : str
    """
    found = []
    for log in logs:
        values = log.column(channel)
        values = values[np.isfinite(values)]
        quantum = (resolution_step(values) or 0.0) / 12**0.5
        found.append(max(float(difference_sigma(values)), quantum, LEAST_NOISE * np.ptp(values)))
    return max(found)


def cycles_of(
    logs: Sequence[Record],
    candidates: Sequence[str],
    outputs: Sequence[str],
    noise: Array,
    warn: Callable[[str], None],
) -> list[DutyCycle]:
    """States of every log that tells any.

    Parameters
    ----------
    logs : sequence of Record
    candidates, outputs, noise
        As in `cycle_of`.
    warn : callable
        Takes a sentence on each of several logs that is left out.

    Raises
    ------
    FitError
        No log tells any.
    """
    cycles: list[DutyCycle] = []
    why = ""
    for log in logs:
        try:
            cycles.append(cycle_of(log, candidates, outputs, noise))
        except FitError as error:
            why = str(error)
            if len(logs) > 1:
                warn(f"left out: {why}")
    if not cycles:
        raise FitError(why)
    return cycles


def cycle_of(
    log: Record, candidates: Sequence[str], outputs: Sequence[str], noise: Array
) -> DutyCycle:
    """States of a log: principal components of its readings, as far as they rise above noise.

    Parameters
    ----------
    log : Record
    candidates, outputs : sequence of str
    noise : ndarray, shape (N,)
        Standard deviation of a reading of each candidate.

    Raises
    ------
    FitError
        Hardly a row with readings of all, or no candidate that rises above the noise.
    """
    rows = log.known([*candidates, *outputs])
    count, name = int(rows.sum()), log.source.get("name", "a log")
    if count < LEAST_ROWS:
        raise FitError(
            f"{counted(count, 'row')} of {name} with readings of all: moments of the temperatures "
            f"take {LEAST_ROWS} at least"
        )

    def rises(names: Sequence[str]) -> Array:
        columns = [log.column(name) for name in names]
        rests = [rest_level(c, drive_reference(n), hold_of(n))
                 for c, n in zip(columns, names, strict=True)]  # fmt: skip
        return np.array([(c - r)[rows] for c, r in zip(columns, rests, strict=True)])

    x, y = rises(candidates), np.array([log.column(name)[rows] for name in outputs])
    y = y - y[:, :1]
    left, sizes, right = np.linalg.svd(x / noise[:, None] / np.sqrt(count), full_matrices=False)
    # Noise alone has singular values within 1 ± √(N/count), and adds 1 to the square of any.
    kept = int(np.sum(sizes > 1 + np.sqrt(len(x) / count)))
    if not kept:
        raise FitError(f"no candidate of {name} rises above the noise")
    readings = noise[:, None] * left[:, :kept] * np.sqrt(sizes[:kept] ** 2 - 1)
    return DutyCycle(readings, y @ right[:kept].T / np.sqrt(count))
