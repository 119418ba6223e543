"""A slow course of one log is told only where it is most of what is wrong."""

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt

PERIOD, ROWS = 60.0, 600


def fan_runs(time):
    """Two spells of a fan that nobody logs."""
    return ((time > 9000) & (time < 16000)) | ((time > 24000) & (time < 30000))


def machine(seed, fan=False):
    """A log of three outputs; a running fan raises every rate of loss by 60 %."""
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(ROWS)
    heaters = [np.repeat(rng.choice(levels, ROWS // rows), rows) for levels, rows in
               (([0.0, 60.0, 120.0, 200.0], 20), ([0.0, 90.0, 150.0], 15))]  # fmt: skip
    rate = np.where(fan & fan_runs(time), 1.6, 1.0)

    def late(series, tau):
        kept, state, found = np.exp(-PERIOD * rate / tau), 0.0, []
        for k in range(ROWS):
            found.append(state)
            state = kept[k] * state + (1 - kept[k]) * series[k] / rate[k]
        return np.array(found)

    column, head = heaters
    noise = rng.standard_normal((3, ROWS))
    near = 0.03 * late(column, 300) + 0.05 * late(column, 2400) + 0.01 * late(head, 3000)
    far = 0.008 * late(column, 3600) + 0.06 * late(head, 500)
    bent = 0.1 * late(column, 900) + 0.15 * late(column, 3600) - 0.08 * late(head, 1500)
    return pd.DataFrame({
        "time_s": time, "Q_column_W": column, "Q_head_W": head,
        "T_column_degC": 20 + near + 0.02 * noise[0], "T_head_degC": 20 + far + 0.02 * noise[1],
        "d_z_um": bent + 0.3 * noise[2],
    })  # fmt: skip


@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(seed, marks=pytest.mark.slow if seed == 1 else pytest.mark.study)
        for seed in range(1, 6)
    ],
)
@pytest.mark.filterwarnings("ignore:.*outside the calibrated range")
def test_spells_of_a_fan_are_no_period(seed):
    model = tt.calibrate(
        machine(seed),
        ["Q_column_W", "Q_head_W"],
        sensors=["T_column_degC", "T_head_degC"],
        deflections=["d_z_um"],
    )
    causes = tt.diagnose(model, machine(100 + seed, fan=True)).diagnosis.causes
    assert "unknown" in [cause.effect.name for cause in causes]
    assert "periodic" not in [cause.effect.name for cause in causes]
