"""A fitted network as a model document: every input to every reading as a sum of lags."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermaltool.fitting.rc.fit import RcFit
from thermaltool.fitting.rc.state_space import thermal_modes
from thermaltool.model import Drive, Model, Output, Term, agreements, rest_level
from thermaltool.record import Record
from thermaltool.responses.rational import KINDS
from thermaltool.signals.agreement import Agreement
from thermaltool.units import drive_reference, hold_of

Array = NDArray[np.float64]

_STEP = 1e-4


def rc_model(fit: RcFit, logs: Sequence[Record], provenance: Mapping[str, Any]) -> Model:
    """The model document of a network, which begins at rest as every model does.

    H(s) = Σ_i c_i b_i/(s + λ_i): a lag of time constant 1/λ_i and gain c_i b_i/λ_i for each mode.

    Parameters
    ----------
    fit : RcFit
    logs : sequence of Record
        That were fitted: rest is that of the first.
    provenance : mapping
    """
    network, lags = fit.network, _lags(fit, fit.vector[None])[0]
    n, inputs = len(network.nodes), network.inputs
    drives = [_drive(channel, logs) for channel in inputs]
    rests = np.array([d.rest if d.rest is not None else 0.0 for d in drives] + [1.0])
    gains = lags[:, :, :n].sum(axis=2)
    slopes = _slopes(fit)
    kind = KINDS[n, 0]
    terms, outputs = [], []
    for k, node in enumerate(network.measured):
        channel = node.measured
        assert channel is not None
        for j, name in enumerate(inputs):
            names = [*(f"K{i + 1}" for i in range(n)), *(f"tau{i + 1}" for i in range(n))]
            values = dict(zip(names, lags[k, j].tolist(), strict=True))
            covariance = slopes[k, j] @ _finite(fit.covariance) @ slopes[k, j].T
            terms.append(Term(name, channel, kind(**values), covariance, tuple(names)))
        offset = float(gains[k] @ rests + fit_offset(fit, k))
        outputs.append(Output(channel, "sensor", offset, _extent(logs, channel, offset)))
    return Model(tuple(drives), tuple(outputs), tuple(terms), logs[0].period, provenance)


def simulated(model: Model, logs: Sequence[Record]) -> dict[str, Agreement]:
    """How far the model document, run from rest, is from each reading over all logs.

    Parameters
    ----------
    model : Model
    logs : sequence of Record
    """
    return agreements(model, logs, initial="rest")


def fit_offset(fit: RcFit, k: int) -> float:
    """What is added to reading k, in the unit of its channel."""
    values = fit.likelihood.space.values(fit.vector[None])
    return float(thermal_modes(fit.network, values).offsets[0, k])


def time_constants(fit: RcFit) -> Array:
    """Time constants of the network, slowest first, shape (n,) [s]."""
    values = fit.likelihood.space.values(fit.vector[None])
    return np.asarray(1.0 / thermal_modes(fit.network, values).rates[0])


def _lags(fit: RcFit, vectors: Array) -> Array:
    """Gains and time constants, shape (B, outputs, inputs and a constant, 2 n)."""
    modes = thermal_modes(fit.network, fit.likelihood.space.values(vectors))
    weights = np.einsum("bmn,bnq->bmqn", modes.outputs, modes.gains / modes.rates[..., None])
    times = np.broadcast_to(1.0 / modes.rates[:, None, None], weights.shape)
    return np.concatenate([weights, times], axis=-1)


def _slopes(fit: RcFit) -> Array:
    """Derivatives of gains and time constants, shape (outputs, inputs, 2 n, p)."""
    steps = _STEP * np.eye(len(fit.vector))
    moved = _lags(fit, np.vstack([fit.vector + steps, fit.vector - steps]))
    up, down = np.split(moved, 2)
    return np.asarray(np.moveaxis((up - down) / (2 * _STEP), 0, -1))


def _finite(covariance: Array) -> Array:
    """Without what is known of nothing, which the sums hardly feel."""
    return np.where(np.isfinite(covariance), covariance, 0.0)


def _drive(channel: str, logs: Sequence[Record]) -> Drive:
    reference, hold = drive_reference(channel), hold_of(channel)
    levels = [rest_level(log.column(channel), reference, hold) for log in logs]
    moved = np.concatenate([
        log.column(channel) - level for log, level in zip(logs, levels, strict=True)
    ])  # fmt: skip
    rest = levels[0] if reference == "first" else None
    return Drive(channel, hold, reference, (float(np.nanmin(moved)), float(np.nanmax(moved))), rest)


def _extent(logs: Sequence[Record], channel: str, offset: float) -> tuple[float, float]:
    moved = np.concatenate([log.column(channel) - offset for log in logs])
    return float(np.nanmin(moved)), float(np.nanmax(moved))
