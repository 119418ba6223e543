"""What a file is, told by what is in it: a log, or which command's result."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np

from thermaltool.documents import ARMA, CONTROLLER, DIAGNOSIS, MODEL, NOISE
from thermaltool.errors import LogError, ModelError
from thermaltool.logs import Log, read_log
from thermaltool.logs.table import UNFINISHED, read_source
from thermaltool.model import loads
from thermaltool.parsing import parse_json
from thermaltool.report.records import FORECAST, RESIDUAL, SETPOINT
from thermaltool.timeseries import model as arma

Kind = Literal[
    "trade-off",
    "kernel",
    "noise",
    "inversion",
    "model",
    "models",
    "log",
    "simulation",
    "setpoints",
    "forecast",
    "diagnosis",
    "orders",
    "arma",
    "controller",
    "reference",
]

# What commands report with --json has no format: it is known by these fields.
REPORTS: dict[Kind, frozenset[str]] = {
    "trade-off": frozenset({"chosen", "forms"}),
    "kernel": frozenset({"time_s", "weight", "A0", "A1_s"}),
    "inversion": frozenset({"time_s", "value_1", "error_1"}),
    "orders": frozenset({"best", "table"}),
}


@dataclass(frozen=True)
class Content:
    """A file that was recognized: `data` is a Log, a Model, or the mapping of a document."""

    kind: Kind
    name: str
    data: Any


def is_document(source: str, from_format: str | None = None) -> bool:
    """True where the input starts as one JSON document does, and is not named as a table.

    Stdin is looked at, not consumed.
    """
    if from_format is not None or source.lower().endswith((".ndjson", ".jsonl")):
        return False
    if source == "-":
        head = cast(io.BufferedReader, sys.stdin.buffer).peek(1)
    elif not os.path.isfile(source):
        return False
    else:
        with open(source, "rb") as stream:
            head = stream.read(64)
    return head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{")


def read_document(source: str) -> Content:
    """A JSON document by its content.

    Raises
    ------
    LogError, ModelError
        Not JSON, or none of the documents that have a figure.
    """
    raw = read_source(source)
    name = raw.name
    try:
        text = raw.data.decode("utf-8-sig")
        document = parse_json(text, name)
    except UnicodeDecodeError as error:
        raise LogError("not a text file", name) from error
    except ModelError as error:
        lines = " (a log of JSON lines: name it .ndjson, or give --from ndjson)"
        raise LogError(f"{error}{lines if 'Extra data' in str(error) else ''}") from error
    if MODEL.matches(document):
        return Content("model", name, loads(text, name))
    if NOISE.matches(document):
        try:
            return Content("noise", name, NOISE.check(document, name))
        except ModelError as error:
            raise LogError(str(error)) from error
    if ARMA.matches(document):
        return Content("arma", name, arma.loads(text, name))
    if CONTROLLER.matches(document):
        # Imported for a controller alone: the other figures are drawn without its solvers.
        from thermaltool.control.controller import load_controller
        from thermaltool.control.design import tried

        return Content("controller", name, tried(load_controller(document, name)))
    if DIAGNOSIS.matches(document):
        return Content("diagnosis", name, DIAGNOSIS.check(document, name))
    for kind, fields in REPORTS.items():
        if fields <= document.keys():
            return Content(kind, name, document)
    raise LogError(
        "no figure for this document: it is neither a model (of a machine or of a series), nor a "
        "controller, nor noise, nor a diagnosis, nor what regularize, invert, laplace or order "
        "report with --json",
        name,
    )


def read_table(source: str, options: Mapping[str, Any], need: Sequence[str] = ()) -> Content:
    """A table by its columns.

    Parameters
    ----------
    options : mapping
        How a log is read: see `read_log`.
    need : sequence of str
        Channels that must be there, without missing values.

    Raises
    ------
    LogError
        What `read_log` raises; no rows.
    """
    try:
        log = _sound(read_log(source, **options, need=need, strict=False))
    except LogError:
        # What is needed of a log is not in a kernel; stdin cannot be read again to see.
        if not need or source == "-":
            raise
        content = read_table(source, options)
        if content.kind != "kernel":
            raise
        return content
    if not len(log):
        raise LogError("no rows: nothing to draw", log.name)
    columns = log.columns
    if log.unread and {"A1_s", "error_1"} & columns.keys():
        raise next(iter(log.unread.values()))
    if {"weight_1", "A0_1", "A1_s"} <= columns.keys():
        data = {"time_s": log.time, "weight": columns["weight_1"],
                "A0": float(columns["A0_1"][0]), "A1_s": float(columns["A1_s"][0])}  # fmt: skip
        return Content("kernel", log.name, data)
    if need:  # beside a model
        return Content("log", log.name, log)
    if {"value_1", "error_1"} <= columns.keys():
        return Content("inversion", log.name, {"time_s": log.time, **columns})
    if any(RESIDUAL + name in columns for name in columns):
        return Content("simulation", log.name, log)
    if any(name.startswith(FORECAST) for name in columns):
        return Content("forecast", log.name, log)
    if any(name.startswith(SETPOINT) for name in columns):
        return Content("setpoints", log.name, log)
    return Content("log", log.name, log)


def _sound(log: Log) -> Log:
    """The log, unless it has a fault other than cells that are no numbers (`Log.unread`).

    A line that the stream refused is answered under the time of the line before it: in a table of
    setpoints the clock may stand still.
    """
    spared = {each.column for each in log.unread.values()}
    faults = [p for p in log.problems if p.message != UNFINISHED and p.column not in spared]
    if any(name.startswith(SETPOINT) for name in log.columns) and np.all(np.diff(log.time) >= 0):
        faults = [p for p in faults if p.column != "time_s"]
    if faults:
        raise faults[0]
    return log
