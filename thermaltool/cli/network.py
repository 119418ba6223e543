"""What ``identify --structure network`` reads and fits: all outputs together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from thermaltool.cli.transfer import Findings, read_one, rests, zero_of
from thermaltool.effects.dynamics import hold_of
from thermaltool.errors import FitError
from thermaltool.identification.network.choose import (
    Candidate,
    choose_delays,
    choose_modes,
    started,
)
from thermaltool.identification.network.data import Records, Span, spans_of
from thermaltool.identification.network.identify import identify_network
from thermaltool.identification.network.model import Network
from thermaltool.identification.network.residuals import network_tests
from thermaltool.identification.transfer.choose import first_that_fits
from thermaltool.identification.transfer.machine import in_use
from thermaltool.model import Model
from thermaltool.report.network import Shared, network_document, network_table
from thermaltool.signals.agreement import improvement


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
        As `identify_network`; no number of modes fits.
    LogError
        As `read_log`.
    """
    data, sources = _load(logs, inputs, outputs, options)
    held = None
    if options["split"] is not None:
        data, held = data.parted(options["split"])
    elif validation is not None:
        held = _load((validation,), inputs, outputs, options)[0]
    if options["initial"] != "free":
        data = data.from_rest() if options["initial"] == "rest" else started(data)
    network, candidates = _fitted(data, options)
    shared = _judged(network, data, held, validation is not None, candidates)
    parts = [(share, shared.ways(k), shared.training[k], data.of(k))
             for k, share in enumerate(network.shares)]  # fmt: skip
    return Findings(sources, parts, network_document(shared), network_table(shared),
                    shared.warnings(), lambda model: _told(shared, model))  # fmt: skip


def _load(
    logs: tuple[str, ...],
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    options: Mapping[str, Any],
) -> tuple[Records, list[dict[str, str]]]:
    spans: list[Span] = []
    sources, period = [], None
    for name in logs:
        log = read_one(name, (*inputs, *outputs), options)
        period = period or log.period
        u, y = (np.array([log.column(c) for c in each]) for each in (inputs, outputs))
        origin = 1 + spans[-1].origin if spans else 0
        spans += spans_of(log.time, u, y, log.segments, origin)
        sources.append({"name": log.name, "sha256": log.digest})
    assert period is not None
    if not spans:
        raise FitError(f"{', '.join(inputs)}: no two rows in a row have a reading")
    holds = tuple(hold_of(name) for name in inputs)
    return Records(tuple(spans), period, inputs, holds, outputs), sources


def _fitted(
    data: Records, options: Mapping[str, Any]
) -> tuple[Network, tuple[Candidate, ...] | None]:
    data.check()
    if options["delay"] == "auto":
        delays = choose_delays(data)
    else:
        delays = tuple((options["delay"] or 0.0,) * len(data.names) for _ in data.targets)
    if options["modes"] is not None:
        return identify_network(data, options["modes"], delays), None
    candidates = choose_modes(data, delays)
    modes = (c.modes for c in candidates)
    return first_that_fits(modes, lambda n: identify_network(data, n, delays)), candidates


def _judged(
    network: Network,
    data: Records,
    held: Records | None,
    other_log: bool,
    candidates: tuple[Candidate, ...] | None,
) -> Shared:
    validation = gained = None
    if held is not None:
        zeros = tuple(zero_of(target, other_log) for target in data.targets)
        validation = tuple(network.fit(held, zeros))
        gains = []
        for k, (share, y) in enumerate(zip(network.shares, network.run(held, zeros), strict=True)):
            values = [s.outputs[k] for s in held.spans]
            rest = rests(held.spans, values, zeros[k], share.offsets)
            gains.append(improvement(held.output(k) - rest, y - rest))
        gained = tuple(gains)
    return Shared(network, data, tuple(network.fit(data)), validation, gained,
                  tuple(network_tests(network, data)), candidates)  # fmt: skip


def _told(shared: Shared, model: Model) -> list[str]:
    data = shared.data
    return shared.in_use({
        target: in_use(model, data.of(k), data.clocks(k)) for k, target in enumerate(data.targets)
    })  # fmt: skip
