"""Readings that are a sensor's fault are found, and those of a machine are left alone."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.api.inputs import read
from thermaltool.errors import LogError
from thermaltool.logs import read_log
from thermaltool.logs.clock import segments
from thermaltool.logs.faults import find_faults
from thermaltool.record import Record

ROWS = 1500
TIME = 10.0 * np.arange(ROWS)
# The days on which and after which this file was written.
SEEDS = (20261124, 20261125, 20261126)
WARM_UP = 22 + 40 * -np.expm1(-TIME / 3000)


def log_of(values: np.ndarray, name: str = "T_a_degC", time: np.ndarray = TIME) -> Record:
    return Record(time, {name: values}, segments(time))


def found_rows(log: Record) -> set[int]:
    return {row for fault in find_faults(log) for row in fault.rows.tolist()}


def noise(seed: int, size: float = 0.05) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, size, ROWS)


# ---------------------------------------------------------------- what is a fault


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("resolution", [0.001, 0.0625, 0.5])
@pytest.mark.parametrize(
    ("value", "rows", "kind", "why"),
    [
        (85.0, 1, "fault", "85 degC is a DS18B20 after power-on"),
        (85.0, 4, "fault", "85 degC is a DS18B20 after power-on in 4 rows"),
        (85.0, 40, "fault", "85 degC is a DS18B20 after power-on in 40 rows"),
        (-127.0, 7, "fault", "-127 degC is a DS18B20 that does not answer in 7 rows"),
        (-242.02, 2, "fault", "-242.02 degC is a MAX31865 with its sensor shorted in 2 rows"),
        (988.79, 3, "fault", "988.79 degC is a MAX31865 with its sensor open in 3 rows"),
        (-180.0, 300, "implausible", "-180 degC is no temperature of a machine in 300 rows"),
        (-300.0, 1, "implausible", "-300 degC is below absolute zero"),
    ],
)
def test_values_that_only_a_fault_gives(seed, resolution, value, rows, kind, why):
    values = resolution * np.round((WARM_UP + noise(seed)) / resolution)
    start = int(np.random.default_rng(seed).integers(200, 1000))
    values[start : start + rows] = value
    (fault,) = find_faults(log_of(values))
    assert (fault.kind, fault.message) == (kind, why)
    assert fault.rows.tolist() == list(range(start, start + rows))


def test_a_sensor_that_is_powered_on_as_the_log_begins():
    values = WARM_UP + noise(SEEDS[0])
    values[:2] = 85.0
    assert found_rows(log_of(values)) == {0, 1}
    assert found_rows(log_of(np.array([85.0, 22.0, 22.1, 22.0]), time=np.arange(4.0))) == {0}


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("rows", [1, 2, 3])
@pytest.mark.parametrize("name", ["T_a_degC", "dT_a_K", "d_z_um"])
def test_spikes_of_up_to_three_rows(seed, rows, name):
    generator = np.random.default_rng([seed, rows])
    values, spiked = WARM_UP + noise(seed), set()
    for start in 20 + 97 * generator.choice(15, 6, replace=False):
        values[start : start + rows] += generator.choice([-1, 1], rows) * generator.uniform(5, 60)
        spiked |= set(range(start, start + rows))
    assert found_rows(log_of(values, name)) == spiked


@pytest.mark.parametrize("seed", SEEDS)
def test_spikes_within_bursts_of_readings(seed):
    """Three rows four seconds apart once a minute, on a slope."""
    time = 60.0 * (np.arange(ROWS) // 3) + 4.0 * (np.arange(ROWS) % 3)
    values = 105 - 80 * -np.expm1(-time / 4000) + noise(seed, 0.02)
    spiked = {301, 302, 450, 451, 600, 901}
    values[sorted(spiked)] += np.random.default_rng(seed).uniform(10, 50)
    assert found_rows(log_of(values, time=time)) == spiked


def test_the_end_of_a_pause_is_no_spike():
    time = TIME + 3000.0 * (TIME > 5000) + 3000.0 * (TIME > 5020)
    values = np.where((TIME > 5000) & (TIME <= 5020), 30.0, 22.0) + noise(SEEDS[0])
    assert len(segments(time)) == 3
    assert not found_rows(log_of(values, time=time))


# ---------------------------------------------------------------- what is none


def lag(level: np.ndarray, tau: float) -> np.ndarray:
    out, keep = np.empty_like(level), np.exp(-10.0 / tau)
    out[0] = level[0]
    for k in range(1, len(level)):
        out[k] = keep * out[k - 1] + (1 - keep) * level[k]
    return out


def pulses(every: int, tau: float) -> np.ndarray:
    rises = 30.0 * (np.arange(ROWS) % every == 0)
    return np.convolve(rises, np.exp(-TIME / tau))[:ROWS]


SAW = np.abs((TIME / 130.0) % 1 - 0.4)
MACHINES = {
    "a bed held at 85": np.minimum(22 + 0.3 * TIME, 85.0) - 60 * (TIME > 9000),
    "a bed that comes to 85 and cools": lag(np.where(TIME < 9000, 85.0, 22.0), 800.0),
    "a fast bed": lag(np.where((TIME > 300) & (TIME < 9000), 85.0, 22.0), 12.0),
    "through 85": lag(np.where(TIME < 9000, 110.0, 22.0), 30.0),
    "a thermostat": 85 + 4 * (SAW - 0.2),
    "a slope": 20 + 0.01 * TIME,
    "a step": np.where(TIME < 7000, 22.0, 60.0),
    "two steps": 22.0 + 30 * ((TIME > 7000) & (TIME < 7045)),
    "fast transients": 20 + pulses(173, 15.0) + pulses(211, 60.0),
    "short pulses of a heater": 22 + 5 * -np.expm1(-TIME / 3000) + 4 * (np.arange(ROWS) % 60 < 3),
    "a cryostat": -196 + 100 * -np.expm1(-TIME / 3000),
}


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("resolution", [0.0, 0.01, 0.0625, 0.5, 1.0])
@pytest.mark.parametrize("machine", MACHINES)
def test_a_machine_is_no_fault(machine, resolution, seed):
    for size in (0.0, 0.02, 0.2):
        values = MACHINES[machine] + noise(seed, size)
        if resolution:
            values = resolution * np.round(values / resolution)
        assert not found_rows(log_of(values)), size


@pytest.mark.parametrize("late", [0, 1, 2])
def test_what_a_command_makes_is_no_spike(late):
    """Dwells of two rows, that come five times, and two spikes beside them."""
    moved, offset = np.zeros(ROWS), noise(5)
    for k in (60, 150, 410, 700, 980):
        moved[k : k + 2] = 1.0
        offset[k + late : k + late + 2] += 8.0
    offset[500] += 8.0
    offset[1200:1202] += 8.0
    # A command that changes all the time, and one that steps but once near a spike, make none.
    switched, step = (TIME // 30) % 2, np.where(TIME < 5000, 0.0, 50.0)
    columns = {"n_axis_rpm": moved, "Q_bed_W": switched, "Q_main_W": step, "d_z_um": offset}
    log = Record(TIME, columns, segments(TIME))
    assert found_rows(log) == {500, 1200, 1201}


def test_a_hole_of_a_command_makes_no_spike():
    torn, values = np.full(ROWS, 300.0), 20 + noise(5)
    torn[200], values[200] = np.nan, values[200] + 25
    log = Record(TIME, {"Q_main_W": torn, "T_head_degC": values}, segments(TIME))
    assert found_rows(log) == {200}


def test_commands_may_leap_for_a_row():
    values = np.where(np.arange(ROWS) % 311 == 5, 85.0, 0.0)
    assert not found_rows(log_of(values, "Q_main_W"))


# ---------------------------------------------------------------- what becomes of them


@pytest.fixture
def faulty() -> Record:
    heat = np.where((TIME > 1000) & (TIME < 9000), 100.0, 0.0)
    columns = {
        "Q_main_W": heat,
        "T_room_degC": 20 + noise(SEEDS[0]),
        "T_a_degC": 20 + lag(0.2 * heat, 900.0) + noise(SEEDS[1]),
    }
    columns["T_a_degC"][[300, 700, 701]] = [85.0, -127.0, -127.0]
    columns["T_a_degC"][[400, 401]] += 25.0
    columns["T_room_degC"][500] = 85.0
    return Record(TIME, columns)


def test_a_fault_of_an_output_is_missing_and_one_of_a_drive_takes_its_row(faulty):
    log = read_log(faulty, faults="omit", need="T_room_degC", outputs=("T_a_degC",))
    assert len(log) == ROWS - 1
    assert 5000.0 not in log.time
    assert np.isnan(log.columns["T_a_degC"]).sum() == 5
    held = read_log(faulty, faults="omit", need="T_room_degC", nan_policy="hold")
    assert held.columns["T_room_degC"][500] == held.columns["T_room_degC"][499]
    kept = read_log(faulty)
    assert kept.columns["T_a_degC"][300] == 85.0
    assert kept.faults == ()


def test_spikes_stay_where_a_stage_finds_them_itself(faulty):
    log = read_log(faulty, faults="omit", keep_spikes=("T_a_degC",))
    assert np.isnan(log.columns["T_a_degC"]).sum() == 3


def test_a_missing_value_is_an_error_still(faulty):
    faulty.columns["T_a_degC"][10] = np.nan
    with pytest.raises(LogError, match="missing value"):
        read_log(faulty, faults="omit", need="Q_main_W", outputs=("T_a_degC",))


def test_one_line_says_how_many_of_what_and_why(faulty):
    told: list[str] = []
    read(faulty, ("Q_main_W",), ("T_a_degC",), warn=told.append)
    assert told == [
        "<record>: faults of sensors left out: 5 of T_a_degC (1 at 85 degC, a DS18B20 after "
        "power-on; 2 at -127 degC, a DS18B20 that does not answer; 2 spikes); --faults keep takes "
        "them"
    ]
    read(faulty, ("Q_main_W",), ("T_a_degC",), warn=told.append, faults="keep")
    assert len(told) == 1


def test_a_sensor_that_never_answered(faulty):
    faulty.columns["T_a_degC"][:] = -127.0
    with pytest.raises(LogError, match="T_a_degC: no reading but faults: -127 degC is a DS18B20"):
        read_log(faulty, faults="omit", outputs=("T_a_degC",))


def test_an_unknown_policy(faulty):
    with pytest.raises(ValueError, match="'drop': one of omit, keep"):
        read_log(faulty, faults="drop")
