"""Logs of a simulated machine with known effects hidden in them, at a chosen size above noise.

The machine is calibrated without any effect, then runs another duty with the effects. Everything
that is needed to judge a diagnosis comes along: what was hidden, where, how much, and the outputs
without noise, with and without the effects.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from zlib import crc32

import numpy as np
from machines.faults import FAULTS, VARIANTS
from machines.network import BEARING, OUTPUTS, Network, machine
from machines.scenario import DEFLECTIONS, Fault, Table, new_run, noise_of, sensors_of

from thermaltool.plants.noise import Sensor

EFFECTS = tuple(FAULTS)
_SHORT = 0.5  # slowest time constants that a calibration covers when the record is too short
_HOT = 90.0  # rise of the column [K] from which radiation matters
_PRECISE = 1e-3  # relative, of the size that is searched
_TRIES = 40
_POWERS = 0.3, 3.0  # by which a change may go with the strength of its effect
_SEEN = 1e-6  # size below which nothing is seen to change


@dataclass(frozen=True)
class Hidden:
    """One effect of a log.

    Parameters
    ----------
    effect : str
        A key of the catalogue (`EFFECTS`).
    variant : str or None
        Its form, see `machines.faults.VARIANTS`.
    channel : str or None
        What a diagnosis should name: drive, sensor or another column; None where there is none.
    parameters : dict of str to float
        The truth, in the units of the channels (``time_s``, ``gain_<output>``, ...).
    size : float
        RMS of what this effect alone changes over that output's noise, for the output where it is
        largest. Means are taken out of deflections, whose zero is arbitrary.
    """

    effect: str
    variant: str | None
    channel: str | None
    parameters: dict[str, float]
    size: float


@dataclass(frozen=True)
class HiddenLog:
    """A calibration log, a log with hidden effects, and the truth about it.

    Parameters
    ----------
    hidden : tuple of Hidden
        Empty for a clean log.
    calibration, log : dict of str to (m,) ndarray
        Columns, ``time_s`` among them: without the effects, and with them.
    truth, clean : dict of str to (m,) ndarray
        Outputs of `log` without noise, with the effects and without.
    noise : dict of str to float
        Standard deviation of the noise of each output, white and slow together.
    slowest : float
        Slowest time constant of the machine [s].
    machine_seed, seed : int
    """

    hidden: tuple[Hidden, ...]
    calibration: Table
    log: Table
    truth: Table
    clean: Table
    noise: dict[str, float]
    slowest: float
    machine_seed: int
    seed: int


def hide(
    effects: Sequence[str],
    size: float,
    machine_seed: int,
    seed: int,
    variant: str | None = None,
) -> HiddenLog:
    """Logs of the machine of `machine_seed` with `effects` of a `size` above noise.

    Parameters
    ----------
    effects : sequence of str
        Keys of the catalogue; none, or ``["clean"]``, for a log without effects. Several act
        together, each of the size that it has alone.
    size : float
        Wanted RMS of the change over noise (see `Hidden.size`), positive. Effects without a
        strength (``sensor_frozen``, ``sensors_swapped``, ``record_too_short``) have the one they
        have; so has one that cannot become so large. `Hidden.size` says what was reached.
        For ``radiation`` the log is driven beyond the calibration, up to a column of 110 °C.
    machine_seed, seed : int
        Of the machine and its sensors; of schedules, places, times, signs and noise.
    variant : str, optional
        Form of the first effect.

    Raises
    ------
    ValueError
        Unknown effect or variant, or a size that is not positive.
    """
    names = [] if list(effects) == ["clean"] else list(effects)
    for name in names:
        if name not in FAULTS or names.count(name) > 1:
            raise ValueError(f"unknown or repeated effect {name!r}; known: " + ", ".join(EFFECTS))
    if variant is not None and (not names or variant not in VARIANTS.get(names[0], ())):
        known = ", ".join(VARIANTS.get(names[0], ())) if names else ""
        raise ValueError(f"no variant {variant!r} of {names[:1]}; known: {known or 'none'}")
    if not size > 0.0:
        raise ValueError(f"size {size} must be positive")

    network, sensors, key = machine(machine_seed), sensors_of(machine_seed), (seed, machine_seed)
    full = _hot(network) if "radiation" in names else 1.0
    calibrated = new_run(network, key, calibrating=True)
    plain, run = (new_run(network, key, full=full) for _ in range(2))
    clean = plain.simulate()
    hidden: list[Hidden] = []
    unlogged = set()
    for name in names:
        form = variant if not hidden else None
        stream = np.random.default_rng([*key, 104, crc32(name.encode())])
        fault = FAULTS[name](plain, stream, form)

        def reach(strength: float, fault: Fault = fault) -> float:
            alone = new_run(network, key, full=full)
            fault.apply(strength, alone)
            return _change(alone.simulate(), clean, sensors)

        strength = 0.0 if fault.most is None else _strength(reach, size, fault.most)
        parameters = fault.apply(strength, run)
        hidden.append(Hidden(name, form, fault.channel, parameters, reach(strength)))
        unlogged.add(fault.unlogged)

    calibration = calibrated.read(sensors, _noise_seed(key, "calibration"))
    if "record_too_short" in names:
        rows = calibration["time_s"] <= _SHORT * network.slowest
        calibration = {name: values[rows] for name, values in calibration.items()}
    log = run.read(sensors, _noise_seed(key, "log"))
    return HiddenLog(
        tuple(hidden),
        {name: values for name, values in calibration.items() if name not in unlogged},
        {name: values for name, values in log.items() if name not in unlogged},
        run.simulate(),
        clean,
        {name: noise_of(name, sensors) for name in OUTPUTS},
        network.slowest,
        machine_seed,
        seed,
    )


def _hot(network: Network) -> float:
    """Drive at which the column would reach `_HOT` in the end: beyond what was calibrated."""
    rise = network.rows @ network.steady(network.source(BEARING, network.power))
    return round(_HOT / float(rise[OUTPUTS.index("T_column_degC")]), 2)


def _noise_seed(key: tuple[int, int], log: str) -> int:
    """A seed for the sensors of one log."""
    return int(np.random.default_rng([*key, 105, crc32(log.encode())]).integers(2**31))


def _change(outputs: Table, clean: Table, sensors: dict[str, Sensor]) -> float:
    """RMS change over noise of the output that changes most."""
    changes = []
    for name in OUTPUTS:
        change = outputs[name] - clean[name]
        if name in DEFLECTIONS:
            change = change - np.mean(change)
        changes.append(np.sqrt(np.mean(change**2)) / noise_of(name, sensors))
    return float(max(changes))


def _strength(reach: Callable[[float], float], size: float, most: float) -> float:
    """Strength at which `reach` is `size`; `most` where even that does not reach it."""
    strength = 1e-2 * min(most, 1.0)
    while (found := reach(strength)) < _SEEN and strength < most:
        strength = min(10.0 * strength, most)
    # The change goes nearly with a power of the strength: secants between logarithms.
    power = 1.0
    for _ in range(_TRIES):
        missing = np.log(size / found)
        if abs(missing) < _PRECISE or (strength == most and missing > 0.0):
            break
        following = min(strength * float(np.exp(missing / power)), most)
        before, found = found, reach(following)
        if following != strength:
            slope = np.log(found / before) / np.log(following / strength)
            power = float(np.clip(slope, *_POWERS))
        strength = following
    return strength
