"""A boring bar whose cutter a piezo moves, after Gao (2000): chapters 3, 5.2 and 6.

The cutting force bends the bar; strain gauges read the bending, a computer commands the piezo.
y is the deflection of the cutter out of its nominal radius, positive into the wall [µm].

From print: static stiffness 2.7 N/µm; piezo 15 µm at 100 V, at the cutter 9/50 µm/V (so the lever
is 1.2, and 120 V give 21.6 µm where the text has a travel above 20 µm); amplifier of gain 10 with
-20 to 120 V, and 140 mA into 7 µF (20 V/ms); gauge filter of 753 rad/s, damping 0.707; 12 bit both
ways; sampling at 0.5 ms; the bar's mode from the roots of the identified ARMA(2,1), 2225 rad/s and
0.1685 (the printed 2478 rad/s and 0.15 do not follow from its coefficients).

Computed from print: the cutting stiffness. Depths of 235 to 442 µm came out 10 to 21 µm short on
the diameter (table 6.3), 4.4 % of the depth, so it is 0.044/(1 - 0.044) of the bar's. The corner of
the loaded amplifier, 86 Hz: with filter and mode it puts -3 dB from command to reading at about the
measured 80 Hz. Noise of the gauges, 0.02 µm: ±2 standard deviations are the resolution of 0.08 µm.

Chosen, for nothing is printed: one sample of computing; hysteresis of about 12 % of the stroke
(usual for a stack in open loop), by Bouc and Wen's law, which no model of the tool uses; how the
force varies (`Workpiece`), scaled so that the four uncompensated sections of the taper are as far
from round as the printed ones in the mean (6.65 µm; over sixteen draws it is 7.0); the spindle's
own error, which no gauge on the bar can see.

Left out: regeneration (a finishing cut takes fresh material each revolution), the axial direction,
and wear.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter

Array = NDArray[np.float64]
Controller = Callable[[float], float | None]

SUBSTEPS = 5  # of a sample: 0.1 ms, a thirtieth of the period of the bar
TAPER_SLOPE = 5.75  # [µm of radius per mm]: 103.5 µm over 18 mm, table 6.1


@dataclass(frozen=True)
class BarParameters:
    """What the module's text says of each [N, µm, V, s, rad/s]."""

    stiffness: float = 2.7
    cutting_stiffness: float = 2.7 * 0.044 / (1 - 0.044)
    natural: float = 2225.0
    damping: float = 0.1685
    amplifier_gain: float = 10.0
    amplifier_range: tuple[float, float] = (-20.0, 120.0)
    amplifier_corner: float = 2 * math.pi * 86.0
    amplifier_slew: float = 0.140 / 7e-6
    expansion: float = 9 / 50
    hysteresis: float = 0.28
    hysteresis_reach: float = 25.0
    filter_natural: float = 753.0
    filter_damping: float = 0.707
    gauge_noise: float = 0.02
    reading_range: float = 40.0
    command_range: float = 10.0
    bits: int = 12
    compute_samples: int = 1
    period: float = 0.5e-3


@dataclass(frozen=True)
class Workpiece:
    """What is cut: the radial depth, and all that varies it.

    Attributes
    ----------
    depth : float [µm]
        At the start.
    taper : float [µm/mm]
        Growth of the depth along the feed.
    eccentricity : float [µm]
        Of the blank against the spindle.
    lobes : mapping of undulations per revolution to amplitude [µm]
        Form of the blank, and what hardness does alike; phases are drawn.
    force_noise : float
        Standard deviation of the force relative to its mean, e.g. by a built-up edge.
    force_corner : float [Hz]
        Its corner frequency.
    spindle_lobes : mapping of undulations per revolution to amplitude [µm]
    spindle_noise : float [µm]
        Error of the spindle that does not repeat, standard deviation.
    feed : float [mm/s]
    """

    depth: float = 150.0
    taper: float = 0.0
    eccentricity: float = 0.0
    lobes: dict[int, float] = field(default_factory=lambda: {1: 16.0, 2: 38.0, 3: 29.0, 5: 11.5})
    force_noise: float = 0.07
    force_corner: float = 20.0
    spindle_lobes: dict[int, float] = field(default_factory=lambda: {2: 0.6, 3: 0.5, 4: 0.3})
    spindle_noise: float = 0.2
    feed: float = 10.0 / 60.0


