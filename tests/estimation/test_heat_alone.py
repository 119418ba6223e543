"""Designs for the heat: models without a deflection, the criterion, drives that look alike."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from machines.wall import Wall, reentry
from reference import fraser1997 as fraser

import thermaltool as tt
from thermaltool.errors import FitError, ModelError
from thermaltool.estimation.design import DesignPlan, design_estimator
from thermaltool.estimation.design_model import DesignModel
from thermaltool.estimation.estimator import SensorNoise
from thermaltool.estimation.identifiability import identifiability_note
from thermaltool.estimation.regularization import best_choice, design_kalman, relative_heat_error
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.responses.conduction import Conduction
from thermaltool.responses.deflection import Deflection
from thermaltool.responses.rational import rational_by_name

DT = 0.5
PEAK = 3e4


def wall_log(wall, time, flux, generator):
    back = 20.0 + wall.back_face(flux, DT) + 0.15 * generator.normal(size=len(time))
    return pd.DataFrame({"time_s": time, "Q_front_W": flux, "T_back_degC": back})


@pytest.mark.slow
def test_the_flux_into_a_wall_from_its_other_face():
    wall, generator = Wall(), np.random.default_rng(31)
    slowest, *_, fastest = wall.time_constants()[:2]
    assert slowest > 600 > 10 > fastest > 9
    time = np.arange(0.0, 2400.0, DT)
    steps = np.where((time > 100) & (time < 1500), 2e4, 0.0)
    steps += np.where((time > 1700) & (time < 1900), PEAK, 0.0)
    model = tt.calibrate(
        wall_log(wall, time, steps, generator),
        "Q_front_W",
        sensors="T_back_degC",
        kinds={"T_back_degC": "rational2"},
        initial="rest",
    )
    idle = wall_log(wall, time, np.zeros(len(time)), generator)
    design = tt.regularize(model, tt.noise(idle, warn=str), form="kalman")
    assert all(design.frame["rmse_Q_front_W"] > 0)
    assert design.frame["lag_s"].min() > 0
    with pytest.raises(ModelError, match="there is no band of a deflection to draw"):
        design.draw()
    time = np.arange(0.0, 1300.0, DT)
    for _ in range(2):
        log = wall_log(wall, time, reentry(time, generator, PEAK), generator)
        found = tt.estimate(design, log, smooth=True, walk="likelihood", bands=True, warn=str)
        assert found.agreements["Q_front_W"].fit_percent >= 90
        error = np.abs(found.columns["Q_front_W"] - log["Q_front_W"].to_numpy())
        assert 0.88 < np.mean(error < 1.96 * found.columns["sigma_Q_front_W"]) < 0.99
        assert "nan" not in found.table()
        of_order_1 = tt.estimate(design, log, method="tikhonov1", warn=str)
        assert of_order_1.agreements["Q_front_W"].fit_percent >= 90
    thin = log.iloc[::4]
    walked, stepped = (
        tt.estimate(design, thin, smooth=True, walk=walk, bands=True, warn=str)
        for walk in ("likelihood", None)
    )
    fits = [each.agreements["Q_front_W"].fit_percent for each in (walked, stepped)]
    assert fits[1] > max(fits[0], 90)
    error, sigma = (
        np.abs(stepped.columns["Q_front_W"] - thin["Q_front_W"].to_numpy()),
        stepped.columns["sigma_Q_front_W"],
    )
    assert np.mean(error < 1.96 * sigma) > 0.9
    assert np.median(sigma) < 0.7 * np.median(walked.columns["sigma_Q_front_W"])


def frame_model():
    """One drive, a probe, a deflection that answers much more slowly."""
    probe, bend = Conduction(**fraser.MAIN), Deflection(**fraser.LINEAR_X)
    return Model(
        (Drive("Q_main_1", "zero", 0.0, (0.0, 1.0)),),
        (
            Output("dT_near_K", "sensor", 0.0, (0.0, 8.0)),
            Output("d_x_um", "deflection", "first", (0.0, 80.0)),
        ),
        (Term("Q_main_1", "dT_near_K", probe), Term("Q_main_1", "d_x_um", bend)),
        2.0,
    )


def frame():
    return DesignModel.of(frame_model(), {"dT_near_K": SensorNoise(0.05, 0.03, 600.0)}, 2.0)


def test_each_criterion_gets_the_best_of_its_own():
    machine = frame()
    found = {
        criterion: best_choice(design_kalman(machine, criterion=criterion)).prediction
        for criterion in ("heat", "deflection", "both")
    }
    heat = {name: relative_heat_error(prediction, machine) for name, prediction in found.items()}
    band = {name: prediction.band[0] for name, prediction in found.items()}
    assert heat["heat"] <= heat["both"] <= heat["deflection"]
    assert band["deflection"] <= band["both"] <= band["heat"]
    assert heat["heat"] < heat["deflection"]


def test_a_heat_that_is_hardly_known_is_told(monkeypatch):
    monkeypatch.setattr("thermaltool.estimation.design.LARGE_HEAT_ERROR", 1e-3)
    design = design_estimator(frame_model(), frame(), DesignPlan("kalman", walk=0.02))
    assert "--criterion heat or both" in design.notes[-1]


def machine_of(gains, sigma=0.01):
    """Two drives into as many sensors as `gains` has rows; gains and time constants differ."""
    lag, names = rational_by_name("rational1"), ("Q_a_W", "Q_b_W")
    sensors = ("T_a_degC", "T_b_degC")[: len(gains)]
    terms = [
        Term(drive, sensor, lag(K1=gain, tau1=20.0 * (1 + k + 2 * j), delay=0.0))
        for sensor, (j, row) in zip(sensors, enumerate(gains), strict=True)
        for k, (drive, gain) in enumerate(zip(names, row, strict=True))
    ]
    model = Model(
        tuple(Drive(name, "zero", 0.0, (0.0, 10.0)) for name in names),
        tuple(Output(name, "sensor", 20.0, (0.0, 30.0)) for name in sensors),
        tuple(terms),
        1.0,
    )
    return DesignModel.of(model, dict.fromkeys(sensors, SensorNoise(sigma)), 1.0)


def test_more_drives_than_sensors_are_named_with_what_is_not_seen():
    with pytest.raises(ModelError, match=r"2 drives \(Q_a_W, Q_b_W\) cannot be told apart by T_a"):
        identifiability_note(machine_of([[2.0, 1.0]]))
    with pytest.raises(ModelError, match=r"\+1 Q_b_W leaves the sensor.*--measured Q_b_W"):
        identifiability_note(machine_of([[2.0, 1.0]]))
    with pytest.raises(ModelError, match="cannot be told apart"):
        identifiability_note(machine_of([[2.0, 1.0], [4.0, 2.0]]))


def test_two_sources_and_two_sensors_that_answer_to_both():
    assert identifiability_note(machine_of([[2.0, 1.0], [1.0, 3.0]])) is None
    assert "hardly identifiable" in identifiability_note(machine_of([[2.0, 1.0], [2.0, 1.001]]))
    choice = best_choice(design_kalman(machine_of([[2.0, 1.0], [1.0, 3.0]])))
    assert max(choice.prediction.heat_rmse) < 5.0


def test_a_deflection_that_is_not_there_cannot_count():
    with pytest.raises(FitError, match="the model has no deflection; give heat"):
        design_kalman(machine_of([[2.0, 1.0], [1.0, 3.0]]), 0.1, criterion="both")
