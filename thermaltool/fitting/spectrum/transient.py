"""A thermal transient: a held power that steps, and the temperature that follows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from thermaltool.errors import LogError, counted
from thermaltool.fitting.data import Array
from thermaltool.record import Record
from thermaltool.units import UNITS, is_absolute, is_temperature, parse_channel

# A change of the input by less than this part of its range is no step of its own.
MIN_STEP = 0.01
# Rows behind a step: in every whole decade of time, and in all.
MIN_ROWS_PER_DECADE, MIN_ROWS = 3, 20
# Time behind a step, from the first row to the last [ratio].
MIN_SPAN = 100.0
# Rows of a block of the design.
BLOCK = 4096


@dataclass(frozen=True)
class Transient:
    """What was measured, in kelvin and watt.

    Attributes
    ----------
    time : ndarray, shape (n,) [s]
    rise : ndarray, shape (n,) [K]
    changes : ndarray, shape (k,) [s]
        Where the input changes.
    levels : ndarray, shape (k,) [W]
        The input from there on.
    before : float [W]
        The input before the first change, at which all had settled.
    free_offset : bool
        Whether the level without power is estimated, too; else it is zero.
    name : str
        What messages call the log.
    output : str
        The channel.
    """

    time: Array
    rise: Array
    changes: Array
    levels: Array
    before: float
    free_offset: bool
    name: str
    output: str

    @property
    def steps(self) -> Array:
        """Times of the changes that count as steps [s]."""
        jumps = np.abs(np.diff(np.append(self.before, self.levels)))
        span = np.ptp(np.append(self.before, self.levels))
        return self.changes[jumps >= MIN_STEP * span]

    @property
    def since_step(self) -> Array:
        """Time of each row since the step before it, rows from the first step on [s]."""
        steps = self.steps
        k = np.searchsorted(steps, self.time, side="right") - 1
        return self.time[k >= 0] - steps[k[k >= 0]]

    @property
    def reach(self) -> tuple[float, float]:
        """Shortest time behind a step, and time from the first step to the last row [s]."""
        since = self.since_step
        return float(np.min(since[since > 0])), float(self.time[-1] - self.steps[0])

    def responses(self, taus: Array) -> Iterator[tuple[slice, Array]]:
        """Responses K τ_j/(τ_j s + 1) of 1 K/W, exact for the held input: (rows, (rows, N)) [K].

        x(t) = u_k + (x_k − u_k) e^(−(t − t_k)/τ) from the change k before t on.

        Parameters
        ----------
        taus : ndarray, shape (N,) [s]
        """
        k = np.searchsorted(self.changes, self.time, side="right")
        u = np.append(self.before, self.levels)
        state, at = np.full(len(taus), self.before), 0
        for start in range(0, len(self.time), BLOCK):
            rows = slice(start, min(start + BLOCK, len(self.time)))
            first, last = at, int(k[rows][-1])
            states = [state]
            for at in range(first + 1, last + 1):
                passed = 0.0 if at == 1 else self.changes[at - 1] - self.changes[at - 2]
                state = u[at - 1] + (state - u[at - 1]) * np.exp(-passed / taus)
                states.append(state)
            at = last
            own = k[rows]
            begin = self.changes[np.maximum(own - 1, 0)]
            passed = np.where(own > 0, self.time[rows] - begin, 0.0)
            level = u[own][:, None]
            decay = np.exp(-passed[:, None] / taus)
            yield rows, level + (np.array(states)[own - first] - level) * decay


def transient_of(
    record: Record,
    drive: str,
    output: str,
    before: float | None = None,
    step_at: float | None = None,
) -> Transient:
    """The transient in a record.

    Parameters
    ----------
    record : Record
        Without missing values of the drive; rows in which the output is missing say when it steps.
    drive, output : str
        A power, held between its rows; a temperature or a difference of two.
    before : float, optional [unit of the drive]
        Input before the first row, at which all had settled. Default: that of the first row;
        with `step_at` zero.
    step_at : float, optional [s]
        When the input went from `before` to what the first row from then on says. Default: at
        the first row.

    Raises
    ------
    LogError
        Channels of other quantities; no step; an output that does not move; too few rows, or too
        short a time, behind the step.
    """
    _check_channels(drive, output, record.name)
    if len(record) < MIN_ROWS:
        raise LogError(f"{counted(len(record), 'row')} say nothing of a spectrum", record.name)
    scale = UNITS[parse_channel(drive).unit][1]
    u, time = record.column(drive) * scale, record.time
    rise = record.column(output) * UNITS[parse_channel(output).unit][1]
    if before is None and step_at is not None:
        before = 0.0
    first = float(u[0]) if before is None else before * scale
    at = np.flatnonzero(np.diff(np.append(first, u)) != 0)
    changes, levels = time[at], u[at]
    if step_at is not None:
        changes, levels = _moved(time, u, first, step_at, record.name)
    if not np.any(u) and not first:
        raise LogError("zero in every row: there is no power, so no response", record.name,
                       column=drive)  # fmt: skip
    if not len(changes):
        raise LogError(
            "no step: the same in every row; where it changed before, say from what level with "
            "--before", record.name, column=drive,
        )  # fmt: skip
    there = np.isfinite(rise)
    time, rise = time[there], rise[there]
    if len(time) < MIN_ROWS or not np.ptp(rise):
        raise LogError("does not move", record.name, column=output)
    rows_before = bool(np.any(time < changes[0]))
    found = Transient(time, rise, changes, levels, first, rows_before or is_absolute(output),
                      record.name, output)  # fmt: skip
    _check_rows(found)
    return found


def _check_channels(drive: str, output: str, name: str) -> None:
    if parse_channel(drive).dimension != "power":
        raise LogError("not a power: thermal resistances need W, mW or kW", name, column=drive)
    if not is_temperature(output):
        raise LogError("neither a temperature nor a difference of two", name, column=output)


def _moved(time: Array, u: Array, first: float, step_at: float, name: str) -> tuple[Array, Array]:
    """Changes of the input where its first one was at a moment between the rows."""
    after = np.flatnonzero(time >= step_at)
    if not len(after):
        raise LogError(f"no row from the step at {step_at:g} s on", name)
    then = u[after]
    at = np.flatnonzero(np.diff(then)) + 1
    changes, levels = np.append(step_at, time[after][at]), np.append(then[0], then[at])
    return (changes, levels) if then[0] != first else (changes[1:], levels[1:])


def _check_rows(found: Transient) -> None:
    """Refuse too few rows, or too short a time, behind the steps (LogError)."""
    since = found.since_step
    since = since[since > 0]
    if len(since) < MIN_ROWS:
        raise LogError(
            f"{counted(len(since), 'row')} behind the step: too few for a spectrum", found.name
        )
    short, long = float(since.min()), found.reach[1]
    if long < MIN_SPAN * short:
        raise LogError(
            f"rows from {short:.3g} s to {long:.3g} s behind the step: a spectrum takes two "
            "decades of time", found.name,
        )  # fmt: skip
    count = int(np.floor(np.log10(since.max() / short)))
    edges = short * 10.0 ** np.arange(count + 1)
    rows = np.histogram(since, edges)[0]
    if count and rows.min() < MIN_ROWS_PER_DECADE:
        k = int(np.argmin(rows))
        few = counted(int(rows[k]), "row")
        raise LogError(
            f"{few} between {edges[k]:.3g} s and {edges[k + 1]:.3g} s behind the step: each decade "
            f"takes {MIN_ROWS_PER_DECADE} rows", found.name,
        )  # fmt: skip
