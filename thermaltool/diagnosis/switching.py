"""Instants of commands that switch between the rows of a log; each output has its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermaltool.diagnosis.simulation import Series, SimulatedLogs
from thermaltool.effects.effect import Float
from thermaltool.responses.switching import SPREAD, change_by_instant, switches
from thermaltool.units import hold_of

# Of more switches of all drives and logs the largest of each count, and what switches in a larger
# share of the rows is no command.
MAX_SWITCHES, MAX_SHARE = 80, 0.2
# By how much all are earlier than their rows where the model was calibrated on commands that switch
# at the rows [of the rows' distance]. All of them later together are a delay, which is a cause.
EARLIER = 0.5


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
    return [
        change_by_instant(time, log.time[j], log.time[j + 1], level[j + 1] - level[j], responses)
        for j in switches(level, np.diff(log.time), most, MAX_SHARE)
    ]
