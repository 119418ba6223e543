"""Least squares of all outputs for given time constants, rates by level and exponents.

Along a record whose level is known the modes are linear: x' = −(1/τ + r(level)) x + u. All gains,
the decay of what is there at the start, and offsets are projected out (variable projection).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermaltool.effects.dynamics import with_ends
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.joint import MIN_LOSS, ProjectedOutput, Sensitivities, criterion
from thermaltool.fitting.lpv.form import LpvForm
from thermaltool.model.rest import rest_level
from thermaltool.record import Record
from thermaltool.responses.propagation import propagate, recursion_of
from thermaltool.signals.gauss_newton import solve
from thermaltool.units import Hold, Reference

Index = NDArray[np.intp]
# Step by which slopes are taken.
LOG_DIFFERENCE = 1e-6


@dataclass(frozen=True)
class Scales:
    """What inputs are and count from.

    Attributes
    ----------
    names : tuple of str
    holds : tuple of "zero" or "first"
    references : tuple of "first" or float
    dt : float [s]
    """

    names: tuple[str, ...]
    holds: tuple[Hold, ...]
    references: tuple[Reference, ...]
    dt: float

    def rests(self, record: Record) -> Array:
        """What each input counts from in a record, shape (m,)."""
        each = zip(self.names, self.references, self.holds, strict=True)
        return np.array([rest_level(record.column(n), rest, hold) for n, rest, hold in each])


def drive_columns(form: LpvForm, scales: Scales, theta: Array, record: Record,
                  rests: Array) -> tuple[Array, Array]:  # fmt: skip
    """What drives the modes of a record, shape (m · shares, n), and Γ along it, shape (n,).

    Parameters
    ----------
    form : LpvForm
    scales : Scales
    theta : ndarray, shape (searched,)
    record : Record
    rests : ndarray, shape (m,)
        What inputs count from.
    """
    n = len(record)
    cooling, shares = np.zeros(n), np.ones((1, n))
    if form.channel:
        values = record.column(form.channel)
        if form.loss:
            rates = np.interp(values, *with_ends(form.levels, form.level_rates(theta)))
            cooling[1:] = np.cumsum(rates[:-1] * scales.dt)
        if form.gain:
            above = values - rests[scales.names.index(form.channel)]
            shares = np.array([band.share(above) for band in form.bands() if band is not None])
    found = np.zeros((len(scales.names) * len(shares), n))
    for i, name in enumerate(scales.names):
        late = min(form.delays[i], n)
        acting = form.acting(name, record.column(name) - rests[i], theta)
        own = slice(i * len(shares), (i + 1) * len(shares))
        found[own, late:] = (shares * acting)[:, : n - late]
    return found, cooling


def lag_columns(form: LpvForm, scales: Scales, theta: Array, driven: Array,
                cooling: Array) -> Array:  # fmt: skip
    """Response of every mode of unit gain, then direct ones, shape (weights, n).

    Parameters
    ----------
    form : LpvForm
    scales : Scales
    theta : ndarray, shape (searched,)
    driven : ndarray, shape (m · shares, n)
    cooling : ndarray, shape (n,)
    """
    rises = np.diff(cooling)
    kept, half = np.exp(-rises), np.exp(-rises / 2)
    held = np.repeat([hold == "zero" for hold in scales.holds], form.shares)[:, None]
    found = []
    lines = not held.all()
    for tau in form.time_constants(theta).tolist():
        pole = np.array([-1.0 / tau])
        phi, whole, _ = propagate(pole, scales.dt, "zero")
        added = whole.real * half * driven[:, :-1]
        if lines:
            _, before, now = propagate(pole, scales.dt, "first")
            joined = before.real * kept * driven[:, :-1] + now.real * driven[:, 1:]
            added = np.where(held, added, joined)
        factor = np.broadcast_to(phi.real * kept, added.shape)
        found.append(recursion_of(factor, added) / tau)
    if form.direct:
        found.append(driven)
    return np.vstack(found)


def decay_columns(form: LpvForm, theta: Array, record: Record, cooling: Array) -> Array:
    """What an unknown state at the first row leaves behind, shape (modes, n)."""
    taus = form.time_constants(theta)[:, None]
    return np.asarray(np.exp(-record.elapsed / taus - cooling))


@dataclass(frozen=True)
class LpvPoint:
    """All that is linear for one vector.

    Attributes
    ----------
    theta : ndarray, shape (searched,)
    linear : ndarray, shape (p, L)
        Gains, decays of each piece with a state of its own, offsets of the experiments.
    losses : ndarray, shape (p,)
    columns : tuple of (ndarray of int, ndarray), one for each piece
        Places of its linear columns among all, and these.
    errors : tuple of ndarray, shape (p, n)
        NaN where no row counts.
    grams : tuple of ndarray, shape (L, L), one for each output
    rows : tuple of int
    """

    theta: Array
    linear: Array
    losses: Array
    columns: tuple[tuple[Index, Array], ...]
    errors: tuple[Array, ...]
    grams: tuple[Array, ...]
    rows: tuple[int, ...]

    @property
    def criterion(self) -> float:
        """½ Σ n ln(loss/n) over the outputs."""
        return criterion(zip(self.losses.tolist(), self.rows, strict=True))


@dataclass(frozen=True)
class LpvProblem:
    """Outputs of one form on given data.

    Attributes
    ----------
    data : TrainingData
        On an even clock; at rest is what begins with all inputs at rest.
    form : LpvForm
    references : tuple of "first" or float
        What inputs count from.
    """

    data: TrainingData
    form: LpvForm
    references: tuple[Reference, ...]

    @property
    def scales(self) -> Scales:
        """What the inputs are."""
        return Scales(self.data.inputs, self.data.holds, self.references, self.data.period)

    @cached_property
    def rests(self) -> Array:
        """What inputs count from in each experiment, shape (experiments, m)."""
        begins = self.data.begins
        return np.array([self.scales.rests(self.data.records[begins[k]]) for k in sorted(begins)])

    @cached_property
    def free(self) -> list[int]:
        """Pieces with a state of their own."""
        return [j for j, record in enumerate(self.data.records) if not record.at_rest]

    @property
    def weights(self) -> int:
        """Gains of each output."""
        return self.form.weights(len(self.data.inputs))

    @property
    def size(self) -> int:
        """Linear parameters of each output."""
        return self.weights + self.form.modes * len(self.free) + self.data.experiments

    @cached_property
    def measured(self) -> tuple[Array, ...]:
        """Outputs of each piece, NaN where delays hide what acts."""
        found = []
        for y in self.data.y:
            own = y.copy()
            own[:, : max(self.form.delays)] = np.nan
            found.append(own)
        return tuple(found)

    @cached_property
    def powers(self) -> Array:
        """Squares of all outputs about their means, shape (p,)."""
        whole = np.hstack(self.measured)
        return np.maximum(np.nanvar(whole, axis=1) * np.isfinite(whole).sum(axis=1), 1e-300)

    def columns(self, theta: Array, j: int) -> tuple[Index, Array]:
        """Places among all, and the columns, of piece j."""
        record, form = self.data.records[j], self.form
        driven, cooling = drive_columns(form, self.scales, theta, record, self.rests[record.origin])
        parts = [lag_columns(form, self.scales, theta, driven, cooling)]
        place = [np.arange(self.weights)]
        if j in self.free:
            at = self.weights + form.modes * self.free.index(j)
            parts.append(decay_columns(form, theta, record, cooling))
            place.append(np.arange(at, at + form.modes))
        parts.append(np.ones((1, len(record))))
        place.append(np.array([self.size - self.data.experiments + record.origin]))
        return np.concatenate(place), np.vstack(parts)

    def project(self, theta: Array) -> LpvPoint:
        """All that is linear for a vector.

        Parameters
        ----------
        theta : ndarray, shape (searched,)
        """
        p, size = len(self.data.outputs), self.size
        grams, cross = np.zeros((p, size, size)), np.zeros((p, size))
        columns = [self.columns(theta, j) for j in range(len(self.data.records))]
        for (place, own), y in zip(columns, self.measured, strict=True):
            for k in range(p):
                there = np.isfinite(y[k])
                rows, known = (own, y[k]) if there.all() else (own[:, there], y[k][there])
                grams[k][np.ix_(place, place)] += rows @ rows.T
                cross[k][place] += rows @ known
        if not (np.isfinite(grams).all() and np.isfinite(cross).all()):
            linear = np.full((p, size), np.nan)
        else:
            linear = np.array([solve(g, c) for g, c in zip(grams, cross, strict=True)])
        errors = tuple(
            y - linear[:, place] @ own
            for (place, own), y in zip(columns, self.measured, strict=True)
        )
        counted = [sum(int(np.isfinite(y[k]).sum()) for y in self.measured) for k in range(p)]
        squares = np.array([[np.nansum(e[k] ** 2) for e in errors] for k in range(p)])
        losses = np.maximum(squares.sum(axis=1), MIN_LOSS * self.powers)
        if not np.isfinite(linear).all():
            losses = np.full(p, np.inf)
        return LpvPoint(theta, linear, losses, tuple(columns), errors, tuple(grams), tuple(counted))

    def slopes(self, point: LpvPoint, j: int) -> Array:
        """How piece j of each output follows the vector, shape (p, searched, n); zero in holes."""
        place, _ = point.columns[j]
        linear, found = point.linear[:, place], []
        for step in LOG_DIFFERENCE * np.eye(len(point.theta)):
            ahead = self.columns(point.theta + step, j)[1]
            found.append(linear @ (ahead - point.columns[j][1]) / LOG_DIFFERENCE)
        slopes = np.array(found).transpose(1, 0, 2)
        return np.where(np.isfinite(self.measured[j])[:, None], slopes, 0.0)

    def linearized(self, point: LpvPoint) -> list[ProjectedOutput]:
        """Every output with its slopes, the linear parameters projected out."""
        p, count = len(self.data.outputs), len(point.theta)
        inner, across = np.zeros((p, count, count)), np.zeros((p, self.size, count))
        pull = np.zeros((p, count))
        for j, ((place, own), errors) in enumerate(zip(point.columns, point.errors, strict=True)):
            slopes = self.slopes(point, j)
            inner += slopes @ slopes.transpose(0, 2, 1)
            pull += np.einsum("pkn,pn->pk", slopes, np.nan_to_num(errors))
            across[:, place] += own @ slopes.transpose(0, 2, 1)
        found = []
        for k in range(p):
            by_searched = solve(point.grams[k], across[k])
            found.append(ProjectedOutput(
                point.linear[k], float(point.losses[k]), point.rows[k], by_searched,
                point.grams[k], inner[k] - across[k].T @ by_searched, pull[k],
            ))  # fmt: skip
        return found

    def sensitivities(self, point: LpvPoint, projected: list[ProjectedOutput], j: int,
                      ) -> Sensitivities:  # fmt: skip
        """How piece j of every output follows all parameters."""
        (place, own), slopes = point.columns[j], self.slopes(point, j)
        there = np.isfinite(self.measured[j])
        linear = [np.where(rows, own, 0.0) for rows in there]
        left = [
            whole - f.by_searched[place].T @ columns
            for whole, f, columns in zip(slopes, projected, linear, strict=True)
        ]
        return Sensitivities(place, left, linear)
