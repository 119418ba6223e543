"""What ``identify`` reads and fits: logs as data on one clock, one model for each output."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from thermaltool.cli.documents import warn, warn_pauses
from thermaltool.effects.dynamics import hold_of
from thermaltool.errors import FitError, LogError, ModelError
from thermaltool.identification.transfer.choose import (
    Choice,
    choose,
    first_that_fits,
    real_poles,
    started,
)
from thermaltool.identification.transfer.continuation import Continued, continued
from thermaltool.identification.transfer.continuous import identify_continuous
from thermaltool.identification.transfer.data import (
    UNEVEN,
    Array,
    Data,
    Piece,
    Zero,
    even_stretches,
)
from thermaltool.identification.transfer.identify import identify, orders_of
from thermaltool.identification.transfer.machine import Identity, in_use
from thermaltool.identification.transfer.model import TransferModel
from thermaltool.identification.transfer.output_error import Orders
from thermaltool.identification.transfer.residuals import residual_tests
from thermaltool.logs import Log, read_log
from thermaltool.logs.selection import between
from thermaltool.model import Model
from thermaltool.report.transfer import Identified, transfer_document, transfer_table
from thermaltool.signals.agreement import Agreement, improvement
from thermaltool.units import parse_channel

Logs = Mapping[str, Data]


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
    parts: Sequence[tuple[Identity, Sequence[Continued | str], Agreement, Data]]
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
        As `identify` and `choose`, with the name of the output.
    LogError
        As `load_data`.
    """
    read, sources, period = load_data(logs, inputs, outputs, options)
    fresh = load_validation(validation, inputs, outputs, period, options)
    found = [run(name, read, fresh, options) for name in outputs]
    return Findings(
        sources,
        [(each.model, each.continued, each.training, each.data) for each in found],
        transfer_document(found),
        "\n\n".join(transfer_table(each) for each in found),
        [m for each in found for m in each.warnings()],
        lambda model: [t for e in found if (t := e.in_use(in_use(model, e.data)))],
    )


def load_data(
    logs: tuple[str, ...],
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    options: Mapping[str, Any],
    period: float | None = None,
) -> tuple[dict[str, Data], list[dict[str, str]], float]:
    """The data of every output, where the logs came from, and the sample period [s].

    Raises
    ------
    LogError
        As `read_log`; a log of another period; too few rows.
    """
    stretches: dict[str, list[Any]] = {name: [] for name in outputs}
    sources = []
    for origin, name in enumerate(logs):
        log = read_one(name, (*inputs, *outputs), options)
        dt = log.period
        if period is None:
            period = dt
        elif abs(dt - period) > UNEVEN * period:
            raise LogError(f"sampled every {dt:g} s, the first log every {period:g} s", log.name)
        _warn_uneven(log, period)
        u = np.array([log.column(channel) for channel in inputs])
        for target in outputs:
            stretches[target] += even_stretches(
                log.time, u, log.column(target), log.segments, period, origin
            )
        sources.append({"name": log.name, "sha256": log.digest})
    assert period is not None
    data = {n: Data(tuple(parts), period, inputs, n) for n, parts in stretches.items()}
    return data, sources, period


def zero_of(target: str, other_log: bool) -> Zero:
    """The zero of validation data: that of a displacement is arbitrary in every log."""
    if not other_log:
        return "fitted"
    return "free" if parse_channel(target).dimension in ("length", "angle") else "mean"


def rests(
    pieces: Sequence[Piece], values: Sequence[Array], zero: Zero, offsets: Sequence[float]
) -> Array:
    """What counts as no deviation, row by row: the zero, or the first reading of its log."""
    if zero == "mean":
        return np.full(sum(map(len, pieces)), np.mean(offsets))
    own: dict[int, float] = dict(enumerate(offsets)) if zero == "fitted" else {}
    for piece, row in zip(pieces, values, strict=True):
        for first in row[np.isfinite(row)][:1].tolist():
            own.setdefault(piece.origin, first)
    return np.concatenate([np.full(len(piece), own.get(piece.origin, np.nan)) for piece in pieces])


