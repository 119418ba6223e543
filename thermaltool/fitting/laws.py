"""Laws that may hold before the responses: of a drive, or of what the machine is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.effects.drive_nonlinearity import DriveNonlinearity
from thermaltool.effects.dynamics import from_rest
from thermaltool.effects.effect import Effect
from thermaltool.effects.heat_capacity import HeatCapacity
from thermaltool.model import Course, Drive, relative
from thermaltool.record import Record

# Parameters of a law that are tried, one at a time.
FORMS: dict[type[Effect], tuple[str, ...]] = {
    DriveNonlinearity: ("exponent", "curvature"),
    HeatCapacity: ("rise",),
}


@dataclass(frozen=True)
class Law:
    """A law that may hold at a channel.

    Attributes
    ----------
    effect : type of Effect
    level : float [unit of the channel]
        Where it is told: the largest value that the records reach.
    ends : tuple of float, optional
        Least and largest value of its parameter; those of the effect by default.
    """

    effect: type[Effect]
    level: float
    ends: tuple[float, float] | None = None

    def place(self, form: str, value: float) -> float:
        """Where a search has a value: at its logarithm where it is searched by that."""
        return float(np.log(value)) if self.effect.known[form].log else value

    def at(self, channel: str, form: str, x: float) -> Effect:
        """The effect at a place of the search."""
        value = np.exp(x) if self.effect.known[form].log else x
        return self.effect(channel, {form: float(value), "level": self.level})

    def places(self, form: str) -> tuple[float, float]:
        """Where a search ends."""
        known = self.effect.known[form]
        low, high = self.ends or (known.low, known.high)
        return self.place(form, low), self.place(form, high)


def acting_records(
    records: Sequence[Record], drives: Sequence[Drive], effects: Sequence[Effect]
) -> tuple[list[Record], list[Drive]]:
    """Records with what acts in place of nonlinear drives, and drives that count it from zero.

    Parameters
    ----------
    records : sequence of Record
    drives : sequence of Drive
    effects : sequence of Effect
        Of the drives, one each at most; of the state, by the outputs as measured.

    Returns
    -------
    list of Record [unit of the drive, relative to its reference]
        In the machine's own time.
    list of Drive
    """
    own = {effect.channel: effect for effect in effects if effect.side == "drive"}
    states = [effect for effect in effects if effect.side == "state"]
    result = []
    for record in records:
        changed = {}
        for drive in drives:
            if drive.channel in own:
                u = relative(record.column(drive.channel), drive.reference, drive.hold)
                changed[drive.channel] = own[drive.channel].drive(record, u)
        measured = {effect.channel: from_rest(record, effect.channel) for effect in states}
        clock = Course.of(states, record, measured).clock if states else record.time
        result.append(replace(record.with_columns(changed), time=clock))
    return result, [replace(d, reference=0.0) if d.channel in own else d for d in drives]
