"""From records and a number of modes to a network, with intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.network.model import Network, Share
from thermaltool.fitting.network.problem import Delays, Index, Problem
from thermaltool.fitting.network.search import METHOD, Found, search
from thermaltool.fitting.transfer.colour import error_colour
from thermaltool.signals.gauss_newton import inverse_of

# As many as a kind of response holds.
MOST_MODES = 6


def identify_network(data: TrainingData, modes: int, delays: Delays) -> Network:
    """Time constants that all outputs share, and the weights of each.

    Parameters
    ----------
    data : TrainingData
    modes : int
        Number of time constants.
    delays : tuple of tuple of float, for each output one for each input [s]

    Raises
    ------
    FitError
        Data that carry no transfer function (`TrainingData.check`), a delay beyond the record, more
        modes than the data carry.
    """
    data.check()
    if not 1 <= modes <= MOST_MODES:
        raise FitError(f"{modes} modes: it takes 1 to {MOST_MODES}")
    problem = Problem(data, delays)
    _carried(problem, modes)
    found = search(problem, modes)
    return _network(problem, found)


def _carried(problem: Problem, modes: int) -> None:
    data, need = problem.data, problem.linear_count(modes) + modes
    for k, (target, delays) in enumerate(zip(data.outputs, problem.delays, strict=True)):
        for name, delay in zip(data.inputs, delays, strict=True):
            if delay >= data.duration:
                raise FitError(
                    f"{name}: a delay of {delay:g} s is longer than the record "
                    f"({data.duration:g} s)"
                )
        rows = problem.rows(k)
        if rows < 2 * need:
            raise FitError(
                f"{target}: {rows} rows do not carry {modes} modes with {need} parameters: take "
                "fewer or more data"
            )


def _network(problem: Problem, found: Found) -> Network:
    data, n, m = problem.data, len(found.lags), len(problem.data.inputs)
    levels, centres = data.levels, problem.centres()
    covariances, variances = _covariances(problem, found)
    shares, zeros = [], []
    for k, f in enumerate(found.projected):
        weights = f.linear[: n * m].reshape(m, n)
        settled = f.linear[n * m : n * m + data.experiments] + centres[k]
        offsets = settled - levels @ weights.sum(1)
        zeros.append(settled)
        shares.append(Share(
            data.inputs, data.outputs[k], data.period, found.lags, weights, problem.delays[k],
            tuple(offsets.tolist()), variances[k], covariances[k], f.rows,
            n + n * m + data.experiments, f.loss, METHOD,
        ))  # fmt: skip
    return Network(tuple(shares), data.holds, levels, np.array(zeros), found.converged,
                   found.criterion)  # fmt: skip


def _covariances(problem: Problem, found: Found) -> tuple[list[Array], list[float]]:
    """Of ln τ and the weights of every output, and the variances of the errors.

    The estimator is linear in the errors near the optimum; their colour is an AR model for each
    output, and what drives them may be correlated between outputs (Ljung 1999, 9.4).
    """
    n, own = len(found.lags), len(found.lags) * len(problem.data.inputs)
    share = n / len(found.projected)
    freedom = [max(f.rows - len(f.linear) - share, 1.0) for f in found.projected]
    variances = [f.loss / free for f, free in zip(found.projected, freedom, strict=True)]
    scores = _Scores(problem, found)
    H = sum((f.reduced / v for f, v in zip(found.projected, variances, strict=True)),
            np.zeros((n, n)))  # fmt: skip
    bread = inverse_of(H)
    p = range(len(variances))
    # Covariance of the weighted score Σ_o d_o'e_o/σ_o² with that of one output.
    mixed = [sum((scores.slopes(k, j) / variances[j] for j in p), np.zeros((n, n))) for k in p]
    middle = sum((mixed[k] / variances[k] for k in p), np.zeros((n, n)))
    V = bread @ middle @ bread
    result = []
    for k, f in enumerate(found.projected):
        inverse = inverse_of(f.gram)
        crossed = sum((scores.columns(k, j) / variances[j] for j in p), 0 * f.by_lags)
        AQ = inverse @ crossed @ bread
        B = f.by_lags
        weights = inverse @ scores.own(k) @ inverse - AQ @ B.T - B @ AQ.T + B @ V @ B.T
        beside = AQ - B @ V
        whole = np.block([[V, beside[:own].T], [beside[:own], weights[:own, :own]]])
        # Errors of the fit are smaller than the noise by the parameters that they were taken for.
        result.append(whole * (f.rows / freedom[k]))
    return result, variances


class _Scores:
    """Sums of slopes and columns, coloured as the errors are.

    Rows are filtered backwards by the errors' AR models, which makes their products with white
    noise those of the rows with the errors.
    """

    def __init__(self, problem: Problem, found: Found) -> None:
        self.problem, self.found = problem, found
        spans, outputs = len(problem.data.records), len(found.projected)
        errors: list[list[Array]] = [[np.empty(0)] * spans for _ in range(outputs)]
        for k, j, error in problem.errors(found.lags, found.projected):
            errors[k][j] = error
        colours = [self._colour(each) for each in errors]
        self.filters = [ar for ar, _ in colours]
        white = [[lfilter(ar, [1.0], np.nan_to_num(e)) for e in each]
                 for ar, each in zip(self.filters, errors, strict=True)]  # fmt: skip
        rows = np.array([np.concatenate(each) for each in white])
        size = np.sqrt(np.maximum(np.sum(rows**2, axis=1), 1e-300))
        self.correlation = (rows / size[:, None]) @ (rows / size[:, None]).T
        self.deviation = np.sqrt([variance for _, variance in colours])
        self.filtered = [self._rows(k) for k in range(outputs)]

    def _colour(self, errors: Sequence[Array]) -> tuple[Array, float]:
        runs = [run for e in errors for run in runs_of(e)]
        found = error_colour(runs)
        if found is not None:
            return found
        return np.ones(1), float(np.mean(np.concatenate(runs) ** 2))

    def _rows(self, k: int) -> list[tuple[Array, Array]]:
        """For every span: what the linear columns leave of the slopes, and these columns."""
        lags, f, n = self.found.lags, self.found.projected[k], len(self.found.lags)
        m, result = len(self.problem.data.inputs), []
        for j, place in enumerate(self.problem.places(n, False)):
            there = self.problem.there(j)[k]
            rows = self.problem.columns(j, lags, self.problem.delays[k], slopes=True)
            rows = rows * there
            linear, slopes = rows[: len(place)], rows[len(place) :]
            sizes = np.concatenate([f.linear[place][: n * m], f.linear[place][n * m + 1 :]])
            whole = np.array([sizes[j::n] @ slopes[j::n] for j in range(n)])
            left = whole - f.by_lags[place].T @ linear
            result.append((self._coloured(k, left), self._coloured(k, linear)))
        return result

    def _coloured(self, k: int, rows: Array) -> Array:
        return np.asarray(lfilter([1.0], self.filters[k], rows[:, ::-1]))

    def slopes(self, k: int, j: int) -> Array:
        """Covariance of the slopes' products with the errors, of two outputs; shape (N, N)."""
        pairs = zip(self.filtered[k], self.filtered[j], strict=True)
        total = sum((a @ b.T for (a, _), (b, _) in pairs), np.zeros((len(self.found.lags),) * 2))
        return total * self._scale(k, j)

    def columns(self, k: int, j: int) -> Array:
        """Of the columns of output k with the slopes of output j; shape (L, N)."""
        total = np.zeros_like(self.found.projected[k].by_lags)
        for place, (_, a), (b, _) in zip(self._places(), self.filtered[k], self.filtered[j],
                                         strict=True):  # fmt: skip
            total[place] += a @ b.T
        return total * self._scale(k, j)

    def own(self, k: int) -> Array:
        """Of the columns of output k; shape (L, L)."""
        total = np.zeros_like(self.found.projected[k].gram)
        for place, (_, a) in zip(self._places(), self.filtered[k], strict=True):
            total[np.ix_(place, place)] += a @ a.T
        return total * self._scale(k, k)

    def _places(self) -> list[Index]:
        return self.problem.places(len(self.found.lags), False)

    def _scale(self, k: int, j: int) -> float:
        return float(self.correlation[k, j] * self.deviation[k] * self.deviation[j])


def runs_of(errors: Array) -> list[Array]:
    """Stretches without a hole."""
    there = np.flatnonzero(np.isfinite(errors))
    if not len(there):
        return []
    return [errors[part] for part in np.split(there, np.flatnonzero(np.diff(there) > 1) + 1)]
