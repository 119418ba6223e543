"""Commands that change during a pause of a log, placed where the outputs show them."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

from thermaltool.api.inputs import Notice

if TYPE_CHECKING:
    from thermaltool.fitting.pauses import PauseSwitch
    from thermaltool.logs import Log
    from thermaltool.units import Hold


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
    from thermaltool.units import drive_reference, hold_of

    steps, held = np.diff(log.time), [name for name in drives if hold_of(name) == "zero"]
    if not any(pauses_with_switch(log.column(name), steps) for name in held):
        return []

    from thermaltool.fitting.pauses import switches_in_pauses
    from thermaltool.model import Drive

    own = [Drive(name, hold_of(name), drive_reference(name), (0.0, 0.0)) for name in drives]
    return switches_in_pauses(log, own, outputs)


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

    from thermaltool.errors import UnitError
    from thermaltool.fitting.pauses import switch_rows
    from thermaltool.report.text import pause_switch_message
    from thermaltool.units import hold_of

    for switch in found:
        warn(pause_switch_message(log, switch))
    holds: dict[str, Hold] = {}
    for name in log.columns:
        # A column without a unit is read by nothing.
        with contextlib.suppress(UnitError):
            holds |= {} if name in outputs else {name: hold_of(name)}
    return log.with_rows(*switch_rows(log, holds, found))
