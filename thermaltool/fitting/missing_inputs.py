"""Inputs in rows that a log lacks, told by the outputs behind them.

A command or a quick signal may have changed while a row was lost. What it was there moves the
outputs as a pulse does: beside a model of few poles its likeliest size is found by least squares,
with what the rows around leave open of it as a prior (Ljung 1999, 14.3: missing data).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, TrainingData, even_training_data
from thermaltool.fitting.even_clock import interpolation_error, lacks_rows
from thermaltool.fitting.projection import orthonormal_rows
from thermaltool.fitting.subspace.identify import identify_subspace
from thermaltool.fitting.subspace.model import Subspace, SubspaceOutput
from thermaltool.fitting.subspace.problem import SubspaceProblem
from thermaltool.record import Record

# Poles of the model at most, orders in a row without a better one, and the share by which each has
# to lower the squared errors: more would take the missing inputs for something of their own.
MAX_POLES, PATIENCE, MIN_GAIN = 10, 3, 0.1
# Inputs that are found at most, the most doubtful ones.
MAX_FOUND = 400
# The model is better where inputs are found: how often they are, and the last change that counts,
# as a share of what was open.
ROUNDS, ENOUGH = 4, 0.05
# Columns of a model count where they are no combination of others to this share.
MIN_DIRECTION = 1e-8


def with_missing_inputs(
    logs: Sequence[Record],
    inputs: Sequence[str],
    outputs: Sequence[str],
    span: tuple[float | None, float | None] = (None, None),
    split: float | None = None,
) -> list[Record]:
    """Logs with those rows that they lack in which inputs are found, their outputs missing.

    As they are where all inputs go on over the rows that are missing, or no model is found.

    Parameters
    ----------
    logs : sequence of Record
    inputs, outputs : sequence of str
    span : (float or None, float or None) [s]
        The stretch that is fitted or held out.
    split : float, optional
        Share of it that is fitted: no input is found in what is held out. Default: all.
    """
    if not any(len(log) > 1 and lacks_rows(log, logs[0].period) for log in logs):
        return list(logs)
    try:
        own = [log.between(*span) for log in logs]
        data = even_training_data(own, inputs, outputs, missing="row")
        data = data if split is None else data.split(split).fitted
        places = _open_places(data, logs)
        if not any(places):
            return list(logs)
        lines = data.u
        for _ in range(ROUNDS):
            before, data = data, _found(data, lines, places, _model(data))
            if _moved(before, data, places) < ENOUGH:
                break
    except FitError:
        return list(logs)
    return [_with_rows(log, data, places, k) for k, log in enumerate(logs)]


# Input, row, and by how much it may be off.
_Place = tuple[int, int, float]


def _open_places(data: TrainingData, logs: Sequence[Record]) -> list[list[_Place]]:
    """Of each record what is open of an input in rows that its log lacks."""
    found = []
    told = interpolation_error(np.hstack(data.u))
    for record, u, y in zip(data.records, data.u, data.y, strict=True):
        empty = ~np.isfinite(y).any(axis=0)
        empty &= ~np.isin(record.time, logs[data.logs[record.origin]].time)
        own: list[_Place] = []
        there = np.flatnonzero(~empty)
        for r in np.flatnonzero(empty).tolist():
            k = int(np.searchsorted(there, r))
            change = np.abs(u[:, there[k]] - u[:, there[k - 1]])
            own += [(i, r, float(max(change[i] / 2, told[i, 0])))
                    for i in np.flatnonzero(change > 0).tolist()]  # fmt: skip
        found.append(own)
    sizes = sorted((each for own in found for each in own), key=lambda each: -each[2])
    least = sizes[MAX_FOUND - 1][2] if len(sizes) > MAX_FOUND else 0.0
    return [[each for each in own if each[2] >= least] for own in found]


def _model(data: TrainingData) -> Subspace:
    """Of so many poles as lower the errors clearly."""
    best: Subspace | None = None
    cost = -np.log(1 - MIN_GAIN) * data.rows * len(data.outputs)
    since = 0
    for order in range(1, MAX_POLES + 1):
        try:
            own = identify_subspace(data, order, data.may_act_at_once, judged=False)
        except FitError:
            break
        gain = np.inf if best is None else best.criteria.deviance - own.criteria.deviance
        if best is None or gain > cost * (order - best.order):
            best, since = own, 0
        elif (since := since + 1) >= PATIENCE:
            break
    if best is None:
        raise FitError("no poles fit")
    return best


def _found(
    data: TrainingData,
    lines: Sequence[Array],
    places: Sequence[Sequence[_Place]],
    model: Subspace,
) -> TrainingData:
    """The data with the likeliest inputs in these places, about those of `lines`."""
    problem = SubspaceProblem(data, model.has_direct)
    point, records = problem.project(model.sections), []
    for j, (record, own) in enumerate(zip(data.records, places, strict=True)):
        if not own:
            records.append(record)
            continue
        u, weights = data.u[j].copy(), np.array([1 / size**2 for _, _, size in own])
        information = np.diag(weights)
        pull = weights * [lines[j][i, r] - u[i, r] for i, r, _ in own]
        # What another model could explain as well is not told of the inputs.
        free, slopes = problem.free(j, model.sections), problem.slopes(j, point)
        for k, output in enumerate(model.outputs):
            basis = orthonormal_rows(np.vstack([point.columns[j], free, slopes[k]]), MIN_DIRECTION)
            rows = problem.counted(j, _pulses(output, record, own))
            rows = np.vstack([rows, point.errors[j][k]]) / np.sqrt(max(output.sigma2, 1e-300))
            rows -= (rows @ basis.T) @ basis
            information += rows[:-1] @ rows[:-1].T
            pull += rows[:-1] @ rows[-1]
        for (i, r, _), by in zip(own, np.linalg.solve(information, pull), strict=True):
            u[i, r] += by
        found = dict(zip(data.inputs, u, strict=True))
        records.append(replace(record, columns={**record.columns, **found}))
    return replace(data, records=tuple(records))


def _pulses(output: SubspaceOutput, record: Record, places: Sequence[_Place]) -> Array:
    """What one more of an input in each place makes of an output, shape (places, n)."""
    n, once = len(record), {}
    for i in {i for i, _, _ in places}:
        # In the second row: an input may have stood at its first value before.
        pulse = {name: np.zeros(n) for name in output.names}
        pulse[output.names[i]] = np.eye(1, n, 1)[0]
        once[i] = output.response_to(Record(record.time, pulse))[1:]
    found = np.zeros((len(places), n))
    for row, (i, r, _) in zip(found, places, strict=True):
        row[r:] = np.append(once[i], 0.0)[: n - r]
    return found


def _moved(before: TrainingData, data: TrainingData, places: Sequence[Sequence[_Place]]) -> float:
    """RMS of the last change of the inputs in these places, as a share of what was open."""
    changes = [(u[i, r] - last[i, r]) / size
               for u, last, own in zip(data.u, before.u, places, strict=True)
               for i, r, size in own]  # fmt: skip
    return float(np.sqrt(np.mean(np.square(changes))))


def _with_rows(
    log: Record, data: TrainingData, places: Sequence[Sequence[_Place]], k: int
) -> Record:
    """A log with rows in the places of its records."""
    times, values = [np.empty(0)], [np.empty((len(data.inputs), 0))]
    for record, u, own in zip(data.records, data.u, places, strict=True):
        if data.logs[record.origin] == k:
            rows = sorted({r for _, r, _ in own})
            times.append(record.time[rows])
            values.append(u[:, rows])
    added, u = np.concatenate(times), np.hstack(values)
    order = np.argsort(added, kind="stable")
    return log.with_rows(added[order], dict(zip(data.inputs, u[:, order], strict=True)))
