"""Test of linearity: do products and powers of the inputs and of the output explain the error.

Of a linear plant the error of the free run is noise, and what is left of the inputs through
dynamics that the model lacks. The regression has terms for both: every input through a bank of
first-order lags, the model's own responses, the output a sample before and after. Beside these
stand second- and third-order terms: powers of the simulated output (a nonlinearity behind the
dynamics, Wiener), powers of the inputs through the model's responses (before them, Hammerstein),
products of input and output or of two inputs through them (bilinear). All is whitened by an AR
model of what the whole regression leaves, and both parts are compared by F.

Higher-order correlation: Billings and Voon, Int. J. Control 44 (1986) 235; the regression form
with a linear part taken off first: Tsay, Biometrika 73 (1986) 461.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.special import fdtrc

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.error_model import MAX_AR_ORDER, ROWS_PER_COEFFICIENT, runs_of
from thermaltool.fitting.output_model import OutputModel
from thermaltool.record import Record
from thermaltool.signals.gauss_newton import solve
from thermaltool.timeseries.ar import burg
from thermaltool.timeseries.runs import joined

# Rows are averaged in groups to so many at most: what is slow is found as well, in less time.
MAX_ROWS = 4000
# Rows for each column of the regression, at least.
ROWS_PER_COLUMN = 6
# Lags of the bank for each input, from one row to this share of the longest record.
MAX_BANK, SLOWEST_SHARE = 8, 0.25
# Products of two inputs are taken of so many inputs at most.
MAX_CROSSED_INPUTS = 4
# Records with a decay of their own at the start, at most.
MAX_DECAYS = 3
# What the linear terms leave of another one counts above this share of it.
MIN_NEW_SHARE = 1e-3
# Times that the colour of the errors is found anew.
COLOUR_ROUNDS = 2
# A p-value below this by the F distribution is found anew by simulated noise: so many draws at
# most, fewer where so many statistics are larger; rows before each in which noise settles.
SURE_P_VALUE, MAX_DRAWS, ENOUGH_LARGER, SETTLING_ROWS = 0.1, 199, 10, 500
# Linear terms count where they are no combination of others to this share; an error below this
# share of the squared output is rounding.
MIN_DIRECTION, MIN_RELATIVE_ERROR = 1e-8, 1e-16
# Runs of fewer rows say nothing of the colour.
MIN_RUN = 40
# "Nonlinear" needs a smaller p-value, and this share of the squared error explained.
MAX_P_VALUE, MIN_EXPLAINED = 0.01, 0.1


@dataclass(frozen=True)
class LinearityTest:
    """What second- and third-order terms explain of the error of a linear model.

    Attributes
    ----------
    p_value : float
        Of the error having none of them; NaN where there are too few rows.
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
        """Whether the plant is not linear, and by how much counts."""
        return self.p_value < MAX_P_VALUE and self.explained > MIN_EXPLAINED


@dataclass(frozen=True)
class Regression:
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


def linearity_test(model: OutputModel, data: TrainingData) -> LinearityTest | None:
    """Test of the errors of a free run; None where the data are too few.

    Parameters
    ----------
    model : OutputModel
    data : TrainingData
        With the one output of the model.
    """
    names, found = _regression(model, data)
    reduced = None if found is None else _reduced(found)
    if found is None or reduced is None:
        return None
    p_value = reduced.p_value
    if p_value < SURE_P_VALUE:
        p_value = _simulated_p_value(found, reduced)
    # What the terms are worth in the error as it is, by the weights of the whitened rows.
    white, kept = reduced.white, reduced.kept
    left = found.error - _weights(white.linear, white.error) @ found.linear
    weights = _weights(np.vstack([white.linear, white.other[kept]]), white.error)
    less = found.error - weights @ np.vstack([found.linear, found.other[kept]])
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
    """The regression whitened, its linear terms taken off the others.

    Attributes
    ----------
    statistic : float
        F.
    degrees : (int, int)
        Its degrees of freedom.
    white : Regression
    kept : ndarray of int, shape (k,)
        Other terms that are not linear ones to rounding.
    alone : ndarray, shape (k,)
        Squared error that each of them explains by itself.
    colour : ndarray
        AR polynomial of the noise.
    """

    statistic: float
    degrees: tuple[int, int]
    white: Regression
    kept: NDArray[np.intp]
    alone: Array
    colour: Array

    @property
    def p_value(self) -> float:
        """By the F distribution: that of many rows."""
        return float(fdtrc(*self.degrees, self.statistic))


