"""What one model gains over another on several logs, beside what it loses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from thermaltool.diagnosis.gain import MIN_LOSS_COUNTED
from thermaltool.diagnosis.simulation import Mask, SimulatedLogs
from thermaltool.diagnosis.written import gains_of
from thermaltool.model import Model
from thermaltool.record import Record

# A loss is slight below this part of what is gained, and below so many times the power of noise.
SLIGHT, MAX_SLIGHT = 0.01, 1.0


def is_slight(
    before: Model, after: Model, logs: Sequence[Record], masked: Mask, noise: Mapping[str, float]
) -> bool:
    """Whether what a model loses is next to nothing of what it gains, however zeros count.

    Parameters
    ----------
    before, after, logs, masked, noise
        As in `balance`.
    """
    # A zero that is counted has the noise of the readings that it is taken from.
    shares, most = (SLIGHT, SLIGHT), (MAX_SLIGHT, MIN_LOSS_COUNTED)
    return not loses(before, after, logs, masked, noise, shares, most)


def loses(
    before: Model,
    after: Model,
    logs: Sequence[Record],
    masked: Mask,
    noise: Mapping[str, float],
    shares: tuple[float, float],
    most: tuple[float, float] = (np.inf, np.inf),
) -> bool:
    """Whether a model loses as much as a share of what it gains, or as some power.

    Parameters
    ----------
    before, after, logs, masked, noise
        As in `balance`.
    shares, most : (float, float)
        Of errors about their mean in each log, and of errors whose zero counts.
    """
    for zero_free, share, power in zip((True, False), shares, most, strict=True):
        gained, lost = balance(before, after, logs, masked, noise, zero_free)
        if lost >= min(share * gained, power):
            return True
    return False


def balance(
    before: Model,
    after: Model,
    logs: Sequence[Record],
    masked: Mask,
    noise: Mapping[str, float],
    zero_free: bool = True,
) -> tuple[float, float]:
    """What a model gains over another, and what it loses, of all rows of all outputs.

    As powers over that of the noise, a log's part by its rows.

    Parameters
    ----------
    before, after, logs, masked, noise
        As in `written.spoiled_by`; outputs without a noise do not count.
    zero_free : bool
        Whether errors count about their mean in each log.
    """
    changes: dict[str, list[tuple[int, float]]] = {o: [] for o in noise}
    for log in logs:
        old, new = (SimulatedLogs(m, (log,), masked) for m in (before, after))
        for o, gain in gains_of(old, new, lambda output: zero_free).items():
            if o in noise:
                change = (gain.rms_after**2 - gain.rms_before**2) / noise[o] ** 2
                changes[o].append((old.groups[o].count, change))
    gained = lost = 0.0
    for each in changes.values():
        rows = sum(count for count, _ in each)
        gained += sum(count / rows * max(-change, 0.0) for count, change in each)
        lost += sum(count / rows * max(change, 0.0) for count, change in each)
    return gained, lost
