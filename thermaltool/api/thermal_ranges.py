"""Thermal tests of ISO 230-3: ranges of displacement and tilt over the prescribed times."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from thermaltool.api.inputs import Reading, read, read_noise, reads, refuse_unread
from thermaltool.api.result import Notice, Result, notice, to_frame
from thermaltool.errors import LogError, UnitError
from thermaltool.signals.ranges import constant_stretches
from thermaltool.signals.thermal_tests import (
    AXES,
    SHORTEST_RUN,
    TESTS,
    TILTS,
    Evaluation,
    Probe,
    ProbeNoise,
    RangeTest,
    Run,
    Test,
    micrometres,
    quantities_of,
)
from thermaltool.units import converted, parse_channel, parse_quantity

if TYPE_CHECKING:
    import os

    import pandas
    from matplotlib.figure import Figure

    from thermaltool.logs import Log
    from thermaltool.logs.reader import Data

# A fifth of 15 min, the shortest prescribed time [s]: longer averages flatten what it prescribes.
MAX_AVERAGE = 180.0


@dataclass(frozen=True, repr=False)
class ThermalTest(Result):
    """A thermal test as it was evaluated.

    Attributes
    ----------
    ranges : RangeTest
        Probes, and runs with their figures.
    notes : tuple of str
    """

    ranges: RangeTest
    notes: tuple[str, ...] = ()

    @property
    def runs(self) -> tuple[Run, ...]:
        """Each stretch that was evaluated by itself, with its figures."""
        return self.ranges.runs

    def table(self) -> str:
        """One block per run: a row per quantity, a column per prescribed time."""
        from thermaltool.report.thermal_ranges import range_table

        return range_table(self.ranges)

    def document(self) -> dict[str, Any]:
        """The figures as JSON-ready data."""
        from thermaltool.report.thermal_ranges import range_document

        return {**range_document(self.ranges), "notes": list(self.notes)}

    def draw(self) -> Figure:
        """Displacements, tilts, temperatures and the speed against time."""
        from thermaltool.report.thermal_ranges import draw_ranges

        return draw_ranges(self.ranges)

    @property
    def frame(self) -> pandas.DataFrame:
        """One row per figure: run, speed, symbol, time, value and 95 % interval."""
        rows = [(k, run, each) for k, run in enumerate(self.runs) for each in run.figures]
        return to_frame(
            {
                "run": [k for k, _, _ in rows],
                "speed": [math.nan if run.speed is None else run.speed for _, run, _ in rows],
                "symbol": [each.symbol for *_, each in rows],
                "time_s": [each.time or run.duration for _, run, each in rows],
                "value": [each.estimate.value for *_, each in rows],
                "low": [each.estimate.low for *_, each in rows],
                "high": [each.estimate.high for *_, each in rows],
                "unit": [each.estimate.unit for *_, each in rows],
            }
        )


@reads(Reading)
def iso230(
    data: Data,
    *,
    test: Test | None = None,
    probes: Mapping[str, str] | Sequence[Probe] = (),
    speed: str | None = None,
    noise: str | os.PathLike[str] | Any = None,
    average: float = 60.0,
    start: float | None = None,
    stop: float | None = None,
    warn: Notice = notice,
    **reading: Unpack[Reading],
) -> ThermalTest:
    """Thermal test of ISO 230-3 from a log: ranges over the prescribed times, with intervals.

    Parameters
    ----------
    data : str, path, pandas.DataFrame or Record
    test : {"etve", "spindle", "axis"}, optional
        Environmental temperature variation, rotating spindle, or moving axis. Default: spindle
        where the log has one speed, else etve.
    probes : mapping of channel to str, or sequence of Probe
        ``{"d_ch1_um": "X:50mm", "d_ch2_um": "X:150mm"}``: axis and distance. Two probes along one
        axis give a tilt (of an axis: an expansion). Default: displacements whose place begins with
        x, y or z.
    speed : str, optional
        Channel of the speed: each speed is a run. Default: the only speed in the log.
    noise : str, path or NoiseReport, optional
        Noise of the probes, as `noise` measures it on an idle log. Default: the white noise of this
        log, and no drift.
    average : float [s]
        Readings are averaged over so long.
    start, stop : float, optional [s]
        The stretch of the log.
    warn : callable
        Takes a sentence on readings that are left out. Default: a `ThermalToolWarning`.
    **reading
        See `read_log`.

    Returns
    -------
    ThermalTest

    Raises
    ------
    LogError
        No probes or readings, a channel that is not there, or no run that is long enough.
    UnitError
        A probe that measures no displacement.
    ValueError
        A test, axis or distance that there is none of.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> time = np.arange(0.0, 7200.0, 10.0)
    >>> frame = pd.DataFrame({"time_s": time, "n_spindle_rpm": 3000.0})
    >>> frame["d_x1_um"] = 20 * -np.expm1(-time / 1200)
    >>> frame["d_x2_um"] = 30 * -np.expm1(-time / 1200)
    >>> done = tt.iso230(frame, probes={"d_x1_um": "X:50mm", "d_x2_um": "X:150mm"})
    >>> float(done.frame.set_index("symbol")["value"].round(1)["d(B)60"])
    95.0
    """
    if not 0 < average <= MAX_AVERAGE:
        raise ValueError(
            f"readings are averaged over more than 0 s and at most {MAX_AVERAGE:g} s, a fifth of "
            f"the shortest prescribed time, not {average:g} s"
        )
    log = read(data, warn=warn, unread=True, **reading).between(start, stop)
    chosen = _probes(log, probes)
    speed, speed_notes = _speed(log, speed, test)
    needed = [*(each.channel for each in chosen), *([] if speed is None else [speed])]
    (log,) = refuse_unread([log], needed, warn)
    test = test or ("spindle" if speed else "etve")
    if test not in TESTS:
        raise ValueError(f"no test {test!r}: there are {', '.join(TESTS)}")
    if test == "etve":
        speed = None
    noises, notes = _noises(log, chosen, noise)
    notes = (*speed_notes, *notes, *_without_tilt(chosen, test))
    whole = [slice(0, len(log))]
    parts = whole if speed is None else constant_stretches(log.column(speed), SHORTEST_RUN)
    evaluation = Evaluation(test, quantities_of(chosen, test), noises, average)
    runs = []
    for part in parts:
        rows = log.rows(part)
        at = None if speed is None else float(rows.column(speed)[0])
        if len(rows) >= SHORTEST_RUN and (figures := tuple(evaluation.figures(rows))):
            runs.append(Run(float(rows.time[0]), rows.duration, at, figures))
    if not runs:
        raise LogError(f"no run of {SHORTEST_RUN} readings and more", log.name)
    drift = any(each.drift > 0 for each in noises.values())
    return ThermalTest(RangeTest(test, chosen, tuple(runs), log, speed, average, drift), notes)


def parse_probe(channel: str, place: str) -> Probe:
    """A probe from ``X:50mm``; ValueError where it is none."""
    axis, colon, distance = place.partition(":")
    if axis.strip().upper() not in AXES:
        raise ValueError(f"{channel}={place}: an axis X, Y or Z, then :DISTANCE")
    if not colon:
        return Probe(channel, axis.strip().upper())
    value, unit = parse_quantity(distance)
    millimetres = value if unit is None else converted(value, unit, "mm")
    if millimetres is None or not math.isfinite(millimetres):
        raise ValueError(f"{channel}={place}: {distance} is no distance")
    return Probe(channel, axis.strip().upper(), millimetres)


def _probes(log: Log, given: Mapping[str, str] | Sequence[Probe]) -> tuple[Probe, ...]:
    if isinstance(given, Mapping):
        given = [parse_probe(*each) for each in given.items()]
    found = list(given)
    if not found:
        for name in log.columns:
            channel = parse_channel(name)
            if channel.dimension == "length" and channel.place[:1].upper() in AXES:
                found.append(Probe(name, channel.place[0].upper()))
    if not found:
        raise LogError(
            "no displacements with a place x, y or z: say where the probes are "
            "(--probe d_ch1_um=X:50mm)",
            log.name,
        )
    for probe in found:
        log.column(probe.channel)
        if parse_channel(probe.channel).dimension != "length":
            raise UnitError(f"{probe.channel}: a probe measures a displacement, as d_x1_um")
    places = [(p.axis, p.distance) for p in found if p.distance is not None]
    if len({p.channel for p in found}) < len(found) or len(set(places)) < len(places):
        raise ValueError("two probes are the same channel, or at the same place")
    # X1 is the probe along X that was named first.
    return tuple(sorted(found, key=lambda p: p.axis))


def _speed(log: Log, given: str | None, test: Test | None) -> tuple[str | None, tuple[str, ...]]:
    """The channel by which runs are told apart, and a note where there is none."""
    if given is not None:
        log.column(given)
        return given, ()
    speeds = [name for name in log.columns if parse_channel(name).dimension == "speed"]
    if test == "etve" or (test is None and not speeds):
        return None, ()
    if len(speeds) == 1:
        return speeds[0], ()
    found = f"speeds {', '.join(speeds)}, and none is chosen" if speeds else "no column of a speed"
    what = "evaluated as etve" if test is None else "one run, taken to move from its first row on"
    return None, (f"{found}: the whole log is {what} (--speed CHANNEL, --start, --stop)",)


def _without_tilt(probes: Sequence[Probe], test: Test) -> tuple[str, ...]:
    """A note on axes of which there is no tilt, or no expansion."""
    notes = []
    for axis in dict.fromkeys(p.axis for p in probes if test == "axis" or p.axis in TILTS):
        own = [p for p in probes if p.axis == axis]
        if sum(p.distance is not None for p in own) < 2:
            what = "expansion along" if test == "axis" else f"tilt {TILTS[axis][0]} from"
            why = "one probe alone" if len(own) == 1 else "distances are not given"
            notes.append(
                f"no {what} {axis}: {why}; two at known distances give one "
                f"(--probe {own[0].channel}={axis}:50mm --probe OTHER={axis}:150mm)"
            )
    return tuple(notes)


def _noises(
    log: Log, probes: Sequence[Probe], given: Any
) -> tuple[dict[str, ProbeNoise], tuple[str, ...]]:
    """Noise of each probe [um], and what its intervals do not hold."""
    from thermaltool.signals.detrend import difference_sigma

    known = {} if given is None else read_noise(given)
    noises, without = {}, []
    for probe in probes:
        scale = converted(1.0, parse_channel(probe.channel).unit, "um") or 1.0
        if (found := known.get(probe.channel)) is not None:
            white, drift = found.white * scale, found.drift * scale
            noises[probe.channel] = ProbeNoise(white, drift, found.drift_time)
            continue
        values = micrometres(log, probe.channel)
        values = values[np.isfinite(values)]
        if len(values) < SHORTEST_RUN:
            raise LogError(f"fewer than {SHORTEST_RUN} readings", log.name, None, probe.channel)
        noises[probe.channel] = ProbeNoise(difference_sigma(values))
        without.append(probe.channel)
    if not without:
        return noises, ()
    return noises, (
        f"the intervals hold the noise of the readings, and no drift of {', '.join(without)}: "
        "--noise noise.json (thermaltool noise IDLE.csv -o noise.json) adds it",
    )
