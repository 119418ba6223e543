"""What a model gets wrong on measured logs, why, and what knowing it is worth.

The search for causes is in `search`; here it is asked, and readings that stand out are set apart
before it and judged after it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from thermaltool.diagnosis.alternatives import invisible
from thermaltool.diagnosis.answer import answer
from thermaltool.diagnosis.limits import USUAL_LIMITS, ExperimentLimits
from thermaltool.diagnosis.no_signature import OutlierMask, find_outliers, outliers_of
from thermaltool.diagnosis.residual_budget import reading_noise
from thermaltool.diagnosis.result import Diagnosis
from thermaltool.diagnosis.search import searched
from thermaltool.diagnosis.select import Progress
from thermaltool.diagnosis.simulation import SimulatedLogs
from thermaltool.diagnosis.state import DiagnosisTask, SearchState
from thermaltool.diagnosis.written import cannot_run
from thermaltool.errors import FitError, ModelError, counted
from thermaltool.model import Model
from thermaltool.record import Record

# Rows, and values of an output, by which a model is judged at least.
MIN_ROWS = 20


def diagnose(
    model: Model,
    logs: Sequence[Record],
    validate: Sequence[Record] = (),
    progress: Progress = lambda message: None,
    calibration: Sequence[Record] = (),
    limits: ExperimentLimits = USUAL_LIMITS,
    simulated: Mapping[str, Record] = MappingProxyType({}),
) -> Diagnosis:
    """What a model gets wrong on measured logs, and why.

    Parameters
    ----------
    model : Model
        As calibrated. Where one of `logs` was used for that, its own parameters are free; else
        they stay within the covariance of the calibration.
    logs : sequence of Record
        Each with the model's drives, and with at least one output in one of them.
    validate : sequence of Record
        Logs that no fit sees, on which gains are measured; causes have to hold there, too. Without
        them blocks of `logs` are held out in turn, and gains are told on `logs`.
    progress : callable
        Told what is being done.
    calibration : sequence of Record
        Logs that the model was calibrated on, beside `logs`: what the written model makes of them
        is told. They are no veto: what has changed since is what is looked for.
    limits : ExperimentLimits
        What can be done at the machine; experiments that are asked for keep within.
    simulated : mapping of digest to Record
        Logs as `simulate` has them, where that is otherwise: outliers that are sought here are
        faults of sensors there. Errors of the models are told of these.

    Returns
    -------
    Diagnosis

    Raises
    ------
    ModelError, FitError
        No output of the model in any log, a channel without values, a drive that never moves.
    """
    _check(model, logs)
    if validate:
        _check(model, validate)
    asked = DiagnosisTask(
        model, tuple(logs), tuple(validate), tuple(calibration), progress, limits, simulated
    )
    task = asked.averaged()
    progress("noise")
    first = task.first()
    progress("what these logs cannot show")
    unseen = tuple(invisible(first, limits))
    outliers = find_outliers(first)
    # They are left out from here on; whether they are a cause is told at the end.
    start = first if outliers is None else first.with_masked(outliers.masked)
    task, search = searched(task, SearchState(start, start, unseen))
    if task.readings is not None:
        search = _with_outliers_of(task.readings, search, search.written(task))
    elif outliers is not None:
        search = _with_outliers(search)
    return answer(task, first, search)


def _check(model: Model, logs: Sequence[Record]) -> None:
    """Refuse logs by which the model cannot be judged."""
    for log in logs:
        if len(log.time) < MIN_ROWS:
            raise FitError(f"{counted(len(log.time), 'row')}: too few to judge a model by")
        for drive in model.drives:
            if drive.channel not in log.columns:
                raise ModelError(f"the model's drive {drive.channel} is not in the log")
            if not np.isfinite(log.columns[drive.channel]).all():
                raise ModelError(f"the model's drive {drive.channel} has missing values")
    outputs = [o.channel for o in model.outputs if o.judged]
    if not any(o in log.columns for o in outputs for log in logs):
        raise ModelError(f"no output of the model in the logs: {', '.join(outputs)}")
    if any(term.band is not None for term in model.terms):
        raise ModelError("a schedule of transfer functions: diagnose its members one by one")
    for o in outputs:
        there = [log.columns[o] for log in logs if o in log.columns]
        if there and not any(np.isfinite(values).sum() >= MIN_ROWS for values in there):
            raise ModelError(f"{o} has fewer than {MIN_ROWS} values")


def _with_outliers(search: SearchState) -> SearchState:
    """Outliers of what is left in the end: a cause where leaving them out is of use."""
    outliers = find_outliers(search.open().with_masked({}))
    if outliers is None:
        return search
    masked = search.hypothesis.with_masked(outliers.masked)
    return _leaving_out(replace(search, hypothesis=masked), outliers)


def _with_outliers_of(readings: DiagnosisTask, search: SearchState, written: Model) -> SearchState:
    """Outliers of the readings, which averages are without from the beginning."""
    written = replace(written, drives=readings.model.drives)
    logs = tuple(log for log in readings.logs if cannot_run(written, log) is None)
    white = {o: reading_noise(search.hypothesis, o) for o in search.hypothesis.groups}
    outliers = outliers_of(SimulatedLogs(written, logs, {}), white)
    if outliers is None:
        return search
    return _leaving_out(replace(search, left_out=outliers.masked), outliers)


def _leaving_out(search: SearchState, outliers: OutlierMask) -> SearchState:
    """The search with outliers as a cause, where leaving them out is of use; else with a note."""
    if not outliers.matter:
        return search.noted("a few readings stand out of their neighbours and are left out")
    causes = search.causes
    first = not causes or outliers.cause.evidence > causes[0].evidence
    causes = (outliers.cause, *causes) if first else (*causes, outliers.cause)
    return replace(search, causes=causes)
