"""Duty cycles from logs: states above the noise, and no others."""

import numpy as np
import pytest

from thermaltool.errors import FitError
from thermaltool.placement.candidates import Candidates
from thermaltool.placement.duty_cycles import cycle_of
from thermaltool.placement.optimal_design import place_sensors
from thermaltool.record import Record

NAMES = tuple(f"dT_{k}_K" for k in range(6))
NOISE = np.full(6, 0.05)


def log_of(rng, shapes, rows=600):
    time = 10.0 * np.arange(rows)
    heats = np.array([np.sin(time / 500), np.sin(time / 170)])[: len(shapes)]
    readings = np.transpose(shapes) @ heats + 0.05 * rng.standard_normal((6, rows))
    readings[:, 0] = 0.0
    columns = dict(zip(NAMES, readings, strict=True))
    return Record(time, {**columns, "d_z_um": 5 * heats[0] - 2 * heats[-1]})


def test_two_heats_are_two_states_of_their_size():
    rng = np.random.default_rng(31)
    shapes = rng.uniform(0.2, 1.0, (2, 6))
    cycle = cycle_of(log_of(rng, shapes), NAMES, ["d_z_um"], NOISE)
    assert cycle.readings.shape == (6, 2)
    power = np.sum(cycle.readings**2)
    assert power == pytest.approx(np.sum(shapes**2) / 2, rel=0.1)


def test_noise_alone_is_no_state():
    rng = np.random.default_rng(32)
    log = log_of(rng, np.zeros((2, 6)))
    with pytest.raises(FitError, match="rises above the noise"):
        cycle_of(log, NAMES, ["d_z_um"], NOISE)


def test_all_temperatures_are_what_a_asks_for():
    rng = np.random.default_rng(33)
    # One heat warms five candidates by much, the other one candidate by little.
    shapes = np.array([[1.0, 1.0, 1.0, 1.0, 1.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 0.2]])
    cycle = cycle_of(log_of(rng, shapes), NAMES, ["d_z_um"], NOISE)
    candidates = Candidates.of([cycle], NOISE)
    chosen = place_sensors(candidates, 1.0, "A").sensors
    assert chosen[0] < 5

    def unknown(k):
        own = candidates.scaled(cycle)[[k]]
        left = np.linalg.inv(np.eye(2) + own.T @ own)
        return np.trace(cycle.readings @ left @ cycle.readings.T)

    assert unknown(chosen[0]) == pytest.approx(min(map(unknown, range(6))))
