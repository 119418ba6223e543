"""Sensors by what is missed of held-out rows, and which say the same."""

import numpy as np
import pytest
from machines.expanding_rod import OUTPUT, SENSORS, random_heat, rod_columns

from thermaltool.errors import FitError
from thermaltool.fitting.data import training_data
from thermaltool.placement.collinearity import collinearity
from thermaltool.placement.regression import Basis, RegressionProblem
from thermaltool.placement.sensor_choice import HeldOutScores, choose_sensors
from thermaltool.record import Record


def rod_log(*heat):
    columns = rod_columns(*heat)
    return Record(columns.pop("time_s"), columns)


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(21)
    logs = [rod_log(random_heat(rng, 360, 60), 10.0, rng, 0.02) for _ in range(2)]
    return training_data(logs, SENSORS, [OUTPUT])


def test_scores_are_errors_of_fits_to_the_other_rows(data):
    scores = HeldOutScores([RegressionProblem(data, Basis(SENSORS))])
    found = scores.choice([0, 4])
    own = RegressionProblem(
        data.driven_by((SENSORS[0], SENSORS[4])), Basis((SENSORS[0], SENSORS[4]))
    )
    held = own.origin == 1
    assert found.errors[0] == pytest.approx(own.error(~held, held), rel=1.0)
    assert found.sensors == (SENSORS[0], SENSORS[4])


def test_a_near_and_a_far_sensor_are_taken_of_the_rod(data):
    scores = HeldOutScores([RegressionProblem(data, Basis(SENSORS))])
    one, two = choose_sensors(scores, 2)
    assert two.errors[0] < 0.5 * one.errors[0]
    assert SENSORS[0] in two.sensors
    assert set(two.sensors) & {SENSORS[3], SENSORS[4], SENSORS[5]}
    kept = choose_sensors(scores, 2, [1, 2, 3, 4])[-1]
    assert set(kept.sensors) <= set(SENSORS[1:5])
    with pytest.raises(FitError, match="3 sensors of 2 candidates"):
        choose_sensors(scores, 3, [0, 1])


def test_sensors_that_say_the_same_are_grouped():
    rng, time = np.random.default_rng(2), np.arange(0.0, 1000.0, 10.0)
    a, b = rng.normal(size=(2, 100)).cumsum(axis=1)
    columns = {"T_a_degC": a, "T_b_degC": b, "T_c_degC": 2 * a + 0.01 * rng.normal(size=100)}
    log = Record(time, {**columns, "d_z_um": a})
    found = collinearity(training_data([log], list(columns), ["d_z_um"]))
    assert found.groups == (("T_a_degC", "T_c_degC"),)
    assert found.condition > 30
    assert found.inflation[0] > 100 > found.inflation[1]
