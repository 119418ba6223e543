"""What unseen logs show as well is no accident of the diagnosed one."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from machines.foreign import PLANTS
from machines.foreign.hide import calibration, hide
from machines.foreign.plant import as_logged

import thermaltool as tt


@pytest.fixture(scope="module")
def furnace():
    """A wall that conducts and stores otherwise when it is hot, and what a linear model has of it.

    Seen while the rule was made.
    """
    seed = 1291950927
    plant = PLANTS["slab"](np.random.default_rng(seed))
    roles = {"sensors": list(plant.sensors), "deflections": list(plant.deflections)}
    log = pd.DataFrame(as_logged(plant, calibration(plant, seed)))
    return plant, tt.calibrate(log, list(plant.inputs), warn=lambda line: None, **roles)


def diagnosed(furnace, kind, size, seed):
    plant, model = furnace
    level = {name: plant.noise[name].sigma for name in plant.outputs}
    found = hide(plant, kind, size, seed, level)
    logs = [pd.DataFrame(as_logged(plant, each)) for each in (found.log, found.validation)]
    report = tt.diagnose(model, logs[0], validate=[logs[1]], warn=lambda line: None)
    return [cause.effect for cause in report.diagnosis.causes], report.document()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_no_accident_is_told_of_what_every_day_shows(furnace, seed):
    effects, document = diagnosed(furnace, "", 0.0, seed)
    # What a linear model leaves of such a wall its calibration may leave open.
    assert document["verdict"] in ("not adequate", "cannot judge")
    assert all(effect.log is None for effect in effects)


@pytest.mark.slow
def test_an_accident_is_told_beside_a_sound_day(furnace):
    effects, _ = diagnosed(furnace, "sensor_offset_step", 30.0, 4)
    assert "sensor_offset_step" in {effect.name for effect in effects}
