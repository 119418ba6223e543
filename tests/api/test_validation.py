"""What `identify` says of validation data is what `simulate` makes of the model."""

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

import thermaltool as tt

STRUCTURES = {
    "oe": {"orders": [(2, 2, 1)]},
    "arx": {"structure": "arx"},
    "network": {"structure": "network", "modes": 2},
    "subspace": {"structure": "subspace", "modes": 2},
}


pytestmark = pytest.mark.filterwarnings("ignore::thermaltool.errors.ThermalToolWarning")


def machine(seed, warm=0.0, zero=0.0, moves=1.0):
    """Two lags by Euler's rule on a fine clock, random steps of power, noise."""
    rng = np.random.default_rng(seed)
    power = np.repeat(rng.uniform(0, 1, 30), 40)
    power[:20] = 0.0
    x, y = np.array([warm, warm / 2]), []
    for p in power:
        y.append(x.sum())
        for _ in range(10):
            x = x + (np.array([30.0, 10.0]) * p * moves - x) / np.array([150.0, 40.0]) / 10 * 5
    noise = rng.normal(0, 0.1, len(y))
    time = 5.0 * np.arange(len(y))
    return pd.DataFrame({"time_s": time, "Q_main_W": power, "d_z_um": np.array(y) + noise + zero})


@pytest.mark.parametrize("warm", [0.0, 25.0])
@pytest.mark.parametrize("structure", STRUCTURES)
def test_validation_behind_a_split_is_what_simulate_gives(structure, warm):
    log = machine(1, warm)
    found = tt.identify(log, ["Q_main_W"], ["d_z_um"], split=0.6, **STRUCTURES[structure])
    held = found.fits[0].validation
    (rows,) = held.logs
    assert structure == "arx" or rows.initial == ("free" if warm else "rest")
    run = tt.simulate(found.model, log, initial=rows.initial, start=rows.start)
    fit = run.agreements["d_z_um"].fit_percent
    assert held.carried_on.fit_percent == pytest.approx(fit, abs=0.01)
    assert fit > 80


@pytest.mark.parametrize("structure", STRUCTURES)
def test_rows_beside_a_span_drive_what_is_simulated(structure):
    log, span = machine(6, warm=25.0), {"start": 1500.0, "stop": 4500.0}
    found = tt.identify(log, ["Q_main_W"], ["d_z_um"], split=0.6, **span, **STRUCTURES[structure])
    (rows,) = found.fits[0].validation.logs
    run = tt.simulate(found.model, log, initial=rows.initial, start=rows.start, stop=rows.stop)
    agreed = run.agreements["d_z_um"]
    assert found.fits[0].validation.carried_on.rmse == pytest.approx(agreed.rmse, rel=1e-3)
    assert agreed.rows == 240


def test_a_span_of_another_log_is_what_simulate_gives():
    span, other = {"start": 2000.0, "stop": 5000.0}, machine(8)
    found = tt.identify(machine(7), ["Q_main_W"], ["d_z_um"], orders=[(2, 2, 1)], validate=other,
                        **span)  # fmt: skip
    agreed = tt.simulate(found.model, other, **span).agreements["d_z_um"]
    assert found.fits[0].validation.carried_on.rmse == pytest.approx(agreed.rmse, rel=1e-3)
    assert found.fits[0].validation.carried_on.fit_percent > 80


def test_each_log_begins_in_a_state_of_its_own():
    logs = [machine(11), machine(12, warm=30.0)]
    found = tt.identify(logs, ["Q_main_W"], ["d_z_um"], orders=[(2, 2, 1)], split=0.6)
    held = found.fits[0].validation
    assert [each.initial for each in held.logs] == ["rest", "free"]


def test_validation_on_another_log_is_what_simulate_gives():
    other = machine(3, zero=400.0)
    found = tt.identify(machine(2), ["Q_main_W"], ["d_z_um"], orders=[(2, 2, 1)], validate=other)
    fit = tt.simulate(found.model, other).agreements["d_z_um"].fit_percent
    assert found.fits[0].validation.carried_on.fit_percent == pytest.approx(fit, abs=0.01)


@pytest.mark.slow
def test_zeros_of_several_logs_explain_nothing():
    """The power moves nothing; the second log counts from elsewhere."""
    rng = np.random.default_rng()
    logs = [machine(k, zero=5000.0 * k, moves=0.0) for k in range(2)]
    for log in logs:
        log["d_z_um"] += np.cumsum(rng.normal(0, 1, len(log)))
    found = tt.identify(logs, ["Q_main_W"], ["d_z_um"], orders=[(1, 1, 1)], split=0.6)
    fit = found.fits[0]
    assert fit.training.fit_percent < 90
    assert fit.validation.carried_on.fit_percent < 90
    single = []
    for log, rows in zip(logs, fit.validation.logs, strict=True):
        run = tt.simulate(found.model, log, initial=rows.initial, start=rows.start)
        single.append(run.agreements["d_z_um"].fit_percent)
        assert rows.fit_percent == pytest.approx(single[-1], abs=0.01)
    assert fit.validation.least_fit == pytest.approx(min(single), abs=0.01)
    assert found.predicts == (min(single) > 0)
    # Beside a fit below 0 % no improvement is told.
    assert ("improvement" in found.table()) == found.predicts


