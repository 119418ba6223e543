"""Machines that are never at rest: each log begins on its way between day and night."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from machines.foreign import PLANTS
from machines.foreign.hide import calibration, hide
from machines.foreign.plant import as_logged
from machines.shop import BASE, HEAD, HEAT, ROOM, shop_columns

import thermaltool as tt


# Machines and nights that were seen while the rules were made.
@pytest.mark.parametrize(
    ("seed", "night"),
    [
        pytest.param(1484662933, 1932712447, marks=pytest.mark.slow, id="start"),
        pytest.param(2059816185, 5, marks=pytest.mark.study, id="short"),
    ],
)
def test_a_start_comes_before_what_is_unknown(seed, night):
    plant = PLANTS["mirror"](np.random.default_rng(seed))
    roles = {"sensors": list(plant.sensors), "deflections": list(plant.deflections)}
    day = pd.DataFrame(as_logged(plant, calibration(plant, seed)))
    model = tt.calibrate(day, list(plant.inputs), warn=lambda line: None, **roles)
    noise = {name: plant.noise[name].sigma for name in plant.outputs}
    found = hide(plant, "", 0.0, night, noise)
    logs = [pd.DataFrame(as_logged(plant, each)) for each in (found.log, found.validation)]
    for log in (day, *logs):
        simulated = tt.simulate(model, log, warn=lambda line: None)
        for name in plant.sensors:
            assert simulated.agreements[name].rmse < 4 * noise[name]
    report = tt.diagnose(model, logs[0], validate=[logs[1]], warn=lambda line: None)
    assert report.diagnosis.causes == ()
    # How far the zero is off is not told beside decays that are as slow as the log is long.
    assert {each["mean"] for each in report.document()["residuals"].values()} == {None}


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "warmer"), [(11, 1.5), (12, -2.5), (13, 0.8)])
def test_a_machine_that_is_as_a_whole_warmer_than_the_shop_has_nothing_wrong(seed, warmer):
    known = pd.DataFrame(shop_columns(seed, 2.0))
    model = tt.calibrate(known, [HEAT, ROOM], sensors=[HEAD, BASE], warn=lambda line: None)
    log = pd.DataFrame(shop_columns(seed + 100, 3.0, warmer=warmer))
    other = pd.DataFrame(shop_columns(seed + 200, -2.0, warmer=-warmer))
    report = tt.diagnose(model, log, validate=[other], warn=lambda line: None)
    assert report.diagnosis.causes == ()
    assert report.diagnosis.verdict == "adequate"
    told = " ".join(report.document()["notes"])
    assert "does not begin at rest" in told
    assert "is wrong" not in told
