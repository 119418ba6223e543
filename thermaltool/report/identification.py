"""Identified models of every output as a document, a table and sentences."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from thermaltool.documents import jsonable
from thermaltool.fitting.document import agreement_from_rest
from thermaltool.fitting.fit import Fit
from thermaltool.fitting.network.model import NetworkOutput
from thermaltool.model import Model
from thermaltool.report.network import network_fields, network_table, network_warnings
from thermaltool.report.transfer import (
    estimate_document,
    lost_from_rest,
    transfer_fields,
    transfer_table,
    transfer_warnings,
)


def is_network(fits: Sequence[Fit]) -> bool:
    """Whether the outputs share their modes."""
    return isinstance(fits[0].model, NetworkOutput)


def identification_document(fits: Sequence[Fit]) -> dict[str, Any]:
    """All models as plain data, each with what its form has of its own."""
    fields = network_fields if is_network(fits) else transfer_fields
    return {"models": [{**_document(fit), **fields(fits, k)} for k, fit in enumerate(fits)]}


def _document(fit: Fit) -> dict[str, Any]:
    m, tests, held = fit.model, fit.tests, fit.validation
    return {
        "inputs": list(m.names),
        "output": m.target,
        "sample_period_s": m.dt,
        "fit_training_percent": jsonable(fit.training.fit_percent),
        "validation": None if held is None else held.document(),
        "parameters": {name: estimate_document(e) for name, e in fit.parameters.items()},
        "offsets": list(m.offsets),
        "method": m.method,
        "converged": m.converged,
        "residuals": None
        if tests is None
        else {
            "lags": tests.lags,
            "white_p": jsonable(tests.white_p),
            "independent_p": {name: jsonable(p) for name, p in tests.independent_p.items()},
        },
    }


def identification_table(fits: Sequence[Fit]) -> str:
    """Fits, gains and time constants with their intervals, what is left."""
    return network_table(fits) if is_network(fits) else "\n\n".join(map(transfer_table, fits))


def identification_warnings(fits: Sequence[Fit]) -> list[str]:
    """What a user should know before using the models, each a sentence."""
    if is_network(fits):
        return [*network_warnings(fits), *_failed(fits)]
    return [*(message for fit in fits for message in transfer_warnings(fit)), *_failed(fits)]


def _failed(fits: Sequence[Fit]) -> list[str]:
    """Sentences on models that predict nothing of the validation data."""
    return [
        f"{fit.model.target}: the model predicts nothing: the mean of the validation data is "
        f"nearer to them than its run ({fit.validation.carried_on.fit_percent:.3g} %)"
        for fit in fits
        if fit.validation is not None and not fit.validation.predicts
    ]


def document_warnings(fits: Sequence[Fit], model: Model) -> list[str]:
    """Sentences where the model document fits much worse, from rest, than the models do."""
    return lost_from_rest([
        (fit.model.target, fit.training, agreement_from_rest(model, fit.data)) for fit in fits
    ])  # fmt: skip
