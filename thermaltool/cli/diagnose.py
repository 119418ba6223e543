"""``thermaltool diagnose``: what a model gets wrong, why, and what knowing it is worth."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from thermaltool.api.inputs import read_model
from thermaltool.cli.messages import terminal_progress, warn, warn_excursions, warn_pauses
from thermaltool.cli.options import (
    NumberRange,
    Source,
    keep_inputs,
    log_options,
    logs_argument,
    model_argument,
    one_stdin,
    quiet_option,
)
from thermaltool.documents import write_json
from thermaltool.report.text import aligned

if TYPE_CHECKING:
    from thermaltool.diagnosis.result import Diagnosis
    from thermaltool.logs import Log
    from thermaltool.model import Model
    from thermaltool.record import Record


@click.command(
    epilog="Example: thermaltool diagnose model.json morning.csv --validate evening.csv "
    "-o extended.json --report why.md > why.json"
)
@model_argument
@logs_argument
@click.option(
    "--validate",
    "validate",
    multiple=True,
    type=Source(),
    metavar="LOG",
    help="Measure the gain on this log, which no fit sees; repeatable.  "
    "[default: stretches of the LOGs, held out in turn]",
)
@click.option(
    "-o", "--output", metavar="FILE", help="Where the extended model goes.  [default: nowhere]"
)
@click.option(
    "--report",
    metavar="FILE.md",
    help="Report in Markdown, with its figures beside it as PNG.",
)
@click.option(
    "--fail-above",
    type=NumberRange(0, 1),
    metavar="SHARE",
    help="Exit 3 only where more than this share of an output's residual power is neither noise "
    "nor the calibration's own error; 1 never fails.  [default: by the verdict]",
)
@click.option("--json", "as_json", is_flag=True, hidden=True)
@log_options
@quiet_option
def command(
    model: str,
    logs: tuple[str, ...],
    validate: tuple[str, ...],
    output: str | None,
    report: str | None,
    fail_above: float | None,
    as_json: bool,
    columns: str | None,
    from_format: str | None,
    nan_policy: str,
    max_gap: float | None,
    quiet: int,
) -> None:
    """What a model gets wrong on measured logs, why, and what knowing it is worth.

    Compares the residual with the noise of the same log, tries every cause of the catalogue,
    extends the model by those that have evidence and help on data that the fit has not seen (-o),
    and says what these logs cannot tell apart. JSON goes to stdout, the verdict to stderr. Exit 0
    where the model is adequate, 3 where it is not.
    """
    # Thousands of small matrices: threads would wait for each other. Before numpy loads.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    from thermaltool.diagnosis.diagnose import diagnose
    from thermaltool.documents import atomic_output
    from thermaltool.logs import read_log
    from thermaltool.model import dumps
    from thermaltool.report.diagnosis import summary
    from thermaltool.report.diagnosis_tables import sections

    inputs = (model, *logs, *validate)
    if output == "-":
        raise click.UsageError("stdout takes the JSON: give the extended model a file with -o")
    if report == "-":
        raise click.UsageError("stdout takes the JSON: give --report a file, FILE.md")
    one_stdin(*inputs)
    keep_inputs(output or "-", *inputs)
    _keep(report, inputs, output)
    document = read_model(model)

    def read(name: str) -> Log:
        log = read_log(
            name,
            columns=columns,
            from_format=from_format,
            nan_policy=nan_policy,
            max_gap=max_gap,
            need=document.needs(),
        )
        _check(log, document)
        if not quiet:
            warn_excursions(document, log)
            warn_pauses(log, "the drive is taken as held over it")
        return log

    judged, unseen = [read(name) for name in logs], [read(name) for name in validate]
    _check_different([*judged, *unseen])
    progress = terminal_progress("diagnose")
    found = diagnose(
        document, [_signals(log) for log in judged], [_signals(log) for log in unseen], progress
    )
    progress("done\n")
    sources = [{"name": log.name, "sha256": log.digest} for log in judged]
    result: dict[str, Any] = {
        **found.document(),
        "model": "<stdin>" if model == "-" else os.path.basename(model),
        "logs": sources,
        "validated_on": [{"name": log.name, "sha256": log.digest} for log in unseen],
    }
    if output is not None:
        with atomic_output(output) as stream:
            stream.write(dumps(_extended(found.model, sources)).encode())
    if report is not None:
        _write_report(report, inputs, found, result, judged)
    write_json(result, "-")
    if not quiet:
        for line in summary(result):
            warn(line)
        for section in sections(result):
            if section.brief:
                warn(f"\n{section.title}")
                warn(aligned(section.rows))
    failed = not found.adequate if fail_above is None else 1 - found.noise_share > fail_above
    if failed:
        sys.exit(3)


def _keep(report: str | None, inputs: Sequence[str], output: str | None) -> None:
    """Refuse a report that would replace an input or the model, or cannot be written."""
    from thermaltool.documents import check_folder

    for name in (*inputs, output):
        if report is not None and name not in (None, "-"):
            assert name is not None
            if os.path.realpath(report) == os.path.realpath(name):
                raise click.UsageError(f"--report {report} would replace {name}")
    check_folder(report or "-")


def _check(log: Log, model: Model) -> None:
    """Refuse a log by which the model cannot be judged."""
    import numpy as np

    from thermaltool.errors import LogError
    from thermaltool.record import hint

    outputs = [output.channel for output in model.outputs]
    there = [name for name in outputs if name in log.columns]
    if not there:
        near = hint(outputs[0], log.columns) if len(outputs) == 1 else ""
        raise LogError(
            f"no output of the model is in the log: {', '.join(outputs)}{near}", log.name
        )
    if not len(log):
        raise LogError("no rows: nothing to judge the model by", log.name)
    for name in there:
        if np.isnan(log.columns[name]).all():
            raise LogError("no values: leave the column out (--columns)", log.name, None, name)


def _check_different(logs: Sequence[Log]) -> None:
    """Refuse a log that is given twice: it would be held out from itself."""
    from thermaltool.errors import LogError

    first: dict[str, Log] = {}
    for log in logs:
        other = first.setdefault(log.digest, log)
        if other is not log:
            raise LogError(f"the same log as {other.name}", log.name)


def _signals(log: Log) -> Record:
    from thermaltool.record import Record

    return Record(log.time, log.columns, digest=log.digest)


def _extended(model: Model, sources: Sequence[Mapping[str, str]]) -> Model:
    """The model with where its effects come from."""
    from dataclasses import replace

    made = {"logs": list(sources), "command": "thermaltool " + " ".join(sys.argv[1:])}
    return replace(model, provenance={**model.provenance, "diagnosed": made})


def _write_report(
    report: str,
    inputs: Sequence[str],
    found: Diagnosis,
    document: Mapping[str, Any],
    logs: Sequence[Log],
) -> None:
    """Figures first: the report appears when what it shows is there."""
    from thermaltool.documents import atomic_output
    from thermaltool.report.diagnosis import DECISIVE, to_markdown
    from thermaltool.report.diagnosis_figures import Traces, pictures

    by_digest = {log.digest: log for log in logs}
    traces = [
        Traces(
            by_digest[curves.log].name,
            curves.output,
            curves.time,
            curves.measured,
            curves.simulated,
            curves.extended if found.causes else None,
            by_digest[curves.log].segments,
        )
        for curves in found.curves
    ]
    figures = []
    for picture in pictures(traces, document, DECISIVE):
        target = f"{os.path.splitext(report)[0]}_{picture.name}.png"
        keep_inputs(target, *inputs)
        with atomic_output(target) as stream:
            stream.write(picture.png)
        figures.append((os.path.basename(target), picture.what))
    with atomic_output(report) as stream:
        stream.write(to_markdown(document, figures).encode())
