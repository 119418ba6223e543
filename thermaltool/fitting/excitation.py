"""Whether inputs excite, and an output moves: what is needed to fit a transfer function."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import DataError
from thermaltool.record import Record

Array = NDArray[np.float64]

# Inputs whose normalized Gram matrix has an eigenvalue below this are the same to rounding.
MIN_INDEPENDENCE = 1e-9
# Weight in such a combination above which an input is named.
MIN_NAMED_WEIGHT = 1e-3
# An input whose deviations are below this share of its size never moves.
MIN_MOVEMENT = 1e-12


def check_excitation(
    inputs: Sequence[str], output: str, u: Sequence[Array], y: Sequence[Array]
) -> None:
    """Refuse what says nothing of a transfer function.

    Parameters
    ----------
    inputs : sequence of str
    output : str
    u : sequence of ndarray, shape (m, n)
        Inputs of each record.
    y : sequence of ndarray, shape (n,)
        The output, NaN where a reading is missing.

    Raises
    ------
    DataError
        An input that never moves, an output that never moves or is never measured, inputs that
        are combinations of each other (named).
    """
    there = [np.isfinite(own) for own in y]
    whole = np.concatenate([own[rows] for own, rows in zip(y, there, strict=True)])
    if not len(whole):
        raise DataError(f"{output} has no reading in any log", output)
    if not np.ptp(whole) > 0:
        if len(whole) == 1:
            raise DataError(
                f"{output}: one reading is too few to tell a transfer function by", output
            )
        raise DataError(
            f"{output} is constant over the rows that are fitted: there is nothing to identify",
            output,
        )
    parts = [own if rows.all() else own[:, rows] for own, rows in zip(u, there, strict=True)]
    moved = np.hstack([own - own.mean(1, keepdims=True) for own in parts if own.size])
    power = np.sqrt(np.sum(moved**2, axis=1))
    size = np.sqrt(np.sum(np.hstack(parts) ** 2, axis=1))
    for name, deviation, own in zip(inputs, power, size, strict=True):
        if not deviation > MIN_MOVEMENT * own:
            raise DataError(
                f"{name} does not excite: it never moves within the rows that are fitted"
            )
    unit = moved / power[:, None]
    values, vectors = np.linalg.eigh(unit @ unit.T)
    if len(values) > 1 and values[0] < MIN_INDEPENDENCE:
        weights = np.abs(vectors[:, 0])
        named = [name for name, weight in zip(inputs, weights, strict=True)
                 if weight > MIN_NAMED_WEIGHT]  # fmt: skip
        raise DataError(f"collinear inputs: {', '.join(named)} are combinations of each other")


def constant_channels(
    logs: Sequence[Record], names: Sequence[str], split: float | None, least: float
) -> tuple[str, ...]:
    """Channels that stand still over the training rows of every log; none where all of them do.

    Parameters
    ----------
    logs : sequence of Record
    names : sequence of str
    split : float or None
        Share of the rows of each log that are fitted.
    least : float
        Range above which a channel moves, as a share of its size.
    """

    def moves(log: Record, name: str) -> bool:
        values = log.column(name)[: round((split or 1.0) * len(log))]
        values = values[np.isfinite(values)]
        # What has no reading at all is named elsewhere.
        return not len(values) or float(np.ptp(values)) > least * float(np.max(np.abs(values)))

    found = tuple(name for name in names if not any(moves(log, name) for log in logs))
    return found if len(found) < len(names) else ()
