"""What ``identify`` reads and fits: logs as data on one clock, one model for each output."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from thermaltool.cli.messages import warn, warn_pauses
from thermaltool.errors import LogError
from thermaltool.fitting.data import TrainingData, even_records
from thermaltool.fitting.transfer.continuation import Continued
from thermaltool.fitting.transfer.machine import Identity, in_use
from thermaltool.fitting.transfer.run import Plan, run
from thermaltool.logs import Log, read_log
from thermaltool.model import Model
from thermaltool.record import MAX_UNEVENNESS, Record
from thermaltool.report.transfer import (
    lost_from_rest,
    transfer_document,
    transfer_table,
    warnings_of,
)
from thermaltool.signals.agreement import Agreement
from thermaltool.units import hold_of


@dataclass(frozen=True)
class Findings:
    """What the command writes, whatever the structure.

    Attributes
    ----------
    sources : list of mapping
        Logs and their digests.
    parts : sequence of (model, its inputs in continuous time, training fit, training data)
        Of every output, for `machine`.
    document : mapping
    table : str
    warnings : list of str
    in_use : callable
        Sentences where a model document fits much worse from rest.
    """

    sources: list[dict[str, str]]
    parts: Sequence[tuple[Identity, Sequence[Continued | str], Agreement, TrainingData]]
    document: Mapping[str, Any]
    table: str
    warnings: list[str]
    in_use: Callable[[Model], list[str]]


def identify_each(
    logs: tuple[str, ...],
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    validation: str | None,
    options: Mapping[str, Any],
) -> Findings:
    """A model for each output.

    Raises
    ------
    FitError
        As `run`.
    LogError
        As `load_data`.
    """
    read, sources, period = load_data(logs, inputs, outputs, options)
    fresh: Mapping[str, TrainingData] = {}
    if validation is not None:
        fresh = load_data((validation,), inputs, outputs, options, period)[0]
    plan = Plan(options["structure"], options["orders"], options["noise_orders"],
                options["continuous"], options["real_poles"], options["initial"],
                options["split"])  # fmt: skip
    found = [run(read[name], plan, fresh.get(name)) for name in outputs]
    return Findings(
        sources,
        [(each.model, each.continued, each.training, each.data) for each in found],
        transfer_document(found),
        "\n\n".join(transfer_table(each) for each in found),
        [m for each in found for m in warnings_of(each)],
        lambda model: lost_from_rest(
            [(each.model.target, each.training, in_use(model, each.data)) for each in found]
        ),
    )


def load_data(
    logs: tuple[str, ...],
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    options: Mapping[str, Any],
    period: float | None = None,
) -> tuple[dict[str, TrainingData], list[dict[str, str]], float]:
    """The data of every output, where the logs came from, and the sample period [s].

    Raises
    ------
    LogError
        As `read_log`; a log of another period; too few rows.
    """
    records: dict[str, list[Record]] = {name: [] for name in outputs}
    sources = []
    for origin, name in enumerate(logs):
        log = read_one(name, (*inputs, *outputs), options)
        dt = log.period
        if period is None:
            period = dt
        elif abs(dt - period) > MAX_UNEVENNESS * period:
            raise LogError(f"sampled every {dt:g} s, the first log every {period:g} s", log.name)
        _warn_uneven(log, period)
        for target in outputs:
            records[target] += even_records(replace(log, origin=origin), inputs, target, period)
        sources.append({"name": log.name, "sha256": log.digest})
    assert period is not None
    holds = tuple(hold_of(name) for name in inputs)
    data = {n: TrainingData(tuple(parts), inputs, (n,), period, holds)
            for n, parts in records.items()}  # fmt: skip
    return data, sources, period


def read_one(name: str, need: tuple[str, ...], options: Mapping[str, Any]) -> Log:
    kept = {key: options[key] for key in ("columns", "from_format", "nan_policy", "max_gap")}
    log = read_log(name, **kept, need=need).between(options["start"], options["stop"])
    if len(log) < 2:
        raise LogError(f"{len(log)} rows say nothing of a transfer function", log.name)
    warn_pauses(log, "the record is parted there")
    return log


def _warn_uneven(log: Log, period: float) -> None:
    steps = np.concatenate([np.diff(log.time[part]) for part in log.segments])
    uneven = int(np.sum(np.abs(steps - period) > MAX_UNEVENNESS * period))
    if uneven:
        warn(
            f"{log.name}: {uneven} of {len(steps)} steps are not {period:g} s: straight lines "
            "between the readings are taken on an even clock, longer steps part the record"
        )