def _reduced(found: Regression) -> Reduced | None:
    """Both parts compared; None where no other term is left, or no error."""
    white, colour = found, np.ones(1)
    for _ in range(COLOUR_ROUNDS):
        # Of what the linear terms leave: with the others off, too, slow noise would look whiter.
        colour = _colour(found, found.error - _weights(white.linear, white.error) @ found.linear)
        white = _filtered(found, colour)
    basis = _orthonormal(white.linear, MIN_DIRECTION)
    rest = white.other - (white.other @ basis.T) @ basis
    error = white.error - (white.error @ basis.T) @ basis
    sizes, left = (np.sqrt(np.sum(rows**2, axis=1)) for rows in (white.other, rest))
    kept = np.flatnonzero(left > MIN_NEW_SHARE * np.maximum(sizes, 1e-300))
    if not len(kept):
        return None
    new = _orthonormal(rest[kept], MIN_NEW_SHARE)
    gained, power = float(np.sum((new @ error) ** 2)), float(error @ error)
    q, free = len(new), len(error) - len(basis) - len(new)
    if free < 1 or not power > MIN_RELATIVE_ERROR * float(found.output @ found.output):
        return None
    alone = (rest[kept] @ error) ** 2 / left[kept] ** 2
    return Reduced(
        gained / q / (max(power - gained, 1e-300) / free), (q, free), white, kept, alone, colour
    )


def _simulated_p_value(found: Regression, reduced: Reduced) -> float:
    """The p-value by noise of the same colour, of which all is estimated anew.

    It counts for slow noise and few rows, whose colour a regression flatters. Drawing ends early
    where so many statistics are larger (Besag and Clifford, Biometrika 78 (1991) 301).
    """
    rng, larger, lengths = np.random.default_rng(0), 0, np.diff([0, *found.ends])
    for drawn in range(1, MAX_DRAWS + 1):
        noise = [
            lfilter([1.0], reduced.colour, rng.standard_normal(n + SETTLING_ROWS))[SETTLING_ROWS:]
            for n in lengths
        ]
        other = _reduced(replace(found, error=np.concatenate(noise)))
        larger += other is not None and other.statistic >= reduced.statistic
        if larger == ENOUGH_LARGER:
            return larger / drawn
    return (larger + 1) / (MAX_DRAWS + 1)


def _weights(rows: Array, error: Array) -> Array:
    sizes = np.maximum(np.sqrt(np.sum(rows**2, axis=1)), 1e-300)
    unit = rows / sizes[:, None]
    return np.asarray(solve(unit @ unit.T, unit @ error) / sizes)


