"""What an experiment may ask for: how fast and how long, and what can be set at all."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from thermaltool.errors import UnitError
from thermaltool.record import hint
from thermaltool.units import converted, hold_of, parse_quantity

# An experiment that nothing limits lasts so long at most [s].
MAX_DURATION = 3 * 86400.0
# A run that is worth asking for without a limit: a working day, or as long as the logs [s].
WORKING_DAY = 8 * 3600.0


@dataclass(frozen=True)
class ExperimentLimits:
    """What can be done at a machine.

    Attributes
    ----------
    switch : float [s]
        Shortest time between two changes of a channel.
    run : float or None [s]
        Longest run; None for a working day, or the longest log where that is longer.
    fixed : frozenset of str
        Channels that cannot be set.
    settable : frozenset of str
        Temperatures and displacements that can be set all the same (a bed that is regulated).
        Others are what a sensor reads.
    unlimited : bool
        Whether everything can be set.
    """

    switch: float = 0.0
    run: float | None = None
    fixed: frozenset[str] = frozenset()
    settable: frozenset[str] = frozenset()
    unlimited: bool = False

    def longest(self, logged: float) -> float:
        """Longest run [s].

        Parameters
        ----------
        logged : float [s]
            Longest log.
        """
        if self.unlimited:
            return max(MAX_DURATION, logged)
        return self.run or max(WORKING_DAY, logged)

    def can_set(self, channel: str) -> bool:
        """Whether somebody at the machine can set a channel.

        Parameters
        ----------
        channel : str
        """
        if self.unlimited or channel in self.settable:
            return True
        return channel not in self.fixed and hold_of(channel) == "zero"


# What can be done at a machine of which nothing is said, and every input that a model can be given.
USUAL_LIMITS = ExperimentLimits()
UNLIMITED = ExperimentLimits(unlimited=True)


def limits_of(text: str, channels: Iterable[str]) -> ExperimentLimits:
    """Limits as they are typed: ``switch=30s,run=4h,fixed=Q_fan_1,set=T_bed_degC``.

    Times have their unit.

    Parameters
    ----------
    text : str
        Parted by commas; ``fixed`` and ``set`` may be there several times. Empty for none.
    channels : iterable of str
        That the logs have.

    Raises
    ------
    UnitError
        Another key, no time, or one without a unit, a channel that no log has.
    """
    known, times = set(channels), {"switch": 0.0, "run": 0.0}
    named: dict[str, set[str]] = {"fixed": set(), "set": set()}
    for part in filter(None, (each.strip() for each in text.split(","))):
        key, equals, value = (each.strip() for each in part.partition("="))
        if key in times and equals:
            times[key] = _seconds(part, value)
        elif key in named and equals:
            if value not in known:
                raise UnitError(f"limits {part}: no channel {value!r}{hint(value, known)}")
            named[key].add(value)
        else:
            raise UnitError(
                f"limits {part}: takes switch=TIME, run=TIME, fixed=CHANNEL and set=CHANNEL"
            )
    if both := named["fixed"] & named["set"]:
        raise UnitError(f"limits: {', '.join(sorted(both))} is both fixed and set")
    if times["run"] and times["switch"] > times["run"]:
        raise UnitError("limits: switch is longer than run")
    return ExperimentLimits(
        times["switch"], times["run"] or None, frozenset(named["fixed"]), frozenset(named["set"])
    )


def _seconds(part: str, value: str) -> float:
    """A time above zero, with its unit: what a log counts in is no user's first thought."""
    try:
        number, unit = parse_quantity(value)
    except UnitError as error:
        raise UnitError(f"limits {part}: {error}") from None
    if unit is None:
        key = part.partition("=")[0].strip()
        several = [f"{key}={number:g}{each}" for each in ("s", "min", "h")]
        raise UnitError(
            f"limits {part}: of which unit? {', '.join(several[:-1])} or {several[-1]} "
            "(logs count in s)"
        )
    seconds = converted(number, unit, "s")
    if seconds is None or not 0 < seconds < np.inf:
        raise UnitError(f"limits {part}: not a time above zero, like 30s, 10min or 4h")
    return seconds
