"""How an identified model does on data that took no part in its fit, whatever its structure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, Zero
from thermaltool.record import Record
from thermaltool.signals.agreement import Agreement, agreement, improvement
from thermaltool.units import is_displacement


def zero_of(target: str, other_log: bool) -> Zero:
    """The zero of validation data: that of a displacement is arbitrary in every log."""
    if not other_log:
        return "fitted"
    return "free" if is_displacement(target) else "mean"


def judged(
    target: str,
    pieces: Sequence[Record],
    measured: Sequence[Array],
    computed: Array,
    rest: Array,
    states: int,
) -> tuple[Agreement, float]:
    """The fit of a free run, and its improvement [%].

    Parameters
    ----------
    target : str
        Name of the output.
    pieces : sequence of Record
    measured : sequence of ndarray
        Output over each piece; NaN where a reading is missing.
    computed, rest : ndarray, all pieces in a row
        The free run (NaN where there is none), and what counts as no deviation (`rests`).
    states : int
        Numbers that are estimated from each piece: one piece has to cover two readings more.

    Raises
    ------
    FitError
        Too few readings in every piece, or an output that does not move.
    """
    y = np.concatenate(measured)
    found = agreement(y, computed)
    ends = np.cumsum([len(piece) for piece in pieces])[:-1]
    if max(map(np.sum, np.split(np.isfinite(y) & np.isfinite(computed), ends))) < states + 2:
        rows = [int(np.isfinite(values).sum()) for values in measured]
        apart = f" (at most {max(rows)} in one piece)" if len(rows) > 1 else ""
        raise FitError(
            f"{target}: {sum(rows)} validation rows{apart} are too few for the delays, a state "
            f"of order {states} at their start and a judgement"
        )
    if not np.isfinite(found.fit_percent):
        raise FitError(
            f"{target} is constant over the {found.rows} validation rows: they say nothing of the "
            "model"
        )
    return found, improvement(y - rest, computed - rest)


def rests(
    pieces: Sequence[Record], measured: Sequence[Array], zero: Zero, offsets: Sequence[float]
) -> Array:
    """What counts as no deviation, row by row: the zero, or the first reading of its log."""
    if zero == "mean":
        return np.full(sum(map(len, pieces)), np.mean(offsets))
    own: dict[int, float] = dict(enumerate(offsets)) if zero == "fitted" else {}
    for piece, row in zip(pieces, measured, strict=True):
        for first in row[np.isfinite(row)][:1].tolist():
            own.setdefault(piece.origin, first)
    return np.concatenate([np.full(len(piece), own.get(piece.origin, np.nan)) for piece in pieces])
