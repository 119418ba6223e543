"""Periodic disturbance: something goes by a clock."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.polynomial import polynomial as poly

from thermaltool.effects.dynamics import HOUR
from thermaltool.effects.effect import Effect, Float, Memory, Outputs, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.record import Record

# Clocks of buildings and control cabinets [s].
CLOCK_PERIODS = (24 * HOUR, 12 * HOUR, HOUR, HOUR / 2)
# Strongest lines of an output that are worth a trial, and how far they stand out at least.
MAX_LINES, MIN_CONTRAST = 3, 4.0
# Slow periods whose lines are as wide as their surroundings: so many of them in a record.
SLOW_PERIODS_PER_RECORD = np.arange(2.0, 8.1, 0.5)
# Points of a spectrum's time axis at most; a log with long pauses would need more.
MAX_POINTS = 50_000


class Periodic(Effect):
    """A sine of one period is added to the outputs, each with its own size and phase.

    Phases count from time zero of one log, so it says nothing of another.
    """

    name: ClassVar[str] = "periodic"
    side: ClassVar[Side] = "source"
    defect: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "something goes by a clock: air conditioning, a pump, a chiller's hysteresis, day and night"
    )
    action: ClassVar[str] = (
        "look for what goes by a clock of {period} (air conditioning, chiller, pump, sun): "
        "it moves {output} by up to {moves}; log it in a column of its own, or shield the "
        "machine from it"
    )
    signature: ClassVar[str] = "a line in the residual's spectrum that none of the drives has"
    source: ClassVar[str] = "ISO 230-3 (cycling of the environment)"
    causal: ClassVar[bool] = True
    known: ClassVar = {
        "sine": Parameter("{output}", linear=True),
        "cosine": Parameter("{output}", linear=True),
        "period": Parameter("s", low=0.0, log=True),
    }

    def output(self, name: str, outputs: Outputs, record: Record, memory: Memory = None) -> Float:
        sine = self.parameters.get(f"sine[{name}]")
        cosine = self.parameters.get(f"cosine[{name}]")
        if sine is None or cosine is None:
            return outputs[name]
        angle = 2 * np.pi * record.time / self.parameters["period"]
        return outputs[name] + sine * np.sin(angle) + cosine * np.cos(angle)

    def plausible(self, scene: Scene) -> bool:
        # A swing that the record does not show twice is a trend.
        return self.parameters["period"] < scene.duration / 2

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        sizes = {f"{part}[{o}]": 1.0 for o in scene.outputs for part in ("sine", "cosine")}
        for k, log in enumerate(scene.logs):
            frequency, spectra = _spectra(scene, k)
            if not len(frequency):
                continue
            for period, output in _places(log, frequency, spectra):
                yield cls(output, {**sizes, "period": period}, log.digest)


def _places(log: Record, frequency: Float, spectra: Mapping[str, Float]) -> list[tuple[float, str]]:
    """Periods worth a trial, and where they are strongest: lines, then slow ones and clocks."""
    lines: list[tuple[float, float, str]] = []
    for output, power in spectra.items():
        above = power / _usual(frequency, power)
        inner = above[1:-1]
        tops = 1 + np.flatnonzero((inner > above[:-2]) & (inner >= above[2:]))
        tops = tops[above[tops] > MIN_CONTRAST]
        best = tops[np.argsort(-above[tops])][:MAX_LINES]
        lines += [(-float(above[i]), 1 / float(frequency[i]), output) for i in best]
    wanted = [(period, output) for _, period, output in sorted(lines)]
    slow = (log.duration / SLOW_PERIODS_PER_RECORD).tolist()
    for period in (*slow, *CLOCK_PERIODS):
        if 8 * log.period < period <= log.duration / 2:
            at = int(np.argmin(np.abs(frequency - 1 / period)))
            _, strongest = max((power[at], output) for output, power in spectra.items())
            wanted.append((period, strongest))
    taken: list[tuple[float, str]] = []
    for period, output in wanted:
        # Closer than that, one search reaches both.
        if all(abs(1 / period - 1 / other) > 0.4 / log.duration for other, _ in taken):
            taken.append((period, output))
    return taken


def _spectra(scene: Scene, k: int) -> tuple[Float, dict[str, Float]]:
    """Power of the residuals of a log, a quadratic trend taken away, over that of the noise.

    Returns
    -------
    frequency : ndarray, shape (n,) [Hz]
        Between two periods in the record and four samples in a period.
    spectra : dict of output to ndarray, shape (n,)
    """
    log = scene.logs[k]
    step = max(log.period, log.duration / MAX_POINTS)
    grid = np.arange(log.time[0], log.time[-1], step)
    padded = 4 * 2 ** int(np.ceil(np.log2(max(len(grid), 2))))
    every = np.asarray(np.fft.rfftfreq(padded, step), np.float64)
    inside = np.flatnonzero((every >= 2 / log.duration) & (every <= 0.25 / step))
    if len(inside) < 16:
        return np.zeros(0), {}
    frequency, spectra = every[inside], {}
    across = np.linspace(-1, 1, len(grid))
    for output, residual in scene.residual[k].items():
        there = np.isfinite(residual)
        if there.sum() < len(residual) / 2:
            continue
        x = np.interp(grid, log.time[there], residual[there])
        x = x - poly.polyval(across, poly.polyfit(across, x, 2))
        line = np.fft.rfft(x * np.hanning(len(x)), padded)[inside]
        power = np.asarray(np.abs(line) ** 2, np.float64)
        if power.any():
            spectra[output] = power / scene.noise[output] ** 2
    return (frequency, spectra) if spectra else (np.zeros(0), {})


def _usual(frequency: Float, power: Float) -> Float:
    """Median power in bands an octave wide, joined by straight lines of the logarithm."""
    octaves = int(np.log2(frequency[-1] / frequency[0]))
    edges = np.geomspace(frequency[0], frequency[-1] * 1.000001, 2 + octaves)
    bands = np.searchsorted(frequency, edges)
    middle, level = [], []
    for a, b in pairwise(bands.tolist()):
        if b > a:
            middle.append(float(np.log(frequency[a:b]).mean()))
            level.append(float(np.log(max(np.median(power[a:b]), 1e-9 * power.max()))))
    return np.exp(np.interp(np.log(frequency), middle, level))