# Sections of the taper, 6 mm apart: the printed depths of cut on the diameter, halved [µm].
SECTIONS = {"A": 117.5, "B": 152.0, "C": 186.5, "D": 221.0}
PARTS = {
    "straight": Workpiece(),
    "taper": Workpiece(depth=SECTIONS["A"], taper=TAPER_SLOPE),
    # Unevenly clamped for its eccentricity, so more oval than lobed.
    "eccentric": Workpiece(eccentricity=100.0, lobes={2: 60.0, 3: 15.0}),
    # Off the wall, farther than the piezo reaches.
    "none": Workpiece(
        depth=-1000.0, lobes={}, force_noise=0.0, spindle_lobes={}, spindle_noise=0.0
    ),
}


@dataclass(frozen=True)
class CutRecord:
    """What a cut leaves, one value per sample.

    Attributes
    ----------
    time : (n,) ndarray [s]
    angle : (n,) ndarray [revolutions]
    reading : (n,) ndarray [µm]
        What the computer reads.
    command : (n,) ndarray [V]
        What it puts out, ahead of the amplifier.
    deflection : (n,) ndarray [µm]
        Of the cutter, as it is.
    trace : (n,) ndarray [µm]
        Radius as cut, from the nominal one: the deflection, and the error of the spindle.
    """

    time: Array
    angle: Array
    reading: Array
    command: Array
    deflection: Array
    trace: Array

    def columns(self, speed: float) -> dict[str, Array]:
        """As a log."""
        return {
            "time_s": np.round(self.time, 9),
            "n_spindle_rpm": np.full_like(self.time, speed),
            "U_command_V": self.command,
            "e_tool_um": self.reading,
            "d_tool_um": np.round(self.deflection, 6),
            "d_trace_um": np.round(self.trace, 6),
        }


@dataclass(frozen=True)
class BoringBar:
    """The bar with its piezo, gauges and converters."""

    parameters: BarParameters = field(default_factory=BarParameters)

    def cut(
        self,
        part: Workpiece,
        speed: float,
        samples: int,
        controller: Controller | None = None,
        seed: int | np.random.SeedSequence = 1,
        push: Array | None = None,
    ) -> CutRecord:
        """Cut for so many samples, from rest beside the wall.

        Parameters
        ----------
        part : Workpiece
        speed : float [rev/min]
        samples : int
        controller : callable
            From each reading [µm] to the command [V] that answers it, or None to end the cut
            there; without one 0 V.
        seed : int or SeedSequence
            Of phases and of all noise.
        push : (samples,) ndarray [N]
            Force on the cutter beside that of cutting, outward.
        """
        p = self.parameters
        rng = np.random.default_rng(seed)
        time = p.period * np.arange(samples, dtype=np.float64)
        angle = time * speed / 60
        wall, noise, spindle = _disturbances(part, p, time, angle, rng)
        gauge = p.gauge_noise * rng.standard_normal(samples)
        state = _State(p)
        pending = [0.0] * p.compute_samples
        reading, command, deflection = np.zeros(samples), np.zeros(samples), np.zeros(samples)
        push = np.zeros(samples) if push is None else push
        rows = zip(wall.tolist(), noise.tolist(), spindle.tolist(), push.tolist(), strict=True)
        for k, (depth, factor, error, force) in enumerate(rows):
            deflection[k] = state.y
            read = _converted(state.filtered + gauge[k], p.reading_range, p.bits)
            answer = controller(read) if controller else 0.0
            if answer is None:
                time, angle, spindle = time[:k], angle[:k], spindle[:k]
                reading, command, deflection = reading[:k], command[:k], deflection[:k]
                break
            pending.append(_converted(answer, p.command_range, p.bits))
            reading[k], command[k] = read, pending[-1]
            state.advance(pending.pop(0), depth + error, factor, force)
        return CutRecord(time, angle, reading, command, deflection, deflection + spindle)

    def probe(self, commands: Array, seed: int | np.random.SeedSequence = 1) -> CutRecord:
        """Free of the wall, the piezo driven by `commands` [V]: to identify it."""
        waiting = iter(commands.tolist())
        return self.cut(PARTS["none"], 0.0, len(commands), lambda reading: next(waiting), seed)


