"""Test of linearity: do products and powers of the inputs and of the output explain the error.

Of a linear plant the error of the free run is noise, and what is left of the inputs through
dynamics that the model lacks. The regression has terms for both: every input through a bank of
first-order lags, the model's own responses, the output a sample before and after. Beside these
stand second- and third-order terms: powers of the simulated output (a nonlinearity behind the
dynamics, Wiener), powers of the inputs through the model's responses (before them, Hammerstein),
products of input and output or of two inputs through them (bilinear). All is whitened by an AR
model of what the whole regression leaves, and both parts are compared by F. Where that looks
significant, the p-value is found anew from noise of the colour that the linear terms leave, for
which everything is done again: a regression flatters slow noise.

Higher-order correlation: Billings and Voon, Int. J. Control 44 (1986) 235; the regression form
with a linear part taken off first: Tsay, Biometrika 73 (1986) 461.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.signal import lfilter
from scipy.special import fdtrc

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.error_model import MAX_AR_ORDER, ROWS_PER_COEFFICIENT, known_runs
from thermaltool.fitting.instants import DECISIVE, Instants, pulses
from thermaltool.fitting.joint import with_absorbed
from thermaltool.fitting.projection import orthonormal_rows
from thermaltool.record import Record
from thermaltool.signals.gauss_newton import solve
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
# Other terms count where the linear ones leave more than this share of them; linear ones where
# they are no combination of others to this share.
MIN_NEW_SHARE, MIN_DIRECTION = 1e-3, 1e-8
# An error below this share of the squared output is rounding; a run above so many deviations of
# the output is one of an unstable model.
MIN_RELATIVE_ERROR, MAX_RELATIVE_RUN = 1e-16, 1e3
# A p-value below this by the F distribution is found anew by simulated noise: so many draws at
# most, fewer where so many statistics are larger; rows before each in which the noise settles.
SURE_P_VALUE, MAX_DRAWS, ENOUGH_LARGER, SETTLING_ROWS = 0.1, 99, 10, 500
# "Nonlinear" needs a p-value of no more, and this share of the squared error explained.
MAX_P_VALUE, MIN_EXPLAINED = 0.01, 0.1


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
class LinearityTest:
    """What second- and third-order terms explain of the error of a linear model.

    Attributes
    ----------
    p_value : float
        Of the error having none of them.
    explained : float
        Share of the squared error that they explain.
    linear_fit_percent, nonlinear_fit_percent : float
        Fit of the free run with all linear terms of the regression, and with the others, too.
    term : str
        Which of them explains most.
    """

    p_value: float
    explained: float
    linear_fit_percent: float
    nonlinear_fit_percent: float
    term: str = ""

    @property
    def nonlinear(self) -> bool:
        """Whether the plant is not linear, and by so much that it counts."""
        return self.p_value <= MAX_P_VALUE and self.explained >= MIN_EXPLAINED


@dataclass(frozen=True)
class ErrorRegression:
    """Rows of all runs without a hole.

    Attributes
    ----------
    error, output : ndarray, shape (n,)
    linear, other : ndarray, shape (p, n), (q, n)
    ends : tuple of int
        Behind each run.
    """

    error: Array
    output: Array
    linear: Array
    other: Array
    ends: tuple[int, ...]

    def runs(self, rows: Array) -> list[Array]:
        """Rows (n,) or (p, n) run by run."""
        return np.split(rows, self.ends[:-1], axis=-1)


def linearity_test(model: TestedModel, data: TrainingData) -> LinearityTest | None:
    """Test of the errors of a free run; None where the data are too few.

    Parameters
    ----------
    model : TestedModel
    data : TrainingData
        With the one output of the model.
    """
    names, found = _regression(model, data)
    if found is None:
        return None
    basis = orthonormal_rows(np.vstack([found.linear, found.other]), MIN_DIRECTION)
    reduced = _reduced(found, basis)
    if reduced is None:
        return None
    p_value = float(fdtrc(*reduced.degrees, reduced.statistic))
    if p_value < SURE_P_VALUE:
        p_value = _simulated_p_value(found, basis, reduced.statistic)
    # What the terms are worth in the error as it is.
    kept = reduced.kept
    left = found.error - _weights(found.linear, found.error) @ found.linear
    both = np.vstack([found.linear, found.other[kept]])
    less = found.error - _weights(both, found.error) @ both
    deviation, linear, whole = (np.sqrt(np.mean(x**2)) for x in (found.output, left, less))
    return LinearityTest(
        p_value,
        float(1 - (whole / linear) ** 2),
        float(100 * (1 - linear / deviation)),
        float(100 * (1 - whole / deviation)),
        names[kept[int(np.argmax(reduced.alone))]],
    )


@dataclass(frozen=True)
class Reduced:
    """Both parts of the regression compared.

    Attributes
    ----------
    statistic : float
        F.
    degrees : (int, int)
        Its degrees of freedom.
    kept : ndarray of int, shape (k,)
        Other terms that are not linear ones to rounding.
    alone : ndarray, shape (k,)
        Squared error that each of them explains by itself.
    """

    statistic: float
    degrees: tuple[int, int]
    kept: NDArray[np.intp]
    alone: Array


def _reduced(found: ErrorRegression, basis: Array) -> Reduced | None:
    """Both parts compared; None where no other term is left, or no error.

    Parameters
    ----------
    found : ErrorRegression
    basis : ndarray, shape (k, n)
        Orthonormal, of all its terms.
    """
    colour, _ = _colour(found, found.error - (found.error @ basis.T) @ basis)
    white = _filtered(found, colour)
    linear = orthonormal_rows(white.linear, MIN_DIRECTION)
    rest = white.other - (white.other @ linear.T) @ linear
    error = white.error - (white.error @ linear.T) @ linear
    sizes, left = (np.sqrt(np.sum(rows**2, axis=1)) for rows in (white.other, rest))
    kept = np.flatnonzero(left > MIN_NEW_SHARE * np.maximum(sizes, 1e-300))
    if not len(kept):
        return None
    new = orthonormal_rows(rest[kept], MIN_NEW_SHARE)
    gained, power = float(np.sum((new @ error) ** 2)), float(error @ error)
    q, free = len(new), len(error) - len(linear) - len(new)
    if free < 1 or not power > MIN_RELATIVE_ERROR * float(found.output @ found.output):
        return None
    statistic = gained / q / (max(power - gained, 1e-300) / free)
    return Reduced(statistic, (q, free), kept, (rest[kept] @ error) ** 2 / left[kept] ** 2)


def _simulated_p_value(found: ErrorRegression, basis: Array, statistic: float) -> float:
    """Share of draws of noise that have as large a statistic (Besag and Clifford 1991).

    Parameters
    ----------
    found : ErrorRegression
    basis : ndarray, shape (k, n)
        As `_reduced`.
    statistic : float
    """
    linear = orthonormal_rows(found.linear, MIN_DIRECTION)
    given = _colour(found, found.error - (found.error @ linear.T) @ linear)
    places = [(np.arange(len(linear)), part) for part in found.runs(linear)]
    colour, _ = with_absorbed(given, np.eye(len(linear)), places)
    # The same draws at every call: a result must not change from run to run.
    rng, larger = np.random.default_rng(0), 0
    for drawn in range(1, MAX_DRAWS + 1):
        noise = [
            lfilter([1.0], colour, rng.standard_normal(len(run) + SETTLING_ROWS))[SETTLING_ROWS:]
            for run in found.runs(found.error)
        ]
        other = _reduced(replace(found, error=np.concatenate(noise)), basis)
        larger += other is not None and other.statistic >= statistic
        if larger == ENOUGH_LARGER:
            return larger / drawn
    return (larger + 1) / (MAX_DRAWS + 1)


def _weights(rows: Array, error: Array) -> Array:
    """Least squares."""
    sizes = np.maximum(np.sqrt(np.sum(rows**2, axis=1)), 1e-300)
    unit = rows / sizes[:, None]
    return np.asarray(solve(unit @ unit.T, unit @ error) / sizes)


def _colour(found: ErrorRegression, error: Array) -> tuple[Array, float]:
    """AR polynomial of errors and the variance of what drives them, of least AIC.

    Colour that it lacks would pass for a term.
    """
    runs = found.runs(error)
    order = min(MAX_AR_ORDER, min(map(len, runs)) // ROWS_PER_COEFFICIENT)
    if order < 1 or not np.any(error):
        return np.ones(1), float(np.mean(error**2))
    table = burg(joined(runs), order)
    return np.asarray(table.whitening(table.best)), float(table.variance[table.best])


def _filtered(found: ErrorRegression, ar: Array) -> ErrorRegression:
    """All rows through the AR polynomial, run by run, without those that it needs to begin."""

    def through(rows: Array) -> Array:
        whole = [lfilter(ar, [1.0], run)[..., len(ar) - 1 :] for run in found.runs(rows)]
        return np.concatenate(whole, axis=-1)

    ends = tuple(np.cumsum([len(run) - (len(ar) - 1) for run in found.runs(found.error)]).tolist())
    return ErrorRegression(
        through(found.error), through(found.output), through(found.linear), through(found.other),
        ends,
    )  # fmt: skip


def _regression(model: TestedModel, data: TrainingData) -> tuple[list[str], ErrorRegression | None]:
    """Names of the other terms, and all rows, in groups where they are many; None: too few."""
    runs = [model.simulate(record) for record in data.records]
    zeros = [model.zeros[record.origin] for record in data.records]
    sizes = np.std(np.hstack(data.u), axis=1)
    about = np.concatenate([y - zero for y, zero in zip(runs, zeros, strict=True)])
    if not np.isfinite(about).any():
        return [], None
    # About its mean: the zero of a model that nearly integrates is far away.
    centre, size = float(np.nanmean(about)), float(np.nanstd(about))
    # An unstable model, or one without a response, has no output whose powers say anything.
    if not 0 < size < MAX_RELATIVE_RUN * float(np.nanstd(data.output())) or not np.all(sizes > 0):
        return [], None
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
        of_input = partial(_response_to, model, record)
        late = [_group_means(x, group) for x in pulses(data.u[k], of_input, data.holds, len(runs))]
        parts += [whole[:, run].copy() for run in runs_there]
        instants += [np.array(late).reshape(len(late), count)[:, run] for run in runs_there]
    instants = [own for own, part in zip(instants, parts, strict=True) if part.shape[1] >= MIN_RUN]
    parts = [part for part in parts if part.shape[1] >= MIN_RUN]
    if not parts:
        return [], None
    ends = np.cumsum([part.shape[1] for part in parts]).tolist()
    for part in parts:
        part[1] -= np.mean(part[1])
    rows = np.hstack(parts)
    if rows.shape[1] < ROWS_PER_COLUMN * len(rows):
        return [], None
    found = ErrorRegression(rows[0], rows[1], rows[2:edge], rows[edge:], tuple(ends))
    return names, _beside_instants(found, block_diag(*instants))


def _beside_instants(found: ErrorRegression, late: Array) -> ErrorRegression:
    """Rows whitened of the instants of switches, where what all terms leave asks for these."""
    if not len(late):
        return found
    basis = orthonormal_rows(np.vstack([found.linear, found.other]), MIN_DIRECTION)
    left, own = (rows - (rows @ basis.T) @ basis for rows in (found.error, late))
    noise = Instants.of(own.T, left)
    if noise.evidence < DECISIVE:
        return found
    white = replace(noise, columns=late.T).whitened
    linear, other = white(found.linear.T).T, white(found.other.T).T
    return replace(found, error=white(found.error), linear=linear, other=other)


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
        yield _response_to(model, record, i, u[i])
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
        yield f"{name}^2", _response_to(model, record, i, u[i] ** 2)
        yield f"{name} y", _response_to(model, record, i, u[i] * v)
        if few:
            yield f"{name}^3", _response_to(model, record, i, u[i] ** 3)
            for k, second in enumerate(model.names):
                if k != i:
                    yield f"{name} {second}", _response_to(model, record, i, u[i] * u[k])


def _delayed(model: TestedModel, u: Array) -> Iterator[Array]:
    """Each input by its delay later."""
    for own, delay in zip(u, model.sample_delays, strict=True):
        yield np.concatenate([np.zeros(min(delay, len(own))), own])[: len(own)]


def _response_to(model: TestedModel, record: Record, i: int, x: Array) -> Array:
    """What the model gives of input i alone."""
    columns = {name: np.zeros(len(x)) for name in model.names}
    return model.response_to(Record(record.time, {**columns, model.names[i]: x}))


def _group_means(x: Array, group: int) -> Array:
    """Means of so many rows each, shape (n // group,)."""
    return np.asarray(x[: len(x) // group * group].reshape(-1, group).mean(axis=1))
