"""How logs may begin away from rest: decays, and how much of each a log shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermaltool.diagnosis.correction import without_lags
from thermaltool.diagnosis.simulation import Series, SimulatedLogs
from thermaltool.effects.effect import Float
from thermaltool.model import Model, away_from_rest, drive_rests, relative, rest_shifts
from thermaltool.model.decays import SAME_POLE, lag_decays, mode_decays, start_decays
from thermaltool.model.simulate import acting_effects
from thermaltool.record import Record
from thermaltool.units import is_absolute

# Decays whose sum follows a way to rest cancel each other: each may be so many times what the
# output goes through.
MAX_DECAY = 10.0
# How much warmer than its surroundings a machine as a whole may be when a log begins: a standard
# deviation [K].
UNIFORM_START = 2.0
# Modes of a response with many of them that may be away from rest one by one.
SLOWEST_MODES = 4
# Directions of the decays weaker than this part of the strongest are left at rest.
SINGULAR = 1e-10


def decays_of(runs: SimulatedLogs, output: str) -> list[Series]:
    """What a machine that was not at rest at the first row may add, one start in one log each.

    A time constant that is longer than the log is a trend in it, however long.

    Parameters
    ----------
    runs : SimulatedLogs
    output : str
    """
    slowest = [min(runs.slowest(output), max(log.duration, log.period)) for log in runs.logs]
    most = MAX_DECAY * max(float(np.max(np.abs(y[output]))) for y in runs.outputs)
    return [
        [most * decay if j == k else np.zeros(len(log)) for j, log in enumerate(runs.logs)]
        for k, own in enumerate(runs.logs)
        for decay in start_decays(own.elapsed, slowest[k], own.period)
    ]


def mode_starts(runs: SimulatedLogs, output: str) -> list[Series]:
    """What the modes of an output add that are not at rest at the first row, one log each.

    Parameters
    ----------
    runs : SimulatedLogs
    output : str
    """
    most = MAX_DECAY * max(float(np.max(np.abs(y[output]))) for y in runs.outputs)
    model, found = without_lags(runs.model), []
    for k, own in enumerate(runs.logs):
        lags = lag_decays(model, acting_effects(model, own.digest), output, own.elapsed)
        for decay in (*_ways_to_rest(model, output, own.elapsed), *lags):
            size = float(np.max(np.abs(decay)))
            # What is gone by the second row would stand for an outlier.
            if np.count_nonzero(np.abs(decay) > size / np.e) > 1:
                unit = most / size * decay
                found.append(
                    [unit if j == k else np.zeros(len(log)) for j, log in enumerate(runs.logs)]
                )
    return found


def _ways_to_rest(model: Model, output: str, elapsed: Float) -> list[Float]:
    """How an output comes to rest by the modes of its responses, shapes (n,).

    Of many modes the slowest, and the sum of all from a level at which each response had settled.
    """
    if few := mode_decays(model, output, elapsed):
        return few
    found: list[Float] = []
    rates: list[float] = []
    for response in (t.response for t in model.terms if t.output == output):
        own = np.sort(np.abs(response.modes(model.sample_period).poles.real)).tolist()
        for rate in own[:SLOWEST_MODES]:
            if not any(abs(rate - other) <= SAME_POLE * rate for other in rates):
                rates.append(rate)
                found.append(np.exp(-rate * elapsed))
        if len(own) > SLOWEST_MODES:
            found.append(response.dc_gain() - response.step(elapsed))
    return found


def uniform_starts(runs: SimulatedLogs, output: str) -> list[Series]:
    """What a machine adds that begins a log as a whole warmer than its surroundings, one log each.

    It then follows them as it would a step of theirs. None where the calibration found no
    temperature that becomes that of its surroundings: a drive may be a part of the machine.

    Parameters
    ----------
    runs : SimulatedLogs
    output : str
    """
    model = runs.model
    around = [t for t in model.terms if t.output == output and is_absolute(t.drive)]
    if not around or not any(each.chosen.get("equilibrium") for each in model.outputs):
        return []
    starts = [
        -UNIFORM_START * np.sum([t.response.step(log.elapsed) for t in around], axis=0)
        for log in runs.logs
    ]
    return [
        [start if j == k else np.zeros(len(start)) for j, start in enumerate(starts)]
        for k in range(len(starts))
    ]


def beginning(runs: SimulatedLogs, output: str) -> Series:
    """What of each log is its start, by the rows that count.

    Parameters
    ----------
    runs : SimulatedLogs
    output : str
    """
    return [start for start, _ in _beside(runs, output, decays_of(runs, output))]


def start_free(runs: SimulatedLogs, output: str) -> Series:
    """Residual of each log about the start and zero that fit it best; NaN where not measured.

    Parameters
    ----------
    runs : SimulatedLogs
    output : str
    """
    found = _beside(runs, output, decays_of(runs, output))
    return [
        residual - start - zero
        for residual, (start, zero) in zip(runs.residual(output), found, strict=True)
    ]


def _beside(
    runs: SimulatedLogs, output: str, decays: Sequence[Series]
) -> list[tuple[Float, float]]:
    """Start, a sum of columns, and zero of each log by least squares."""
    groups, found = runs.groups[output], []
    for k, (residual, rows) in enumerate(zip(runs.residual(output), groups.rows, strict=True)):
        columns = [np.ones(len(residual)), *(each[k] for each in decays if np.any(each[k]))]
        basis = np.column_stack(columns)
        weights = np.linalg.lstsq(basis[rows], residual[rows], rcond=SINGULAR)[0]
        start = basis[:, 1:] @ weights[1:]
        found.append((start, float(np.mean((residual - start)[rows]))))
    return found


def level_responses(runs: SimulatedLogs) -> list[dict[str, Series]]:
    """Responses to the level of each drive with which each log begins.

    How a machine came to be where a log begins with a drive on, nobody knows: what it would do
    from rest under that level tells nothing.

    Parameters
    ----------
    runs : SimulatedLogs
    """
    found = []
    bare = replace(runs.model, effects=())
    rest = {d.channel: 0.0 if d.reference == "first" else d.reference for d in bare.drives}
    for k, log in enumerate(runs.logs):
        for channel in rest:
            if runs.inputs[k][channel][0] == 0:
                continue
            columns = {c: np.full(len(log.time), r + (c == channel)) for c, r in rest.items()}
            response = bare.simulate(Record(log.time, columns))
            found.append(
                {
                    o: [y if j == k else np.zeros(len(g)) for j, g in enumerate(runs.logs)]
                    for o, y in response.items()
                }
            )
    return found


def begins_away(runs: SimulatedLogs) -> bool:
    """Whether a log begins away from rest, by an output whose rest is known.

    Parameters
    ----------
    runs : SimulatedLogs
    """
    for log in runs.logs:
        shifts = rest_shifts(runs.model, drive_rests(runs.model, log))
        for o in runs.model.outputs:
            if o.offset != "first" and o.channel in runs.groups and o.channel in log.columns:
                values = relative(log.columns[o.channel], o.offset)
                values = values[np.isfinite(values)] - shifts.get(o.channel, 0.0)
                if len(values) and away_from_rest(float(values[0]), o.range):
                    return True
    return False
