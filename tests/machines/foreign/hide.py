"""Logs of a machine with one thing wrong, as large as is wanted against what a model leaves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from machines.foreign.fault import Builder, Fault, Scene
from machines.foreign.faults import CATALOGUE, NATURAL, SINCE
from machines.foreign.plant import Conditions, Plant, Table, clean_twin, draw, read, run
from machines.foreign.solver import Array
from machines.foreign.strangers import MAY_BE_KNOWN, NEVER_KNOWN

KINDS: dict[str, Builder] = {
    **CATALOGUE,
    **SINCE,
    **NATURAL,
    **{name: builder for name, (builder, _) in MAY_BE_KNOWN.items()},
    **NEVER_KNOWN,
}
_PRECISE, _TRIES = 0.05, 9  # of the search for a strength
_POWERS = 0.4, 3.0  # by which a change may go with the strength


@dataclass(frozen=True)
class Exercise:
    """A diagnosed and a validation log, and what is wrong in them.

    Parameters
    ----------
    kind : str
        A key of `KINDS`; empty where nothing is wrong.
    size : float
        Reached: RMS of the change of an output about its mean, over what the model leaves of a
        clean log, where that is largest.
    strength : float
    fault : Fault or None
    log, validation : Table
        As the machine's own quantities; the second has the fault where it recurs.
    change : mapping of output to (r,) ndarray
        Without noise, of `log`.
    """

    kind: str
    size: float
    strength: float
    fault: Fault | None
    log: Table
    validation: Table
    change: Mapping[str, Array]


def calibration(plant: Plant, seed: int) -> Table:
    """A log of the machine's own excitation."""
    generator = np.random.default_rng([seed, 1])
    c = draw(plant, generator, calibrating=True)
    return read(plant, c, run(plant, c), generator)


def clean_log(plant: Plant, seed: int) -> Table:
    """A later log with nothing wrong."""
    generator = np.random.default_rng([seed, 2])
    c = draw(plant, generator)
    return read(plant, c, run(plant, c), generator)


def hide(
    plant: Plant, kind: str, size: float, seed: int, residual: Mapping[str, float]
) -> Exercise | None:
    """Logs with one thing wrong; None where it does not apply to this machine.

    Parameters
    ----------
    plant : Plant
    kind : str
        A key of `KINDS`, or empty.
    size : float
        Wanted, see `Exercise.size`; what has no strength has the size that it has.
    seed : int
    residual : mapping of output to float
        RMS about the mean of what the model leaves of a clean log.
    """
    generator = np.random.default_rng([seed, 3])
    clean, later = draw(plant, generator), draw(plant, generator)
    fault = None
    if kind:
        fault = KINDS[kind](Scene(plant, clean, run(plant, clean), generator))
        if fault is None:
            return None
    strength, reached, change = _strength(plant, clean, fault, kind, size, residual)
    tables = []
    for c, affected in ((clean, True), (later, fault is not None and fault.recurs)):
        here = c.copy()
        if fault and affected:
            fault.apply(strength, here)
        tables.append(read(plant, here, run(plant, here), generator))
    return Exercise(kind, reached, strength, fault, tables[0], tables[1], change)


def change_of(plant: Plant, clean: Conditions, fault: Fault, strength: float) -> Table:
    """What a fault changes of every output, under the commands of the log that has it."""
    c = clean.copy()
    fault.apply(strength, c)
    course = run(plant, c)
    twin = run(plant, clean_twin(c, clean, course))
    return {name: course.table[name] - twin.table[name] for name in plant.outputs}


def size_of(change: Mapping[str, Array], residual: Mapping[str, float]) -> float:
    """Size of a change, see `Exercise.size`."""
    return max(float(np.std(change[name])) / residual[name] for name in residual)


def _strength(
    plant: Plant,
    clean: Conditions,
    fault: Fault | None,
    kind: str,
    wanted: float,
    residual: Mapping[str, float],
) -> tuple[float, float, Table]:
    """The strength that gives a size, by secants of the logarithms; with size and change."""
    if fault is None:
        return 0.0, 0.0, {name: np.zeros(len(clean.rows)) for name in residual}
    if kind in NATURAL:
        change = change_of(plant, clean, fault, 1.0)
        return 1.0, size_of(change, residual), change
    strength, power, seen = min(fault.typical, fault.most), 1.0, (0.0, 0.0)
    best: tuple[float, float, Table] | None = None
    for _ in range(_TRIES):
        change = change_of(plant, clean, fault, strength)
        size = size_of(change, residual)
        if best is None or abs(np.log((size + 1e-9) / wanted)) < abs(
            np.log((best[1] + 1e-9) / wanted)
        ):
            best = strength, size, change
        if abs(size / wanted - 1.0) < _PRECISE or (strength >= fault.most and size < wanted):
            break
        if seen[1] > 0 and size > 0 and strength != seen[0]:
            slope = np.log(size / seen[1]) / np.log(strength / seen[0])
            power = float(np.clip(slope, *_POWERS))
        seen = strength, size
        factor = (wanted / size) ** (1.0 / power) if size > 0 else 3.0
        strength = min(strength * float(np.clip(factor, 0.05, 20.0)), fault.most)
    assert best is not None
    return best
