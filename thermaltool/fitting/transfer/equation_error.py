"""ARX and ARMAX: F(q) y = Σ B(q) u + offset + C(q) e, all inputs over one denominator.

ARX is linear. ARMAX starts from the errors of a long ARX model in place of e (Hannan and Rissanen)
and goes on by damped Gauss-Newton on the one-step error (Ljung 1999, 10.2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.transfer.model import TransferModel
from thermaltool.fitting.transfer.orders import Orders
from thermaltool.fitting.transfer.polynomials import difference_basis, stabilized
from thermaltool.fitting.transfer.structure import Structure, check_steady_state, one_step
from thermaltool.record import Record
from thermaltool.signals.gauss_newton import inverse_of, minimize, solve

# The long ARX model that stands in for the noise has so many times the orders.
LONG_ORDER_RATIO = 5
# A loss that changes by less than this many error variances: a hundredth of a standard error.
TOLERANCE = 1e-4
# Steps of ARMAX, at most.
MAX_STEPS = 50


@dataclass(frozen=True)
class Regression:
    """What an equation-error fit found.

    Attributes
    ----------
    F, C : ndarray
    numerators : tuple of ndarray
    constants : tuple of float
        F(1)·offset of each experiment.
    gram : ndarray
        Of the slopes of the error by (F, B, C) in differences, constants.
    loss : float
    rows : int
    converged : bool
    """

    F: Array
    C: Array
    numerators: tuple[Array, ...]
    constants: tuple[float, ...]
    gram: Array
    loss: float
    rows: int
    converged: bool = True


@dataclass(frozen=True)
class ArxStructure(Structure):
    """White errors of the equation."""

    name: ClassVar[str] = "arx"
    letter: ClassVar[str] = "a"
    shares_denominator: ClassVar[bool] = True
    estimates_start: ClassVar[bool] = False
    method: ClassVar[str] = "least squares"

    def regression(self, data: TrainingData, orders: Orders) -> Regression:
        """The estimate and its normal equations."""
        return _linear(data, orders, 0, None)

    def estimate(self, data: TrainingData, orders: Orders) -> TransferModel:
        found = self.regression(data, orders)
        sigma2 = found.loss / max(found.rows - len(found.gram), 1)
        check_steady_state(found.F)
        at_rest, own = float(found.F.sum()), orders.parameters
        offsets = np.array(found.constants) / at_rest
        gains = np.array([b.sum() / at_rest for b in found.numerators])
        return TransferModel(
            structure=self,
            names=data.inputs,
            target=data.outputs[0],
            dt=data.period,
            orders=orders,
            holds=data.holds,
            lagging=data.lagging,
            B=found.numerators,
            F=(found.F,),
            C=found.C,
            levels=data.levels,
            zeros=tuple((offsets + data.levels @ gains).tolist()),
            sigma2=sigma2,
            covariance=sigma2 * inverse_of(found.gram)[:own, :own],
            method=self.method,
            converged=found.converged,
            rows=found.rows,
            loss=max(found.loss, 1e-300),
            output_variance=float(np.nanvar(data.output())),
        )

    def residual(self, model: TransferModel, record: Record) -> Array | None:
        if len(record) <= model.orders.shortest:
            return None
        error = record.column(model.target) - model.respond(record.matrix(model.names))
        first = model.orders.first + len(model.F[0]) - 1
        return one_step(error - model.offsets[record.origin], model.F[0], model.C, first)

    def residual_parameters(self, model: TransferModel) -> int:
        return super().residual_parameters(model) + len(model.F[0]) - 1


@dataclass(frozen=True)
class ArmaxStructure(ArxStructure):
    """Errors of the equation that are a moving average."""

    name: ClassVar[str] = "armax"
    noise_orders: ClassVar[bool] = True
    method: ClassVar[str] = "Gauss-Newton from two regressions"

    def regression(self, data: TrainingData, orders: Orders) -> Regression:
        nc = self.noise[0]
        longer = min(LONG_ORDER_RATIO * max(orders.nf[0], nc, 2), max(2, data.longest // 10))
        long_orders = replace(orders, nf=(max(longer, orders.nf[0]),))
        long = _linear(data, long_orders, 0, None)
        noise = [_errors(data, k, long_orders, long) for k in range(len(data.records))]
        end = minimize(
            _evaluated(data, orders, _linear(data, orders, nc, noise)),
            lambda here: here.loss,
            lambda here: _normal_equations(data, orders, here),
            lambda here, step: _evaluated(data, orders, _moved(here, orders, step)),
            lambda here: TOLERANCE * here.loss / here.rows,
            MAX_STEPS,
        )
        gram, _ = _normal_equations(data, orders, end.point)
        return replace(end.point, gram=gram, converged=end.converged)


def _first(orders: Orders) -> int:
    return max(orders.first, orders.nf[0])


def _counted(data: TrainingData, k: int, orders: Orders) -> NDArray[np.bool_]:
    """Rows behind the first that have a reading, and those before that the equation takes."""
    first, known = _first(orders), np.isfinite(data.y[k][0])
    counts = known[first:].copy()
    for lag in range(1, orders.nf[0] + 1):
        counts &= known[first - lag : len(known) - lag]
    return counts


def _rows(data: TrainingData, k: int, orders: Orders) -> list[Array]:
    """Columns of F and B in differences, and the constant, behind the first rows.

    Zero where the row does not count.
    """
    first = _first(orders)
    inputs, (y,) = data.u[k], data.y[k]
    n = len(y) - first
    rows = []
    lag = y
    for j in range(orders.nf[0]):
        if j:
            lag = np.diff(lag)
        rows.append(-lag[first - 1 - j : first - 1 - j + n])
    for u, nb, nk in zip(inputs, orders.nb, orders.nk, strict=True):
        for j in range(nb):
            if j:
                u = np.diff(u)
            rows.append(u[first - nk - j : first - nk - j + n])
    rows.append(np.ones(n))
    counts = _counted(data, k, orders)
    return rows if counts.all() else [np.where(counts, row, 0.0) for row in rows]


def _lags(e: Array, count: int) -> list[Array]:
    return [np.concatenate([np.zeros(j), e[: len(e) - j]]) for j in range(1, count + 1)]


def _place(orders: Orders, nc: int, origin: int) -> NDArray[np.intp]:
    own = orders.parameters
    parts = np.arange(own), [own + nc + origin], own + np.arange(nc)
    return np.concatenate(parts).astype(np.intp)


def _linear(data: TrainingData, orders: Orders, nc: int, noise: list[Array] | None) -> Regression:
    """One linear regression; `noise` stands for e where C is wanted."""
    size = orders.parameters + nc + data.experiments
    gram, right, power, rows_seen = np.zeros((size, size)), np.zeros(size), 0.0, 0
    for k, record in enumerate(data.records):
        first = _first(orders)
        if len(record) <= first + 1:
            continue
        X = _rows(data, k, orders)
        if noise is not None:
            X += [lag[first:] for lag in _lags(noise[k], nc)]
        counts = _counted(data, k, orders)
        Z, place = np.array(X)[:, counts], _place(orders, nc, record.origin)
        y = data.y[k][0, first:][counts]
        gram[np.ix_(place, place)] += Z @ Z.T
        right[place] += Z @ y
        power += float(y @ y)
        rows_seen += len(y)
    if rows_seen <= size:
        raise FitError(f"{rows_seen} rows are too few for {size} parameters")
    theta = solve(gram, right)
    loss = max(power - float(theta @ right), 1e-30 * power)
    start = Regression(np.eye(1, orders.nf[0] + 1)[0], np.eye(1, nc + 1)[0],
                       tuple(np.zeros(b) for b in orders.nb), (0.0,) * data.experiments,
                       gram, loss, rows_seen)  # fmt: skip
    return _moved(start, orders, theta)


def _moved(r: Regression, orders: Orders, step: Array) -> Regression:
    n, at = orders.nf[0], orders.nf[0]
    F = np.concatenate([[1.0], r.F[1:] + step[:n] @ difference_basis(n)])
    B = []
    for b in r.numerators:
        B.append(b + step[at : at + len(b)] @ difference_basis(len(b)))
        at += len(b)
    nc = len(r.C) - 1
    C = stabilized(np.concatenate([[1.0], r.C[1:] + step[at : at + nc]]))
    constants = tuple(np.add(r.constants, step[at + nc :]).tolist())
    return replace(r, F=F, C=C, numerators=tuple(B), constants=constants)


def _errors(data: TrainingData, k: int, orders: Orders, r: Regression) -> Array:
    """One-step errors e on every row, zero where none counts."""
    first = _first(orders)
    record, (y,) = data.records[k], data.y[k]
    if len(record) <= first:
        return np.zeros(len(record))
    error = np.convolve(y, r.F)[: len(y)] - r.constants[record.origin]
    for u, b, nk in zip(data.u[k], r.numerators, orders.nk, strict=True):
        error = error - lfilter(np.concatenate([np.zeros(nk), b]), [1.0], u)
    result = np.zeros(len(record))
    counts = _counted(data, k, orders)
    result[first:] = counts * lfilter([1.0], r.C, np.where(counts, error[first:], 0.0))
    return result


def _evaluated(data: TrainingData, orders: Orders, r: Regression) -> Regression:
    """With the loss of the one-step errors."""
    loss = sum(float(np.sum(_errors(data, k, orders, r) ** 2)) for k in range(len(data.records)))
    return replace(r, loss=loss)


def _normal_equations(data: TrainingData, orders: Orders, r: Regression) -> tuple[Array, Array]:
    nc = len(r.C) - 1
    size = orders.parameters + nc + data.experiments
    gram, score, first = np.zeros((size, size)), np.zeros(size), _first(orders)
    for k, record in enumerate(data.records):
        if len(record) <= first + 1:
            continue
        e = _errors(data, k, orders, r)
        rows = [lfilter([1.0], r.C, x) for x in _rows(data, k, orders)]
        rows += [lag[first:] for lag in _lags(lfilter([1.0], r.C, e), nc)]
        counts, place = _counted(data, k, orders), _place(orders, nc, record.origin)
        Z = np.array(rows)[:, counts]
        gram[np.ix_(place, place)] += Z @ Z.T
        score[place] += Z @ e[first:][counts]
    return gram, score
