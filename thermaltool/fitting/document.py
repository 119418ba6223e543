"""Identified transfer functions as a model document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.fitting.components.redundancy import redundancy_of
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.fit import Fit
from thermaltool.model import Drive, Model, Output, Role, Term, agreements, rest_level
from thermaltool.signals.agreement import Agreement
from thermaltool.units import Hold, Reference, drive_reference, is_displacement


def model_document(
    fits: Sequence[Fit], reference: Reference | None, provenance: Mapping[str, Any]
) -> Model:
    """All outputs with their terms in continuous time.

    Parameters
    ----------
    fits : sequence of Fit
    reference : "first", float or None
        What counts as no drive; None is "first" for an absolute temperature and 0 otherwise.

    Raises
    ------
    ModelError
        A term that has no form in continuous time.
    """
    drives: dict[str, Drive] = {}
    outputs, terms = [], []
    for fit in fits:
        model, data = fit.model, fit.data.measured(0)
        holds = dict(zip(data.inputs, data.holds, strict=True))
        for k, name in enumerate(model.names):
            rest = drive_reference(name) if reference is None else reference
            hold = holds[name]
            extent = _extent(data, [u[k] for u in data.u], rest, hold)
            begins = _level(data, [u[k] for u in data.u], hold) if rest == "first" else None
            drives[name] = Drive(name, hold, rest, extent, begins)
        for k, (name, term) in enumerate(zip(model.names, fit.terms, strict=True)):
            if isinstance(term, str):
                raise ModelError(term)
            terms += [
                Term(name, model.target, each.response, each.covariance, each.names, each.band)
                for each in ((term,) if model.is_linear else model.level_terms(k))
            ]
        outputs.append(_output(fit, data, drives))
    redundancy = None
    if fits[0].model.redundant:
        # Of the inputs that every output has: one that never moved says nothing.
        names = [n for n in fits[0].model.names if all(n in fit.model.names for fit in fits)]
        data = fits[0].data.driven_by(names)
        redundancy = redundancy_of(data, [drives[name].reference for name in names])
    return Model(tuple(drives.values()), tuple(outputs), tuple(terms),
                 fits[0].model.dt, provenance, effects=fits[0].model.effects,
                 redundancy=redundancy)  # fmt: skip


def agreement_from_rest(model: Model, data: TrainingData) -> Agreement:
    """How far the model document, from rest, is from the output of `data`.

    That is what ``simulate --initial rest`` gives, where a fit may have estimated the state.

    Parameters
    ----------
    model : Model
    data : TrainingData
        Of one of its outputs; the first record of each experiment counts.
    """
    (target,), data = data.outputs, data.measured(0)
    output = next(o for o in model.outputs if o.channel == target)
    records = [data.records[k] for k in data.begins.values()]
    return agreements(model, records, [output], "rest")[target]


def _extent(
    data: TrainingData, values: Sequence[Array], rest: Reference, hold: Hold = "first"
) -> tuple[float, float]:
    """Least and largest value of a channel from what counts as its zero in each experiment."""
    begins = data.begins
    moved = np.concatenate([
        v - rest_level(values[begins[record.origin]], rest, hold)
        for v, record in zip(values, data.records, strict=True)
    ])  # fmt: skip
    return float(moved.min()), float(moved.max())


def _level(data: TrainingData, values: Sequence[Array], hold: Hold) -> float:
    """Where a channel begins, on average over the experiments."""
    levels = [rest_level(values[k], "first", hold) for k in data.begins.values()]
    return float(np.mean(levels))


def _output(fit: Fit, data: TrainingData, drives: Mapping[str, Drive]) -> Output:
    """The output with its value at rest: what the offset and the drives at rest give.

    A displacement has no zero of its own, and a drive that starts from anywhere leaves none.
    """
    model, training = fit.model, fit.training
    arbitrary = is_displacement(model.target)
    rests = [drives[name].reference for name in model.names]
    offset: Reference = "first"
    if not arbitrary and "first" not in rests:
        gains = [model.gain(k).value for k in range(len(model.names))]
        moved = sum(g * float(r) for g, r in zip(gains, rests, strict=True))
        offset = float(np.mean(model.offsets)) + moved
    role: Role = "deflection" if arbitrary else "sensor"
    return Output(
        model.target,
        role,
        offset,
        _extent(data, [y[0] for y in data.y], offset),
        {
            "rmse": training.rmse,
            "max_error": training.max_error,
            "fit_percent": training.fit_percent,
            "rows": training.rows,
            "method": model.method,
        },
    )
