"""Components of many inputs through lags, as weights of the inputs themselves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thermaltool.fitting.components.choose import Weighed
from thermaltool.fitting.components.problem import ComponentProblem, Weights
from thermaltool.fitting.components.reduction import Method, same_inputs
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.network.problem import mode_responses
from thermaltool.fitting.output_model import ContinuousTerm, OutputModel
from thermaltool.record import Record
from thermaltool.responses.rational import rational_kind
from thermaltool.signals.intervals import Estimate, normal_estimate, standard_error
from thermaltool.units import Hold

METHOD = "ridge by held-out blocks and by evidence, averaged"


@dataclass(frozen=True, kw_only=True)
class ComponentOutput(OutputModel):
    """Weights with which one output follows every input, directly and through lags.

    Attributes
    ----------
    time_constants : ndarray, shape (N,) [s], the slowest first
    weights : ndarray, shape (1 + N, m)
        Of the inputs themselves, then of each lag [unit of the output per unit of the input].
    covariance : ndarray, shape ((1 + N) · m, (1 + N) · m)
        Of `weights` in a row, what the ridge knows of them included.
    holds : tuple of "zero" or "first"
    reduction : {"pca", "pls", "none"}
    freedom : float
        How many weights the ridge leaves free.
    choices : tuple of Weighed
        Of which the weights are the mean, what counts most first.
    idle : tuple of str
        Inputs that never moved and are left out.
    same : tuple of tuple of str
        Inputs that are nearly equal but for zero and scale.
    """

    time_constants: Array
    weights: Array
    holds: tuple[Hold, ...]
    reduction: Method
    freedom: float
    choices: tuple[Weighed, ...]
    idle: tuple[str, ...] = ()
    same: tuple[tuple[str, ...], ...] = ()

    @property
    def redundant(self) -> bool:
        return len(self.names) > 2

    @property
    def order(self) -> int:
        return len(self.time_constants)

    @property
    def parameters(self) -> int:
        return round(self.freedom) + len(self.zeros)

    @property
    def sample_delays(self) -> tuple[int, ...]:
        return (0,) * len(self.names)

    def _place(self, k: int) -> NDArray[np.intp]:
        return np.arange(len(self.weights)) * len(self.names) + k

    def gain(self, k: int) -> Estimate:
        own = self._place(k)
        slope = np.zeros(self.weights.size)
        slope[own] = 1.0
        return normal_estimate(
            float(self.weights[:, k].sum()), standard_error(slope, self.covariance)
        )

    def weight_estimates(self, k: int) -> dict[str, Estimate]:
        """Weights of input k by the names of the model file: K0 of itself, then of each lag."""
        own = self._place(k)
        errors = np.sqrt(np.maximum(np.diag(self.covariance)[own], 0.0)).tolist()
        return {
            f"K{j}": normal_estimate(float(w), error)
            for j, (w, error) in enumerate(zip(self.weights[:, k], errors, strict=True))
        }

    def named(self) -> Iterator[tuple[str, Estimate]]:
        """Weights by the names of the model file, input by input."""
        for k, name in enumerate(self.names):
            own = f"[{name}]" if len(self.names) > 1 else ""
            for label, estimate in self.weight_estimates(k).items():
                yield label + own, estimate

    def term(self, k: int) -> ContinuousTerm:
        n, own = self.order, self._place(k)
        values = {f"tau{j + 1}": float(tau) for j, tau in enumerate(self.time_constants)}
        values |= {f"K{j}": float(w) for j, w in enumerate(self.weights[:, k])}
        response = rational_kind(n, 0, True)(**values)
        names = tuple(f"K{j}" for j in range(n + 1))
        return ContinuousTerm(response, covariance=self.covariance[np.ix_(own, own)], names=names)

    def residuals(self, data: TrainingData) -> Iterator[tuple[Array, Array]]:
        for record in data.records:
            yield record.column(self.target) - self.simulate(record), record.matrix(self.names)

    def _from_rest(self, record: Record, levels: Array) -> Array:
        inputs = record.matrix(self.names)
        y = self.weights[0] @ (inputs - levels[:, None])
        for i, u in enumerate(inputs):
            lagged = mode_responses(
                record.elapsed, u[None], levels[i : i + 1], self.time_constants, (0.0,),
                self.holds[i : i + 1],
            )  # fmt: skip
            y = y + self.weights[1:, i] @ lagged
        return np.asarray(y)

    def _free_responses(self, record: Record) -> Array:
        return np.exp(-record.elapsed / self.time_constants[:, None])

    def _known(self, record: Record) -> NDArray[np.bool_]:
        return np.ones(len(record), bool)


def output_of(
    problem: ComponentProblem,
    found: Weights,
    choices: tuple[Weighed, ...] = (),
    idle: tuple[str, ...] = (),
) -> ComponentOutput:
    """The model that weights are, on all rows of the data.

    Parameters
    ----------
    problem : ComponentProblem
    found : Weights
    choices : tuple of Weighed
        Of which it is the mean.
    idle : tuple of str
        Inputs that were left out.
    """
    data = problem.data
    model = ComponentOutput(
        names=data.inputs,
        target=data.outputs[0],
        dt=data.period,
        levels=data.levels,
        zeros=tuple(found.offsets.tolist()),
        sigma2=0.0,
        covariance=found.covariance,
        method=METHOD,
        converged=True,
        rows=data.rows,
        loss=0.0,
        time_constants=problem.times[list(found.choice.lags)],
        weights=found.values,
        holds=data.holds,
        reduction=problem.reduction.method,
        freedom=found.freedom,
        choices=choices,
        idle=idle,
        same=same_inputs(data),
    )
    return _with_errors(model, data)


def _with_errors(model: ComponentOutput, data: TrainingData) -> ComponentOutput:
    errors = data.output() - model.run(data)
    loss = float(np.nansum(errors**2))
    rows = int(np.isfinite(errors).sum())
    return replace(model, loss=loss, sigma2=loss / max(rows - model.parameters, 1), rows=rows)
