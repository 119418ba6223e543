"""What a stream of set points does in which case."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Policy:
    """What a process of set points does in which case.

    Attributes
    ----------
    period : float [s]
        Sample period that is expected.
    sign : float
        The setpoint is `sign` times the estimate.
    safe : float [unit of the setpoint] or None
        The safe setpoint; None holds the one before.
    slew_gap : float [s]
        A longer pause counts as this long for the slew rate.
    settled : bool
        The machine has stood at the first readings for long; else it is at rest there.
    max_age : float [s]
        Time after which a state that was kept says nothing of the machine.
    kept_every : float [s]
        How old a state is at the most that was kept before a kill.
    hold_at_end : bool
        The setpoints stay at the end; else they become safe.
    """

    period: float
    sign: float = -1.0
    safe: float | None = 0.0
    slew_gap: float = math.inf
    settled: bool = False
    max_age: float = math.inf
    kept_every: float = 0.0
    hold_at_end: bool = False
