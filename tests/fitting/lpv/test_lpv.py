"""Loss rate and gains by level, powers of inputs: on machines that share no code with the model."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from machines.stateful import cooled, levels, noisy, steam_heated, turning
from scipy.signal import lfilter

import thermaltool as tt
from thermaltool.api import write_model
from thermaltool.errors import FitError
from thermaltool.fitting.data import even_training_data
from thermaltool.fitting.identification import identify
from thermaltool.fitting.lpv.choose import _Room
from thermaltool.fitting.lpv.form import LpvForm
from thermaltool.fitting.lpv.identify import identify_lpv
from thermaltool.fitting.lpv.model import LpvOutput
from thermaltool.fitting.transfer.model import TransferModel
from thermaltool.fitting.transfer.plan import TransferPlan
from thermaltool.fitting.transfer.registry import structure_of
from thermaltool.model import characteristics
from thermaltool.record import Record
from thermaltool.report.identification import identification_table
from thermaltool.report.presentation import presented

SPEED = "n_main_rpm"


def frame_of(plant):
    period, columns, _ = plant
    rows = len(next(iter(columns.values())))
    return pd.DataFrame({"time_s": period * np.arange(rows), **columns})


def quiet(message):
    pass


@pytest.fixture(scope="module")
def fan():
    """A machine that a fan cools, identified as bilinear."""
    plant = cooled(np.random.default_rng(20261124), 900)
    found = tt.identify(frame_of(plant), ["Q_a_W", "u_fan_V"], ["T_a_degC"], structure="bilinear",
                        modes=1, split=0.6, warn=quiet)  # fmt: skip
    return plant, found


def test_a_bilinear_machine_is_found_with_its_loss(fan):
    _, found = fan
    (fit,) = found.fits
    model, form = fit.model, fit.model.form
    assert (form.channel, form.loss, len(form.levels)) == ("u_fan_V", True, 2)
    still, more = 1 / 900, (form.levels[1] - form.levels[0]) / 3000
    first = still + form.levels[0] / 3000
    tau, rate = model.time_constant_estimates()[0], model.rate_estimates()[1]
    assert tau.value == pytest.approx(1 / first, rel=0.05)
    assert rate.value == pytest.approx(more, rel=0.05)
    assert rate.high - rate.low < 0.1 * more
    # What it says of the gain at either level follows.
    for k, level in enumerate(form.levels):
        gain = model.level_gain(0, k)
        assert gain.value == pytest.approx(1 / 4000 / (still + level / 3000), rel=0.05)
    assert fit.validation.carried_on.fit_percent > 90
    assert "loss rate" in found.table()
    assert "faster at" in found.table()


def test_what_is_printed_is_what_simulate_gives(fan, tmp_path, thermaltool):
    plant, found = fan
    frame_of(plant).to_csv(tmp_path / "log.csv", index=False)
    write_model(found, tmp_path / "model.json", "identify")
    (held,) = found.fits[0].validation.logs
    got = thermaltool("simulate", tmp_path / "model.json", tmp_path / "log.csv", "--initial",
                      held.initial, "--start", held.start, "--json")  # fmt: skip
    assert got.code == 0, got.err
    fit = got.json["T_a_degC"]["fit_percent"]
    assert fit == pytest.approx(held.fit_percent, abs=0.01)


def test_row_by_row_it_is_the_same(fan):
    (period, columns, _), found = fan
    model = found.model
    record = Record(period * np.arange(300), {k: v[:300] for k, v in columns.items()})
    whole = model.simulate(record)["T_a_degC"]
    recursion = model.recursion()
    rows = [{name: float(v[k]) for name, v in columns.items()} for k in range(300)]
    got = [recursion.start(0.0, rows[0])["T_a_degC"]]
    got += [recursion.step(period * k, rows[k])["T_a_degC"] for k in range(1, 300)]
    np.testing.assert_allclose(got, whole, rtol=1e-6, atol=1e-6)


def planned(columns, inputs, output, period):
    """What `identify` does by default, the orders of the linear model given."""
    rows = len(columns[output])
    record = Record(period * np.arange(rows), columns)
    plan = TransferPlan(structure=structure_of("oe"), orders=((2, 2, 1),), linear=False, split=0.6)
    return identify([record], inputs, [output], plan)[0]


@pytest.mark.slow
def test_it_is_taken_where_the_machine_is_not_linear():
    period, columns, _ = steam_heated(np.random.default_rng(20261125), 1500)
    fit = planned(columns, ["x_flow_1"], "T_out_degC", period)
    linear = tt.identify(frame_of((period, columns, None)), ["x_flow_1"], ["T_out_degC"], split=0.6,
                         structure="oe", orders=[(2, 2, 1)], warn=quiet).fits[0]  # fmt: skip
    assert isinstance(fit.model, LpvOutput)
    assert fit.linearity.nonlinear
    assert "hence this model" in identification_table([fit])
    assert fit.validation.carried_on.fit_percent > linear.validation.carried_on.fit_percent + 4


def test_a_linear_machine_stays_linear():
    generator = np.random.default_rng(20261126)
    u = levels(generator, 900, -1, 1, 10, 60)
    clean = lfilter([0.1], [1, -0.9], np.append(0.0, u[:-1])) * 5
    columns = {"Q_a_W": u, "d_z_um": noisy(generator, clean, 0.05, 0.5)}
    assert isinstance(planned(columns, ["Q_a_W"], "d_z_um", 1.0).model, TransferModel)


@pytest.mark.slow
def test_by_default_orders_are_chosen_first():
    plant = steam_heated(np.random.default_rng(20261129), 1500)
    found = tt.identify(frame_of(plant), ["x_flow_1"], ["T_out_degC"], split=0.6, warn=quiet)
    assert found.document()["models"][0]["structure"] == "lpv"


def powered(seed, power=1.5, rows=1200):
    period, columns, _ = turning(np.random.default_rng(seed), rows, power)
    record = Record(period * np.arange(rows), columns)
    data = even_training_data([record], [SPEED], ["T_a_degC"]).from_rest()
    form = LpvForm(2, powers=(SPEED,), sizes=((SPEED, float(columns[SPEED].max())),), delays=(0,))
    return identify_lpv(data, form, (0.0,)).outputs[0]


def test_a_speed_enters_by_its_power():
    frame = frame_of(turning(np.random.default_rng(20261127), 1200))
    found = tt.identify(frame, [SPEED], ["T_a_degC"], structure="lpv", modes=2, warn=quiet)
    effect = next(e for e in found.model.effects if e.name == "drive_nonlinearity")
    assert effect.channel == SPEED
    assert effect.parameters["exponent"] == pytest.approx(1.5, abs=0.1)
    (e,) = found.fits[0].model.exponent_estimates().values()
    assert e.low < 1.5 < e.high


def loss_of(seed):
    period, columns, _ = cooled(np.random.default_rng(seed), 900)
    record = Record(period * np.arange(900), columns)
    fan = columns["u_fan_V"]
    levels = float(fan.min()), float(fan.max())
    form = LpvForm(1, "u_fan_V", levels, loss=True, delays=(0, 0))
    data = even_training_data([record], ["Q_a_W", "u_fan_V"], ["T_a_degC"])
    model = identify_lpv(data, form, (0.0, 0.0)).outputs[0]
    return model.rate_estimates()[1], (levels[1] - levels[0]) / 3000


@pytest.mark.slow
def test_intervals_of_the_loss_cover():
    held = [e.low < truth < e.high for e, truth in map(loss_of, range(40))]
    assert sum(held) >= 34


@pytest.mark.slow
def test_intervals_of_the_exponent_cover():
    held = []
    for seed in range(40):
        power = float(np.random.default_rng(seed).uniform(1.2, 2.2))
        (e,) = powered(seed, power).exponent_estimates().values()
        held.append(e.low < power < e.high)
    # 38 on average; fewer than 34 in one run of two hundred.
    assert sum(held) >= 34


def test_levels_of_both_signs():
    generator = np.random.default_rng(20261128)
    u = levels(generator, 1000, -1, 1, 10, 60)
    u[:20] = 0.0
    x = np.zeros(1000)
    for k in range(999):
        rate = 0.05 * (1 + 0.6 * u[k])
        x[k + 1] = x[k] * np.exp(-rate) + u[k] * -np.expm1(-rate)
    frame = pd.DataFrame({"time_s": np.arange(1000.0), "U_a_V": u,
                          "d_z_um": noisy(generator, x, 0.02, 0.0)})  # fmt: skip
    found = tt.identify(frame, ["U_a_V"], ["d_z_um"], structure="bilinear", modes=1, warn=quiet)
    model = found.fits[0].model
    assert model.form.loss
    slow, fast = model.form.levels
    assert model.time_constants[0] == pytest.approx(1 / (0.05 * (1 + 0.6 * slow)), rel=0.1)
    rate = model.rate_estimates()[1].value
    assert rate == pytest.approx(0.05 * 0.6 * (fast - slow), rel=0.1)
    np.testing.assert_allclose(
        found.model.simulate(Record(np.arange(1000.0), {"U_a_V": u}))["d_z_um"],
        model.response_to(Record(np.arange(1000.0), {"U_a_V": u})), atol=1e-9,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"orders": [(1, 1, 1)]}, "--orders: a parameter-varying model takes --modes"),
        ({"modes": 5}, "--modes: a parameter-varying model has up to 4"),
        ({"delay": 2.0}, "--delay goes with --structure network"),
        ({"real_poles": True}, "--real-poles"),
        ({"noise_orders": (1, 1)}, "--noise-orders"),
    ],
)
def test_options_of_other_structures_are_refused(options, message):
    frame = frame_of(turning(np.random.default_rng(1), 60))
    with pytest.raises(ValueError, match=message):
        tt.identify(frame, [SPEED], ["T_a_degC"], structure="lpv", **options)


def test_too_few_rows_are_told():
    frame = frame_of(turning(np.random.default_rng(1), 40)).iloc[10:34]
    with pytest.raises(FitError, match="rows do not carry"):
        tt.identify(frame, [SPEED], ["T_a_degC"], structure="lpv", modes=4, warn=quiet)


def test_levels_lie_where_the_log_stays():
    speed = np.repeat([0.0, 2000.0, 8000.0, 4000.0], 50)
    record = Record(np.arange(200.0), {SPEED: speed, "d_z_um": speed})
    data = even_training_data([record], [SPEED], ["d_z_um"])
    room = _Room(data, (20.0,), (2, 3, 5), None)
    assert room._levels(SPEED, 2) == (0.0, 8000.0)
    assert set(room._levels(SPEED, 5)) == {0.0, 2000.0, 4000.0, 8000.0}


def spindle(generator, speeds, rest=180, period=20.0):
    """A head that its spindle warms, and whose loss rises with its speed, in Euler steps."""
    speed, warm, found = np.repeat(np.array(speeds, float), rest), 0.0, []
    for n in speed:
        found.append(warm)
        for _ in range(10):
            warm += period / 10 * (0.06 * n - (8.0 + 0.0035 * n) * warm) / 20000.0
    time, noise = period * np.arange(len(speed)), generator.standard_normal((2, len(speed)))
    warm = np.array(found)
    return pd.DataFrame({"time_s": time, SPEED: speed, "T_head_degC": 22 + warm + 0.02 * noise[0],
                         "d_z_um": 2 + 0.9 * warm + 0.05 * noise[1]})  # fmt: skip


@pytest.mark.slow
def test_a_spindle_that_runs_fastest_late_in_its_log(tmp_path):
    generator = np.random.default_rng(20261125)
    # The rows that forms are first fitted to know nothing of 8000 rpm.
    log = spindle(generator, [0, 2000, 0, 4000, 2000, 4000, 0, 8000, 2000, 8000, 0])
    found = tt.identify(log, [SPEED], ["T_head_degC", "d_z_um"], structure="lpv", warn=quiet)
    assert found.fits[0].model.form.levels[-1] == 8000.0
    assert min(fit.training.fit_percent for fit in found.fits) > 98.0
    # A speed between the levels.
    other = spindle(generator, [0, 6000, 0, 6000, 3000, 0])
    run = tt.simulate(found, other, warn=quiet).agreements
    assert run["T_head_degC"].rmse < 0.03
    assert run["d_z_um"].rmse_zero_free < 0.07
    still, fast = (row for row in tt.present(found).frame.reset_index().to_dict("records")
                   if row["output"] == "T_head_degC")  # fmt: skip
    assert (still["gain"], still["slowest_s"]) == pytest.approx((0.06 / 8, 20000 / 8), rel=0.02)
    assert (fast["gain"], fast["slowest_s"]) == pytest.approx((0.06 / 36, 20000 / 36), rel=0.02)
    assert "at 8000 rpm of n_main_rpm" in str(tt.present(found))


def test_shares_count_from_what_the_channel_counts_from():
    form = LpvForm(1, SPEED, (20.0, 120.0), gain=True, delays=(0,), rest=20.0)
    assert form.bands()[1].levels == (0.0, 100.0)


def test_present_tells_gains_with_the_loss_rate_at_the_level(fan):
    model = fan[1].model
    term = model.terms[0]
    plain, faster = characteristics(term), characteristics(term, 1e-3)
    tau = plain.time_constants[0].value
    assert faster.time_constants[0].value == pytest.approx(tau / (1 + 1e-3 * tau))
    assert faster.gain.value == pytest.approx(plain.gain.value / (1 + 1e-3 * tau))
    assert "convection_state)" in presented(model)
