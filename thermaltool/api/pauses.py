"""Commands that change during a pause of a log, placed where the outputs show them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from thermaltool.api.inputs import Notice

if TYPE_CHECKING:
    from thermaltool.fitting.pauses import PauseSwitch
    from thermaltool.logs import Log


def placed_in_pauses(
    log: Log, drives: Sequence[str], outputs: Sequence[str], warn: Notice, shown: Log | None = None
) -> Log:
    """A log with rows, without readings, where a command changes during a pause.

    Parameters
    ----------
    log : Log
    drives, outputs : sequence of str
    warn : callable
        Takes a sentence on each.
    shown : Log, optional
        The same without readings that would mislead. Default: the log itself.
    """
    found = switches_in(log if shown is None else shown, drives, outputs)
    return with_switches(log, found, outputs, warn)


def switches_in(log: Log, drives: Sequence[str], outputs: Sequence[str]) -> list[PauseSwitch]:
    """Commands that change during a pause of a log, where the outputs are sure of it.

    Parameters
    ----------
    log : Log
    drives, outputs : sequence of str
    """
    import numpy as np

    from thermaltool.responses.switching import pauses_with_switch
    from thermaltool.units import hold_of

    steps, held = np.diff(log.time), [name for name in drives if hold_of(name) == "zero"]
    if not any(pauses_with_switch(log.column(name), steps) for name in held):
        return []

    from thermaltool.fitting.pauses import switches_of

    return switches_of(log, drives, outputs)


def with_switches(
    log: Log, found: Sequence[PauseSwitch], outputs: Sequence[str], warn: Notice
) -> Log:
    """A log with rows, without readings, around such switches.

    Parameters
    ----------
    log : Log
    found : sequence of PauseSwitch
    outputs : sequence of str
    warn : callable
        Takes a sentence on each.
    """
    if not found:
        return log

    from thermaltool.fitting.pauses import with_switch_rows
    from thermaltool.report.text import pause_switch_message

    for switch in found:
        warn(pause_switch_message(log, switch))
    return with_switch_rows(log, found, outputs)