def load_validation(
    log: str | None,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    period: float,
    options: Mapping[str, Any],
) -> Logs | None:
    """The data of another log, on the clock of the first."""
    return None if log is None else load_data((log,), inputs, outputs, options, period)[0]


def read_one(name: str, need: tuple[str, ...], options: Mapping[str, Any]) -> Log:
    kept = {key: options[key] for key in ("columns", "from_format", "nan_policy", "max_gap")}
    log = between(read_log(name, **kept, need=need), options["start"], options["stop"])
    if len(log) < 2:
        raise LogError(f"{len(log)} rows say nothing of a transfer function", log.name)
    warn_pauses(log, "the record is parted there")
    return log


def _warn_uneven(log: Log, period: float) -> None:
    steps = np.concatenate([np.diff(log.time[part]) for part in log.segments])
    uneven = int(np.sum(np.abs(steps - period) > UNEVEN * period))
    if uneven:
        warn(
            f"{log.name}: {uneven} of {len(steps)} steps are not {period:g} s: straight lines "
            "between the readings are taken on an even clock, longer steps part the record"
        )


def run(target: str, read: Logs, fresh: Logs | None, options: Mapping[str, Any]) -> Identified:
    """Fit and judge one output.

    Raises
    ------
    FitError
        As `identify` and `choose`, with the name of the output.
    """
    data, held = read[target], None
    try:
        if options["split"] is not None:
            data, held = data.parted(options["split"])
        elif fresh is not None:
            held = fresh[target]
        least = tuple(1 if hold_of(name) == "zero" else 0 for name in data.names)
        if options["initial"] != "free" and options["structure"] in ("oe", "bj"):
            at_rest = options["initial"] == "rest"
            data = data.from_rest() if at_rest else started(data, least)
        model, choice = _model(data, least, options)
        # OE searches over real poles; slow ones side by side only look like pairs to rounding.
        found_free = options["real_poles"] and options["structure"] != "oe"
        if found_free and not real_poles(model):
            raise FitError("not all poles are real: take lower orders, or --structure oe")
    except FitError as error:
        raise FitError(f"{target}: {error}") from error
    training, validation, gained = model.fit(data), None, None
    if held is not None:
        zero = zero_of(target, fresh is not None)
        validation = model.fit(held, zero)
        rest = rests(held.stretches, [s.output for s in held.stretches], zero, model.offsets)
        gained = improvement(held.output() - rest, model.run(held, zero) - rest)
    return Identified(
        model,
        data,
        training,
        validation,
        gained,
        residual_tests(model, data),
        choice,
        tuple(_continued(model, k) for k in range(len(model.names))),
    )


def _model(
    data: Data, least: tuple[int, ...], options: Mapping[str, Any]
) -> tuple[TransferModel, Choice | None]:
    structure, (nc, nd) = options["structure"], options["noise_orders"]
    given, count, real = options["orders"], len(data.names), options["real_poles"]

    def fit(orders: Orders) -> TransferModel:
        if options["continuous"]:
            holds = [hold_of(name) for name in data.names]
            orders = replace(orders, nb=tuple(map(min, orders.nb, orders.nf)))
            return identify_continuous(data, orders, holds, real)
        return identify(data, structure, orders, nc, nd, real)

    if given and None not in given:
        each = given * count if len(given) == 1 else given
        nb, nf, nk = zip(*each, strict=True)
        return fit(orders_of(structure, nb, nf, nk)), None
    choice = choose(data, structure, least, nc, nd, real)
    return first_that_fits((c.orders(structure) for c in choice.candidates), fit), choice


def _continued(model: TransferModel, k: int) -> Continued | str:
    try:
        return continued(model, k, hold_of(model.names[k]))
    except ModelError as error:
        return str(error)
