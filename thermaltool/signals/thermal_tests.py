"""What thermal tests of ISO 230-3 evaluate: runs, displacements, tilts, and their ranges."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thermaltool.record import Record
from thermaltool.signals.intervals import Estimate
from thermaltool.signals.ranges import EvenLevel, even_level, noise_repeats, range_estimate
from thermaltool.signals.smooth_curves import curve_draws
from thermaltool.units import converted, parse_channel

Array = NDArray[np.float64]

Test = Literal["etve", "spindle", "axis"]
TESTS: tuple[Test, ...] = ("etve", "spindle", "axis")
AXES = ("X", "Y", "Z")
# About which axis parallel probes along Z see a tilt, and its sign: x rises with z where B is
# positive, y falls with z where A is.
TILTS = {"X": ("B", 1.0), "Y": ("A", -1.0)}
MINUTE, HOUR, DAY = 60.0, 3600.0, 86400.0
# Times from the start of a run, and windows of an environmental test.
TIMES: dict[Test, tuple[float, ...]] = {
    "etve": (HOUR, DAY),
    "spindle": (15 * MINUTE, HOUR),
    "axis": (15 * MINUTE, HOUR),
}
# A shorter stretch of constant speed is on its way to another [readings].
SHORTEST_RUN = 10


@dataclass(frozen=True)
class Probe:
    """A displacement probe: the axis that it measures along, and where it is.

    Attributes
    ----------
    channel : str
    axis : {"X", "Y", "Z"}
    distance : float [mm] or None
        From the spindle nose, along the spindle; in a test of an axis along that axis.
    """

    channel: str
    axis: str
    distance: float | None = None


@dataclass(frozen=True)
class RangeFigure:
    """One figure of a test.

    Attributes
    ----------
    quantity : str
        ``X1``, or ``B`` for a tilt.
    symbol : str
        As the standard has it: ``d(X1)60``, ``ETVE(B)``.
    time : float [s] or None
        Prescribed time; None for the whole run.
    estimate : Estimate
        In um, or in urad.
    """

    quantity: str
    symbol: str
    time: float | None
    estimate: Estimate


@dataclass(frozen=True)
class Run:
    """A stretch of the log that is evaluated by itself: a speed, or all.

    Attributes
    ----------
    start, duration : float [s]
    speed : float [unit of the speed's channel] or None
    figures : tuple of RangeFigure
    """

    start: float
    duration: float
    speed: float | None
    figures: tuple[RangeFigure, ...]


class ProbeNoise(NamedTuple):
    """Noise of a probe [um]: of a reading, and a drift with its time constant [s]."""

    white: float
    drift: float = 0.0
    time: float = 1.0


@dataclass(frozen=True)
class RangeTest:
    """A thermal test as it was evaluated.

    Attributes
    ----------
    test : {"etve", "spindle", "axis"}
    probes : tuple of Probe
    runs : tuple of Run
    record : Record
    speed_channel : str or None
    average : float [s]
        Over which readings were averaged.
    drift : bool
        Whether the intervals hold the drift of the probes.
    """

    test: Test
    probes: tuple[Probe, ...]
    runs: tuple[Run, ...]
    record: Record
    speed_channel: str | None
    average: float
    drift: bool

    def quantities(self) -> dict[str, tuple[str, Array]]:
        """Displacements [um] and tilts [urad] by name, with their unit, one value per row."""
        found = quantities_of(self.probes, self.test)
        return {each.name: (each.unit, each.of(self.record)) for each in found}


@dataclass(frozen=True)
class Quantity:
    """A displacement or a tilt: a weighted sum of channels in um."""

    name: str
    unit: str
    parts: tuple[tuple[str, float], ...]

    def of(self, record: Record) -> Array:
        """One value per row."""
        return np.sum([micrometres(record, c) * f for c, f in self.parts], axis=0)


def quantities_of(probes: Sequence[Probe], test: Test) -> list[Quantity]:
    """Displacements of the probes, and tilts or expansions between those of one axis."""
    displacements, tilts = [], []
    for axis, group in itertools.groupby(probes, lambda p: p.axis):
        own = list(group)
        names = [axis] if len(own) == 1 else [f"{axis}{k}" for k in range(1, len(own) + 1)]
        displacements += [
            Quantity(n, "um", ((p.channel, 1.0),)) for n, p in zip(names, own, strict=True)
        ]
        placed = sorted((p.distance, n, p) for n, p in zip(names, own, strict=True)
                        if p.distance is not None)  # fmt: skip
        if len(placed) < 2:
            continue
        (near, one, first), (far, other, last) = placed[0], placed[-1]
        name, sign = TILTS.get(axis, (f"{other}-{one}", 1.0))
        if test == "axis":
            name, sign = f"{other}-{one}", 1.0
        # um over mm is 1000 urad, or 1000 um/m.
        factor = 1e3 * sign / (far - near)
        unit = "um/m" if "-" in name else "urad"
        parts = (first.channel, -factor), (last.channel, factor)
        tilts.append(Quantity(name, unit, parts))
    return displacements + sorted(tilts, key=lambda each: each.name)


def micrometres(log: Record, channel: str) -> Array:
    """A channel of lengths in um."""
    found = converted(1.0, parse_channel(channel).unit, "um")
    assert found is not None
    return log.column(channel) * found


@dataclass(frozen=True)
class Evaluation:
    """What is made of a run."""

    test: Test
    quantities: Sequence[Quantity]
    noises: Mapping[str, ProbeNoise]
    average: float

    def figures(self, run: Record) -> Iterator[RangeFigure]:
        """The figures of a run; those of prescribed times that it is too short for are left out."""
        rng = np.random.default_rng(0)
        for each in self.quantities:
            values = each.of(run)
            if np.isfinite(values).sum() < SHORTEST_RUN:
                continue
            level = even_level(run.time, values, self.average)
            noise = np.sum(
                [f * noise_repeats(level, *self.noises[c], rng) for c, f in each.parts], axis=0
            )
            curves = self._curves(each, level, len(noise), rng)
            for time in (*TIMES[self.test], None):
                if time is not None and time > run.duration + level.step:
                    continue
                name = self._symbol(each.name, time)
                if self.test == "etve":
                    rows = None if time is None else round(time / level.step) + 1
                    found = range_estimate(level.level, curves, noise, each.unit, rows)
                else:
                    last = _rows_within(level, time)
                    found = range_estimate(
                        level.level[:last], curves[:, :last], noise[:, :last], each.unit
                    )
                yield RangeFigure(each.name, name, time, found)

    def _curves(
        self, quantity: Quantity, level: EvenLevel, draws: int, rng: np.random.Generator
    ) -> Array:
        """What the quantity may have been without noise, shape (draws, n)."""
        noises = [(abs(factor), self.noises[channel]) for channel, factor in quantity.parts]
        white = math.hypot(*(factor * each.white for factor, each in noises))
        drifts = [(factor * each.drift, each.time) for factor, each in noises]
        return curve_draws(level.time, level.means, level.counts, white, drifts, draws, rng)

    def _symbol(self, quantity: str, time: float | None) -> str:
        if self.test == "etve":
            within = {HOUR: " in 1 h", DAY: " in 24 h", None: ""}[time]
            return f"ETVE({quantity}){within}"
        return f"d({quantity}){'t' if time is None else f'{time / MINUTE:g}'}"


def _rows_within(level: EvenLevel, time: float | None) -> int:
    if time is None:
        return len(level.time)
    return int(np.searchsorted(level.time, level.time[0] + time + level.step / 2))
