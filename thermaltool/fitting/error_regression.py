"""Rows of the test of linearity: the error of a free run, linear and other terms, instants.

Linear terms are what a linear machine may answer with beside the model: every input through a bank
of first-order lags, the model's own responses, the output a sample before and after, decays.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np
from scipy.linalg import block_diag
from scipy.signal import lfilter

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.error_model import MAX_AR_ORDER, ROWS_PER_COEFFICIENT, known_runs
from thermaltool.fitting.instants import DECISIVE, Instants, pulses
from thermaltool.fitting.projection import orthonormal_rows
from thermaltool.record import Record
from thermaltool.timeseries.ar import burg
from thermaltool.timeseries.runs import joined

# Rows are averaged in groups to so many at most: what is slow is found as well, in less time.
MAX_ROWS = 4000
# Rows for each column of the regression, at least; a run of fewer says nothing of the colour.
ROWS_PER_COLUMN, MIN_RUN = 6, 40
# Lags of the bank for each input, and for all, from one row to this share of the longest record.
MIN_BANK, MAX_BANK, MAX_ALL_BANKS, SLOWEST_SHARE = 2, 8, 24, 0.25
# Of so many inputs at most the terms of third order are taken, and products of two inputs.
MAX_CROSSED_INPUTS = 4
# Records with a decay of their own at the start, at most.
MAX_DECAYS = 3
# Linear terms count where they are no combination of others to this share.
MIN_DIRECTION = 1e-8
# A run above so many deviations of the output is one of an unstable model.
MAX_RELATIVE_RUN = 1e3


class TestedModel(Protocol):
    """What is asked of a model to test what it leaves of its output."""

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def target(self) -> str: ...
    @property
    def zeros(self) -> tuple[float, ...]: ...
    @property
    def sample_delays(self) -> tuple[int, ...]: ...
    def simulate(self, record: Record) -> Array: ...
    def response_to(self, record: Record) -> Array: ...


@dataclass(frozen=True)
class ErrorRegression:
    """Rows of all runs without a hole.

    Attributes
    ----------
    error, output : ndarray, shape (n,)
    linear, other : ndarray, shape (p, n), (q, n)
    late : ndarray, shape (m, n)
        By the instant of each switch.
    ends : tuple of int
        Behind each run.
    names : tuple of str
        Of the other terms.
    """

    error: Array
    output: Array
    linear: Array
    other: Array
    late: Array
    ends: tuple[int, ...]
    names: tuple[str, ...]

    def runs(self, rows: Array) -> list[Array]:
        """Rows (n,) or (p, n) run by run."""
        return np.split(rows, self.ends[:-1], axis=-1)


def error_regression(model: TestedModel, data: TrainingData) -> ErrorRegression | None:
    """All rows, in groups where they are many; None: too few."""
    runs = [model.simulate(record) for record in data.records]
    zeros = [model.zeros[record.origin] for record in data.records]
    sizes = np.std(np.hstack(data.u), axis=1)
    about = np.concatenate([y - zero for y, zero in zip(runs, zeros, strict=True)])
    if not np.isfinite(about).any():
        return None
    # About its mean: the zero of a model that nearly integrates is far away.
    centre, size = float(np.nanmean(about)), float(np.nanstd(about))
    # An unstable model, or one without a response, has no output whose powers say anything.
    if not 0 < size < MAX_RELATIVE_RUN * float(np.nanstd(data.output())) or not np.all(sizes > 0):
        return None
    group, taus = -(-data.rows // MAX_ROWS), _bank(data.longest, len(sizes))
    longest = np.argsort([-len(run) for run in runs], kind="stable")[:MAX_DECAYS].tolist()
    free = [k for k in longest if not data.records[k].at_rest]
    names: list[str] = []
    parts: list[Array] = []
    instants: list[Array] = []
    edge = 0
    for k, (record, run) in enumerate(zip(data.records, runs, strict=True)):
        there = np.flatnonzero(np.isfinite(run))
        if not len(there):
            continue
        y, clock = record.column(model.target), np.arange(len(run))
        v = (np.interp(clock, there, run[there]) - zeros[k] - centre) / size
        # From its first value each: a level before the record is then no term of its own.
        u = (data.u[k] - data.levels[record.origin][:, None]) / sizes[:, None]
        # One column at a time: all together are some hundred bytes a row.
        first = [_group_means(x, group) for x in (y - run, y)]
        linear = [_group_means(x, group) for x in _linear_terms(model, record, u, v, taus)]
        other = {name: _group_means(x, group) for name, x in _other_terms(model, record, u, v)}
        names, count = list(other), len(run) // group
        offsets = np.zeros((data.experiments, count))
        offsets[record.origin] = 1.0
        decays = np.zeros((len(free), len(taus), count))
        if k in free:
            decays[free.index(k)] = [_group_means(np.exp(-clock / tau), group) for tau in taus]
        whole = np.vstack([*first, offsets, *decays, *linear, *other.values()])
        edge, runs_there = len(whole) - len(other), known_runs(whole[0])
        of_input = partial(input_response, model, record)
        late = [_group_means(x, group) for x in pulses(data.u[k], of_input, data.holds, len(runs))]
        long = [run for run in runs_there if run.stop - run.start >= MIN_RUN]
        parts += [whole[:, run].copy() for run in long]
        # The same instants in all runs of a record.
        of_record = np.array(late).reshape(len(late), count)
        instants.append(np.hstack([of_record[:, :0], *(of_record[:, run] for run in long)]))
    if not parts:
        return None
    ends = np.cumsum([part.shape[1] for part in parts]).tolist()
    for part in parts:
        part[1] -= np.mean(part[1])
    rows = np.hstack(parts)
    if rows.shape[1] < ROWS_PER_COLUMN * len(rows):
        return None
    of_instants = block_diag(*instants)
    return ErrorRegression(
        rows[0], rows[1], rows[2:edge], rows[edge:], of_instants, tuple(ends), tuple(names)
    )


def instants_of(found: ErrorRegression) -> tuple[ErrorRegression, Instants] | None:
    """White rows, and the instants beside all terms of them; None where nothing switches.

    Slow noise looks like the decay after a switch: its colour is taken off before.

    Parameters
    ----------
    found : ErrorRegression
    """
    if not len(found.late):
        return None
    colour, _ = colour_of(found, _left(found, found.error))
    white = filtered(found, colour)
    return white, Instants.of(_left(white, white.late).T, _left(white, white.error))


def beside_instants(found: ErrorRegression) -> ErrorRegression:
    """White rows without what the instants of switches may explain, where evidence asks for these.

    Parameters
    ----------
    found : ErrorRegression
    """
    own = instants_of(found)
    if own is None or own[1].evidence < DECISIVE:
        return found
    white, noise = own
    of_noise = replace(noise, columns=white.late.T).whitened
    error, linear, other = (of_noise(rows.T).T for rows in (white.error, white.linear, white.other))
    return replace(white, error=error, linear=linear, other=other)


def _left(found: ErrorRegression, rows: Array) -> Array:
    """Rows (n,) or (m, n) without what all terms explain of them."""
    basis = orthonormal_rows(np.vstack([found.linear, found.other]), MIN_DIRECTION)
    return np.asarray(rows - (rows @ basis.T) @ basis)


def _bank(longest: int, inputs: int) -> Array:
    """Time constants of the lags of every input [rows]."""
    slowest = max(SLOWEST_SHARE * longest, 4.0)
    count = min(round(2.5 * np.log10(slowest)), MAX_BANK, MAX_ALL_BANKS // inputs)
    return np.geomspace(1.0, slowest, max(count, MIN_BANK))


def _linear_terms(
    model: TestedModel, record: Record, u: Array, v: Array, taus: Array
) -> Iterator[Array]:
    """What a linear machine may answer with beside the model, one column at a time."""
    yield v
    yield np.append(v[:1], v[:-1])
    yield np.append(v[1:], v[-1:])
    for i, late in enumerate(_delayed(model, u)):
        yield late
        yield input_response(model, record, i, u[i])
        for a in np.exp(-1 / taus):
            yield lfilter([1 - a], [1, -a], late)


def _other_terms(
    model: TestedModel, record: Record, u: Array, v: Array
) -> Iterator[tuple[str, Array]]:
    """Powers and products of the model's output and its inputs, with their names."""
    yield "y^2", v**2
    yield "y^3", v**3
    few = len(u) <= MAX_CROSSED_INPUTS
    for i, (name, late) in enumerate(zip(model.names, _delayed(model, u), strict=True)):
        if few:
            yield f"{name} y at once", late * v
        yield f"{name}^2", input_response(model, record, i, u[i] ** 2)
        yield f"{name} y", input_response(model, record, i, u[i] * v)
        if few:
            yield f"{name}^3", input_response(model, record, i, u[i] ** 3)
            for k, second in enumerate(model.names):
                if k != i:
                    yield f"{name} {second}", input_response(model, record, i, u[i] * u[k])


