"""A fan at one place of a machine, logged or not, is found there; it is no heat below zero."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from machines.cooled_chain import PLACES, CooledChain

import thermaltool as tt


def quiet(message):
    """Nothing is told."""


def calibrated(machine, seed):
    return tt.calibrate(
        pd.DataFrame(machine.log(seed, rows=1800)),
        ["P_motor_W", "T_room_degC"],
        sensors=[f"T_{place}_degC" for place in PLACES],
        deflections=["d_tool_um"],
        warn=quiet,
    )


@pytest.mark.parametrize(
    ("place", "logged"),
    [
        pytest.param(0, True, marks=pytest.mark.slow),
        pytest.param(1, False, marks=pytest.mark.slow),
        pytest.param(2, True, marks=pytest.mark.slow),
        pytest.param(0, False, marks=pytest.mark.study),
        pytest.param(1, True, marks=pytest.mark.study),
        pytest.param(2, False, marks=pytest.mark.study),
    ],
)
def test_a_fan_at_one_place_is_named_there(place, logged):
    machine = CooledChain.drawn(4417 + place)
    sensor = f"T_{PLACES[place]}_degC"
    model = calibrated(machine, 60 + place)
    fan = {"place": place, "factor": 2.2}
    if not logged:
        warm = np.quantile(machine.log(60 + place)[sensor], 0.98) - 20.0
        fan["thermostat"] = 20.0 + 0.6 * warm, 20.0 + 0.5 * warm
    logs = [pd.DataFrame(machine.log(seed, **fan)) for seed in (70 + place, 80 + place)]
    diagnosis = tt.diagnose(model, logs[0], validate=[logs[1]], warn=quiet).diagnosis
    cause = diagnosis.causes[0].effect
    if logged:
        assert (cause.name, cause.channel) == ("convection_state", "x_fan_1")
    else:
        assert (cause.name, cause.channel) == ("switching_loss", sensor)
        assert cause.parameters["on"] == pytest.approx(fan["thermostat"][0], abs=0.05 * warm)
    assert cause.partner == sensor
    assert cause.air == "T_room_degC"
