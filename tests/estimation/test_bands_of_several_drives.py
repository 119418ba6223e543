"""Standard errors that the parameters make of several heats are those of each heat's own size."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt

ROWS, DT, NOISE = 1200, 5.0, 0.02
# Gains [K/W] and time constants [s] of two heats to two sensors.
GAINS, LAGS = ((0.1, 0.02), (0.03, 0.08)), ((150.0, 500.0), (600.0, 200.0))


def log(seed):
    rng = np.random.default_rng(seed)
    heats = [100.0 * np.repeat(rng.integers(0, 2, ROWS // 60), 60) for _ in range(2)]
    columns = {"time_s": DT * np.arange(ROWS), "Q_a_W": heats[0], "Q_b_W": heats[1]}
    for k, name in enumerate(("dT_a_K", "dT_b_K")):
        rises = np.zeros(ROWS)
        for heat, gain, lag in zip(heats, GAINS[k], LAGS[k], strict=True):
            kept, x = np.exp(-DT / lag), 0.0
            for row in range(ROWS):
                rises[row] += x
                x = kept * x + (1 - kept) * gain * heat[row]
        columns[name] = rises + NOISE * rng.normal(size=ROWS)
    return pd.DataFrame(columns)


@pytest.mark.slow
def test_a_heat_that_rests_in_the_trial_of_another_is_not_unknown():
    fit = tt.calibrate(log(1), ["Q_a_W", "Q_b_W"], sensors=["dT_a_K", "dT_b_K"], warn=str)
    idle = log(2)
    idle[["dT_a_K", "dT_b_K"]] = NOISE * np.random.default_rng(3).normal(size=(ROWS, 2))
    design = tt.regularize(fit, tt.noise(idle, warn=str), form="kalman", warn=str)
    relative = design.model.estimator_design()["bands"]["relative"]
    assert all(0 < share < 0.1 for share in relative)
