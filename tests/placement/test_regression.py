"""Regressions on the source's rod and axis; robustness; bad inputs."""

import numpy as np
import pytest
from machines.expanding_rod import OUTPUT, SENSORS, periodic_heat, rod_columns
from machines.warm_axis import axis_columns

from thermaltool.errors import FitError
from thermaltool.fitting.data import training_data
from thermaltool.placement.estimators import METHOD_NAMES
from thermaltool.placement.regression import Basis, Column, RegressionProblem
from thermaltool.placement.robustness import judged, missed, trials
from thermaltool.record import Record

PAIR = (SENSORS[0], SENSORS[4])


def record_of(columns):
    return Record(columns["time_s"], {n: v for n, v in columns.items() if n != "time_s"})


def rod_log(*heat):
    return record_of(rod_columns(*heat))


def problem_of(log, sensors, output, taus=(), **axis):
    channels = [*sensors, *([axis["position"]] if axis else [])]
    return RegressionProblem(training_data([log], channels, [output]), Basis(sensors, taus, **axis))


@pytest.fixture(scope="module")
def axis():
    return [record_of(each) for each in axis_columns(np.random.default_rng(11))]


def test_the_evidence_keeps_the_terms_of_the_published_axis(axis):
    train, test = axis
    names = ("dT_1_K", "dT_2_K", "dT_3_K")
    problem = problem_of(train, names, "d_z_um", position="x_z_mm", degree=2)
    kept = problem.selected()
    assert max(column.power for column in kept) == 1
    found = problem.with_columns(kept).fit(problem.every, "least-squares")
    truth = {
        Column("dT_3_K", 0, 0): -2.420,
        Column("dT_3_K", 0, 1): -0.100,
        Column("dT_2_K", 0, 1): -0.008,
        Column(None, 0, 1): 0.014,
    }
    for column, value in truth.items():
        k = kept.index(column)
        assert found.weights[k] == pytest.approx(value, abs=4 * found.deviations[k])
    # Noise within ±0.5 um is 0.289 um RMS.
    assert found.rmse == pytest.approx(0.289, abs=0.02)
    own = problem.with_columns(kept)
    assert missed(own, test, (*names, "x_z_mm"), "least-squares") < 0.35


def test_two_sensors_of_the_rod_hold_at_other_periods():
    rng = np.random.default_rng(5)
    log = rod_log(periodic_heat(720, 120), 10.0, rng, 0.02)
    problem = problem_of(log, PAIR, OUTPUT)
    found = problem.fit(problem.every)
    assert found.weights == pytest.approx([2.6, 6.6], rel=0.1)
    for period in (60, 240):
        other = rod_log(periodic_heat(720, period), 10.0, rng, 0.02)
        assert missed(problem, other, PAIR, "ridge") < 0.05 * np.ptp(other.column(OUTPUT))


def test_all_methods_agree_where_there_is_nothing_to_shrink():
    rng, time = np.random.default_rng(6), 10.0 * np.arange(400)
    u = rng.normal(size=(2, 400))
    y = 2.0 * u[0] - 1.0 * u[1] + 0.1 * rng.normal(size=400)
    log = Record(time, {"dT_a_K": u[0], "dT_b_K": u[1], "d_z_um": y})
    problem = problem_of(log, ("dT_a_K", "dT_b_K"), "d_z_um")
    fits = {method: problem.fit(problem.every, method) for method in METHOD_NAMES}
    for found in fits.values():
        assert found.rmse == pytest.approx(fits["least-squares"].rmse, rel=0.05)


def test_an_elastic_net_follows_columns_that_say_nearly_the_same():
    rng, time = np.random.default_rng(9), 10.0 * np.arange(400)
    common = 10 * np.sin(time / 600)
    u = common + 0.3 * rng.normal(size=(6, 400)).cumsum(axis=1) / 10
    y = 300 * (u[0] - u[3]) + 2 * u[1] + 0.1 * rng.normal(size=400)
    names = tuple(f"dT_{k}_K" for k in range(6))
    log = Record(time, {**dict(zip(names, u, strict=True)), "d_z_um": y})
    problem = problem_of(log, names, "d_z_um")
    found = {m: problem.fit(problem.every, m).rmse for m in ("least-squares", "elastic-net")}
    assert found["elastic-net"] < 1.1 * found["least-squares"]


