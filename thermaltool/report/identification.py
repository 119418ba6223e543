"""Identified models of every output as a document, a table and sentences."""

from __future__ import annotations

from typing import Any

from thermaltool.fitting.document import agreement_from_rest
from thermaltool.fitting.identification import fits_of
from thermaltool.fitting.network.run import IdentifiedNetwork
from thermaltool.fitting.transfer.run import Identified
from thermaltool.model import Model
from thermaltool.report.network import network_document, network_table, network_warnings
from thermaltool.report.transfer import (
    lost_from_rest,
    transfer_document,
    transfer_table,
    warnings_of,
)

Found = tuple[Identified, ...] | IdentifiedNetwork


def identification_document(found: Found) -> dict[str, Any]:
    """All models as plain data."""
    return transfer_document(found) if isinstance(found, tuple) else network_document(found)


def identification_table(found: Found) -> str:
    """Fits, gains and time constants with their intervals, what is left."""
    if isinstance(found, tuple):
        return "\n\n".join(transfer_table(each) for each in found)
    return network_table(found)


def identification_warnings(found: Found) -> list[str]:
    """What a user should know before using the models, each a sentence."""
    if isinstance(found, tuple):
        return [message for each in found for message in warnings_of(each)]
    return network_warnings(found)


def document_warnings(found: Found, model: Model) -> list[str]:
    """Sentences where the model document fits much worse, from rest, than the models do."""
    return lost_from_rest([
        (fit.model.target, fit.training, agreement_from_rest(model, fit.data))
        for fit in fits_of(found)
    ])  # fmt: skip