class _State:
    """Amplifier, piezo, bar and filter, from sample to sample."""

    def __init__(self, p: BarParameters) -> None:
        self._p = p
        self._step = p.period / SUBSTEPS
        self._lag = -math.expm1(-p.amplifier_corner * self._step)
        self._slope = _slope(p)
        self._max_move = p.amplifier_slew * self._step
        self._bar = _second_order(p.natural, p.damping, self._step)
        self._filter = _second_order(p.filter_natural, p.filter_damping, self._step)
        self.y = self._speed = self.filtered = self._rate = 0.0
        self._volts = self._z = 0.0

    def advance(self, command: float, depth: float, factor: float, push: float) -> None:
        """One sample with a held command [V], depth [µm], force factor and push [N]."""
        p = self._p
        low, high = p.amplifier_range
        target = min(max(p.amplifier_gain * command, low), high)
        (a, b, c, d), (e, f) = self._bar
        (g, h, i, j), (m, n) = self._filter
        y, speed, filtered, rate = self.y, self._speed, self.filtered, self._rate
        for _ in range(SUBSTEPS):
            move = self._lag * (target - self._volts)
            move = min(max(move, -self._max_move), self._max_move)
            self._volts += move
            self._z = _bouc_wen(self._z, move, p)
            # the wall pushes back on what the cutter takes, where it takes something
            taken = depth + y
            force = p.cutting_stiffness * taken * factor if taken > 0 else 0.0
            pushed = self._slope * (self._volts - self._z) + (push - force) / p.stiffness
            filtered, rate = (g * filtered + h * rate + m * y, i * filtered + j * rate + n * y)
            y, speed = a * y + b * speed + e * pushed, c * y + d * speed + f * pushed
        self.y, self._speed, self.filtered, self._rate = y, speed, filtered, rate


def _bouc_wen(z: float, move: float, p: BarParameters) -> float:
    """The part of the voltage that the piezo lags behind, after a move of the voltage [V].

    ż = α V̇ - |V̇| z/R: it goes with α V at first and saturates at α R.
    """
    return z + p.hysteresis * move - abs(move) * z / p.hysteresis_reach


def _slope(p: BarParameters) -> float:
    """Expansion per effective volt, so that a loop over 100 V has the printed stroke [µm/V].

    The closed loop of `_bouc_wen` over V lags by z = ±α R tanh(V/2R) at its ends.
    """
    lag = 2 * p.hysteresis * p.hysteresis_reach * math.tanh(50.0 / p.hysteresis_reach)
    return p.expansion * 100.0 / (100.0 - lag)


def _second_order(
    natural: float, damping: float, step: float
) -> tuple[tuple[float, float, float, float], tuple[float, float]]:
    """Exact recursion of ω²/(s² + 2 ζ ω s + ω²) with a held input: rows of A, then B."""
    block = np.zeros((3, 3))
    block[0, 1] = 1.0
    block[1] = -(natural**2), -2 * damping * natural, natural**2
    held = expm(block * step)
    a, b, c, d = held[:2, :2].ravel().tolist()
    e, f = held[:2, 2].tolist()
    return (a, b, c, d), (e, f)


def _converted(value: float, full: float, bits: int) -> float:
    """The nearest level of a converter between -full and full."""
    level = 2 * full / 2**bits
    return min(max(round(value / level) * level, -full), full - level)


def _disturbances(
    part: Workpiece, p: BarParameters, time: Array, angle: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Depth of the wall [µm], factor of the force, error of the spindle [µm]."""
    turn = 2 * np.pi * angle
    wall = part.depth + part.taper * part.feed * time
    wall = wall + part.eccentricity * np.cos(turn + rng.uniform(0, 2 * np.pi))
    spindle = np.zeros_like(time)
    for undulations, amplitude in part.lobes.items():
        wall = wall + amplitude * np.cos(undulations * turn + rng.uniform(0, 2 * np.pi))
    for undulations, amplitude in part.spindle_lobes.items():
        spindle += amplitude * np.cos(undulations * turn + rng.uniform(0, 2 * np.pi))
    factor = 1 + part.force_noise * _coloured(len(time), part.force_corner * p.period, rng)
    spindle += part.spindle_noise * _coloured(len(time), 60.0 * p.period, rng)
    return wall, factor, spindle


def _coloured(count: int, corner: float, rng: np.random.Generator) -> Array:
    """First-order noise of variance 1; corner in cycles per sample."""
    keep = math.exp(-2 * math.pi * corner)
    white = rng.standard_normal(count)
    start = [keep * rng.standard_normal()]
    values, _ = lfilter([math.sqrt(1 - keep**2)], [1, -keep], white, zi=start)
    return np.asarray(values, float)


def build(parameters: BarParameters | None = None) -> BoringBar:
    """The bar of the source, or another."""
    return BoringBar(parameters or BarParameters())
