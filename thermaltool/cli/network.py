"""What ``identify --structure network`` reads and fits: all outputs together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from thermaltool.cli.transfer import Findings, read_one
from thermaltool.errors import FitError
from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.network.run import IdentifiedNetwork, NetworkPlan, run_network
from thermaltool.fitting.transfer.machine import in_use
from thermaltool.model import Model
from thermaltool.record import Record
from thermaltool.report.network import network_document, network_table, network_warnings
from thermaltool.report.transfer import lost_from_rest
from thermaltool.units import hold_of


def identify_shared(
    logs: tuple[str, ...],
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    validation: str | None,
    options: Mapping[str, Any],
) -> Findings:
    """One network for all outputs.

    Raises
    ------
    FitError
        As `run_network`.
    LogError
        As `read_log`.
    """
    data, sources = _load(logs, inputs, outputs, options)
    fresh = None if validation is None else _load((validation,), inputs, outputs, options)[0]
    plan = NetworkPlan(options["modes"], options["delay"] or 0.0, options["initial"],
                      options["split"])  # fmt: skip
    found = run_network(data, plan, fresh)
    parts = [(output, found.continuous_terms(k), found.training[k], found.data.measured(k))
             for k, output in enumerate(found.network.outputs)]  # fmt: skip
    return Findings(sources, parts, network_document(found), network_table(found),
                    network_warnings(found), lambda model: _lost(found, model))  # fmt: skip


def _load(
    logs: tuple[str, ...],
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    options: Mapping[str, Any],
) -> tuple[TrainingData, list[dict[str, str]]]:
    records: list[Record] = []
    sources, period = [], None
    for name in logs:
        log = read_one(name, (*inputs, *outputs), options)
        period = period or log.period
        origin = 1 + records[-1].origin if records else 0
        records += [replace(piece, origin=origin) for piece in log.pieces(inputs)]
        sources.append({"name": log.name, "sha256": log.digest})
    assert period is not None
    if not records:
        raise FitError(f"{', '.join(inputs)}: no two rows in a row have a reading")
    holds = tuple(hold_of(name) for name in inputs)
    return TrainingData(tuple(records), inputs, outputs, period, holds), sources


def _lost(found: IdentifiedNetwork, model: Model) -> list[str]:
    data = found.data
    return lost_from_rest([
        (target, found.training[k], in_use(model, data.measured(k)))
        for k, target in enumerate(data.outputs)
    ])  # fmt: skip
