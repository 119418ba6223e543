"""Shared first-order modes: what they mean for every output, and how sure they are."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from thermaltool.fitting.data import Array, TrainingData, Zero
from thermaltool.fitting.network.problem import Delays, known_rows, mode_responses
from thermaltool.record import Record
from thermaltool.responses import Response
from thermaltool.responses.modes import Hold
from thermaltool.responses.rational import KINDS
from thermaltool.signals.agreement import Agreement, agreement
from thermaltool.signals.criteria import Criteria
from thermaltool.signals.gauss_newton import solve
from thermaltool.signals.intervals import Estimate, log_normal_estimate, normal_estimate

# Upper over lower end of an interval from which the data do not determine a time constant.
MAX_INTERVAL_RATIO = 10.0


@dataclass(frozen=True)
class NetworkOutput:
    """Weights with which one output follows the shared modes.

    Attributes
    ----------
    names : tuple of str
        Inputs.
    target : str
    dt : float [s]
    time_constants : ndarray, shape (N,) [s], the slowest first
    weights : ndarray, shape (m, N)
        Steady state of each mode per unit of each input.
    delays : tuple of float, one for each input [s]
    offsets : tuple of float, one for each experiment
        Output at inputs of zero.
    sigma2 : float [unit²]
        Variance of the errors.
    covariance : ndarray, shape (N + m · N, N + m · N)
        Of the logarithms of the time constants, then of the weights input by input.
    rows : int
    parameters : int
    loss : float [unit²]
    method : str
    """

    names: tuple[str, ...]
    target: str
    dt: float
    time_constants: Array
    weights: Array
    delays: tuple[float, ...]
    offsets: tuple[float, ...]
    sigma2: float
    covariance: Array
    rows: int
    parameters: int
    loss: float
    method: str

    @property
    def modes(self) -> int:
        """Number of time constants, N."""
        return len(self.time_constants)

    @property
    def criteria(self) -> Criteria:
        """Information criteria of this output's fit."""
        return Criteria.of_squares(self.loss, self.rows, self.parameters)

    def time_constant_estimates(self) -> tuple[Estimate, ...]:
        """Time constants with intervals that are symmetric in the logarithm [s]."""
        found = []
        for tau, variance in zip(
            self.time_constants.tolist(), np.diag(self.covariance), strict=False
        ):
            found.append(log_normal_estimate(tau, math.sqrt(max(float(variance), 0.0))))
        return tuple(found)

    def weight_estimates(self, k: int) -> tuple[Estimate, ...]:
        """Weights of every mode in the response to input k [unit of the output per unit of it]."""
        at = self.modes * (1 + k)
        variances = np.diag(self.covariance)[at : at + self.modes]
        errors = np.sqrt(np.maximum(variances, 0.0))
        return tuple(
            normal_estimate(float(w), float(error))
            for w, error in zip(self.weights[k], errors, strict=True)
        )

    def gain(self, k: int) -> Estimate:
        """Steady state of the output per unit of input k: the sum of its weights."""
        at = slice(self.modes * (1 + k), self.modes * (2 + k))
        error = math.sqrt(max(float(self.covariance[at, at].sum()), 0.0))
        return normal_estimate(float(self.weights[k].sum()), error)

    def named(self) -> Iterator[tuple[str, Estimate]]:
        """Time constants and weights by the names of the model file, input by input."""
        for j, e in enumerate(self.time_constant_estimates()):
            yield f"tau{j + 1}", e
        for k, name in enumerate(self.names):
            own = f"[{name}]" if len(self.names) > 1 else ""
            for j, e in enumerate(self.weight_estimates(k)):
                yield f"K{j + 1}{own}", e

    def response(self, k: int) -> Response:
        """Response to input k, for a model document."""
        values = {f"tau{j + 1}": float(tau) for j, tau in enumerate(self.time_constants)}
        values |= {f"K{j + 1}": float(w) for j, w in enumerate(self.weights[k])}
        response: Response = KINDS[self.modes, 0](**values, delay=self.delays[k])
        return response

    def response_covariance(self, k: int) -> tuple[Array, tuple[str, ...]]:
        """Covariance of the parameters of `response`, shape (2N, 2N), and their names."""
        n = self.modes
        place = np.r_[0:n, n * (1 + k) : n * (2 + k)]
        scale = np.concatenate([self.time_constants, np.ones(n)])
        names = (*(f"tau{j + 1}" for j in range(n)), *(f"K{j + 1}" for j in range(n)))
        return self.covariance[np.ix_(place, place)] * np.outer(scale, scale), names


