"""Validation: how an identified model does on data that took no part in its fit.

What counts is the free run of the model document, as ``simulate`` gives it: its state is carried on
from the data of the fit, and from rest in another log. Beside it stands the run whose state is
estimated from the validation data themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from thermaltool.documents import jsonable
from thermaltool.errors import FitError, LogError, ModelError
from thermaltool.fitting.data import Array, Split, TrainingData, Zero
from thermaltool.fitting.output_model import OutputModel
from thermaltool.model import Model
from thermaltool.model.initial_state import Start, with_initial_state
from thermaltool.record import Record
from thermaltool.signals.agreement import Agreement, agreement, improvement
from thermaltool.signals.start_level import start_level
from thermaltool.units import is_displacement

# Readings that one record has to hold beyond the state that is estimated at its start.
MIN_MORE_READINGS = 2


@dataclass(frozen=True)
class Validation:
    """How a model does on rows that it was not fitted to.

    Attributes
    ----------
    carried_on : Agreement
        As ``simulate`` runs the model document: the state goes on from the rows before.
    estimated_state : Agreement
        The state at the first of these rows is estimated from them.
    improvement : float [%]
        Share by which the model, carried on, reduces the mean deviation from where its log begins
        (Mareš et al.: imp).
    initial : {"rest", "free"}
        How the logs begin.
    least_fit : float [%]
        Of the log that it predicts least.
    start : float or None [s]
        The first of these rows, in the first log; None where they are another log.
    """

    carried_on: Agreement
    estimated_state: Agreement
    improvement: float
    initial: Start
    least_fit: float
    start: float | None = None

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
            "initial": self.initial,
            "start_s": self.start,
        }


def validate(
    model: OutputModel, split: Split, whole: Model | None, logs: Sequence[Record]
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
        Each an experiment of the split.

    Raises
    ------
    FitError
        Too few readings in every record, or an output that does not move.
    """
    held, begins = split.held, split.data.begins
    initial: Start = (
        "rest" if all(split.data.records[k].at_rest for k in begins.values()) else "free"
    )
    since = [held.records[k].time[0] for _, k in sorted(held.begins.items())]
    runs = None if whole is None else _runs(whole, model.target, logs, since, initial)
    if runs is None:
        runs = [(held.output(), model.carried_on(split), np.concatenate([
            np.full(len(r), _level(split.data.records[begins[r.origin]], model.target))
            for r in held.records
        ]))]  # fmt: skip
    return replace(_judged(model, held, "fitted", runs, initial), start=float(since[0]))


def validate_on(
    model: OutputModel, fresh: TrainingData, whole: Model | None, logs: Sequence[Record]
) -> Validation:
    """The same on other logs, in which a displacement has a zero of its own.

    Parameters
    ----------
    model : OutputModel
    fresh : TrainingData
        With the output of the model alone.
    whole : Model or None
    logs : sequence of Record

    Raises
    ------
    FitError
    """
    zero: Zero = "free" if is_displacement(model.target) else "mean"
    runs = None
    if whole is not None:
        runs = _runs(whole, model.target, logs, [-np.inf] * len(logs), "rest")
    if runs is None:
        begins = fresh.begins
        runs = [(fresh.output(), model.run(fresh.from_rest(), zero), np.concatenate([
            np.full(len(r), _level(fresh.records[begins[r.origin]], model.target))
            for r in fresh.records
        ]))]  # fmt: skip
    return _judged(model, fresh, zero, runs, "rest")


Run = tuple[Array, Array, Array]


def _runs(
    whole: Model, target: str, logs: Sequence[Record], since: Sequence[float], initial: Start
) -> list[Run] | None:
    """As measured, as simulated, and the level at which each log begins; None where one cannot."""
    output = next(o for o in whole.outputs if o.channel == target)
    found = []
    for log, start in zip(logs, since, strict=True):
        if not all(np.isfinite(log.column(drive.channel)).all() for drive in whole.drives):
            return None
        try:
            simulated = whole.simulate(log)[target]
            computed, zero = with_initial_state(
                whole, output, log, simulated, initial, log.time < start
            )
        except (LogError, ModelError):
            return None
        rows = log.time >= start
        measured = log.column(target)
        level = np.full(int(rows.sum()), _level(log, target))
        found.append((measured[rows], computed[rows] + zero.value, level))
    return found


def _level(record: Record, target: str) -> float:
    return start_level(record.column(target)).value


def _judged(
    model: OutputModel, held: TrainingData, zero: Zero, runs: Sequence[Run], initial: Start
) -> Validation:
    y, own = held.output(), model.run(held, zero)
    ends = np.cumsum([len(record) for record in held.records])[:-1]
    counted = np.split(np.isfinite(y) & np.isfinite(own), ends)
    if max(map(np.sum, counted)) < model.order + MIN_MORE_READINGS:
        rows = [int(np.isfinite(values).sum()) for values in np.split(y, ends)]
        apart = f" (at most {max(rows)} in one piece)" if len(rows) > 1 else ""
        raise FitError(
            f"{model.target}: {sum(rows)} validation rows{apart} are too few for the delays, a "
            f"state of order {model.order} at their start and a judgement"
        )
    fits = [agreement(measured, computed).fit_percent for measured, computed, _ in runs]
    # Each log about its own mean: arbitrary zeros would pass for something to explain.
    means = [np.mean(y[np.isfinite(y)]) if np.isfinite(y).any() else 0.0 for y, _, _ in runs]
    measured, computed, level = (
        np.concatenate([run[k] - mean for run, mean in zip(runs, means, strict=True)])
        for k in range(3)
    )
    carried = agreement(measured, computed)
    if not np.isfinite(carried.fit_percent):
        raise FitError(
            f"{model.target} is constant over the {carried.rows} validation rows: they say nothing "
            "of the model"
        )
    gained = improvement(measured - level, computed - level)
    return Validation(
        carried, agreement(*held.about_means(y, own)), gained, initial, float(np.nanmin(fits))
    )