def _delayed(model: TestedModel, u: Array) -> Iterator[Array]:
    """Each input by its delay later."""
    for own, delay in zip(u, model.sample_delays, strict=True):
        yield np.concatenate([np.zeros(min(delay, len(own))), own])[: len(own)]


def input_response(model: TestedModel, record: Record, i: int, x: Array) -> Array:
    """What the model gives of input i alone, shape (n,).

    Parameters
    ----------
    model : TestedModel
    record : Record
        Its clock counts.
    i : int
    x : ndarray, shape (n,)
        Course of the input.
    """
    columns = {name: np.zeros(len(x)) for name in model.names}
    return model.response_to(Record(record.time, {**columns, model.names[i]: x}))


def _group_means(x: Array, group: int) -> Array:
    """Means of so many rows each, shape (n // group,)."""
    return np.asarray(x[: len(x) // group * group].reshape(-1, group).mean(axis=1))


def colour_of(found: ErrorRegression, error: Array) -> tuple[Array, float]:
    """AR polynomial of errors and the variance of what drives them, of least AIC.

    Colour that it lacks would pass for a term.
    """
    runs = found.runs(error)
    order = min(MAX_AR_ORDER, min(map(len, runs)) // ROWS_PER_COEFFICIENT)
    if order < 1 or not np.any(error):
        return np.ones(1), float(np.mean(error**2))
    table = burg(joined(runs), order)
    return np.asarray(table.whitening(table.best)), float(table.variance[table.best])


def filtered(found: ErrorRegression, ar: Array) -> ErrorRegression:
    """All rows through the AR polynomial, run by run, without those that it needs to begin."""

    def through(rows: Array) -> Array:
        whole = [
            lfilter(ar, [1.0], run)[..., len(ar) - 1 :] if run.size else run[..., len(ar) - 1 :]
            for run in found.runs(rows)
        ]
        return np.concatenate(whole, axis=-1)

    ends = tuple(np.cumsum([len(run) - (len(ar) - 1) for run in found.runs(found.error)]).tolist())
    return replace(
        found, error=through(found.error), output=through(found.output),
        linear=through(found.linear), other=through(found.other), late=through(found.late),
        ends=ends,
    )  # fmt: skip
