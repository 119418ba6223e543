"""Whether records begin at rest, or in a state that has to be estimated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.error_model import effective_share
from thermaltool.signals.detrend import difference_sigma

Initial = Literal["auto", "rest", "free"]
# A free state at the start has to lower the mean square error by this factor, or twice the
# logarithm of the likelihood, of rows that count, by that much.
MIN_FACTOR, MIN_EVIDENCE = 1.25, 25.0
# A signal is idle while it moves by less than this share of its range, or than its noise in so
# many standard deviations.
IDLE_SHARE, IDLE_DEVIATIONS = 0.01, 4.0
# An output is compared over so many parts of at least so many rows.
COMPARED_PARTS, MIN_PART_ROWS = 5, 3


@dataclass(frozen=True)
class StartErrors:
    """Errors of a model with one assumption on the start.

    Attributes
    ----------
    mean_squares : sequence of float, one for each output [unit²]
    records : callable
        Errors of every output in each record; NaN where there is none.
    """

    mean_squares: Sequence[float]
    records: Callable[[], Sequence[Sequence[Array]]]


def with_start(
    data: TrainingData,
    initial: Initial,
    errors_of: Callable[[TrainingData], StartErrors | None],
) -> TrainingData:
    """The data with what is known of the state at the first row of each experiment.

    "auto" is rest, unless a free state at the start describes some output clearly better. An
    experiment whose signals are all idle at first is at rest in any case.

    Free responses can stand for slow modes: with one step in the record gain, offset, modes and
    state are confounded, and a free state is preferred for the smallest error of the model. A
    record that begins within a transient gains far more by it, or its errors become white. Of
    idle signals a delay alone can make a free state better.

    Parameters
    ----------
    data : TrainingData
    initial : {"auto", "rest", "free"}
        Settled; estimated; or settled unless a free state is clearly better.
    errors_of : callable
        Errors of a small model of given data; None where they have too few rows for it.

    Raises
    ------
    FitError
        As `TrainingData.check` and `errors_of`.
    """
    if initial != "auto":
        return data.from_rest() if initial == "rest" else data
    data.check()
    if any(len(data.records[k]) < COMPARED_PARTS * MIN_PART_ROWS for k in data.begins.values()):
        return data  # too short to tell rest from a transient
    idle = idle_experiments(data)
    if len(idle) == data.experiments:
        return data.from_rest()
    unknown = data.from_rest(idle)
    rest = errors_of(data.from_rest())
    free = None if rest is None else errors_of(unknown)
    if rest is None or free is None:
        return unknown
    for at_rest, at_free, errors in zip(rest.mean_squares, free.mean_squares, free.records(),
                                        strict=True):  # fmt: skip
        if _clearly_better(at_rest, at_free, errors):
            return unknown
    return data.from_rest()


def _clearly_better(rest: float, free: float, errors: Sequence[Array]) -> bool:
    """Whether a free state lowers the mean square error enough; `errors` are those it leaves."""
    ratio = rest / max(free, 1e-300)
    rows = effective_share(errors) * sum(int(np.isfinite(each).sum()) for each in errors)
    return ratio > MIN_FACTOR or rows * float(np.log(max(ratio, 1.0))) > MIN_EVIDENCE


def idle_experiments(data: TrainingData) -> set[int]:
    """Experiments in which inputs and outputs stand still at first, within their noise.

    Parameters
    ----------
    data : TrainingData
    """
    idle = set(data.begins)
    for k in range(len(data.outputs)):
        measured = data.measured(k)
        idle &= {
            origin
            for origin, first in measured.begins.items()
            if stands_still(measured.u[first], measured.y[first][0])
        }
    return idle


def stands_still(inputs: Array, output: Array) -> bool:
    """Whether an output stands still, within its noise, as long as the inputs do at first.

    Parameters
    ----------
    inputs : ndarray, shape (k, n)
    output : ndarray, shape (n,)
    """
    moved = np.abs(inputs - inputs[:, :1]) > [[_idle_range(u)] for u in inputs]
    rows = int(np.argmax(moved.any(axis=0))) if moved.any() else inputs.shape[1]
    if rows < COMPARED_PARTS * MIN_PART_ROWS:
        return False
    parts = [float(part.mean()) for part in np.array_split(output[:rows], COMPARED_PARTS)]
    return float(np.ptp(parts)) <= _idle_range(output, rows // COMPARED_PARTS)


def _idle_range(signal: Array, averaged: int = 1) -> float:
    """What two means of so many readings may differ where the signal stands still."""
    chance = IDLE_DEVIATIONS * np.sqrt(2.0 / averaged) * difference_sigma(signal)
    return max(IDLE_SHARE * float(np.ptp(signal)), float(chance))
