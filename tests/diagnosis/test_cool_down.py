"""A cool-down that a model of a warm-up misses: the cause is named, and where it is."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from machines.turning_spindle import PLACES, TurningSpindle, spells, warm_and_cool, warm_up

import thermaltool as tt

# The first of the machines that benchmarks/cool_down.py drew.
SEED = 1462659974


def quiet(message):
    """Nothing is told."""


@pytest.mark.parametrize(
    ("kind", "truth"),
    [
        pytest.param(
            "speed",
            ("convection_state", "n_spindle_rpm", "T_bearing_degC"),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "fan", ("convection_state", "n_spindle_rpm", "T_motor_degC"), marks=pytest.mark.study
        ),
        pytest.param("pump", ("second_source", "x_pump_1", None), marks=pytest.mark.slow),
    ],
)
def test_a_cool_down_says_what_differs_from_the_warm_up(kind, truth):
    machine, rng = TurningSpindle.drawn(SEED), np.random.default_rng([SEED, 1])
    cooled = None if kind == "pump" else kind
    sensors = [f"T_{place}_degC" for place in PLACES]
    train = pd.DataFrame(machine.log(SEED + 1, warm_up(5.0), cooled))
    model = tt.calibrate(train, "n_spindle_rpm", sensors=sensors, deflections="d_z_um", warn=quiet)
    logs = []
    for k in (2, 3):
        speeds = warm_and_cool(rng, 9.0)
        pump = spells(rng, len(speeds)) if kind == "pump" else None
        logs.append(pd.DataFrame(machine.log(SEED + k, speeds, cooled, pump)))
    cause = tt.diagnose(model, logs[0], validate=[logs[1]], warn=quiet).diagnosis.causes[0].effect
    assert (cause.name, cause.channel, cause.partner) == truth
