"""Validation: how an identified model does on data that took no part in its fit.

What counts is the free run of the model document, as ``simulate`` gives it: its state is carried on
from the data of the fit; another log begins at rest, unless it says clearly that it does not.
Beside it stands the run whose state is estimated from the validation data themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from thermaltool.documents import jsonable
from thermaltool.errors import DataError, FitError, LogError, ModelError
from thermaltool.fitting.data import Array, Split, TrainingData, Zero
from thermaltool.fitting.output_model import OutputModel
from thermaltool.fitting.pauses import switches_of, with_switch_rows
from thermaltool.model import Model, Start, started_outputs
from thermaltool.record import Record
from thermaltool.signals.agreement import Agreement, agreement, improvement
from thermaltool.signals.start_level import start_level
from thermaltool.units import is_displacement

# Readings that one record has to hold beyond the state that is estimated at its start.
MIN_MORE_READINGS = 2
# First and last moment of what is fitted and judged [s]; open where None.
Span = tuple[float | None, float | None]


@dataclass(frozen=True)
class HeldOut:
    """Rows of a log that are held out, as ``simulate`` judges them.

    Attributes
    ----------
    log : Record
        All of it: every row drives the model.
    initial : {"auto", "rest", "free"}
        How the log begins.
    start, stop : float or None [s]
        The rows that are judged.
    fit_percent : float
        NaN before they are.
    """

    log: Record
    initial: Start
    start: float | None
    stop: float | None
    fit_percent: float = float("nan")

    def document(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "log": self.log.name,
            "initial": self.initial,
            "start_s": self.start,
            "stop_s": self.stop,
            "fit_percent": jsonable(self.fit_percent),
        }


@dataclass(frozen=True)
class Validation:
    """How a model does on rows that it was not fitted to.

    Attributes
    ----------
    carried_on : Agreement
        As ``simulate`` runs the model document: the state goes on from the rows before.
    estimated_state : Agreement
        The state at the first of these rows, and the zero of a displacement, are estimated from
        them.
    improvement : float [%]
        Share by which the model, carried on, reduces the mean deviation from where its log begins
        (Mareš et al.: imp).
    logs : tuple of HeldOut
        Which rows of each log, and the fit of each.
    is_split : bool
        Whether they go on from rows that were fitted; else they are other logs.
    """

    carried_on: Agreement
    estimated_state: Agreement
    improvement: float
    logs: tuple[HeldOut, ...]
    is_split: bool

    @property
    def least_fit(self) -> float:
        """Fit of the log that the model predicts least [%]."""
        return float(np.nanmin([each.fit_percent for each in self.logs]))

    @property
    def predicts(self) -> bool:
        """Whether the model is nearer to the rows of each log than their mean is."""
        return self.least_fit > 0

    def document(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "fit_percent": jsonable(self.carried_on.fit_percent),
            "fit_state_estimated_percent": jsonable(self.estimated_state.fit_percent),
            "improvement_percent": jsonable(self.improvement),
            "logs": [each.document() for each in self.logs],
        }


def validate(
    model: OutputModel,
    split: Split,
    whole: Model | None,
    logs: Sequence[Record],
    span: Span,
    outputs: Sequence[str],
) -> Validation:
    """How a model does on the held-out rows of the logs that it was fitted to.

    Parameters
    ----------
    model : OutputModel
    split : Split
        With the output of the model alone.
    whole : Model or None
        Its document; None where it has none: then the model itself is run.
    logs : sequence of Record
        Each an experiment of the split, with the rows beside the span.
    span : (float or None, float or None) [s]
        What was fitted and is judged.
    outputs : sequence of str
        All that are identified: together they tell when a command has changed in a pause.

    Raises
    ------
    FitError
        Too few readings in every record, or an output that does not move.
    """
    held, begins = split.held, split.data.begins
    rows = [
        HeldOut(
            logs[origin],
            "rest" if split.data.records[begins[origin]].at_rest else "free",
            float(held.records[k].time[0]),
            span[1],
        )
        for origin, k in sorted(held.begins.items())
    ]
    # As simulate counts it a displacement has a zero of its own, which is not that of the fit.
    zero: Zero = "free" if is_displacement(model.target) else "fitted"
    simulated = partial(_simulated, whole, model.target, rows, outputs)
    return _judged(model, held, zero, rows, simulated, lambda: model.carried_on(split), True)


def validate_on(
    model: OutputModel,
    fresh: TrainingData,
    whole: Model | None,
    logs: Sequence[Record],
    span: Span,
    outputs: Sequence[str],
) -> Validation:
    """The same on other logs, in which a displacement has a zero of its own.

    Parameters
    ----------
    model : OutputModel
    fresh : TrainingData
        With the output of the model alone.
    whole : Model or None
    logs : sequence of Record
    span : (float or None, float or None) [s]
    outputs : sequence of str

    Raises
    ------
    FitError
    """
    zero: Zero = "free" if is_displacement(model.target) else "mean"
    rows = [HeldOut(log, "auto", *span) for log in logs]
    simulated = partial(_simulated, whole, model.target, rows, outputs)
    return _judged(
        model, fresh, zero, rows, simulated, lambda: model.run(fresh.from_rest(), zero), False
    )


Run = tuple[Array, Array]


def _simulated(
    whole: Model | None, target: str, rows: Sequence[HeldOut], outputs: Sequence[str]
) -> list[Run] | None:
    """As measured and as simulated, for each log; None where one cannot be simulated."""
    if whole is None:
        return None
    found = []
    for each in rows:
        log, time = each.log, each.log.time
        if not all(np.isfinite(log.column(drive.channel)).all() for drive in whole.drives):
            return None
        # Without rows before those that are judged these say how the log begins.
        first = np.inf if each.start is None else each.start
        # As simulate does: rows that are judged do not say when a command has changed in a pause.
        known = {name: np.where(time < first, log.column(name), np.nan) for name in outputs}
        drives = [drive.channel for drive in whole.drives]
        log = with_switch_rows(log, switches_of(log.with_columns(known), drives, outputs), outputs)
        read, time = np.isin(log.time, time), log.time
        try:
            run = whole.simulate(log)
            own = started_outputs(whole, log, run, each.initial, time < first)[target]
        except (LogError, ModelError):
            return None
        low = -np.inf if each.start is None else each.start
        high = np.inf if each.stop is None else each.stop
        judged = read & (time >= low) & (time <= high)
        found.append((log.column(target)[judged], own.computed[judged] + own.zero.value))
    return found


def _of_experiments(held: TrainingData, computed: Array) -> list[Run]:
    """As measured and as computed over all records, for each experiment."""
    origins = np.concatenate([np.full(len(r), r.origin) for r in held.records])
    y = held.output()
    return [(y[origins == k], computed[origins == k]) for k in sorted(held.begins)]


def _judged(
    model: OutputModel,
    held: TrainingData,
    zero: Zero,
    rows: Sequence[HeldOut],
    simulated: Callable[[], list[Run] | None],
    run: Callable[[], Array],
    is_split: bool,
) -> Validation:
    """The model document as ``simulate`` runs it, or the model's own `run` where it has none."""
    y, own = held.output(), model.run(held, zero)
    ends = np.cumsum([len(record) for record in held.records])[:-1]
    counted = np.split(np.isfinite(y) & np.isfinite(own), ends)
    if max(map(np.sum, counted)) < model.order + MIN_MORE_READINGS:
        readings = [int(np.isfinite(values).sum()) for values in np.split(y, ends)]
        apart = f" (at most {max(readings)} in one piece)" if len(readings) > 1 else ""
        raise FitError(
            f"{model.target}: {sum(readings)} validation rows{apart} are too few for the delays, a "
            f"state of order {model.order} at their start and a judgement"
        )
    runs = simulated() or _of_experiments(held, run())
    logs = tuple(
        replace(each, fit_percent=agreement(*run).fit_percent)
        for each, run in zip(rows, runs, strict=True)
    )
    # Each log about its own mean: arbitrary zeros would pass for something to explain.
    means = [np.mean(y[np.isfinite(y)]) if np.isfinite(y).any() else 0.0 for y, _ in runs]
    measured, computed = (
        np.concatenate([run[k] - mean for run, mean in zip(runs, means, strict=True)])
        for k in range(2)
    )
    carried = agreement(measured, computed)
    if not np.isfinite(carried.fit_percent):
        raise DataError(
            f"{model.target} is constant over the {carried.rows} validation rows: they say nothing "
            "of the model"
        )
    level = np.concatenate([
        np.full(len(run[0]), start_level(each.log.column(model.target)).value - mean)
        for each, run, mean in zip(rows, runs, means, strict=True)
    ])  # fmt: skip
    gained = improvement(measured - level, computed - level)
    about = agreement(*held.about_means(y, own))
    return Validation(carried, about, gained, logs, is_split)
