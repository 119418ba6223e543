"""How fast the channels of a model have changed in the logs that it was fitted to."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from thermaltool.fitting.even_clock import longest_step
from thermaltool.model import Model
from thermaltool.record import MAX_UNEVENNESS, Record
from thermaltool.signals.changes import Float, larger_changes, largest_changes

# A log of more sample periods with its pauses is not filled: about eight million numbers.
MAX_PAUSED = 2**23


def with_seen_changes(model: Model, records: Sequence[Record]) -> Model:
    """The model with the largest changes of its outputs, and of drives that run on.

    What it knows of other logs stays. A held drive switches as it likes: nothing is kept of it.

    Parameters
    ----------
    model : Model
    records : sequence of Record
    """

    def seen(channel: str, known: tuple[float, ...]) -> tuple[float, ...]:
        own = [
            piece
            for record in records
            if channel in record.columns
            for piece in _even(record, channel, model.sample_period)
        ]
        return larger_changes(known, largest_changes(own))

    return replace(
        model,
        drives=tuple(
            d if d.hold == "zero" else replace(d, changes=seen(d.channel, d.changes))
            for d in model.drives
        ),
        outputs=tuple(replace(o, changes=seen(o.channel, o.changes)) for o in model.outputs),
    )


def _even(record: Record, channel: str, period: float) -> Iterator[Float]:
    """A channel on an even clock; straight lines where it is not, and cut at longer steps.

    Of a log with pauses all of it is another piece, a straight line over each: by so much at least
    the machine went on meanwhile.
    """
    values, longest = record.column(channel), longest_step(record, period)
    known = np.flatnonzero(np.isfinite(values))
    whole = record.time[known]
    paused = len(known) > 1 and np.max(np.diff(whole)) > longest
    if paused and whole[-1] - whole[0] < MAX_PAUSED * period:
        yield np.interp(np.arange(whole[0], whole[-1] + period / 2, period), whole, values[known])
    for part in record.segments:
        rows = part.start + np.flatnonzero(np.isfinite(values[part]))
        breaks = np.flatnonzero(np.diff(record.time[rows]) > longest) + 1
        for piece in np.split(rows, breaks):
            if len(piece) < 2:
                continue
            time, seen = record.time[piece], values[piece]
            if np.max(np.abs(np.diff(time) - period)) > MAX_UNEVENNESS * period:
                seen = np.interp(np.arange(time[0], time[-1] + period / 2, period), time, seen)
            yield seen
