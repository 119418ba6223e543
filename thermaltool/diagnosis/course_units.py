"""Whether a log is in other units than its names say, by what the model makes of its drives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermaltool.model import Model
from thermaltool.model.rest import relative
from thermaltool.model.validity import SAME_SIZE, UNIT_STEP, UnitSuspect, thousandth
from thermaltool.record import Record

# An output follows the model's course where this part of its variance goes with it.
SAME_COURSE = 0.9


def course_suspects(model: Model, record: Record) -> tuple[UnitSuspect, ...]:
    """Channels that follow the model's course at a thousand times its size, or at a thousandth.

    Where all outputs do, alike, and one drive moves, it is the drive; of a single output only where
    the drive is as far from its calibrated range.

    Parameters
    ----------
    model : Model
    record : Record
        With the drives and what the effects need, without NaN there.
    """
    simulated = model.simulate(record)
    reach, gains = {}, {}
    for output in (o.channel for o in model.outputs if o.channel in record.columns):
        read = np.isfinite(record.columns[output]) & np.isfinite(simulated[output])
        if not read.any():
            continue
        measured, course = (
            values[read] - values[read].mean()
            for values in (record.columns[output], simulated[output])
        )
        common, power = float(measured @ course), float(course @ course)
        if common > 0 and common**2 > SAME_COURSE * power * float(measured @ measured):
            reach[output], gains[output] = float(np.ptp(course)), common / power
    for step in (UNIT_STEP, 1 / UNIT_STEP):
        stepped = [o for o, gain in gains.items() if 1 / SAME_SIZE < gain / step < SAME_SIZE]
        if stepped:
            all_alike = len(stepped) == len(gains)
            if all_alike and (suspect := _drive(model, record, step, len(gains))):
                return (suspect,)
            found = (thousandth(o, gains[o] * reach[o], reach[o]) for o in stepped)
            return tuple(replace(each, by_model=True) for each in found if each is not None)
    return ()


def _drive(model: Model, record: Record, step: float, outputs: int) -> UnitSuspect | None:
    """The one drive that moves, where all outputs go with a drive of `step` times its size."""
    moved = {}
    for drive in model.drives:
        values = relative(record.columns[drive.channel], drive.reference, drive.hold)
        if logged := float(np.max(np.abs(values))):
            moved[drive.channel] = logged, max(map(abs, drive.range))
    if len(moved) != 1:
        return None
    channel, (logged, seen) = next(iter(moved.items()))
    if outputs == 1 and max(logged, seen) < np.sqrt(UNIT_STEP) * min(logged, seen):
        return None
    known = thousandth(channel, logged, step * logged)
    unit = None if known is None else known.unit
    return UnitSuspect(channel, unit, logged, step * logged, by_model=True)
