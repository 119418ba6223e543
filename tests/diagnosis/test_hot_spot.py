"""A hot place that radiates, beside a machine that does not."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt

PERIOD, ROWS, COLD = 20.0, 1400, 293.15
LOSS = 1.5  # [W/K] of the hot place at rest, beside its linear loss


def machine(seed: int, loss: float) -> pd.DataFrame:
    """A heated mass, a far one behind it, and what they bend; small explicit steps."""
    rng = np.random.default_rng([14, seed])
    heat = np.repeat(rng.choice([0.0, 120.0, 300.0, 500.0], ROWS // 70), 70)
    steps, hot, far = 10, COLD, COLD
    rows = []
    for q in heat:
        rows.append((hot, far))
        for _ in range(steps):
            radiated = loss * ((hot**4 - COLD**4) / (4 * COLD**3) - (hot - COLD))
            flow = 3.0 * (hot - far)
            hot += PERIOD / steps / 2500 * (q - 4.0 * (hot - COLD) - flow - radiated)
            far += PERIOD / steps / 9000 * (flow - 5.0 * (far - COLD))
    hots, fars = np.array(rows).T - 273.15
    bend = 0.8 * (hots - hots[0]) + 1.5 * (fars - fars[0])
    return pd.DataFrame({
        "time_s": PERIOD * np.arange(ROWS),
        "Q_heater_W": heat,
        "T_hot_degC": hots + 0.05 * rng.standard_normal(ROWS),
        "T_far_degC": fars + 0.05 * rng.standard_normal(ROWS),
        "d_z_um": bend + 0.3 * rng.standard_normal(ROWS),
    })  # fmt: skip


@pytest.mark.parametrize("seed", [2, 3])
@pytest.mark.slow
def test_a_place_that_radiates_where_a_drive_heats_it(seed: int) -> None:
    known = tt.calibrate(
        machine(1, 0.0), ["Q_heater_W"], sensors=["T_hot_degC", "T_far_degC"],
        deflections=["d_z_um"],
    ).model  # fmt: skip
    found = tt.diagnose(known, machine(seed, LOSS), validate=[machine(seed + 10, LOSS)])
    cause = found.diagnosis.causes[0]
    assert (cause.effect.name, cause.effect.channel) == ("radiation", "Q_heater_W")
    assert cause.effect.partner == "T_hot_degC"
    assert cause.effect.parameters["loss"] == pytest.approx(LOSS, rel=0.1)
    assert "T_hot_degC" in cause.action
    last = found.diagnosis.written[-1].step
    noise = {"d_z_um": 0.3, "T_hot_degC": 0.05, "T_far_degC": 0.05}
    for step in found.diagnosis.written:
        if step.step == last:
            assert step.agreement.rmse_zero_free < 1.5 * noise[step.output]
