"""Lags, plays, jumps and clocks that several causes share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermaltool.effects.effect import Float, Memory, needed
from thermaltool.effects.scene import Scene
from thermaltool.record import Record
from thermaltool.responses.propagation import recursion_of
from thermaltool.units import Hold, hold_of, source_rest

HOUR = 3600.0
# A lag of more records than this is a trend.
MAX_LAG_RECORDS = 1.0
# By how much more is lost in a sample, at most [1].
MAX_SAMPLE_LOSS = 1.0
# From so many samples on a recursion in one call is faster than a loop; a stream has one at a time.
MIN_SAMPLES_AT_ONCE = 50
# A jump is looked for between the means of so many readings before and after it, and at so many
# places for each.
JUMP_READINGS, JUMP_PLACES = (2, 8, 32), 3
# A line goes on beyond its levels by this part of their range, within which a model is not told to
# extrapolate.
BEYOND_LEVELS = 0.1


def lagged(
    time: Float,
    u: Float,
    time_constant: float,
    hold: Hold,
    start: float = 0.0,
    memory: Memory = None,
) -> Float:
    """First-order lag ``τ y' + y = u`` from `start` at the first sample, shape (n,).

    Parameters
    ----------
    time, u : ndarray, shape (n,)
    time_constant : float [s]
    hold : {"zero", "first"}
        Between samples: constant, or a straight line.
    start : float
    memory : dict, optional
        Keeps the last sample, from which the next call goes on.
    """
    if memory is not None:
        before = memory.get("lag")
        if before is not None:
            time, u, start = np.append(before[0], time), np.append(before[1], u), before[2]
        y = lagged(time, u, time_constant, hold, start)
        memory["lag"] = [float(time[-1]), float(u[-1]), float(y[-1])]
        return y if before is None else y[1:]
    steps = np.diff(time)
    x = steps / time_constant
    decay, whole = np.exp(-x), -np.expm1(-x)
    # Of a straight line between samples: φ = (1 − (1 − e^(−x))/x) is the weight of its end.
    now = 1.0 - whole / np.maximum(x, 1e-12) if hold == "first" else np.zeros_like(x)
    now = np.where(x < 1e-6, x / 2, now) if hold == "first" else now
    before = whole - now
    y = np.empty(len(time))
    y[:1] = start
    if len(steps) >= MIN_SAMPLES_AT_ONCE:
        added = before * u[:-1] + now * u[1:]
        added[0] += decay[0] * start
        y[1:] = recursion_of(decay[None], added[None])[0, 1:]
        return y
    level, terms = start, (each.tolist() for each in (decay, before * u[:-1], now * u[1:]))
    for k, (kept, from_before, from_now) in enumerate(zip(*terms, strict=True)):
        level = kept * level + from_before + from_now
        y[k + 1] = level
    return y


def from_rest(
    record: Record, channel: str, memory: Memory = None, rest: float | None = None
) -> Float:
    """A channel relative to its rest, shape (n,); a missing reading keeps the one before.

    Parameters
    ----------
    record : Record
    channel : str
    memory : dict, optional
        Keeps the rest and the last value.
    rest : float, optional
        Default: that of `source_rest`.

    Raises
    ------
    ModelError
        It is not in the record.
    """
    values = needed(record, channel)
    known = values[np.isfinite(values)]
    memory = {} if memory is None else memory
    if "reading" not in memory:
        if not len(known):
            return np.zeros(len(values))
        first = float(known[0])
        usual = source_rest(channel) if rest is None else rest
        # Until it is read nothing is known to act.
        memory["reading"] = [first if usual == "first" else usual] * 2
    origin, last = memory["reading"]
    values = np.append(last, values)
    rows = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), 0))
    memory["reading"] = [origin, float(values[rows[-1]])]
    return values[rows[1:]] - origin


def elapsed(time: Float, memory: Memory = None) -> Float:
    """Time since the first row [s], shape (n,).

    Parameters
    ----------
    time : ndarray, shape (n,) [s]
    memory : dict, optional
        Keeps the first row's.
    """
    first = float(time[0]) if memory is None else memory.setdefault("begin", float(time[0]))
    return time - first


def warmed(
    record: Record,
    channel: str,
    time_constant: float,
    memory: Memory = None,
    rest: float | None = None,
) -> Float:
    """A channel relative to its rest through a first-order lag, shape (n,).

    Parameters
    ----------
    record : Record
    channel : str
    time_constant : float [s]
    memory : dict, optional
        Keeps the last sample.
    rest : float, optional
        As in `from_rest`.
    """
    rise = from_rest(record, channel, memory, rest)
    return lagged(record.time, rise, time_constant, hold_of(channel), memory=memory)


def with_ends(
    levels: Sequence[float] | Float, rates: Sequence[float] | Float
) -> tuple[Float, Float]:
    """Levels and rates, whose line goes on a little beyond both ends, shapes (n + 2,).

    By a tenth of the range of the levels at most, and of the rate at the end.

    Parameters
    ----------
    levels, rates : sequence of float, of one length, at least 2; levels rise
    """
    x, y = np.asarray(levels, float), np.asarray(rates, float)
    ends = []
    for at, inner in ((0, 1), (-1, -2)):
        slope = float((y[at] - y[inner]) / abs(x[at] - x[inner]))  # outwards
        # No machine loses so little that it warms by itself.
        least = abs(y[at]) if y[at] > 0 or slope > 0 else 0.0
        reach = min(
            BEYOND_LEVELS * float(x[-1] - x[0]), BEYOND_LEVELS * least / max(abs(slope), 1e-300)
        )
        ends.append((reach, float(y[at]) + slope * reach))
    (below, low), (above, high) = ends
    x = np.concatenate([[x[0] - below], x, [x[-1] + above]])
    return x, np.concatenate([[low], y, [high]])


def play(u: Float, widths: Float, memory: Memory = None) -> Float:
    """Play operator: what follows `u` between two flanks, from the middle at rest.

    Parameters
    ----------
    u : ndarray, shape (n,)
    widths : ndarray, shape (k,) [unit of u]
        Distance between the two flanks.
    memory : dict, optional
        Keeps where the last sample has left what follows.

    Returns
    -------
    p : ndarray, shape (k, n)

    Notes
    -----
    Each sample confines what was before, p ← min(max(p, u − w/2), u + w/2). One such step after
    another is again one, so that all rows follow from log2(n) doublings.
    """
    low, high = u - widths[:, None] / 2, u + widths[:, None] / 2
    reach = 1
    while reach < len(u):
        now = low[:, reach:], high[:, reach:]
        low, high = (
            np.hstack([edge[:, :reach], np.clip(edge[:, :-reach], *now)]) for edge in (low, high)
        )
        reach *= 2
    start = np.zeros(len(widths)) if memory is None else memory.get("play", np.zeros(len(widths)))
    p = np.clip(np.reshape(start, (-1, 1)), low, high)
    if memory is not None:
        memory["play"] = p[:, -1]
    return p


def is_plausible_rate(rate: float, scene: Scene) -> bool:
    """Whether a machine may lose heat faster by a rate, whatever its time scale.

    Not every output grows by itself (one may have a slow mode that is none), and no sample shows
    what is gone before it ends.

    Parameters
    ----------
    rate : float [1/s]
    scene : Scene
    """
    return -1.0 / min(scene.slowest.values()) < rate <= MAX_SAMPLE_LOSS / scene.period


def time_constants(period: float, duration: float, count: int = 7) -> list[float]:
    """Time constants worth a trial, from a sample to a third of the record [s].

    Parameters
    ----------
    period, duration : float [s]
        Of the samples and of the record.
    count : int
    """
    return np.geomspace(period, max(duration / 3, 2 * period), count).tolist()


def jump_times(scene: Scene, k: int, outputs: Sequence[str]) -> list[float]:
    """Where the residuals of one log jump most, and a coarse grid [s].

    Under a slow discrepancy a jump is only seen where it is: a trial one sample beside it explains
    nothing. Each time is that of the first reading after the jump.

    Parameters
    ----------
    scene : Scene
    k : int
        Which of its logs.
    outputs : sequence of str
        Whose residuals are looked at.
    """
    log = scene.logs[k]
    times = scene.instants(log, 24)
    for output in outputs:
        there = np.flatnonzero(np.isfinite(scene.residual[k][output]))
        total = np.append(0.0, np.cumsum(scene.residual[k][output][there]))
        for side in JUMP_READINGS:
            # Means of `side` readings from each reading on; those before it lie `side` earlier.
            means = (total[side:] - total[:-side]) / side
            contrast = np.abs(means[side:] - means[:-side])
            for _ in range(JUMP_PLACES if len(contrast) else 0):
                at = int(np.argmax(contrast))
                times.append(float(log.time[there[at + side]]))
                contrast[max(at - side, 0) : at + side + 1] = 0.0
    return list(dict.fromkeys(times))