def _colour(found: Regression, error: Array) -> Array:
    """AR polynomial of errors, of least AIC: colour that it lacks would pass for a term."""
    runs = np.split(error, found.ends[:-1])
    order = min(MAX_AR_ORDER, min(map(len, runs)) // ROWS_PER_COEFFICIENT)
    if order < 1 or not np.any(error):
        return np.ones(1)
    table = burg(joined(runs), order)
    return np.asarray(table.whitening(table.best))


def _filtered(found: Regression, ar: Array) -> Regression:
    """All rows through the AR polynomial, run by run, without those that it needs to begin."""

    def through(rows: Array) -> Array:
        parts = np.split(np.atleast_2d(rows), found.ends[:-1], axis=1)
        return np.hstack([lfilter(ar, [1.0], part, axis=1)[:, len(ar) - 1 :] for part in parts])

    lengths = np.diff([0, *found.ends]) - (len(ar) - 1)
    ends = tuple(np.cumsum(np.maximum(lengths, 0)).tolist())
    return Regression(through(found.error)[0], through(found.output)[0], through(found.linear),
                      through(found.other), ends)  # fmt: skip


def _orthonormal(rows: Array, least: float) -> Array:
    """An orthonormal basis of rows, without directions that are nearly in the others."""
    sizes = np.linalg.norm(rows, axis=1)
    rows = rows[sizes > 0] / sizes[sizes > 0][:, None]
    values, vectors = np.linalg.eigh(rows @ rows.T)
    used = values > least * max(values[-1], 1e-300) if len(values) else np.zeros(0, bool)
    basis = (vectors[:, used] / np.sqrt(values[used])).T @ rows
    return np.asarray(basis)


def _regression(model: OutputModel, data: TrainingData) -> tuple[list[str], Regression | None]:
    """Names of the other terms, and all rows, in groups where they are many; None: too few."""
    runs = [model.simulate(record) for record in data.records]
    zeros = [model.zeros[record.origin] for record in data.records]
    sizes = np.std(np.hstack(data.u), axis=1)
    size = float(np.nanstd(np.concatenate([y - z for y, z in zip(runs, zeros, strict=True)])))
    if not (size > 0 and np.all(sizes > 0)):
        return [], None
    group, taus = -(-data.rows // MAX_ROWS), _bank(data.longest)
    longest = np.argsort([-len(run) for run in runs], kind="stable")[:MAX_DECAYS].tolist()
    free = [k for k in longest if not data.records[k].at_rest]
    names: list[str] = []
    parts: list[Array] = []
    edge = 0
    for k, (record, run) in enumerate(zip(data.records, runs, strict=True)):
        there = np.flatnonzero(np.isfinite(run))
        if not len(there):
            continue
        y, clock = record.column(model.target), np.arange(len(run))
        v = (np.interp(clock, there, run[there]) - zeros[k]) / size
        # From its first value each: a level before the record is then no term of its own.
        u = (data.u[k] - data.levels[record.origin][:, None]) / sizes[:, None]
        linear, other, names = _columns(model, record, u, v, taus)
        offsets = np.zeros((data.experiments, len(run)))
        offsets[record.origin] = 1.0
        decays = np.zeros((len(free), len(taus), len(run)))
        if k in free:
            decays[free.index(k)] = np.exp(-clock / taus[:, None])
        whole = np.vstack([y - run, y, offsets, *decays, *linear, *other])
        edge = len(whole) - len(other)
        whole = whole[:, : len(run) // group * group].reshape(len(whole), -1, group).mean(axis=2)
        known = np.where(np.isfinite(whole[0]), np.arange(whole.shape[1]), np.nan)
        parts += [whole[:, rows.astype(np.intp)] for rows in runs_of(known)]
    parts = [part for part in parts if part.shape[1] >= MIN_RUN]
    if not parts:
        return [], None
    ends = np.cumsum([part.shape[1] for part in parts]).tolist()
    for part in parts:
        part[1] -= np.mean(part[1])
    rows = np.hstack(parts)
    if rows.shape[1] < ROWS_PER_COLUMN * len(rows):
        return [], None
    return names, Regression(rows[0], rows[1], rows[2:edge], rows[edge:], tuple(ends))


def _bank(longest: int) -> Array:
    """Time constants of the lags of every input [rows]."""
    slowest = max(SLOWEST_SHARE * longest, 4.0)
    return np.geomspace(1.0, slowest, int(np.clip(round(2.5 * np.log10(slowest)), 3, MAX_BANK)))


def _columns(
    model: OutputModel, record: Record, u: Array, v: Array, taus: Array
) -> tuple[list[Array], list[Array], list[str]]:
    """Linear and other terms of one record, and the names of these."""

    def through(i: int, x: Array) -> Array:
        """What the model gives of input i alone."""
        columns = {name: np.zeros(len(x)) for name in model.names}
        return model.response_to(Record(record.time, {**columns, model.names[i]: x}))

    linear = [v, np.append(v[:1], v[:-1]), np.append(v[1:], v[-1:])]
    other = {"y^2": v**2, "y^3": v**3}
    for i, (name, delay) in enumerate(zip(model.names, model.sample_delays, strict=True)):
        late = np.concatenate([np.zeros(min(delay, len(v))), u[i]])[: len(v)]
        linear += [late, through(i, u[i])]
        linear += [lfilter([1 - a], [1, -a], late) for a in np.exp(-1 / taus)]
        own = {f"{name}^2": u[i] ** 2, f"{name}^3": u[i] ** 3, f"{name} y": u[i] * v}
        if len(u) <= MAX_CROSSED_INPUTS:
            own |= {
                f"{name} {second}": u[i] * x
                for second, x in zip(model.names, u, strict=True)
                if second != name
            }
        other |= {label: through(i, x) for label, x in own.items()}
        other[f"{name} y at once"] = late * v
    return linear, list(other.values()), list(other)
