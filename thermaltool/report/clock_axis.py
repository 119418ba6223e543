"""The axis of time: seconds, minutes or hours, or dates where the clock says them."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from thermaltool.record import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

# Up to this span [s] -> unit of the axis, and its length [s].
_TIME_UNITS = ((600.0, "s", 1.0), (4 * 3600.0, "min", 60.0), (np.inf, "h", 3600.0))
# Seconds between these count from 1970: they are dates of 2001 to 2128.
EPOCH_SECONDS = (1e9, 5e9)
HOUR, DAY = 3600.0, 86400.0
# Ticks of an axis of dates. Where more must be there, matplotlib has no interval for some spans.
MIN_TICKS, MAX_TICKS = 2, 8


@dataclass(frozen=True)
class ClockAxis:
    """How times are drawn.

    Attributes
    ----------
    label : str
    per : float [s]
        Length of a unit of the axis.
    offset : float
        Where time 0 is, in units of the axis.
    dated : bool
        Whether the axis has dates.
    """

    label: str
    per: float
    offset: float = 0.0
    dated: bool = False

    def of(self, time: Array) -> Array:
        """Times [s] as places on the axis, ndarray (n,)."""
        return time / self.per + self.offset

    def mark(self, ax: Axes, ticks: int = MAX_TICKS) -> None:
        """Name the axis; where it is dated, its ticks are dates, so many at most (5 or more)."""
        ax.set(xlabel=self.label)
        if self.dated:
            from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

            locator = AutoDateLocator(minticks=MIN_TICKS, maxticks=ticks)
            ax.xaxis.set_major_locator(locator)
            first, last = ax.dataLim.intervalx
            if first == last:  # one moment, about which a figure would show years
                ax.set_xlim(first - HOUR / DAY, last + HOUR / DAY)
            ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))


def time_unit(span: float) -> tuple[str, float]:
    """Unit for an axis of this span [s], and its length [s]."""
    return next((unit, length) for limit, unit, length in _TIME_UNITS if span <= limit)


def modes_unit(taus: Array) -> tuple[str, float]:
    """Unit for time constants [s], the slowest first, and its length: that of the second one."""
    return time_unit(float(taus[min(1, len(taus) - 1)]))


def span_of(time: Array) -> float:
    """Length of a clock [s]."""
    return float(time[-1] - time[0]) if len(time) else 0.0


def clock_axis(time: Array, epoch: str | None = None) -> ClockAxis:
    """The axis of a clock.

    Parameters
    ----------
    time : ndarray, shape (n,) [s]
    epoch : str, optional
        The moment at which it is 0, ISO 8601.
    """
    if epoch is not None:
        moment = datetime.fromisoformat(epoch)
        return _dated(moment, moment.tzname() or "")
    if len(time) and EPOCH_SECONDS[0] <= time[0] and time[-1] <= EPOCH_SECONDS[1]:
        return _dated(datetime(1970, 1, 1, tzinfo=UTC), "UTC")
    unit, length = time_unit(span_of(time))
    return ClockAxis(f"time [{unit}]", length)


def record_axis(record: Record) -> ClockAxis:
    """The axis of a record's clock; a log knows the moment at which its clock is 0.

    Parameters
    ----------
    record : Record
    """
    return clock_axis(record.time, getattr(record, "epoch", None))


def _dated(moment: datetime, zone: str) -> ClockAxis:
    """Days since 1970, which figures count in, of the wall clock that the stamps say."""
    since = moment.replace(tzinfo=None) - datetime(1970, 1, 1)
    return ClockAxis(f"time, {zone}" if zone else "time", DAY, since / timedelta(days=1), True)