def test_intervals_hold_the_truth():
    rng, inside = np.random.default_rng(12), 0
    for _ in range(60):
        time = np.arange(0.0, 4000.0, 20.0)
        u = np.cumsum(rng.normal(size=(2, 200)), axis=1)
        y = 2.0 * u[0] - 1.0 * u[1] + 0.5 * rng.normal(size=200)
        log = Record(time, {"dT_a_K": u[0], "dT_b_K": u[1], "d_z_um": y})
        problem = problem_of(log, ("dT_a_K", "dT_b_K"), "d_z_um")
        found = problem.fit(problem.every, "least-squares")
        inside += np.sum(np.abs(found.weights - [2.0, -1.0]) < 1.96 * found.deviations)
    assert 0.88 <= inside / 120 <= 1.0


def test_trials_hold_out_what_they_are_called():
    logs = [rod_log(periodic_heat(360, p), 10.0) for p in (60, 120)]
    problem = RegressionProblem(training_data(logs, PAIR, [OUTPUT]), Basis(PAIR))
    level = np.repeat([0.0, 1.0], 360)
    tried = {trial.name: trial for trial in trials(problem, level, ["a", "b"])}
    assert list(tried) == [
        "blocks",
        "time",
        "level",
        "condition",
        "other log",
        "a alone",
        "b alone",
    ]
    for trial in tried.values():
        for fitted, held in trial.splits:
            assert not np.any(fitted & held)
    assert np.sum([held for _, held in tried["blocks"].splits], axis=0).tolist() == [1] * 720
    errors = judged(problem, ("ridge",), tuple(tried.values()))["ridge"]
    spread = np.ptp(problem.measured)
    assert all(0 < error < 0.2 * spread for error in errors.values()), errors


def test_logs_of_one_name_and_logs_without_a_piece_are_told_apart():
    logs = [rod_log(periodic_heat(360, p), 10.0) for p in (60, 90, 120)]
    logs[0] = logs[0].with_columns({PAIR[0]: np.full(360, np.nan)})
    problem = RegressionProblem(training_data(logs, PAIR, [OUTPUT]), Basis(PAIR))
    found = [trial.name for trial in trials(problem, None, ["a", "b", "b"])]
    assert found[-2:] == ["b (2) alone", "b (3) alone"]


def test_warm_rows_are_known_where_terms_go_with_the_position(axis):
    names = ("dT_1_K", "dT_2_K", "dT_3_K")
    problem = problem_of(axis[0], names, "d_z_um", position="x_z_mm", degree=1)
    steep = problem.with_columns([c for c in problem.columns if c.power == 1])
    found = {trial.name: trial for trial in trials(steep)}["level"]
    whole = {trial.name: trial for trial in trials(problem)}["level"]
    assert np.array_equal(found.splits[0][1], whole.splits[0][1])


def rows(**columns):
    n = 60
    time, rng = 10.0 * np.arange(n), np.random.default_rng(0)
    own = {"T_a_degC": 20 + np.sin(time / 90), "d_z_um": rng.normal(size=n)}
    return Record(time, own | columns)


def test_bad_inputs_are_named():
    dead = rows(T_b_degC=np.full(60, 21.0))
    with pytest.raises(FitError, match="T_b_degC never moves in training"):
        problem_of(dead, ("T_a_degC", "T_b_degC"), "d_z_um")
    still = rows(x_z_mm=np.full(60, 100.0))
    with pytest.raises(FitError, match="x_z_mm has one value"):
        problem_of(still, ("T_a_degC",), "d_z_um", position="x_z_mm", degree=1)
    with pytest.raises(FitError, match="d_z_um is constant"):
        problem_of(rows(d_z_um=np.zeros(60)), ("T_a_degC",), "d_z_um")
    few = rows().rows(slice(0, 6))
    problem = problem_of(few, ("T_a_degC",), "d_z_um", (10.0, 20.0, 30.0, 40.0))
    with pytest.raises(FitError, match="6 rows do not determine 5 weights"):
        problem.fit(problem.every)
    with pytest.raises(FitError, match="are no operating conditions"):
        trials(problem_of(rows(), ("T_a_degC",), "d_z_um"), np.arange(60.0))
