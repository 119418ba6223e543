"""What a model gets wrong: how much of a residual is noise, when, how slowly, under what."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.ndimage import uniform_filter1d

from thermaltool.diagnosis.coloured import ColouredTests, Dependence
from thermaltool.diagnosis.residual_parts import ResidualParts
from thermaltool.effects.effect import Float
from thermaltool.errors import FitError
from thermaltool.signals.start_level import start_level

# Fewer rows say nothing.
MIN_ROWS = 16
# Bins of a record among which the worst interval is looked for.
MAX_BINS = 40
# A channel of at most so many levels is described by level, else by thirds.
MAX_LEVELS = 4
# Rows within so many times the noise agree on a level, which is another than the median from so
# many times as many rows on.
AGREES, MANY_MORE = 2.0, 1.5
# Periods at which bands may meet [s].
BAND_EDGES = np.array(
    [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 18000, 36000, 86400, 604800]
)


@dataclass(frozen=True)
class ResidualNoise:
    """White noise of a reading, and the slow discrepancy on top of it.

    Attributes
    ----------
    white, discrepancy : float [unit of the channel]
        Standard deviations.
    time_constant : float or None [s]
        Of the discrepancy; None where there is none.
    """

    white: float
    discrepancy: float
    time_constant: float | None


@dataclass(frozen=True)
class WorstInterval:
    """The stretch that holds most of the residual for its length.

    Attributes
    ----------
    record : int
        Which record, from 0: a new one begins where the clock goes back.
    start, stop : float [s]
    rms : float
    power, time : float
        Share of the residual's power, and of the rows, in it.
    """

    record: int
    start: float
    stop: float
    rms: float
    power: float
    time: float


@dataclass(frozen=True)
class PeriodBand:
    """A band of periods.

    Attributes
    ----------
    shortest, longest : float or None [s]
    power : float
        Share of the power above white noise.
    """

    shortest: float | None
    longest: float | None
    power: float


@dataclass(frozen=True)
class Condition:
    """The residual under one operating condition.

    Attributes
    ----------
    channel : str or None
        None for what the machine itself does: heating, cooling, idle.
    name : str
    low, high : float or None
        Values of the channel.
    rows : int
    rms, mean : float
    power, time : float
        Share of the residual's power, and of the rows.
    """

    channel: str | None
    name: str
    low: float | None
    high: float | None
    rows: int
    rms: float
    mean: float
    power: float
    time: float


@dataclass(frozen=True)
class ResidualReport:
    """What is wrong with one output in one log.

    Attributes
    ----------
    rows : int
        Rows that count.
    rms, mean : float or None [unit of the channel]
        About zero. None where a start is fitted apart, whose slowest decays are told from no zero.
    spread : float [unit of the channel]
        RMS about the mean of each record.
    above_noise : float
        Share of the power, about the mean of each record, that white noise does not account for.
    noise : ResidualNoise
    parts : ResidualParts
        Without a calibration to judge by, noise and the rest.
    effective_rows : float
        Independent rows that tell as much about a mean.
    white_p : float
        p-value of the innovations being white (Ljung-Box).
    worst : WorstInterval or None
    bands : tuple of PeriodBand, the slowest first
    conditions : tuple of Condition
        As `worst`, of the residual about where the model is right: the level of the first rows, or
        in a log that begins warm the one that its record keeps longest.
    dependences : tuple of Dependence, the strongest first
    log : str
        Digest; empty for rows of none.
    """

    rows: int
    rms: float | None
    mean: float | None
    spread: float
    above_noise: float
    noise: ResidualNoise
    parts: ResidualParts
    effective_rows: float
    white_p: float
    worst: WorstInterval | None
    bands: tuple[PeriodBand, ...]
    conditions: tuple[Condition, ...]
    dependences: tuple[Dependence, ...]
    log: str = ""

    def document(self) -> dict[str, Any]:
        """As JSON: null for what is not there."""
        return asdict(self)


def residual_report(
    time: Float,
    residual: Float,
    measured: Float,
    drives: Mapping[str, Float],
    others: Mapping[str, Float],
    white_sigma: float,
    hidden: float = 0.0,
    warm: bool = False,
) -> ResidualReport:
    """Describe and test the residual of one output.

    Parameters
    ----------
    time : ndarray, shape (n,) [s]
        Increasing; where it goes back a new record begins.
    residual, measured : ndarray, shape (n,) [unit of the channel]
        Measured minus simulated, and measured relative to rest; rows with NaN are left out.
    drives, others : mapping of channel to ndarray, shape (n,)
        Inputs of the model, and further channels (a speed, a state); NaN counts as no change.
    white_sigma : float
        White noise of a reading.
    hidden : float
        Noise of a reading that rows do not show, being averages; `rms`, `spread` and shares of the
        power are those of readings.
    warm : bool
        Whether the first rows tell no zero: the machine is on its way there, and the state from
        which it comes is an estimate.

    Returns
    -------
    ResidualReport

    Raises
    ------
    FitError
        Fewer than 16 rows with both.
    """
    use = np.isfinite(residual) & np.isfinite(measured)
    if use.sum() < MIN_ROWS:
        raise FitError(f"{use.sum()} rows of a residual say nothing")
    channels = {name: _held(values)[use] for name, values in {**drives, **others}.items()}
    time, residual, measured = time[use], residual[use], measured[use]
    starts = np.flatnonzero(np.diff(time, prepend=np.inf) <= 0)
    records = [slice(a, b) for a, b in zip(starts, [*starts[1:].tolist(), len(time)], strict=True)]
    about = np.concatenate([residual[r] - np.mean(residual[r]) for r in records])
    power = float(np.mean(about**2)) + hidden**2
    row_white = float(np.sqrt(max(white_sigma**2 - hidden**2, 0.0))) if hidden else white_sigma
    levels = [
        _usual_level(residual[r], row_white) if warm else start_level(residual[r]).value
        for r in records
    ]
    zeroed = np.concatenate([residual[r] - at for r, at in zip(records, levels, strict=True)])
    tests = ColouredTests(time, about, records)
    dependences = [tests.dependence(name, values) for name, values in channels.items()]
    time_constant = tests.tau if tests.discrepancy else None
    return ResidualReport(
        rows=len(time),
        rms=float(np.sqrt(np.mean(residual**2) + hidden**2)),
        mean=float(np.mean(residual)),
        spread=float(np.sqrt(power)),
        above_noise=max(0.0, 1.0 - white_sigma**2 / power) if power > 0 else 0.0,
        noise=ResidualNoise(white_sigma, tests.discrepancy, time_constant),
        parts=ResidualParts.of(float(np.sqrt(power)), white_sigma),
        effective_rows=tests.effective_rows(),
        white_p=tests.white_p(),
        worst=_worst(time, zeroed, records),
        bands=_bands(time, about, records, row_white),
        conditions=(
            *_machine(time, zeroed, measured, records, row_white),
            *(c for name, values in channels.items() for c in _by_value(name, values, zeroed)),
        ),
        dependences=tuple(sorted((d for d in dependences if d), key=lambda d: d.p_value)),
    )


def _usual_level(residual: Float, white: float) -> float:
    """The level that most rows agree on: the median, unless far more do so on another one."""
    ordered = np.sort(residual)
    middle = float(np.median(ordered))
    ends = np.searchsorted(ordered, ordered + 2 * AGREES * white, "right")
    first = int(np.argmax(ends - np.arange(len(ordered))))
    about = np.count_nonzero(np.abs(ordered - middle) <= AGREES * white)
    if ends[first] - first <= MANY_MORE * about:
        return middle
    return float(np.median(ordered[first : ends[first]]))


def _held(values: Float) -> Float:
    """Missing values replaced by the last one there was, or by the first one there is."""
    there = np.flatnonzero(np.isfinite(values))
    if not len(there):
        return np.zeros(len(values))
    return values[there[np.maximum(np.searchsorted(there, np.arange(len(values)), "right") - 1, 0)]]


def _worst(time: Float, residual: Float, records: Sequence[slice]) -> WorstInterval | None:
    """The stretch whose power exceeds the average by most (largest sum over bins of a record)."""
    power = residual**2
    mean = float(np.mean(power))
    best, found = 0.0, None
    for k, record in enumerate(records):
        rows = np.arange(record.start, record.stop)
        edges = np.unique(np.linspace(0, len(rows), min(MAX_BINS, len(rows)) + 1).astype(int))
        excess = np.add.reduceat(power[rows] - mean, edges[:-1])
        total, begin = 0.0, 0
        for end, value in enumerate(excess.tolist()):
            if total <= 0.0:
                total, begin = 0.0, end
            total += value
            if total > best:
                best, found = total, (k, rows[edges[begin] : edges[end + 1]])
    if found is None:
        return None
    k, rows = found
    return WorstInterval(
        k,
        float(time[rows[0]]),
        float(time[rows[-1]]),
        float(np.sqrt(np.mean(power[rows]))),
        float(power[rows].sum() / power.sum()),
        len(rows) / len(time),
    )


def _bands(
    time: Float, about: Float, records: Sequence[slice], white: float
) -> tuple[PeriodBand, ...]:
    """Shares of the power above white noise by period, of the cosine transform of each record.

    The cosine transform continues a record by its mirror image, so that a difference between its
    ends, which thermal records have, does not leak into all bands.
    """
    steps = np.concatenate([np.diff(time[r]) for r in records])
    shortest = 4.0 * float(np.median(steps))
    longest = max(float(time[r][-1] - time[r][0]) for r in records) / 3.0
    between = BAND_EDGES[(1.5 * shortest < BAND_EDGES) & (longest > BAND_EDGES)]
    if len(between) > 3:
        wanted = np.geomspace(shortest, longest, 5)[1:-1]
        between = np.unique([between[np.argmin(abs(np.log(between / w)))] for w in wanted])
    edges = [np.inf, *between[::-1].tolist(), 0.0]
    power = np.zeros(len(edges) - 1)
    for r in records:
        n = r.stop - r.start
        if n < 2:
            continue
        even = np.linspace(time[r][0], time[r][-1], n)
        squares = dct(np.interp(even, time[r], about[r]), norm="ortho")[1:] ** 2
        period = 2.0 * (even[1] - even[0]) * n / np.arange(1, n)
        for k, (high, low) in enumerate(itertools.pairwise(edges)):
            inside = (period <= high) & (period > low)
            power[k] += float(np.sum(squares[inside])) - inside.sum() * white**2
    power = np.maximum(power, 0.0)
    shares = power / power.sum() if power.sum() > 0 else power
    return tuple(
        PeriodBand(low or None, high if np.isfinite(high) else None, share)
        for high, low, share in zip(edges[:-1], edges[1:], shares.tolist(), strict=True)
    )


def _machine(
    time: Float, residual: Float, measured: Float, records: Sequence[slice], white: float
) -> list[Condition]:
    """The residual while the output moves away from rest, comes back, or stays."""
    slope, least = np.zeros(len(time)), 0.0
    # As little smoothing as shows slopes of a tenth of the steepest above their noise.
    for parts in (200, 100, 50, 20):
        noise = 0.0
        for r in records:
            width = max(5, (r.stop - r.start) // parts)
            smooth = uniform_filter1d(uniform_filter1d(measured[r], width), width)
            slope[r] = np.gradient(np.abs(smooth), time[r]) if r.stop - r.start > 1 else 0.0
            span = width * float(np.median(np.diff(time[r]))) if r.stop - r.start > 1 else np.inf
            noise = max(noise, 3.0 * white * float(np.sqrt(2.0 / width)) / span)
        small = 0.1 * float(np.quantile(np.abs(slope), 0.9))
        least = max(noise, small)
        if noise < small:
            break
    if least == 0.0:
        return []
    states = {"heating": slope > least, "cooling": slope < -least}
    states["idle"] = ~states["heating"] & ~states["cooling"]
    return [_condition(None, name, rows, residual) for name, rows in states.items() if rows.any()]


def _by_value(channel: str, values: Float, residual: Float) -> list[Condition]:
    """The residual at every level of a channel of few levels, else in each third of its rows."""
    levels = np.unique(values)
    if len(levels) < 2:
        return []
    if len(levels) <= MAX_LEVELS:
        return [
            _condition(channel, f"at {level:.4g}", values == level, residual, level, level)
            for level in levels.tolist()
        ]
    cuts = np.unique(np.quantile(values, [0.0, 1 / 3, 2 / 3, 1.0]))
    found = []
    for k, (low, high) in enumerate(zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True)):
        inside = (values > low) & (values <= high)
        if k == 0:
            inside |= values == low
        if inside.any():
            ends = dict.fromkeys([f"{low:.4g}", f"{high:.4g}"])
            name = " to ".join(ends) if len(ends) > 1 else f"at {low:.4g}"
            found.append(_condition(channel, name, inside, residual, low, high))
    return found


def _condition(
    channel: str | None,
    name: str,
    inside: NDArray[np.bool_],
    residual: Float,
    low: float | None = None,
    high: float | None = None,
) -> Condition:
    own, total = residual[inside], float(np.sum(residual**2))
    return Condition(
        channel,
        name,
        low,
        high,
        len(own),
        float(np.sqrt(np.mean(own**2))),
        float(np.mean(own)),
        float(np.sum(own**2)) / total if total else 0.0,
        len(own) / len(residual),
    )
