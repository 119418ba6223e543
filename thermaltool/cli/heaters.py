"""``thermaltool plant quill`` and ``c-frame``: structures with two heaters."""

from __future__ import annotations

import click
import numpy as np

from thermaltool.cli.plant import clock, read_input
from thermaltool.logs import write_table
from thermaltool.plants import build_heated
from thermaltool.plants.duties import DUTIES, HOUR, air, settings
from thermaltool.plants.excitation import hold
from thermaltool.plants.heated import HEATERS, POWERS, SENSORS
from thermaltool.plants.noise import read_sensors

AIR = "T_ambient_degC"
USUAL_DURATION, USUAL_START, USUAL_PERIOD = 12 * HOUR, 1800.0, 60.0


def write_heated(
    name: str,
    shape: str,
    heater: str | None,
    power: float | None,
    times: tuple[float | None, float | None, float | None],
    climate: tuple[float, float],
    seed: int,
    clean: bool,
    output: str,
    form: str | None,
) -> None:
    """Simulate and write; `times` are duration, start and period, `climate` mean and swing."""
    duration, start, dt = times
    time = clock(duration or USUAL_DURATION, dt or USUAL_PERIOD)
    since = time - (USUAL_START if start is None else start)
    plant = build_heated(name)
    full = plant.regulators[0].full
    if power is not None and power > full:
        raise click.BadParameter(f"{name} has {full:g} W", param_hint="--power")
    around = air(time, *climate, seed)
    if shape in DUTIES:
        chosen = heater or HEATERS[0]
        on = (chosen != HEATERS[1], chosen != HEATERS[0])
        powers = settings(shape, on, full if power is None else power, since, seed)
    elif heater is None and power is None:
        powers, around = _from_log(shape, since, around)
    else:
        raise click.UsageError("--heater and --power are for shapes: a log has its own powers")
    outputs = plant.simulate(powers, around, time[1] - time[0])
    read = {AIR: around, **outputs}
    if not clean:
        read = read_sensors(read, SENSORS, time[1] - time[0], seed)
    write_table({"time_s": time, **dict(zip(POWERS, powers.T, strict=True)), **read}, output, form)


def _from_log(source: str, since: np.ndarray, around: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Settings, and the air where the log has it, held between its rows."""
    log = read_input(source, tuple(DUTIES), POWERS)
    elapsed = log.time - log.time[0]
    powers = [hold(since, elapsed, log.column(channel), before=0.0) for channel in POWERS]
    if AIR in log.columns:
        measured = log.column(AIR)
        around = hold(since, elapsed, measured, before=measured[0])
    return np.column_stack(powers), around
