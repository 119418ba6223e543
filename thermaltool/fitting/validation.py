"""Validation: how an identified model does on data that took no part in its fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, TrainingData, Zero
from thermaltool.fitting.output_model import OutputModel
from thermaltool.signals.agreement import Agreement, agreement, improvement
from thermaltool.units import is_displacement

# Readings that one record has to hold beyond the state that is estimated at its start.
MIN_MORE_READINGS = 2


def validate(model: OutputModel, held: TrainingData, other_log: bool) -> tuple[Agreement, float]:
    """Agreement of a free run with held-out data, and its improvement [%].

    One record has to hold `MIN_MORE_READINGS` beyond the state that is estimated at its start.

    Parameters
    ----------
    model : OutputModel
    held : TrainingData
        With the output of the model alone.
    other_log : bool
        Whether they come from another log than the data of the fit.

    Raises
    ------
    FitError
        Too few readings in every record, or an output that does not move.
    """
    zero: Zero = "fitted"
    if other_log:  # in which a displacement has a zero of its own
        zero = "free" if is_displacement(model.target) else "mean"
    y, computed, target = held.output(), model.run(held, zero), model.target
    found = agreement(y, computed)
    ends = np.cumsum([len(record) for record in held.records])[:-1]
    counted = np.split(np.isfinite(y) & np.isfinite(computed), ends)
    if max(map(np.sum, counted)) < model.order + MIN_MORE_READINGS:
        rows = [int(np.isfinite(values).sum()) for values in np.split(y, ends)]
        apart = f" (at most {max(rows)} in one piece)" if len(rows) > 1 else ""
        raise FitError(
            f"{target}: {sum(rows)} validation rows{apart} are too few for the delays, a state "
            f"of order {model.order} at their start and a judgement"
        )
    if not np.isfinite(found.fit_percent):
        raise FitError(
            f"{target} is constant over the {found.rows} validation rows: they say nothing of the "
            "model"
        )
    rest = _rest(held, np.split(y, ends), zero, model.offsets)
    return found, improvement(y - rest, computed - rest)


def _rest(
    held: TrainingData, measured: Sequence[Array], zero: Zero, offsets: Sequence[float]
) -> Array:
    """What counts as no deviation, row by row: the zero, or the first reading of its log."""
    if zero == "mean":
        return np.full(held.rows, np.mean(offsets))
    own: dict[int, float] = dict(enumerate(offsets)) if zero == "fitted" else {}
    for record, values in zip(held.records, measured, strict=True):
        for first in values[np.isfinite(values)][:1].tolist():
            own.setdefault(record.origin, first)
    return np.concatenate([np.full(len(r), own.get(r.origin, np.nan)) for r in held.records])
