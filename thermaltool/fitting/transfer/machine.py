"""Identified transfer functions as a model document."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.transfer.continuation import Continued
from thermaltool.model import Drive, Model, Output, Role, Term, relative
from thermaltool.signals.agreement import Agreement, agreement
from thermaltool.signals.intervals import Estimate
from thermaltool.units import Reference, drive_reference, hold_of, is_displacement


class Identity(Protocol):
    """What the document takes of an identified model of one output."""

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def target(self) -> str: ...
    @property
    def dt(self) -> float: ...
    @property
    def offsets(self) -> tuple[float, ...]: ...
    @property
    def method(self) -> str: ...
    def gain(self, k: int) -> Estimate: ...
    def named(self) -> Iterator[tuple[str, Estimate]]: ...


def machine(
    found: Sequence[tuple[Identity, Sequence[Continued | str], Agreement, TrainingData]],
    reference: Reference | None,
    provenance: Mapping[str, Any],
) -> Model:
    """All outputs with their terms in continuous time.

    Parameters
    ----------
    found : sequence of (model, its inputs in continuous time, training fit, training data)
    reference : "first", float or None
        What counts as no drive; None is "first" for an absolute temperature and 0 otherwise.

    Raises
    ------
    ModelError
        A term that has no form in continuous time.
    """
    drives: dict[str, Drive] = {}
    outputs, terms = [], []
    for model, ways, training, data in found:
        for k, name in enumerate(model.names):
            rest = drive_reference(name) if reference is None else reference
            drives[name] = Drive(
                name, hold_of(name), rest, _extent(data, [u[k] for u in data.u], rest)
            )
        for name, way in zip(model.names, ways, strict=True):
            if isinstance(way, str):
                raise ModelError(way)
            terms.append(Term(name, model.target, way.response, way.covariance, way.names))
        outputs.append(_output(model, training, data, drives))
    return Model(tuple(drives.values()), tuple(outputs), tuple(terms),
                 found[0][0].dt, provenance)  # fmt: skip


def in_use(model: Model, data: TrainingData) -> Agreement:
    """How far the model document, from rest, is from the output of `data`.

    That is what ``simulate`` gives: it takes every log to begin at rest, where a fit may have
    estimated the state.

    Parameters
    ----------
    model : Model
    data : TrainingData
        Of one of its outputs; the first record of each experiment counts.
    """
    (target,) = data.outputs
    output = next(o for o in model.outputs if o.channel == target)
    measured, computed = [], []
    for k in data.begins.values():
        computed.append(model.simulate(data.records[k])[target])
        measured.append(relative(data.y[k][0], output.offset))
    return agreement(np.concatenate(measured), np.concatenate(computed))


def _extent(data: TrainingData, values: Sequence[Array], rest: Reference) -> tuple[float, float]:
    """Least and largest value of a channel from what counts as its zero in each experiment."""
    begins = data.begins
    moved = np.concatenate([
        v - (values[begins[record.origin]][0] if rest == "first" else rest)
        for v, record in zip(values, data.records, strict=True)
    ])  # fmt: skip
    return float(moved.min()), float(moved.max())


def _output(
    model: Identity, training: Agreement, data: TrainingData, drives: Mapping[str, Drive]
) -> Output:
    """The output with its value at rest: what the offset and the drives at rest give.

    A displacement has no zero of its own, and a drive that starts from anywhere leaves none.
    """
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
