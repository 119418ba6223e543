"""Logs in, sensors to keep out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Unpack

import numpy as np

from thermaltool.api.inputs import (
    Reading,
    all_of,
    read,
    read_noise,
    reads,
    refuse_unread,
    warn_pauses,
)
from thermaltool.api.result import Notice, Result, notice
from thermaltool.errors import FitError, LogError, counted
from thermaltool.record import hint
from thermaltool.units import is_temperature, names

if TYPE_CHECKING:
    import os

    import pandas
    from matplotlib.figure import Figure

    from thermaltool.logs import Log
    from thermaltool.logs.reader import Data
    from thermaltool.placement.sensor_sets import PlacedSensors, SensorSet
    from thermaltool.record import Record

HELD_OUT = "held-out"
# How many sensors are chosen at most where nothing is said.
USUAL_MOST = 6


@dataclass(frozen=True, repr=False)
class SensorPlacement(Result):
    """Which sensors to keep.

    Attributes
    ----------
    placed : PlacedSensors
    notes : tuple of str
    """

    placed: PlacedSensors
    notes: tuple[str, ...] = ()

    @property
    def sets(self) -> tuple[SensorSet, ...]:
        """For 1, 2, 3 … sensors."""
        return self.placed.sets

    def document(self) -> dict[str, Any]:
        """As ``place --json`` writes it."""
        from thermaltool.report.placement import placement_document

        return {**placement_document(self.placed), "notes": list(self.notes)}

    def table(self) -> str:
        """A row for each number of sensors, and which sensors say the same."""
        from thermaltool.report.placement import placement_table

        return placement_table(self.placed)

    def draw(self) -> Figure:
        """Error against the number of sensors, and which these are."""
        from thermaltool.report.placement import draw_placement

        return draw_placement(self.placed)

    @property
    def frame(self) -> pandas.DataFrame:
        """One row for each number of sensors and output."""
        from thermaltool.report.placement import sets_frame

        return sets_frame(self.sets, self.placed.outputs)


@reads(Reading)
def place(
    data: Data | Sequence[Data],
    outputs: str | Sequence[str],
    *,
    candidates: str | Sequence[str] = (),
    sensors: int | None = None,
    criterion: Literal["held-out", "I", "A", "D"] = "held-out",
    time_constants: Sequence[float] | None = None,
    noise: str | os.PathLike[str] | Any = None,
    costs: Mapping[str, float] | None = None,
    forbid: Sequence[str] = (),
    start: float | None = None,
    stop: float | None = None,
    warn: Notice = notice,
    **reading: Unpack[Reading],
) -> SensorPlacement:
    """Which temperature sensors to keep, for deflections that are to be predicted from them.

    Parameters
    ----------
    data : str, path, pandas.DataFrame, Record, or a sequence of them
        Each log is a duty cycle: the sensors have to do in all of them.
    outputs : str or sequence of str
        Deflections.
    candidates : str or sequence of str, optional
        Default: all temperatures that every log has.
    sensors : int, optional
        How many at most. Default: 6, or as many as there are.
    criterion : {"held-out", "I", "A", "D"}
        What a regression misses of rows that it was not fitted to; or, by the moments of the logs
        and the noise, what stays unknown of the deflections (I), of all temperatures (A), or what
        the readings tell (D).
    time_constants : sequence of float, optional [s]
        Low-pass states beside each sensor; empty for none. Default: none, one or two, whichever
        predicts best. Held-out only.
    noise : str, path or NoiseReport, optional
        Noise of each sensor for I, A and D. Default: the white noise of the logs.
    costs : mapping of channel to float, optional
        For I, A and D: a sensor of cost 1 is one of `sensors`.
    forbid : sequence of str
        Candidates that cannot be taken: they are not read.
    start, stop : float, optional [s]
        The stretch of every log.
    warn : callable
        Takes a sentence on candidates that are left out.
    **reading
        See `read_log`.

    Returns
    -------
    SensorPlacement

    Raises
    ------
    LogError
        A log that cannot be read, or lacks a channel; no temperature.
    FitError
        More sensors than candidates, no candidate that moves, outputs that do not.
    ValueError
        Options that belong to another criterion.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> time = np.arange(0.0, 6000.0, 20.0)
    >>> heat = np.sin(time / 400) + np.sin(time / 1100)
    >>> frame = pd.DataFrame({"time_s": time, "T_a_degC": 20 + heat, "T_b_degC": 20 + time / 900})
    >>> frame["d_z_um"] = 3 * (frame["T_a_degC"] - 20) + 0.01 * np.cos(time)
    >>> tt.place(frame, "d_z_um", sensors=1).sets[0].sensors
    ('T_a_degC',)
    """
    from thermaltool.fitting.components.reduction import moving_inputs
    from thermaltool.fitting.data import training_data
    from thermaltool.placement.collinearity import collinearity
    from thermaltool.placement.sensor_sets import PlacedSensors

    targets = names(outputs)
    if criterion == HELD_OUT and (noise is not None or costs):
        raise ValueError("noise and costs count for the criteria I, A and D")
    if criterion != HELD_OUT and time_constants is not None:
        raise ValueError("time constants count for the criterion held-out")
    own, span = names(candidates), (start, stop)
    logs, every, chosen = read_sensors(data, own, targets, (), forbid, span, warn, reading)
    for name in costs or {}:
        if name not in every:
            raise LogError(f"a cost for no candidate{hint(name, every)}", logs[0].name, None, name)
    moving = moving_inputs(training_data(logs, chosen, targets[:1]))
    empty = [name for name in every if name not in chosen and name not in forbid]
    still = [name for name in chosen if name not in moving]
    notes = [f"{name} never has a reading: it is no candidate" for name in empty]
    notes += [f"{name} never moves: it is no candidate" for name in still]
    most = min(USUAL_MOST, len(moving)) if sensors is None else sensors
    if most > len(moving):
        others = "".join(f"; {note}" for note in notes)
        raise FitError(
            f"{counted(most, 'sensor')} of {counted(len(moving), 'candidate')} that move: "
            f"ask for fewer{others}"
        )
    together = training_data(logs, moving, targets)
    if criterion == HELD_OUT:
        sets = _held_out_sets(together, targets, most, time_constants)
    else:
        sets = _design_sets(logs, moving, targets, most, criterion, noise, costs, warn)
    placed = PlacedSensors(targets, moving, criterion, sets, collinearity(together))
    return SensorPlacement(placed, tuple(notes))


def read_logs(
    data: Data | Sequence[Data],
    need: Sequence[str],
    outputs: Sequence[str],
    span: tuple[float | None, float | None],
    warn: Notice,
    reading: Mapping[str, Any],
    pauses: bool = True,
) -> list[Log]:
    """Logs whose temperatures are regressed; with a word on their pauses."""
    logs = [read(each, need, outputs, warn=warn, **reading).between(*span) for each in all_of(data)]
    for log in logs:
        if len(log) < 2:
            named = f" of {', '.join(need)}" if need else ""
            raise LogError(
                f"{counted(len(log), 'row')} with readings{named}: no regression", log.name
            )
        if pauses:
            warn_pauses(log, warn, "the sensors are taken along a straight line over it")
    return logs


def read_sensors(
    data: Data | Sequence[Data],
    given: Sequence[str],
    outputs: Sequence[str],
    beside: Sequence[str],
    forbid: Sequence[str],
    span: tuple[float | None, float | None],
    warn: Notice,
    reading: Mapping[str, Any],
    pauses: bool = True,
    keep_empty: bool = False,
) -> tuple[list[Log], tuple[str, ...], tuple[str, ...]]:
    """Logs with readings of all sensors in every row, as missing values are to be taken.

    Parameters
    ----------
    data, outputs, span, warn, reading, pauses : as for `read_logs`
    given : sequence of str
        Sensors that were named. None: all temperatures that every log has.
    beside : sequence of str
        Further channels that are needed.
    forbid : sequence of str
        Sensors that are not read.
    keep_empty : bool
        Whether a sensor without a reading is taken, and refused as any missing value.

    Returns
    -------
    logs : list of Log
    every : tuple of str
        All sensors.
    chosen : tuple of str
        Those that are neither forbidden nor empty in a log.

    Raises
    ------
    LogError
        As `candidates_of`; a missing value, one to forbid that is none.
    """
    from thermaltool.report.text import stuck_messages

    # Which temperatures there are the logs themselves say; then these are needed.
    kept = {**reading, "faults": "keep"}
    whole = [read(each, warn=warn, unread=True, **kept) for each in all_of(data)]
    every = candidates_of(whole, given, outputs, beside)
    for name in forbid:
        if name not in every:
            message = f"no such candidate to forbid{hint(name, every)}"
            raise LogError(message, whole[0].name, None, name)
    allowed = [name for name in every if name not in forbid]
    if not allowed:
        raise FitError("no candidate is left: all are forbidden")
    whole = refuse_unread(whole, [*allowed, *outputs, *beside], warn)
    parts = [log.between(*span) for log in whole]
    chosen = tuple(
        name
        for name in allowed
        if keep_empty or all(np.isfinite(log.column(name)).any() for log in parts)
    )
    if not chosen:
        raise LogError(f"no reading of {', '.join(allowed)}", whole[0].name)
    for log in parts if reading.get("nan_policy") == "omit" else ():
        for name in chosen:
            if missing := int(np.sum(np.isnan(log.column(name)))):
                warn(
                    f"{log.name}: {name} has no reading in {missing} of {len(log)} rows: they are "
                    "left out for all sensors"
                )
    for log in parts:
        for message in stuck_messages(log, (*chosen, *outputs)):
            warn(message)
    own = {k: v for k, v in reading.items() if k not in ("columns", "from_format")}
    logs = read_logs(whole, [*chosen, *beside], outputs, span, warn, own, pauses)
    for k, log in enumerate(logs):
        if is_among(log, logs[:k]):
            warn(f"{log.name}: the same log again: held out, it is judged by itself")
    return logs, every, chosen


def is_among(log: Record, others: Sequence[Record]) -> bool:
    """Whether one of other logs has the same content."""
    return bool(log.digest) and any(log.digest == other.digest for other in others)


def refuse_twice(sensors: Sequence[str], outputs: Sequence[str]) -> None:
    """ValueError for a name that is given twice in a role."""
    for role, own in (("sensors", sensors), ("outputs", outputs)):
        for name in own:
            if own.count(name) > 1:
                raise ValueError(f"{name} is given twice among the {role}")


def candidates_of(
    logs: Sequence[Record],
    given: Sequence[str],
    outputs: Sequence[str],
    beside: Sequence[str] = (),
) -> tuple[str, ...]:
    """Sensors that were named, or all temperatures that every log has.

    Parameters
    ----------
    logs : sequence of Record
    given, outputs : sequence of str
    beside : sequence of str
        Channels that are no sensors.

    Raises
    ------
    LogError
        There is none, or an output that a log lacks.
    ValueError
        A name that is given twice, or in two roles.
    """
    refuse_twice(given, outputs)
    for name in given:
        if name in outputs or name in beside:
            other = "an output" if name in outputs else "the position or the condition"
            raise ValueError(f"{name} is a sensor and {other}: one of both")
    for name in outputs:
        if name in beside:
            raise ValueError(f"{name} is an output and the position or the condition: one of both")
    for log in logs:
        for name in (*given, *outputs, *beside):
            log.column(name)
    found = tuple(given) or tuple(
        name
        for name in logs[0].columns
        if is_temperature(name)
        and name not in (*outputs, *beside)
        and all(name in r.columns for r in logs)
    )
    if not found:
        raise LogError("no temperature that every log has: name candidates")
    return found


def _held_out_sets(
    data: Any,
    outputs: Sequence[str],
    most: int,
    time_constants: Sequence[float] | None,
) -> tuple[SensorSet, ...]:
    from thermaltool.placement.regression import Basis, RegressionProblem
    from thermaltool.placement.sensor_choice import HeldOutScores, choose_sensors, lag_forms
    from thermaltool.placement.sensor_sets import SensorSet

    forms = lag_forms(data) if time_constants is None else (tuple(time_constants),)
    found = []
    for taus in forms:
        basis = Basis(data.inputs, taus)
        problems = [RegressionProblem(data.only(k), basis) for k in range(len(outputs))]
        found.append(choose_sensors(HeldOutScores(problems), most))
    best = [min(each, key=lambda one: one.score) for each in zip(*found, strict=True)]
    return tuple(SensorSet(each.sensors, each.errors, each.time_constants) for each in best)


def _design_sets(
    logs: Sequence[Record],
    channels: Sequence[str],
    outputs: Sequence[str],
    most: int,
    criterion: Any,
    noise: Any,
    costs: Mapping[str, float] | None,
    warn: Notice,
) -> tuple[SensorSet, ...]:
    from thermaltool.placement.candidates import Candidates
    from thermaltool.placement.duty_cycles import cycles_of, reading_noise
    from thermaltool.placement.optimal_design import placed_sets

    known = {} if noise is None else {name: n.white for name, n in read_noise(noise).items()}
    if noise is not None and (absent := [name for name in channels if not known.get(name)]):
        warn(f"no white noise of {', '.join(absent)} in the noise file: by the logs instead")
    sigma = np.array([known.get(name) or reading_noise(logs, name) for name in channels])
    price = np.ones(len(channels))
    for name, cost in (costs or {}).items():
        if name in channels:
            price[list(channels).index(name)] = cost
    cycles = cycles_of(logs, channels, outputs, sigma, warn)
    return placed_sets(Candidates.of(cycles, sigma, price), channels, most, criterion)
