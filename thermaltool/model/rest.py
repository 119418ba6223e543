"""Rest: what a channel counts from where it has no zero of its own; one rule for all commands.

- A commanded drive (held between samples) counts from its first value.
- A measured drive counts from the level of its first rows, `start_level`. Where that is another one
  than in the calibration, temperatures at rest are others, too: `rest_shifts`.
- A displacement counts from the median of measured minus simulated over the first rows: while the
  model has moved by less than a tenth of what it moves in the log. Its own motion is thus no rest,
  an error of its gain hardly goes into the zero, and neither a wrong first reading nor a jump of
  the first minute shifts a whole log.
- Beside an estimate, which follows with a delay, it counts from the level of the first rows of
  measured minus estimated, `start_level`; where the machine is warm there, of which the estimate
  knows little, from the median over all rows.

A stream has the first reading alone, and counts from that one (`ModelRecursion`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.record import Record
from thermaltool.responses.modes import Float, Hold
from thermaltool.units import Reference, is_absolute

if TYPE_CHECKING:
    from thermaltool.model.document import Model


# Share of what the model moves in a log up to which a row counts as a first one. In any case so
# many rows count, the median of which has a quarter of the noise of one reading, or this share of a
# short log, and no fewer than three.
STILL_SHARE, ENOUGH_ROWS, SHORT_SHARE, LEAST_ROWS = 0.1, 30, 0.05, 3


@dataclass(frozen=True)
class Zero:
    """What an output counts from in a log.

    Attributes
    ----------
    value : float [unit of the output]
        Reading at rest.
    rows : int
        Readings that it was estimated from; 0 where the model states it.
    start, stop : float [s]
        Times of the first and last of these; NaN where there are none.
    """

    value: float
    rows: int = 0
    start: float = float("nan")
    stop: float = float("nan")

    def document(self) -> dict[str, Any]:
        """As JSON: null for what is not there."""
        known = {"zero": self.value, "zero_from_s": self.start, "zero_to_s": self.stop}
        return {
            **{k: v if np.isfinite(v) else None for k, v in known.items()},
            "zero_rows": self.rows,
        }


def rest_level(values: Float, rest: Reference, hold: Hold = "first") -> float:
    """The value that a channel counts from; 0 where it has no value at all.

    Parameters
    ----------
    values : ndarray, shape (n,)
    rest : "first" or float
    hold : "zero" or "first"
        Whether it is commanded, and its first value exact, or measured.
    """
    if rest != "first":
        return rest
    if hold == "first":
        # Imported on use: the stream reads models and needs no scipy.
        from thermaltool.signals.start_level import start_level

        level = start_level(values).value
    else:
        there = np.flatnonzero(np.isfinite(values))
        level = float(values[there[0]]) if len(there) else float("nan")
    return level if np.isfinite(level) else 0.0


def relative(values: Float, rest: Reference, hold: Hold = "first") -> Float:
    """Values minus the value at rest; see `rest_level`.

    Parameters
    ----------
    values : ndarray, shape (n,)
    rest : "first" or float
    hold : "zero" or "first"
    """
    return values - rest_level(values, rest, hold)


def zero_of(time: Float, measured: Float, simulated: Float, rest: Reference) -> Zero:
    """What a measured output counts from.

    Parameters
    ----------
    time : ndarray, shape (n,) [s]
    measured, simulated : ndarray, shape (n,) [unit of the output]
        As read, NaN where missing, and relative to rest.
    rest : "first" or float
    """
    if rest != "first":
        return Zero(rest)
    there = np.flatnonzero(np.isfinite(measured) & np.isfinite(simulated))
    if not len(there):
        return Zero(0.0)
    moved = np.abs(simulated[there] - simulated[there[0]])
    still = int(np.argmax(np.append(moved > STILL_SHARE * np.ptp(simulated[there]), True)))
    enough = max(min(ENOUGH_ROWS, int(SHORT_SHARE * len(there))), LEAST_ROWS)
    first = there[: max(still, enough)]
    value = float(np.median(measured[first] - simulated[first]))
    return Zero(value, len(first), float(time[first[0]]), float(time[first[-1]]))


def rest_shifts(model: Model, levels: Mapping[str, float]) -> dict[str, float]:
    """By how much temperatures at rest stand above those of the calibration, by output.

    A machine at rest in a room that is colder than the calibration's is colder, too: by the static
    gain of the response to the room. Nothing passive follows by less than nothing or by more than
    all of it, whatever a record leaves of the gain.

    Parameters
    ----------
    model : Model
    levels : mapping of channel to float
        What drives count from that have no zero of their own.
    """
    above = {
        d.channel: levels[d.channel] - d.rest
        for d in model.drives
        if d.reference == "first" and d.rest is not None and d.channel in levels
    }
    shifts = {}
    for output in model.outputs if above else ():
        if output.offset == "first" or not is_absolute(output.channel):
            continue
        shift = 0.0
        for drive, rise in above.items():
            own = [t for t in model.terms if (t.drive, t.output) == (drive, output.channel)]
            shift += rise * min(max(sum(t.response.dc_gain() for t in own), 0.0), 1.0)
        shifts[output.channel] = shift
    return shifts


def zero_beside(
    time: Float, measured: Float, estimated: Float, rest: Reference, warm: bool = False
) -> Zero:
    """What a measured channel counts from beside an estimate.

    An estimate follows with a delay: it says nothing of how the first rows move, and the level of
    the difference counts as that of a measured drive does.

    Parameters
    ----------
    time : ndarray, shape (n,) [s]
    measured, estimated : ndarray, shape (n,) [unit of the channel]
        As read, NaN where missing, and relative to rest.
    rest : "first" or float
    warm : bool
        The machine is not at rest at the first row: all rows count.
    """
    # Imported on use: the stream reads models and needs no scipy.
    from thermaltool.signals.start_level import start_level

    if rest != "first":
        return Zero(rest)
    difference = measured - estimated
    there = np.flatnonzero(np.isfinite(difference))
    if not len(there):
        return Zero(0.0)
    if warm:
        value = float(np.median(difference[there]))
        return Zero(value, len(there), float(time[there[0]]), float(time[there[-1]]))
    level = start_level(difference)
    return Zero(level.value, level.rows, float(time[level.first]), float(time[level.last]))


def drive_rests(model: Model, record: Record) -> dict[str, float]:
    """What every drive counts from in a record, by channel.

    Parameters
    ----------
    model : Model
    record : Record
    """
    return {
        d.channel: rest_level(record.column(d.channel), d.reference, d.hold) for d in model.drives
    }