@pytest.mark.slow
def test_what_can_be_written_is_chosen():
    """Two plain lags in noise: the best orders by error alone often have a pole below zero."""
    for seed in range(3):
        log = machine(10 + seed)
        log["d_z_um"] += np.random.default_rng(seed).normal(0, 3, len(log))
        assert tt.identify(log, ["Q_main_W"], ["d_z_um"]).model.terms


@pytest.mark.slow
def test_logs_of_one_name_one_of_which_has_no_piece():
    sparse = machine(5).iloc[::2]
    found = tt.identify([machine(4), sparse], ["Q_main_W"], ["d_z_um"], structure="network",
                        modes=1, max_gap=7.0, split=0.6)  # fmt: skip
    assert found.fits[0].validation is not None


@pytest.mark.parametrize("structure", ["oe", "bj"])
def test_a_state_that_is_estimated_is_no_worse_than_the_run(structure):
    """In noise that wanders: the zero that simulate takes is not that of the fit."""
    log = machine(4)
    rng = np.random.default_rng(1795570700)
    wander = lfilter([1.0], [1, -0.98], rng.normal(0, 0.5, len(log)))
    log["d_z_um"] += wander
    found = tt.identify(log, "Q_main_W", "d_z_um", split=0.6, structure=structure,
                        orders=[(1, 1, 1)])  # fmt: skip
    held = found.fits[0].validation
    assert held.estimated_state.fit_percent >= held.carried_on.fit_percent - 0.01


def test_readings_in_bursts_are_validated_one_by_one():
    """The fit has a row for each burst, simulate one for each reading."""
    rng = np.random.default_rng(20261126)
    time = (60.0 * np.arange(300)[:, None] + [0.0, 3.0, 6.0]).ravel()
    levels = np.repeat(rng.choice([20.0, 60.0], 30), 10)
    bed = np.repeat(levels, 3) + 0.5 * rng.standard_normal(900)
    pole, y = np.exp(-60.0 / 900.0), np.zeros(300)
    for k in range(1, 300):
        y[k] = pole * y[k - 1] + 0.4 * (1 - pole) * (levels[k - 1] - levels[0])
    frame = np.repeat(20.0 + y, 3) + 0.1 * rng.standard_normal(900)
    log = pd.DataFrame({"time_s": time, "T_bed_degC": bed, "T_frame_degC": frame})
    found = tt.identify(log, "T_bed_degC", "T_frame_degC", structure="subspace", modes=1,
                        split=0.6, warn=lambda message: None)  # fmt: skip
    fit = found.fits[0]
    assert fit.data.rows < 300
    (held,) = fit.validation.logs
    run = tt.simulate(found.model, log, initial=held.initial, start=held.start)
    printed = fit.validation.carried_on.fit_percent
    assert run.agreements["T_frame_degC"].fit_percent == pytest.approx(printed, abs=1e-6)


@pytest.mark.parametrize(
    "options", [{"orders": [(1, 1, 1)]}, STRUCTURES["network"], STRUCTURES["subspace"]]
)
def test_outputs_tell_together_when_a_command_has_changed_in_a_pause(options):
    """The motor shows it, the displacement behind it hardly: one instant holds for both."""
    log = machine(21)
    rng = np.random.default_rng(20261129)
    pole = np.exp(-5.0 / 30.0)
    motor = lfilter([0.0, 20.0 * (1 - pole)], [1.0, -pole], log["Q_main_W"])
    log["T_motor_degC"] = 25.0 + motor + rng.normal(0, 0.1, len(log))
    # 280 s around a step of the command, 155 s before the rows that are held out.
    log = log.drop(index=range(690, 745))
    log["d_z_um"] += rng.normal(0, 3.0, len(log))
    outputs = ["T_motor_degC", "d_z_um"]
    found = tt.identify(log, "Q_main_W", outputs, split=0.63, warn=lambda message: None,
                        **options)  # fmt: skip
    for fit in found.fits:
        (held,) = fit.validation.logs
        run = tt.simulate(found.model, log, initial=held.initial, start=held.start)
        printed = fit.validation.carried_on.fit_percent
        assert run.agreements[fit.model.target].fit_percent == pytest.approx(printed, abs=1e-6)
