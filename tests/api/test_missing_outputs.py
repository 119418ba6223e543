"""A reading that is missing from an output takes no drive with it."""

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt

pytestmark = pytest.mark.filterwarnings("ignore::thermaltool.errors.ThermalToolWarning")
NOISE = 0.1


@pytest.fixture
def log():
    """Two lags by Euler's rule, steps of power; no reading where two of the steps fall."""
    rng = np.random.default_rng()
    power = np.repeat(rng.uniform(0.2, 1, 30), 40)
    power[:20] = 0.0
    power[700:] = power[:-700]
    power[300:330], power[900:930] = 0.0, 0.0
    x, y = np.zeros(2), []
    for p in power:
        y.append(x.sum())
        for _ in range(50):
            x = x + (np.array([30.0, 10.0]) * p - x) / np.array([150.0, 40.0]) / 10
    d = np.array(y) + rng.normal(0, NOISE, len(y))
    d[300:345] = d[900:945] = np.nan
    return pd.DataFrame({"time_s": 5.0 * np.arange(len(y)), "Q_main_W": power, "d_z_um": d})


@pytest.mark.parametrize("structure", ["oe", "network", "subspace"])
def test_validation_is_what_simulate_gives(log, structure):
    form = {"orders": [(2, 2, 1)]} if structure == "oe" else {"modes": 2}
    found = tt.identify(log, ["Q_main_W"], ["d_z_um"], split=0.6, nan_policy="omit",
                        structure=structure, **form)  # fmt: skip
    held = found.fits[0].validation
    (rows,) = held.logs
    run = tt.simulate(found.model, log, initial=rows.initial, start=rows.start)
    assert held.carried_on.rmse == pytest.approx(run.agreements["d_z_um"].rmse, rel=1e-3)
    assert held.carried_on.rmse < 1.5 * NOISE


def test_a_calibration_reaches_the_noise(log):
    fit = tt.calibrate(log, ["Q_main_W"], deflections=["d_z_um"], nan_policy="omit")
    assert tt.simulate(fit, log).agreements["d_z_um"].rmse < 1.2 * NOISE


@pytest.mark.parametrize("channel", ["Q_main_W", "d_z_um"])
def test_without_a_policy_a_missing_value_is_refused(log, channel):
    whole = log.interpolate()
    whole.loc[50, channel] = np.nan
    with pytest.raises(tt.errors.LogError, match=f"{channel}: missing value"):
        tt.calibrate(whole, ["Q_main_W"], deflections=["d_z_um"])
    with pytest.raises(tt.errors.LogError, match=f"{channel}: missing value"):
        tt.identify(whole, ["Q_main_W"], ["d_z_um"])


@pytest.mark.slow
def test_a_dead_sensor_is_told_and_not_judged(log):
    whole = log.interpolate()
    whole["T_a_degC"] = 21.0 + whole["d_z_um"] / 4
    fit = tt.calibrate(whole, ["Q_main_W"], sensors=["T_a_degC"], deflections=["d_z_um"])
    dead, said = whole.assign(T_a_degC=np.nan), []
    found = tt.diagnose(fit, dead, nan_policy="omit", warn=said.append)
    assert any("T_a_degC: no values: it is not judged there" in line for line in said)
    assert list(found.document()["residuals"]) == ["d_z_um"]
    assert found.document()["not_judged"] == ["T_a_degC"]
    assert ", T_a_degC not judged" in str(found)
    # In another unit it is there: a model that has not seen it says nothing good of it.
    for one, other, why in (
        ("T_a_degC", "T_a_um", "is no temperature"),
        ("d_z_um", "d_z_mm", "of a map turns it"),
    ):
        with pytest.raises(tt.errors.LogError, match=f"no column {one} .*{other}.*{why}"):
            tt.diagnose(fit, whole.rename(columns={one: other}))
    with pytest.raises(tt.errors.LogError, match="T_a_degC: no values: nothing to judge"):
        tt.diagnose(fit, dead.drop(columns="d_z_um"), nan_policy="omit")
