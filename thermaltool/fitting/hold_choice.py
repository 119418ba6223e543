"""Whether a drive switches at the rows of its log, or somewhere between them.

A command that a logger of its own clock reads may have changed at any instant since the row before:
on the average it then acts as a straight line between the rows does. What is held from row to row
leaves an error at each switch that no response explains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.fitting.kind_candidate import LEFT_OUT
from thermaltool.fitting.projection import GridStates
from thermaltool.fitting.response_search import FittedKinds, KindSearch
from thermaltool.fitting.sound_kinds import DECISIVE
from thermaltool.model import Drive
from thermaltool.record import Record
from thermaltool.responses.modes import Float

# Share of the squared error of some output that has to go.
MIN_FALL = 0.2


@dataclass(frozen=True)
class ChosenKinds:
    """An output and the kinds of response that were chosen for it.

    Attributes
    ----------
    output : str
    drives : tuple of int
        Of the calibration's drives, those that act on it.
    kinds : tuple of str, one for each of these drives
    delays : tuple of float [s]
    equilibrium : bool
        Whether gains to all temperatures among these drives add up to one.
    common : bool
        Whether these drives share their rates.
    """

    output: str
    drives: tuple[int, ...]
    kinds: tuple[str, ...]
    delays: tuple[float, ...]
    equilibrium: bool = False
    common: bool = False

    def of_all(self, drives: int) -> tuple[list[str], list[float], bool]:
        """Kinds and delays of all drives of the calibration, and whether they share their rates.

        Parameters
        ----------
        drives : int
            Their number.
        """
        own = dict(zip(self.drives, zip(self.kinds, self.delays, strict=True), strict=True))
        every = [own.get(k, (LEFT_OUT, 0.0)) for k in range(drives)]
        return [kind for kind, _ in every], [delay for _, delay in every], self.common

    def fitted(self, task: KindSearch, near: Float | None = None) -> FittedKinds | None:
        """These kinds fitted to all rows; None where they cannot be.

        Parameters
        ----------
        task : KindSearch
            Of the drives that act.
        near : ndarray, shape (searched,), optional
            Where to start, too.
        """
        return task.fit(self.kinds, self.delays, near, common=self.common)


def switched_between_rows(
    records: Sequence[Record],
    drives: Sequence[Drive],
    chosen: Sequence[ChosenKinds],
    fixed: Mapping[str, float],
    free_start: bool,
) -> list[str]:
    """Held drives that straight lines between the rows describe decisively better.

    Parameters
    ----------
    records : sequence of Record
    drives : sequence of Drive
    chosen : sequence of ChosenKinds
    fixed : mapping of parameter name to value
    free_start : bool
        See `fit_output`.

    Returns
    -------
    list of str
        Channels.
    """
    found, lines = [], list(drives)
    held_states: GridStates = {}
    for d, drive in enumerate(drives):
        if drive.hold != "zero":
            continue
        lines[d] = replace(drive, hold="first")
        states: GridStates = {}
        changes = [
            _change(records, drives, lines, each, fixed, free_start, held_states, states)
            for each in chosen
            if d in each.drives
        ]
        evidence = sum(change[0] for change in changes)
        if evidence > DECISIVE and any(fall > MIN_FALL for _, fall in changes):
            found.append(drive.channel)
        else:
            lines[d] = drive
    return found


def _change(
    records: Sequence[Record],
    held: Sequence[Drive],
    lines: Sequence[Drive],
    chosen: ChosenKinds,
    fixed: Mapping[str, float],
    free_start: bool,
    held_states: GridStates,
    states: GridStates,
) -> tuple[float, float]:
    """Fall of the criterion, and relative fall of the squared error, of one output."""
    one, other = ([each[k] for k in chosen.drives] for each in (held, lines))
    # Rows that lines explain are no outliers, and those after a switch would be.
    task = KindSearch(records, other, chosen.output, free_start, fixed, states, chosen.equilibrium)
    after = chosen.fitted(task)
    before = chosen.fitted(task.driven_by(one, held_states))
    if before is None or after is None or not before.size:
        return 0.0, 0.0
    floor = np.finfo(float).tiny
    fall = np.log(before.size / max(after.size, floor))
    return float(after.independent * fall), float(1 - after.size / before.size)
