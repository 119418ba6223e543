"""Commands that switch between the rows of a log, nobody knows when.

A logger with a clock of its own shows a command that has changed at some instant since the row
before. What heat is missing, or too much, until the row is a pulse: it acts as the response to a
pulse does, for as long as an output remembers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermaltool.responses import Response
from thermaltool.responses.modes import Float

# A drive switches where it changes by this share of its range between two rows.
MIN_SWITCH = 0.02
# Rows that are further apart part the log [of its usual step].
MAX_APART = 3.0
# Standard deviation of an instant that may be anywhere between two rows [of the rows' distance].
SPREAD = 12**-0.5


def switches(level: Float, steps: Float, most: int, max_share: float) -> list[int]:
    """Rows behind which a drive switches, the largest changes of many; none where it runs on.

    A pause says nothing of what the drive did in it.

    Parameters
    ----------
    level : ndarray, shape (n,)
    steps : ndarray, shape (n - 1,) [s]
        From row to row.
    most : int
    max_share : float
        What switches in a larger share of the rows is no command.
    """
    changes = np.abs(np.diff(level))
    rows = np.flatnonzero(changes > MIN_SWITCH * float(np.ptp(level)))
    if not len(rows) or len(rows) > max_share * len(level):
        return []
    largest = rows[np.argsort(-changes[rows], kind="stable")][:most]
    whole = steps[largest] <= MAX_APART * float(np.median(steps))
    return sorted(largest[whole].tolist())


def pauses_with_switch(level: Float, steps: Float) -> list[int]:
    """Rows before the pauses in which a drive switches, in order.

    A pause is long beside the usual step and beside those around it: a logarithmic clock has none.

    Parameters
    ----------
    level : ndarray, shape (n,)
    steps : ndarray, shape (n - 1,) [s]
        From row to row.
    """
    if len(steps) < 2:
        return []
    around = np.minimum(np.append(np.inf, steps[:-1]), np.append(steps[1:], np.inf))
    pauses = steps > MAX_APART * np.maximum(np.median(steps), around)
    return np.flatnonzero(
        pauses & (np.abs(np.diff(level)) > MIN_SWITCH * float(np.ptp(level)))
    ).tolist()


def change_by_instant(
    time: Float, begins: float, ends: float, step: float, responses: Sequence[Response]
) -> Float:
    """Change of an output where a switch is earlier by a standard deviation, shape (n,).

    Parameters
    ----------
    time : ndarray, shape (n,) [s]
        Less the dead time of the drive.
    begins, ends : float [s]
        The rows between which it switches.
    step : float
        Change of the drive.
    responses : sequence of Response
    """
    column = np.zeros(len(time))
    for response in responses:
        column = column + (_risen(response, time - begins) - _risen(response, time - ends))
    return SPREAD * step * column


def _risen(response: Response, since: Float) -> Float:
    """Step response, zero before the step."""
    return np.where(since > 0, response.step(np.maximum(since, 0.0)), 0.0)
