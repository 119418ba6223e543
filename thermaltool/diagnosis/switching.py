"""Commands that switch between the rows of a log, nobody knows when.

A logger with a clock of its own shows a command that has changed at some instant since the row
before. What heat is missing, or too much, until the row is a pulse: it acts as the response to a
pulse does, for as long as an output remembers. Each output has instants of its own.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermaltool.diagnosis.simulation import Series, SimulatedLogs
from thermaltool.effects.effect import Float
from thermaltool.responses import Response
from thermaltool.units import hold_of

# A drive switches where it changes by this share of its range between two rows; of more switches
# of all drives and logs the largest of each count, and what switches in a larger share of the rows
# is no command.
MIN_SWITCH, MAX_SWITCHES, MAX_SHARE = 0.02, 80, 0.2
# Rows that are further apart part the log [of its usual step].
MAX_APART = 3.0
# Standard deviation of an instant that may be anywhere between two rows, and by how much all are
# earlier than their rows where the model was calibrated on commands that switch at the rows [of the
# rows' distance]. All of them later together are a delay, which is a cause.
SPREAD, EARLIER = 12**-0.5, 0.5


def instants_of(runs: SimulatedLogs, output: str) -> list[Series]:
    """Change of an output by the instant of each switch, earlier by a standard deviation.

    Parameters
    ----------
    runs : SimulatedLogs
    output : str
    """
    found: list[Series] = []
    held = [d.channel for d in runs.model.drives if hold_of(d.channel) == "zero"]
    most = max(MAX_SWITCHES // max(len(held) * len(runs.logs), 1), 1)
    for k in range(len(runs.logs)):
        for drive in held:
            columns = _of_drive(runs, k, output, drive, most)
            found += [
                [column if j == k else np.zeros(len(each)) for j, each in enumerate(runs.logs)]
                for column in columns
            ]
    return found


def earlier_of(columns: Sequence[Series]) -> list[Series]:
    """Change of an output by all instants together, earlier by half a row.

    Parameters
    ----------
    columns : sequence of list of ndarray
        As `instants_of` has them.
    """
    if not columns:
        return []
    return [[EARLIER / SPREAD * np.sum(each, axis=0) for each in zip(*columns, strict=True)]]


def _of_drive(runs: SimulatedLogs, k: int, output: str, drive: str, most: int) -> list[Float]:
    """Change of an output in one log by the instant of each switch of a drive."""
    log, level = runs.logs[k], runs.inputs[k][drive]
    time = log.time - runs.dead_times[k][drive]
    responses = [t.response for t in runs.model.terms if (t.output, t.drive) == (output, drive)]
    found = []
    for j in _switches(level, np.diff(log.time), most):
        ends, begins = time - log.time[j + 1], time - log.time[j]
        column = sum((_risen(r, begins) - _risen(r, ends) for r in responses), np.zeros(len(log)))
        found.append(SPREAD * (level[j + 1] - level[j]) * column)
    return found


def _switches(level: Float, steps: Float, most: int) -> list[int]:
    """Rows behind which a drive switches, the largest changes of many; none where it runs on.

    A pause says nothing of what the drive did in it.
    """
    changes = np.abs(np.diff(level))
    rows = np.flatnonzero(changes > MIN_SWITCH * float(np.ptp(level)))
    if len(rows) > MAX_SHARE * len(level):
        return []
    largest = rows[np.argsort(-changes[rows], kind="stable")][:most]
    whole = steps[largest] <= MAX_APART * float(np.median(steps))
    return sorted(largest[whole].tolist())


def _risen(response: Response, since: Float) -> Float:
    """Step response, zero before the step."""
    return np.where(since > 0, response.step(np.maximum(since, 0.0)), 0.0)
