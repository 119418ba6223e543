"""What `order`, `fit` and `forecast` take: one channel on an even clock."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypedDict, Unpack

from thermaltool.api.result import Notice
from thermaltool.errors import FitError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from thermaltool.logs.columns import Columns
    from thermaltool.logs.reader import Data
    from thermaltool.record import Record

    Index = NDArray[np.intp]

# Degree of the polynomial that is estimated along.
TRENDS = {"mean": 0, "linear": 1, "none": -1}
# Outliers that are named one by one.
MAX_OUTLIER_MESSAGES = 5


class SeriesReading(TypedDict, total=False):
    """How a series is read.

    Attributes
    ----------
    columns, from_format, max_gap
        As for `read_log`; without a column map any name of a column will do.
    period : float [s]
        Sample period. Default: the median step of the clock, 1 without a clock.
    start, stop : float [s]
        First and last time taken.
    """

    columns: Columns | None
    from_format: str | None
    max_gap: float | None
    period: float | None
    start: float | None
    stop: float | None


class Preparation(TypedDict, total=False):
    """How a series is prepared for a model.

    Attributes
    ----------
    detrend : {"mean", "linear", "none"}
        What is estimated along. Default: the mean; nothing with a difference.
    difference : int
        The series is differenced so often first.
    outliers : {"omit", "keep"}
        Samples that stand alone count as missing, or are taken as they are.
    """

    detrend: str | None
    difference: int | None
    outliers: str


def read_even(
    data: Data, column: str, warn: Notice, **reading: Unpack[SeriesReading]
) -> tuple[Record, float]:
    """The even record of a column, and its period [s]."""
    from thermaltool.logs.series import read_series

    record, counted = read_series(data, column, **reading)
    period = reading.get("period")
    if counted and period is None:
        warn(
            f"{record.name}: no clock (a column time_s or time_min, or ISO 8601 times in time): "
            "samples are counted, 1 s each (--period)"
        )
    return record, period or record.period


def place_of(record: Record) -> str:
    """File and column, for messages."""
    return f"{record.name}: {', '.join(record.columns)}"


def outlier_messages(record: Record, rows: Index) -> list[str]:
    """Which samples stand alone."""
    (values,), place = record.columns.values(), place_of(record)
    messages = [
        f"{place}: {values[row]:.6g} at {record.time[row]:.10g} s stands alone: "
        "left out as missing (--outliers keep takes it)"
        for row in rows[:MAX_OUTLIER_MESSAGES].tolist()
    ]
    if rows.size > MAX_OUTLIER_MESSAGES:
        messages.append(f"{place}: {rows.size - MAX_OUTLIER_MESSAGES} more like this")
    return messages


def prepared(
    record: Record, warn: Notice, **preparation: Unpack[Preparation]
) -> tuple[Record, int, int]:
    """The record without outliers, the degree of its trend, and the order of its difference."""
    from thermaltool.timeseries.runs import runs
    from thermaltool.timeseries.screening import screened

    order = preparation.get("difference") or 0
    trend = preparation.get("detrend") or ("none" if order else "mean")
    omit = preparation.get("outliers", "omit") == "omit"
    try:
        good, outliers = screened(record, omit, order)
    except FitError as error:
        raise FitError(f"{place_of(record)}: {error}") from error
    for message in outlier_messages(record, outliers):
        warn(message)
    holes = len(runs(good)) - 1
    if holes:
        warn(
            f"{place_of(record)}: {holes} gaps; what is missing is integrated out of the likelihood"
        )
    return good, TRENDS[trend], order
