"""Parameter-varying models: what they mean for every output, and how sure they are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thermaltool.effects.effect import Effect
from thermaltool.fitting.data import Array, Split, TrainingData
from thermaltool.fitting.error_model import known_runs
from thermaltool.fitting.joint import JointModel
from thermaltool.fitting.lpv.form import LpvForm
from thermaltool.fitting.lpv.problem import Scales, decay_columns, drive_columns, lag_columns
from thermaltool.fitting.output_model import ContinuousTerm, OutputModel
from thermaltool.record import Record
from thermaltool.responses.rational import rational_kind
from thermaltool.signals.intervals import (
    Estimate,
    log_normal_estimate,
    normal_estimate,
    standard_error,
)
from thermaltool.units import Reference

# Half the step by which rates follow what is searched.
DIFFERENCE = 1e-6


def settled(data: TrainingData, references: tuple[Reference, ...]) -> TrainingData:
    """The data, at rest only what begins with every input at what it counts from.

    Parameters
    ----------
    data : TrainingData
    references : tuple of "first" or float
    """

    def at_rest(record: Record, u: Array) -> bool:
        each = zip(u[:, 0], references, strict=True)
        return record.at_rest and all(rest == "first" or v == rest for v, rest in each)

    kept = (
        replace(record, at_rest=at_rest(record, u))
        for record, u in zip(data.records, data.u, strict=True)
    )
    return replace(data, records=tuple(kept))


@dataclass(frozen=True, kw_only=True)
class LpvOutput(OutputModel):
    """Gains with which one output follows lags whose rate goes by a level.

    Attributes
    ----------
    form : LpvForm
    scales : Scales
    theta : ndarray, shape (searched,)
        As `LpvForm.time_constants`, `level_rates`, `exponents`.
    weights : ndarray, shape (modes + direct, m, shares)
        Of every mode, then direct ones.
    covariance : ndarray, shape (p, p)
        Of `theta`, then of `weights` in a row.
    """

    form: LpvForm
    scales: Scales
    theta: Array
    weights: Array

    @property
    def is_linear(self) -> bool:
        return False

    @property
    def time_constants(self) -> Array:
        """At the first level, shape (modes,), the slowest first [s]."""
        return self.form.time_constants(self.theta)

    @property
    def order(self) -> int:
        return self.form.modes

    @property
    def parameters(self) -> int:
        return len(self.theta) + self.weights.size + len(self.zeros)

    @property
    def sample_delays(self) -> tuple[int, ...]:
        each = zip(self.form.delays, self.scales.holds, strict=True)
        return tuple(k + (hold == "zero" and not self.form.direct) for k, hold in each)

    def _place(self, k: int, level: int) -> NDArray[np.intp]:
        """Gains of input k at a level among all parameters: direct ones last."""
        flat = np.arange(self.weights.size).reshape(self.weights.shape)
        return len(self.theta) + flat[:, k, level]

    def gain(self, k: int) -> Estimate:
        """Steady state of the output per unit of input k at the first level."""
        return self.level_gain(k, 0)

    def level_gain(self, k: int, level: int) -> Estimate:
        """Steady state of the output per unit of what input k makes act, at a level.

        Parameters
        ----------
        k, level : int
        """
        share = level if self.form.gain else 0

        def value(theta: Array) -> Array:
            rates = self.form.level_rates(theta)
            rate = rates[level] if len(rates) else 0.0
            return 1.0 / (1.0 + self.form.time_constants(theta) * rate)

        steady = np.append(value(self.theta), np.ones(int(self.form.direct)))
        weights = self.weights[:, k, share]
        slope = np.zeros(len(self.covariance))
        slope[self._place(k, share)] = steady
        for j in range(len(self.theta)):
            step = DIFFERENCE * np.eye(len(self.theta))[j]
            moved = (value(self.theta + step) - value(self.theta - step)) / (2 * DIFFERENCE)
            slope[j] = weights[: self.order] @ moved
        error = standard_error(slope, self.covariance)
        return normal_estimate(float(weights @ steady), error)

    def time_constant_estimates(self) -> tuple[Estimate, ...]:
        """At the first level, with intervals that are symmetric in the logarithm [s]."""
        errors = np.sqrt(np.maximum(np.diag(self.covariance), 0.0)).tolist()
        each = zip(self.time_constants.tolist(), errors, strict=False)
        return tuple(log_normal_estimate(tau, error) for tau, error in each)

    def rate_estimates(self) -> tuple[Estimate, ...]:
        """By how much all modes decay faster at each level [1/s]; empty without `loss`."""
        if not self.form.loss:
            return ()
        covariance = self._rate_covariance()
        rates = self.form.level_rates(self.theta).tolist()
        return tuple(
            normal_estimate(rate, float(np.sqrt(max(covariance[k, k], 0.0))))
            for k, rate in enumerate(rates)
        )

    def _rate_covariance(self) -> Array:
        n = len(self.theta)
        slopes = np.zeros((len(self.form.levels), n))
        for j in range(n):
            step = DIFFERENCE * np.eye(n)[j]
            ahead, behind = (self.form.level_rates(self.theta + s * step) for s in (1, -1))
            slopes[:, j] = (ahead - behind) / (2 * DIFFERENCE)
        return np.asarray(slopes @ self.covariance[:n, :n] @ slopes.T)

    def exponent_estimates(self) -> dict[str, Estimate]:
        """Of every input that acts by a power, symmetric in the logarithm."""
        at, errors = self.form.modes + self.form.rates, np.diag(self.covariance)
        return {
            name: log_normal_estimate(value, float(np.sqrt(max(errors[at + k], 0.0))))
            for k, (name, value) in enumerate(self.form.exponents(self.theta).items())
        }

    def weight_estimates(self, k: int, share: int) -> dict[str, Estimate]:
        """Gains of input k at a level by the names of the model file.

        Parameters
        ----------
        k, share : int
        """
        own = self._place(k, share)
        errors = np.sqrt(np.maximum(np.diag(self.covariance)[own], 0.0)).tolist()
        labels = [*(f"K{j + 1}" for j in range(self.order)), *("K0",) * self.form.direct]
        values = self.weights[:, k, share].tolist()
        return {
            label: normal_estimate(value, error)
            for label, value, error in zip(labels, values, errors, strict=True)
        }

    def named(self) -> Iterator[tuple[str, Estimate]]:
        """Time constants, rates, exponents and gains, these by input and level."""
        for j, e in enumerate(self.time_constant_estimates()):
            yield f"tau{j + 1}", e
        for k, e in list(enumerate(self.rate_estimates()))[1:]:
            yield f"rate{k}[{self.form.channel}]", e
        for name, e in self.exponent_estimates().items():
            yield f"exponent[{name}]", e
        for k, name in enumerate(self.names):
            for share in range(self.form.shares):
                at = f", {self.form.levels[share]:.6g}" if self.form.gain else ""
                for label, e in self.weight_estimates(k, share).items():
                    yield f"{label}[{name}{at}]", e

    def term(self, k: int) -> ContinuousTerm:
        return self.level_terms(k)[0]

    def level_terms(self, k: int) -> tuple[ContinuousTerm, ...]:
        found, n = [], self.order
        scale = np.append(self.time_constants, np.ones(len(self.weights)))
        for share, band in enumerate(self.form.bands()):
            values = {f"tau{j + 1}": float(tau) for j, tau in enumerate(self.time_constants)}
            values |= {name: e.value for name, e in self.weight_estimates(k, share).items()}
            place = np.concatenate([np.arange(n), self._place(k, share)])
            covariance = self.covariance[np.ix_(place, place)] * np.outer(scale, scale)
            response = rational_kind(n, 0, self.form.direct)(**values)
            found.append(ContinuousTerm(response, covariance=covariance, names=tuple(values),
                                        band=band))  # fmt: skip
        return tuple(found)

    @property
    def effects(self) -> tuple[Effect, ...]:
        form, n = self.form, self.form.modes + self.form.rates
        found = form.late_effects(self.names, self.dt)
        for k, name in enumerate(form.powers):
            effect, exponent = form.power(name, self.theta), form.exponents(self.theta)[name]
            if effect is not None:
                covariance = np.zeros((2, 2))
                covariance[0, 0] = exponent**2 * self.covariance[n + k, n + k]
                found.append(replace(effect, covariance=covariance))
        loss = form.loss_effect(self.theta)
        if loss is not None:
            covariance = np.zeros((2 * len(form.levels),) * 2)
            covariance[1::2, 1::2] = self._rate_covariance()
            found.append(replace(loss, covariance=covariance))
        return tuple(found)

    def residuals(self, data: TrainingData) -> Iterator[tuple[Array, Array]]:
        for record in data.records:
            error, inputs = (
                record.column(self.target) - self.simulate(record),
                record.matrix(self.names),
            )
            for run in known_runs(error):
                yield error[run], inputs[:, run]

    def _driven(self, record: Record) -> tuple[Array, Array]:
        rests = self.scales.rests(record)
        return drive_columns(self.form, self.scales, self.theta, record, rests)

    def _from_rest(self, record: Record, levels: Array) -> Array:
        # By what inputs count from, whatever the levels: no other model has the same response.
        columns = lag_columns(self.form, self.scales, self.theta, *self._driven(record))
        return np.asarray(self.weights.ravel() @ columns)

    def _free_responses(self, record: Record) -> Array:
        return decay_columns(self.form, self.theta, record, self._driven(record)[1])

    def _known(self, record: Record) -> NDArray[np.bool_]:
        return np.arange(len(record)) >= max(self.form.delays)


@dataclass(frozen=True)
class Lpv(JointModel[LpvOutput]):
    """Parameter-varying modes behind all outputs.

    Attributes
    ----------
    references : tuple of "first" or float
        What inputs count from.
    """

    references: tuple[Reference, ...]

    @property
    def form(self) -> LpvForm:
        """The structure that was fitted."""
        return self.outputs[0].form

    @property
    def theta(self) -> Array:
        """What is searched, shape (searched,)."""
        return self.outputs[0].theta

    def carried_on(self, split: Split) -> Array:
        whole = settled(split.data, self.references)
        return super().carried_on(Split(whole, split.starts, split.stops))
