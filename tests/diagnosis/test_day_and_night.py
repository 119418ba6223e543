"""A mirror in its dome is never at rest: each log begins on its way between day and night."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from machines.foreign import PLANTS
from machines.foreign.hide import calibration, hide
from machines.foreign.plant import as_logged

import thermaltool as tt

# Machines and nights that were seen while the rules were made.
SEEN = {1484662933: 1932712447, 2059816185: 5}


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "night"), SEEN.items(), ids=["start", "short"])
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
