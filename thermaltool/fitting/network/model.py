"""Shared first-order modes: what they mean for every output, and how sure they are."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.error_model import known_runs
from thermaltool.fitting.joint import JointModel
from thermaltool.fitting.network.problem import known_rows, mode_responses
from thermaltool.fitting.output_model import ContinuousTerm, OutputModel
from thermaltool.record import Record
from thermaltool.responses import Response
from thermaltool.responses.modes import Hold
from thermaltool.responses.rational import rational_kind
from thermaltool.signals.intervals import Estimate, log_normal_estimate, normal_estimate

# Upper over lower end of an interval from which the data do not determine a time constant.
MAX_INTERVAL_RATIO = 10.0


@dataclass(frozen=True, kw_only=True)
class NetworkOutput(OutputModel):
    """Weights with which one output follows the shared modes.

    Attributes
    ----------
    time_constants : ndarray, shape (N,) [s], the slowest first
    weights : ndarray, shape (m, N)
        Steady state of each mode per unit of each input.
    delays : tuple of float, one for each input [s]
    holds : tuple of "zero" or "first"
        Of each input.
    covariance : ndarray, shape (p, p)
        Of the logarithms of the time constants, then of the weights input by input, then of
        `direct`.
    direct : ndarray, shape (m,), or (0,) without feedthrough
        Of every input.
    """

    time_constants: Array
    weights: Array
    delays: tuple[float, ...]
    holds: tuple[Hold, ...]
    direct: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def has_direct(self) -> bool:
        """Whether the output follows the inputs of the same row."""
        return bool(len(self.direct))

    @property
    def modes(self) -> int:
        """Number of time constants, N."""
        return len(self.time_constants)

    @property
    def order(self) -> int:
        return self.modes

    @property
    def parameters(self) -> int:
        return self.modes + self.weights.size + len(self.direct) + len(self.zeros)

    @property
    def sample_delays(self) -> tuple[int, ...]:
        return tuple(round(delay / self.dt) + (hold == "zero" and not self.has_direct)
                     for delay, hold in zip(self.delays, self.holds, strict=True))  # fmt: skip

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
        at = self._gains(k)
        error = math.sqrt(max(float(self.covariance[np.ix_(at, at)].sum()), 0.0))
        value = self.weights[k].sum() + self.direct[k : k + 1].sum()
        return normal_estimate(float(value), error)

    def _gains(self, k: int) -> NDArray[np.intp]:
        """Weights of input k, and its feedthrough, among the parameters."""
        n, m = self.modes, len(self.names)
        own = np.arange(n * (1 + k), n * (2 + k))
        return np.append(own, n * (1 + m) + k) if self.has_direct else own

    def direct_estimate(self, k: int) -> Estimate:
        """Feedthrough of input k [unit of the output per unit of it]; the model has it."""
        at = self._gains(k)[-1]
        error = math.sqrt(max(float(self.covariance[at, at]), 0.0))
        return normal_estimate(float(self.direct[k]), error)

    def named(self) -> Iterator[tuple[str, Estimate]]:
        """Time constants and weights by the names of the model file, input by input."""
        for j, e in enumerate(self.time_constant_estimates()):
            yield f"tau{j + 1}", e
        for k, name in enumerate(self.names):
            own = f"[{name}]" if len(self.names) > 1 else ""
            for j, e in enumerate(self.weight_estimates(k)):
                yield f"K{j + 1}{own}", e
            if self.has_direct:
                yield f"K0{own}", self.direct_estimate(k)

    def response(self, k: int) -> Response:
        """Response to input k, for a model document."""
        values = {f"tau{j + 1}": float(tau) for j, tau in enumerate(self.time_constants)}
        values |= {f"K{j + 1}": float(w) for j, w in enumerate(self.weights[k])}
        values |= {"K0": float(self.direct[k])} if self.has_direct else {"delay": self.delays[k]}
        response: Response = rational_kind(self.modes, 0, self.has_direct)(**values)
        return response

    def response_covariance(self, k: int) -> tuple[Array, tuple[str, ...]]:
        """Covariance of the parameters of `response`, and their names."""
        n, gains = self.modes, self._gains(k)
        place = np.concatenate([np.arange(n), gains])
        scale = np.concatenate([self.time_constants, np.ones(len(gains))])
        names = (*(f"tau{j + 1}" for j in range(n)), *(f"K{j + 1}" for j in range(n)))
        names += ("K0",) * self.has_direct
        return self.covariance[np.ix_(place, place)] * np.outer(scale, scale), names

    def term(self, k: int) -> ContinuousTerm:
        covariance, names = self.response_covariance(k)
        return ContinuousTerm(self.response(k), covariance=covariance, names=names)

    def undetermined(self) -> tuple[Estimate, ...]:
        """Time constants that the data leave undetermined."""
        each = self.time_constant_estimates()
        return tuple(e for e in each if e.high > MAX_INTERVAL_RATIO * e.low)

    def residuals(self, data: TrainingData) -> Iterator[tuple[Array, Array]]:
        for record in data.records:
            error, inputs = (
                record.column(self.target) - self.simulate(record),
                record.matrix(self.names),
            )
            for run in known_runs(error):
                yield error[run], inputs[:, run]

    def _from_rest(self, record: Record, levels: Array) -> Array:
        modes = mode_responses(
            record.elapsed, record.matrix(self.names), levels, self.time_constants, self.delays,
            self.holds,
        )  # fmt: skip
        y = self.weights.ravel() @ modes
        if self.has_direct:
            y = y + self.direct @ (record.matrix(self.names) - levels[:, None])
        return np.asarray(y)

    def _free_responses(self, record: Record) -> Array:
        return np.exp(-record.elapsed / self.time_constants[:, None])

    def _known(self, record: Record) -> NDArray[np.bool_]:
        return known_rows(record, self.delays)


@dataclass(frozen=True)
class Network(JointModel[NetworkOutput]):
    """Network of modes behind all outputs."""

    @property
    def time_constants(self) -> Array:
        """Time constants, shape (N,), the slowest first [s]."""
        return self.outputs[0].time_constants

    @property
    def modes(self) -> int:
        """Number of time constants."""
        return len(self.time_constants)

    @property
    def has_direct(self) -> bool:
        """Whether outputs follow the inputs of the same row."""
        return self.outputs[0].has_direct