@dataclass(frozen=True)
class Network:
    """Network of modes behind all outputs, and what a free run needs.

    Attributes
    ----------
    outputs : tuple of NetworkOutput, one for each output
    holds : tuple of "zero" or "first"
        Of each input.
    levels : ndarray, shape (experiments, m)
        Inputs about which each experiment was fitted, and
    zeros : ndarray, shape (p, experiments)
        the outputs where they stand for ever.
    converged : bool
    criterion : float
        ½ Σ n ln(loss/n) over the outputs.
    """

    outputs: tuple[NetworkOutput, ...]
    holds: tuple[Hold, ...]
    levels: Array
    zeros: Array
    converged: bool
    criterion: float

    @property
    def time_constants(self) -> Array:
        """Time constants, shape (N,), the slowest first [s]."""
        return self.outputs[0].time_constants

    @property
    def modes(self) -> int:
        """Number of time constants."""
        return len(self.time_constants)

    @property
    def parameters(self) -> int:
        """Everything that was fitted: time constants once, weights and offsets of each output."""
        return self.modes + sum(output.parameters - self.modes for output in self.outputs)

    @property
    def delays(self) -> Delays:
        """Dead times, for each output one for each input [s]."""
        return tuple(s.delays for s in self.outputs)

    def undetermined(self) -> tuple[Estimate, ...]:
        """Time constants that the data leave undetermined."""
        each = self.outputs[0].time_constant_estimates()
        return tuple(e for e in each if e.high > MAX_INTERVAL_RATIO * e.low)

    def simulate(self, record: Record, zero: Zero = "fitted") -> Array:
        """Free run over a record; the state at its start is estimated from it.

        Parameters
        ----------
        record : Record
        zero : Zero

        Returns
        -------
        y : ndarray, shape (p, n)
            NaN where a delayed input is not in the record.
        """
        at, elapsed = record.origin if zero == "fitted" else 0, record.elapsed
        inputs = record.matrix(self.outputs[0].names)
        result = np.full((len(self.outputs), len(record)), np.nan)
        decays = np.exp(-elapsed / self.time_constants[:, None])
        for k, output in enumerate(self.outputs):
            measured = record.column(output.target)
            modes = mode_responses(
                elapsed, inputs, self.levels[at], self.time_constants, output.delays, self.holds
            )
            y = output.weights.ravel() @ modes + self.zeros[k, at]
            if zero == "mean":
                y += np.mean(output.offsets) - output.offsets[at]
            known = known_rows(record, output.delays)
            counted = known & np.isfinite(measured)
            free = [] if record.at_rest else [decays]
            columns = np.vstack([*free, *([np.ones((1, len(y)))] if zero == "free" else [])] or
                                [np.zeros((0, len(y)))])  # fmt: skip
            if len(columns) and int(counted.sum()) > len(columns):
                own = columns[:, counted]
                left = measured[counted] - y[counted]
                y = y + solve(own @ own.T, own @ left) @ columns
            result[k] = np.where(known, y, np.nan)
        return result

    def fit(self, data: TrainingData, zeros: Sequence[Zero] | None = None) -> list[Agreement]:
        """Agreement of the free run of every output with it, over all records.

        Parameters
        ----------
        data : TrainingData
        zeros : sequence of Zero, one for each output, optional
            Default: those of the fit.
        """
        computed = self.run(data, zeros)
        return [agreement(data.output(k), computed[k]) for k in range(len(self.outputs))]

    def run(self, data: TrainingData, zeros: Sequence[Zero] | None = None) -> Array:
        """Free runs over all records in a row, shape (p, n); parameters as `fit`."""
        fitted: list[Zero] = ["fitted"]
        each = zeros or fitted * len(self.outputs)
        runs = {z: np.hstack([self.simulate(s, z) for s in data.records]) for z in set(each)}
        return np.array([runs[z][k] for k, z in enumerate(each)])
