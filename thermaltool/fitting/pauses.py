"""Commands that change during a pause of a log: when, as far as the outputs tell it.

Held over the pause, a command that has changed in it acts from the first row after it on. Where it
has changed earlier, the heat of the time between is missing for as long as an output remembers, and
no response explains that. The instant is looked for beside all linear responses at once: weights of
a grid of rates, by least squares. No model takes part: a log says the same to every command.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.linalg import solve
from scipy.optimize import minimize_scalar

from thermaltool.errors import UnitError
from thermaltool.fitting.averaging import average
from thermaltool.fitting.error_model import effective_share
from thermaltool.fitting.projection import CalibrationProblem, GridStates
from thermaltool.model import Drive
from thermaltool.record import Record
from thermaltool.responses.modes import Float
from thermaltool.responses.switching import pauses_with_switch
from thermaltool.units import Hold, drive_reference, hold_of

R = TypeVar("R", bound=Record)

# Switches whose instants are looked for: those that leave most heat open.
MAX_SWITCHES = 16
# More rows are averaged: the search takes seconds.
MAX_ROWS = 8000
# Instants that are tried first, the nearer the end of a pause the closer: what has happened long
# before it is forgotten.
INSTANTS = 16
# Rounds over all switches at most, and the share of a pause by which none moves after the last.
ROUNDS, SETTLED = 3, 0.01
# Rise of the log likelihood of all outputs from which an instant counts: odds of 20 000 to 1.
DECISIVE = 10.0
# Weights are held at zero by this share of the columns' squares: directions of rounding.
RIDGE = 1e-10
# From the level before to the one after [sample periods].
EDGE = 1e-3


@dataclass(frozen=True)
class PauseSwitch:
    """A command that changes during a pause.

    Attributes
    ----------
    drive : str
    begins, ends : float [s]
        Of the last row before the pause and of the first after it.
    step : float [unit of the drive]
    time : float [s]
        When it changes; `ends` where nothing tells.
    """

    drive: str
    begins: float
    ends: float
    step: float
    time: float


def switches_of(record: Record, drives: Sequence[str], outputs: Sequence[str]) -> list[PauseSwitch]:
    """As `switches_in_pauses`, of drives by their names.

    Parameters
    ----------
    record : Record
    drives, outputs : sequence of str
    """
    own = [Drive(name, hold_of(name), drive_reference(name), (0.0, 0.0)) for name in drives]
    return switches_in_pauses(record, own, outputs)


def with_switch_rows(record: R, found: Sequence[PauseSwitch], outputs: Sequence[str]) -> R:
    """A record with rows, without readings, around switches.

    Parameters
    ----------
    record : Record
    found : sequence of PauseSwitch
    outputs : sequence of str
    """
    holds: dict[str, Hold] = {}
    for name in record.columns:
        # A column without a unit is read by nothing.
        with contextlib.suppress(UnitError):
            holds |= {} if name in outputs else {name: hold_of(name)}
    return record.with_rows(*switch_rows(record, holds, found)) if found else record


def switches_in_pauses(
    record: Record, drives: Sequence[Drive], outputs: Sequence[str]
) -> list[PauseSwitch]:
    """Held commands that change during a pause at an instant of which the outputs are sure.

    Parameters
    ----------
    record : Record
    drives : sequence of Drive
    outputs : sequence of str
        Those that are in the record take part.
    """
    found = _candidates(record, drives)
    own = (o for o in outputs if o in record.columns)
    measured = [o for o in own if record.known((o,)).any()]
    if not found or not measured:
        return []
    numbers = {drive.channel: d for d, drive in enumerate(drives)}
    records: Sequence[Record] = [record]
    if len(record) > MAX_ROWS:
        records, drives = average(records, drives, measured, MAX_ROWS)
    states: GridStates = {}
    views = [
        _OutputView(CalibrationProblem.assemble(records, drives, o, True, (), states), numbers)
        for o in measured
    ]
    for _ in range(ROUNDS if len(found) > 1 else 1):
        before = list(found)
        for k, switch in enumerate(found):
            held = replace(switch, time=switch.ends)
            for view in views:
                view.move(switch, held.time)
            found[k] = replace(switch, time=_likeliest(views, held, record.period))
            for view in views:
                view.move(held, found[k].time)
        moved = (
            abs(a.time - b.time) / (a.ends - a.begins) for a, b in zip(before, found, strict=True)
        )
        if max(moved) < SETTLED:
            break
    return [switch for switch in found if switch.time < switch.ends]


def _candidates(record: Record, drives: Sequence[Drive]) -> list[PauseSwitch]:
    """The switches that leave most heat open, each at the end of its pause."""
    found, time = [], record.time
    for drive in drives:
        level = record.column(drive.channel)
        for j in pauses_with_switch(level, np.diff(time)) if drive.hold == "zero" else ():
            begins, ends, step = float(time[j]), float(time[j + 1]), float(level[j + 1] - level[j])
            heat = abs(step) / float(np.ptp(level)) * (ends - begins)
            found.append((heat, PauseSwitch(drive.channel, begins, ends, step, ends)))
    found.sort(key=lambda each: -each[0])
    return [switch for _, switch in found[:MAX_SWITCHES]]


class _OutputView:
    """The linear problem of one output, with its commands as they are taken now."""

    def __init__(self, problem: CalibrationProblem, numbers: dict[str, int]) -> None:
        self._problem, self._numbers = problem, numbers
        self._design = problem.design.copy()

    def _change(self, switch: PauseSwitch, at: float) -> Float:
        """What the columns of a drive gain where it changes at an instant, not after the pause."""
        rates, since = self._problem.grid.rates, self._problem.time - switch.ends
        after = since >= 0
        decays = after[:, None] * np.exp(-np.outer(np.where(after, since, 0.0), rates))
        return np.asarray(decays * (-np.expm1(-rates * (switch.ends - at)) * switch.step))

    def _columns(self, switch: PauseSwitch) -> slice:
        n, d = len(self._problem.grid.rates), self._numbers[switch.drive]
        return slice(d * n, (d + 1) * n)

    def move(self, switch: PauseSwitch, to: float) -> None:
        """Take a switch at another instant."""
        change = self._change(switch, to) - self._change(switch, switch.time)
        self._design[:, self._columns(switch)] += change

    def residual(self, switch: PauseSwitch, at: float) -> Float:
        """What all responses together leave with a switch, which is at the end, at an instant."""
        design, measured = self._design.copy(), self._problem.measured
        design[:, self._columns(switch)] += self._change(switch, at)
        size = np.linalg.norm(design, axis=0)
        design /= np.where(size > 0, size, 1.0)
        normal = design.T @ design + RIDGE * np.eye(design.shape[1])
        return np.asarray(measured - design @ solve(normal, design.T @ measured, assume_a="pos"))


def _likeliest(views: Sequence[_OutputView], switch: PauseSwitch, period: float) -> float:
    """Instant of largest likelihood of all outputs; the end of the pause where it is not sure."""

    def left(at: float) -> list[Float]:
        return [view.residual(switch, at) for view in views]

    def misfit(at: float) -> float:
        return sum(len(r) * _log_rms(r) for r in left(at))

    pause = switch.ends - switch.begins
    before = np.append(0.0, np.geomspace(min(period, pause / 2), pause, INSTANTS))
    tried = (switch.ends - before[::-1]).tolist()
    best = int(np.argmin([misfit(at) for at in tried]))
    between = tried[max(best - 1, 0)], tried[min(best + 1, INSTANTS)]
    finest = 1e-2 * (between[1] - between[0])
    at = float(
        minimize_scalar(misfit, bounds=between, method="bounded", options={"xatol": finest}).x
    )
    evidence = sum(
        effective_share([own]) * len(own) * (_log_rms(held) - _log_rms(own))
        for own, held in zip(left(at), left(switch.ends), strict=True)
    )
    return at if evidence > DECISIVE else switch.ends


def _log_rms(residual: Float) -> float:
    return 0.5 * math.log(max(float(residual @ residual), np.finfo(float).tiny))


def switch_rows(
    record: Record, holds: Mapping[str, Hold], found: Sequence[PauseSwitch]
) -> tuple[Float, dict[str, Float]]:
    """Times around each switch, and what channels that are no output are then.

    Parameters
    ----------
    record : Record
    holds : mapping of channel to "zero" or "first"
        Of each such channel between the rows.
    found : sequence of PauseSwitch

    Returns
    -------
    ndarray, shape (m,) [s]
    dict of channel to ndarray, shape (m,)
    """
    edge = EDGE * record.period
    # A switch right after the row before leaves no time for the level until then.
    time = np.array(
        sorted({t for s in found for t in (max(s.time - edge, (s.begins + s.time) / 2), s.time)})
    )
    before = np.searchsorted(record.time, time, side="right") - 1
    levels = {}
    for name, hold in holds.items():
        level = record.column(name)
        own = level[before] if hold == "zero" else np.interp(time, record.time, level)
        for switch in found:
            if switch.drive == name:
                late = (time >= switch.time) & (time < switch.ends)
                own[late] = level[before[late] + 1]
        levels[name] = own
    return time, levels
