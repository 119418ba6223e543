"""Levels of the heat in logs of a joint, and which of them responses are fitted to.

The reference level is the one beside which the others tell what a joint does (Fraser 1997, 7.4.1:
half of the largest). Drives are of different units and may run at one speed throughout: each has
levels of its own, and only those that have several say which level a log is of.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.law_choice import SAME_LEVEL
from thermaltool.model import Drive, relative
from thermaltool.record import Record
from thermaltool.responses.modes import Float
from thermaltool.units import is_temperature

# Levels that differ by less are one [of the larger]: a measured power is not set to the digit, and
# departures by a joint go with the square of the level.
ALIKE = 0.05
# A log is of one level where no more rows than this are of others: switches fall between rows.
MAX_BETWEEN = 0.05
# Cosine between two drives above which one is the other in another unit.
MAX_COSINE = 0.999


def reference_logs(records: Sequence[Record], drives: Sequence[Drive]) -> list[bool]:
    """Which logs are of the reference level: the lower one of the middle; else all.

    Logs at rest are of no level and go with every one.

    Parameters
    ----------
    records : sequence of Record
    drives : sequence of Drive

    Raises
    ------
    FitError
        One level alone, or drives that go in proportion to one another at the reference level.
    """
    heats = [d for d in drives if not is_temperature(d.channel)] or drives
    each = [_levels(records, drive) for drive in heats]
    several = [
        (levels / np.max(levels), single)
        for levels, single in each
        if not (np.all(single) and _alike(levels[levels > 0]))
    ]
    if not several:
        raise FitError(
            f"a joint shows in how several levels differ, and these logs have one "
            f"({heats[0].channel} = {np.max(each[0][0]):.4g}): add a log of half or twice of it"
        )
    level = np.max([levels for levels, _ in several], axis=0)
    of_one = np.all([single for _, single in several], axis=0)
    groups: list[list[float]] = []
    for own in sorted(level[of_one & (level > 0)]):
        if groups and _alike(np.array([groups[-1][0], own])):
            groups[-1].append(own)
        else:
            groups.append([own])
    if not groups:
        return [True] * len(records)
    middle = groups[(len(groups) - 1) // 2]
    taken = of_one & ((level == 0) | ((level >= middle[0]) & (level <= middle[-1])))
    _check_apart([r for r, own in zip(records, taken, strict=True) if own], heats)
    return [bool(own) for own in taken]


def _check_apart(records: Sequence[Record], drives: Sequence[Drive]) -> None:
    """Refuse drives whose responses these logs cannot tell apart."""
    for one, other in combinations(drives, 2):
        u, v = (np.concatenate(_sizes(records, drive)) for drive in (one, other))
        size = float(np.linalg.norm(u) * np.linalg.norm(v))
        if size and abs(float(u @ v)) > MAX_COSINE * size:
            raise FitError(
                f"at the reference level {one.channel} and {other.channel} go in proportion: their "
                "responses cannot be told apart; leave one of them out, or add a log of one alone"
            )


def _levels(records: Sequence[Record], drive: Drive) -> tuple[Float, np.ndarray]:
    """Level of a drive in every log, 0 at rest [its unit], and whether the log has no other."""
    size = [np.abs(own) for own in _sizes(records, drive)]
    rest = SAME_LEVEL * max(float(np.max(own)) for own in size)
    levels, single = np.zeros(len(size)), np.full(len(size), True)
    for k, own in enumerate(size):
        acting = own[own > rest]
        # As few rows as lie between others are no level either.
        if len(acting) > MAX_BETWEEN * len(own):
            levels[k] = np.median(acting)
            off = np.abs(acting - levels[k]) > ALIKE * levels[k]
            single[k] = np.mean(off) <= MAX_BETWEEN
    return levels, single


def _sizes(records: Sequence[Record], drive: Drive) -> list[Float]:
    """A drive in every log, relative to its reference."""
    return [relative(r.column(drive.channel), drive.reference, drive.hold) for r in records]


def _alike(levels: Float) -> bool:
    """Whether levels are one."""
    return not len(levels) or bool(np.min(levels) >= (1 - ALIKE) * np.max(levels))
