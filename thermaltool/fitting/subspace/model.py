"""Shared poles, real or complex: what they mean for every output, and how sure they are."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.error_model import known_runs
from thermaltool.fitting.joint import JointModel
from thermaltool.fitting.output_model import ContinuousTerm, OutputModel
from thermaltool.fitting.subspace.sections import PoleSection, all_poles, combined
from thermaltool.fitting.subspace.term import (
    kind_of,
    response_slopes,
    response_values,
    searched_names,
)
from thermaltool.record import Record
from thermaltool.signals.intervals import (
    Estimate,
    log_normal_estimate,
    normal_estimate,
    standard_error,
)
from thermaltool.units import Hold

# Upper over lower end of an interval from which the data do not determine a time constant.
MAX_INTERVAL_RATIO = 10.0


@dataclass(frozen=True, kw_only=True)
class SubspaceOutput(OutputModel):
    """Weights with which one output follows poles that all outputs share.

    Attributes
    ----------
    sections : tuple of PoleSection
    weights : ndarray, shape (m · N,)
        Section by section, in each input by input.
    direct : ndarray, shape (m,), or (0,) without feedthrough
        Of every input.
    holds : tuple of "zero" or "first"
        Of each input.
    covariance : ndarray, shape (p, p)
        Of the logarithms of the sections, then of `weights`, then of `direct`.
    participations : ndarray, shape (N, m), or None
        Combination of the inputs that each pole takes, the same for all outputs and of length one,
        where the weights are those of such a model.
    """

    sections: tuple[PoleSection, ...]
    weights: Array
    direct: Array
    holds: tuple[Hold, ...]
    participations: Array | None = None

    @property
    def order(self) -> int:
        return sum(section.states for section in self.sections)

    @property
    def has_direct(self) -> bool:
        """Whether the output follows the inputs of the same row."""
        return bool(len(self.direct))

    @property
    def parameters(self) -> int:
        return self.order + len(self.weights) + len(self.direct) + len(self.zeros)

    @property
    def sample_delays(self) -> tuple[int, ...]:
        return tuple(int(hold == "zero" and not self.has_direct) for hold in self.holds)

    def places(self, k: int) -> NDArray[np.intp]:
        """Weights of input k among all, section by section."""
        m, states = len(self.names), [section.states for section in self.sections]
        edges = np.cumsum([0, *states])[:-1]
        return np.concatenate(
            [m * a + n * k + np.arange(n) for a, n in zip(edges, states, strict=True)]
        ).astype(np.intp)

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles in s, the slowest first [1/s]."""
        poles = all_poles(self.sections) / self.dt
        return poles[np.argsort(-poles.real, kind="stable")]

    def time_constant_estimates(self) -> tuple[Estimate, ...]:
        """−1/Re s of every pole in the order of `poles` [s]; symmetric in the logarithm.

        Of a pair it is the decay of its envelope, twice.
        """
        slopes, values, at = [], [], 0
        for section in self.sections:
            n = section.states
            for k, p in enumerate(section.poles):
                slope = np.zeros(len(self.covariance))
                # ln τ = −ln ω − ln ζ of a pair; of real poles −ln ω ± arcosh ζ, a root in ζ = 1.
                slope[at] = -1.0
                if section.is_pair:
                    slope[at + 1] = -1.0
                elif n == 2:
                    zeta = math.exp(section.theta[1])
                    slope[at + 1] = (1 - 2 * k) * zeta / math.sqrt(max(zeta**2 - 1, 1e-12))
                slopes.append(slope)
                values.append(-self.dt / float(p.real))
            at += n
        order = np.argsort(-np.array(values), kind="stable")
        return tuple(
            log_normal_estimate(values[k], standard_error(slopes[k], self.covariance))
            for k in order
        )

    def gain(self, k: int) -> Estimate:
        """Steady state of the output per unit of input k."""
        slope = np.zeros(len(self.covariance))
        # The first state of each section has a steady state of one, the second none.
        edges = np.cumsum([0, *(section.states for section in self.sections)])[:-1]
        slope[self.order + self.places(k)[edges]] = 1.0
        if self.has_direct:
            slope[self.order + len(self.weights) + k] = 1.0
        given = np.concatenate([np.zeros(self.order), self.weights, self.direct])
        return normal_estimate(float(slope @ given), standard_error(slope, self.covariance))

    def named(self) -> Iterator[tuple[str, Estimate]]:
        """Parameters by the names of the model file: those of the poles, then input by input."""
        values, (covariance, names) = self._values(0), self.response_covariance(0)
        for j, name in enumerate(names[: self.order]):
            error = math.sqrt(max(float(covariance[j, j]), 0.0))
            yield name, log_normal_estimate(values[name], error / values[name])
        for k, name in enumerate(self.names):
            own = f"[{name}]" if len(self.names) > 1 else ""
            for label, estimate in self.gain_estimates(k).items():
                yield label + own, estimate

    @property
    def oscillations(self) -> tuple[tuple[float, float], ...]:
        """Undamped angular frequency [rad/s] and damping ratio of every pair."""
        return tuple((float(abs(p)), float(-p.real / abs(p))) for p in self.poles if p.imag > 0)

    def gain_estimates(self, k: int) -> dict[str, Estimate]:
        """Weights in the response to input k by name [unit of the output per unit of it]."""
        values, (covariance, names) = self._values(k), self.response_covariance(k)
        errors = np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist()
        shared = searched_names(self.sections)
        return {
            name: normal_estimate(values[name], error)
            for name, error in zip(names, errors, strict=True)
            if name not in shared
        }

    def _values(self, k: int) -> dict[str, float]:
        direct = float(self.direct[k]) if self.has_direct else None
        return response_values(self.sections, self.weights[self.places(k)], direct, self.dt)

    def response_covariance(self, k: int) -> tuple[Array, tuple[str, ...]]:
        """Covariance of the parameters of the response to input k, and their names."""
        return self._covariances[k]

    @cached_property
    def _covariances(self) -> tuple[tuple[Array, tuple[str, ...]], ...]:
        found, n = [], self.order
        kind = kind_of(self.sections, self.has_direct)
        names = (*kind.searched, *kind.gains)  # type: ignore[attr-defined]
        for k in range(len(self.names)):
            own = self.places(k)
            place = [*range(n), *(n + own)]
            direct = None
            if self.has_direct:
                direct = float(self.direct[k])
                place.append(n + len(self.weights) + k)
            turn = response_slopes(self.sections, self.weights[own], direct, self.dt, names)
            found.append((turn @ self.covariance[np.ix_(place, place)] @ turn.T, names))
        return tuple(found)

    def term(self, k: int) -> ContinuousTerm:
        covariance, names = self.response_covariance(k)
        response = kind_of(self.sections, self.has_direct)(**self._values(k))
        return ContinuousTerm(response, covariance=covariance, names=names)

    def undetermined(self) -> tuple[Estimate, ...]:
        """Time constants that the data leave undetermined."""
        each = self.time_constant_estimates()
        return tuple(e for e in each if e.high > MAX_INTERVAL_RATIO * e.low)

    def residuals(self, data: TrainingData) -> Iterator[tuple[Array, Array]]:
        for record in data.records:
            error, u = record.column(self.target) - self.simulate(record), record.matrix(self.names)
            for run in known_runs(error):
                yield error[run], u[:, : run.stop]

    def _from_rest(self, record: Record, levels: Array) -> Array:
        inputs = record.matrix(self.names)
        # An input has stood at its first value before the record.
        driven, stood = inputs - inputs[:, :1], inputs[:, 0] - levels
        y = np.full(len(record), sum(self.gain(k).value * u for k, u in enumerate(stood)))
        edges = np.cumsum([0, *(len(self.names) * section.states for section in self.sections)])
        for section, (a, b) in zip(self.sections, pairwise(edges.tolist()), strict=True):
            y += combined(section, driven, self.holds, self.weights[None, a:b])[0]
        return np.asarray(y + self.direct @ driven if self.has_direct else y)

    def _free_responses(self, record: Record) -> Array:
        return np.vstack([section.free(len(record)) for section in self.sections])

    def _known(self, record: Record) -> NDArray[np.bool_]:
        return np.ones(len(record), bool)


@dataclass(frozen=True)
class Subspace(JointModel[SubspaceOutput]):
    """Poles behind all outputs."""

    @property
    def order(self) -> int:
        """Number of poles."""
        return self.outputs[0].order

    @property
    def has_direct(self) -> bool:
        """Whether outputs follow the inputs of the same row."""
        return self.outputs[0].has_direct

    @property
    def sections(self) -> tuple[PoleSection, ...]:
        """The poles as sections."""
        return self.outputs[0].sections

    @property
    def participations(self) -> Array | None:
        """Combination of the inputs that each pole takes, shape (N, m), where it takes one."""
        return self.outputs[0].participations
