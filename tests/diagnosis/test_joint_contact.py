"""A joint is named on the machine that has one, and not on machines that depart otherwise."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt
from thermaltool.plants import build

STEP = 30.0  # [s]
STAIRS = np.repeat([0.5, 1.0, 1.5, 2.0, 1.0, 0.25], 120)
NOISE = {"dT_main_K": 0.02, "T_joint1_degC": 0.02, "d_x_um": 0.2, "d_y_um": 0.2}
# Of two lags each in `NOISE`'s order: gain, time constant [s].
LAGS = (
    ((5.0, 150.0), (0.0, 1.0)),
    ((6.0, 900.0), (3.0, 2500.0)),
    ((-50.0, 1200.0), (-45.0, 4000.0)),
    ((160.0, 2200.0), (0.0, 1.0)),
)
SHORT = 1.0  # steps of integration [s]

pytestmark = pytest.mark.slow


def table(heat, outputs, fan, seed):
    rng = np.random.default_rng(seed)
    read = {name: outputs[name] + s * rng.normal(size=len(heat)) for name, s in NOISE.items()}
    time = STEP * np.arange(len(heat))
    return pd.DataFrame({"time_s": time, "Q_main_1": heat, "n_fan_rpm": 1000 * fan, **read})


def joint(heat, seed):
    """The knee mill; a fan beside it does nothing."""
    outputs = build("knee-mill").simulate(heat, np.full(len(heat), 20.0), STEP)
    return table(heat, outputs, np.arange(len(heat)) // 120 % 2, seed)


def lags(heat, seed, exponent=1.0, cooling=0.0):
    """Sums of lags of a power of the heat; with the fan on they decay faster [1/s]."""
    fan = np.arange(len(heat)) // 120 % 2
    gain, tau = np.array(LAGS)[..., 0], np.array(LAGS)[..., 1]
    x, rows = np.zeros(gain.shape), []
    for level, on in zip(heat, fan, strict=True):
        rows.append(x.sum(axis=1))
        for _ in range(round(STEP / SHORT)):
            x = x + SHORT * ((gain * level**exponent - x) / tau - cooling * on * x)
    outputs = dict(zip(NOISE, np.array(rows).T, strict=True))
    outputs["T_joint1_degC"] = outputs["T_joint1_degC"] + 20.0
    return table(heat, outputs, fan, seed)


def first_cause(machine, **fault):
    calibration = machine(np.ones(1201), 1)
    fit = tt.calibrate(
        calibration,
        "Q_main_1",
        sensors="dT_main_K",
        deflections=["T_joint1_degC", "d_x_um", "d_y_um"],
        warn=lambda message: None,
    )
    found = tt.diagnose(fit, machine(STAIRS, 2, **fault), warn=lambda message: None)
    return [cause.effect for cause in found.diagnosis.causes]


def test_the_joint_of_the_knee_mill_is_named_first():
    first = first_cause(joint)[0]
    assert first.name == "joint_contact"
    assert first.channel == "dT_main_K"
    assert {"forces[d_x_um]", "forces[d_y_um]", "heat[T_joint1_degC]"} <= set(first.parameters)


@pytest.mark.parametrize(
    ("fault", "name"),
    [({"exponent": 1.15}, "drive_nonlinearity"), ({"cooling": 1e-4}, "convection_state")],
)
def test_another_departure_is_no_joint(fault, name):
    causes = [each.name for each in first_cause(lags, **fault)]
    assert causes[0] == name
    assert "joint_contact" not in causes
