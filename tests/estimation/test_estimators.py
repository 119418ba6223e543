"""Both forms of the estimator: gains, noise, steady state, batch and stream."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import fraser1997 as fraser
from scipy.linalg import solve_discrete_are

import thermaltool as tt
from thermaltool.errors import FitError, ModelError
from thermaltool.estimation.design_model import DesignModel
from thermaltool.estimation.estimator import (
    KalmanEstimator,
    SensorNoise,
    load_estimator,
)
from thermaltool.estimation.kernel import Regularization, invert_modes
from thermaltool.estimation.regularization import (
    best_choice,
    design_kalman,
    design_kernel,
    predict,
)
from thermaltool.estimation.state_space import predicted_covariance
from thermaltool.model import Drive, Model, Output, Term, dumps, loads, only_sensors
from thermaltool.responses.conduction import Conduction
from thermaltool.responses.deflection import Deflection

DT = 2.0
NEAR, FAR = Conduction(**fraser.MAIN), Conduction(**fraser.PAIR)
BEND = Deflection(**fraser.LINEAR_X)
NOISE = {"dT_near_K": SensorNoise(0.02, 0.03, 600.0), "dT_far_K": SensorNoise(0.03)}
# Stable, and without ringing, for the near probe.
SMOOTH = {"A": 0.02, "B": 2e-4, "c": 0.05}
PINNED = {**SMOOTH, "cutoff_Hz": 0.05, "delay_s": 5.0}


def document(sensors=("dT_near_K", "dT_far_K")):
    responses = {"dT_near_K": NEAR, "dT_far_K": FAR}
    return Model(
        (Drive("Q_main_1", "zero", 0.0, (0.0, 1.0)),),
        (
            *(Output(name, "sensor", 0.0, (0.0, 8.0)) for name in sensors),
            Output("d_x_um", "deflection", "first", (0.0, 80.0)),
        ),
        (
            *(Term("Q_main_1", name, responses[name]) for name in sensors),
            Term("Q_main_1", "d_x_um", BEND),
        ),
        DT,
    )


def machine(*sensors):
    return DesignModel.of(document(sensors or ("dT_near_K", "dT_far_K")), NOISE, DT)


@pytest.fixture(scope="module")
def estimators():
    near = machine("dT_near_K")
    return {
        "kalman": near.kalman([0.02]),
        "two sensors": machine().kalman([0.02]),
        "kernel": near.kernel(Regularization(**SMOOTH), 0.05, 5.0),
    }


forms = pytest.mark.parametrize("form", ["kalman", "two sensors", "kernel"])


def stream(estimator, time, readings):
    """One line after the other, as a stream would."""
    x, out = None, []
    for k in range(len(time)):
        if k:
            recursion = estimator.recursion(time[k] - time[k - 1])
            x = np.zeros(len(recursion.F)) if x is None else x
            x = recursion.F @ x + recursion.G0 @ readings[k - 1] + recursion.G1 @ readings[k]
            out.append(recursion.C @ x)
        else:
            out.append(np.zeros(len(estimator.estimates)))
    return np.array(out)


@forms
@settings(max_examples=15, deadline=None)
@given(
    periods=st.lists(st.sampled_from([0.5, 1.0, 2.0, 2.0, 2.0, 37.5]), min_size=1, max_size=150),
    seed=st.integers(0, 99),
)
def test_batch_is_stream(estimators, form, periods, seed):
    estimator = estimators[form]
    time = np.cumsum([0.0, *periods])
    readings = np.random.default_rng(seed).normal(3, 1, (len(time), len(estimator.sensors)))
    batch = estimator.run(time, readings)
    expected = stream(estimator, time, readings)
    np.testing.assert_allclose(batch, expected, rtol=1e-8, atol=1e-9 * np.max(np.abs(expected)))


@forms
def test_document_round_trip(estimators, form):
    estimator = estimators[form]
    again = load_estimator(json.loads(json.dumps(estimator.document())))
    assert again.document() == estimator.document()
    time = DT * np.arange(300)
    readings = np.random.default_rng(1).standard_normal((300, len(estimator.sensors)))
    np.testing.assert_array_equal(again.run(time, readings), estimator.run(time, readings))


@forms
def test_steady_state_is_unbiased(estimators, form):
    estimator = estimators[form]
    gains = {"dT_near_K": NEAR.dc_gain(), "dT_far_K": FAR.dc_gain()}
    reading = 0.7 * np.array([gains[name] for name in estimator.sensors])
    estimates = estimator.run(DT * np.arange(60_000), np.tile(reading, (60_000, 1)))
    expected = [0.7, 0.7 * BEND.dc_gain()]
    # The drift that a sensor may have takes a share of a constant reading, for a while.
    np.testing.assert_allclose(estimates[-1], expected, rtol=1e-4)


@forms
def test_a_machine_that_has_settled_stays_where_it_is(estimators, form):
    estimator = estimators[form]
    gains = {"dT_near_K": NEAR.dc_gain(), "dT_far_K": FAR.dc_gain()}
    reading = 0.7 * np.array([gains[name] for name in estimator.sensors])
    estimates = estimator.run(DT * np.arange(500), np.tile(reading, (500, 1)), True)
    expected = np.tile([0.7, 0.7 * BEND.dc_gain()], (500, 1))
    np.testing.assert_allclose(estimates, expected, rtol=1e-5)


@forms
def test_a_step_is_followed(estimators, form):
    estimator = estimators[form]
    time = DT * np.arange(4000)
    by_name = {"dT_near_K": NEAR, "dT_far_K": FAR}
    readings = np.column_stack([by_name[name].step(time) for name in estimator.sensors])
    estimates = estimator.run(time, readings)
    assert np.max(np.abs(estimates[1500:, 0] - 1)) < 0.01
    assert np.max(np.abs(estimates[:, 1] - BEND.step(time))) < 0.05 * BEND.dc_gain()


def test_kernel_estimator_has_unit_gain(estimators):
    estimator = estimators["kernel"]
    assert estimator.inverse.dc_gain() * NEAR.dc_gain() == pytest.approx(1, abs=1e-6)
    damping = invert_modes(NEAR.modes(DT), Regularization(**SMOOTH)).damping
    assert damping > 0.3


def test_kernel_estimator_carries_the_deflection_over_its_delay():
    """With heat that has settled, `delay` makes no difference; with a ramp it leads by `delay`."""
    near, shape = machine("dT_near_K"), Regularization(**SMOOTH)
    time = DT * np.arange(3000)
    runs = [
        near.kernel(shape, 0.05, delay).run(time, 1e-3 * time[:, None]) for delay in (0.0, 40.0)
    ]
    np.testing.assert_array_equal(runs[0][:, 0], runs[1][:, 0])
    # δ(t) + what the heat known now adds in 40 s: from the source's response to a held input.
    lead = (runs[1] - runs[0])[-1, 1]
    ahead = BEND.modes(DT).discretize(40.0)
    heat = runs[0][:, 0]
    states = BEND.modes(DT).discretize(DT)
    x = np.zeros(len(states.F))
    for value in heat[1:]:
        x = states.F @ x + states.G0[:, 0] * value
    expected = ahead.C @ (ahead.F @ x + ahead.G0[:, 0] * heat[-1]) - states.C @ x
    assert lead == pytest.approx(expected[0], rel=1e-6)


# ---------------------------------------------------------------- the Kalman gain


def test_prediction_covariance_is_scipys():
    rng = np.random.default_rng(0)
    for n, p in ((1, 1), (4, 2), (9, 3)):
        F = rng.standard_normal((n, n))
        F *= 0.98 / np.max(np.abs(np.linalg.eigvals(F)))
        H, L = rng.standard_normal((p, n)), rng.standard_normal((n, n))
        Q, R = L @ L.T, np.diag(rng.uniform(0.1, 2, p))
        expected = solve_discrete_are(F.T, H.T, Q, R)
        np.testing.assert_allclose(predicted_covariance(F, H, Q, R), expected, rtol=1e-8)


def test_a_state_that_nobody_sees_has_no_covariance():
    with pytest.raises(FitError, match="no steady solution"):
        predicted_covariance(np.diag([1.05, 0.5]), np.array([[0.0, 1.0]]), np.eye(2), np.eye(1))


def test_gain_is_the_solution_of_the_riccati_equation():
    """The whole filter, from its textbook equations and scipy's solver, for a rational machine."""
    sensed = ((0, 0, BEND.modes(DT)),)
    noise = SensorNoise(0.5, 0.8, 400.0)
    estimator = KalmanEstimator(("d_a_um",), ("Q_main_1",), (), sensed, (), (0.03,), (noise,))
    dt = float(np.exp(70 * 0.01))  # on the grid of sample lengths for which gains are solved
    part = BEND.modes(DT).discretize(dt)
    n = len(part.F)
    F = np.zeros((n + 2, n + 2))
    F[:n, :n], F[:n, n], F[n, n] = part.F, part.G0[:, 0], 1
    F[n + 1, n + 1] = np.exp(-dt / 400)
    H = np.concatenate([part.C[0], [0, 1]])[None, :]
    Q = np.zeros((n + 2, n + 2))
    Q[n, n] = 0.03**2 * dt
    Q[n + 1, n + 1] = 0.8**2 * (1 - np.exp(-2 * dt / 400))
    P = solve_discrete_are(F.T, H.T, Q, np.array([[0.25]]))
    gain = P @ H.T / (H @ P @ H.T + 0.25)
    got = estimator.recursion(dt)
    np.testing.assert_allclose(got.G1, gain, rtol=1e-4, atol=1e-6 * np.max(np.abs(gain)))
    np.testing.assert_allclose(got.F, (np.eye(n + 2) - gain @ H) @ F, atol=1e-5)


# ---------------------------------------------------------------- predictions


@forms
def test_predicted_noise_is_that_of_a_simulation(estimators, form):
    estimator = estimators[form]
    trial = machine() if form == "two sensors" else machine("dT_near_K")
    rng = np.random.default_rng(12)
    n = 120_000
    readings = np.empty((n, len(trial.noise)))
    for k, noise in enumerate(trial.noise):
        stays = np.exp(-DT / noise.drift_time)
        kicks = noise.drift * np.sqrt(1 - stays**2) * rng.standard_normal(n)
        drift = np.empty(n)
        drift[0] = noise.drift * rng.standard_normal()
        for i in range(1, n):
            drift[i] = stays * drift[i - 1] + kicks[i]
        readings[:, k] = drift + noise.white * rng.standard_normal(n)
    estimates = estimator.run(DT * np.arange(n), readings)[5000:]
    prediction = predict(estimator, trial)
    np.testing.assert_allclose(prediction.heat_sigma, estimates[:, :1].std(0), rtol=0.1)
    np.testing.assert_allclose(prediction.noise_sigma, estimates[:, 1:].std(0), rtol=0.1)


@forms
def test_predicted_lag_error_is_that_of_a_simulation(estimators, form):
    estimator = estimators[form]
    trial = machine() if form == "two sensors" else machine("dT_near_K")
    prediction = predict(estimator, trial)
    time = DT * np.arange(6000)
    by_name = {"dT_near_K": NEAR, "dT_far_K": FAR}
    readings = np.column_stack([by_name[name].step(time) for name in estimator.sensors])
    error = estimator.run(time, readings)[:, 1] - BEND.step(time)
    assert prediction.lag_error[0] == pytest.approx(np.max(np.abs(error)), rel=0.02)
    half = 3 * prediction.noise_sigma[0]
    band = max(half, error.max()) - min(-half, error.min())
    assert prediction.band[0] == pytest.approx(band, rel=0.02)


def test_more_sensors_never_hurt():
    one = best_choice(design_kalman(machine("dT_near_K")))
    two = best_choice(design_kalman(machine()))
    assert two.objective <= 1.02 * one.objective


def test_the_kalman_choice_is_the_best_of_its_trade_off():
    choices = design_kalman(machine("dT_near_K"))
    shares = [c.settings["walk_per_sqrt_s"] for c in choices]
    assert shares == sorted(set(shares))
    chosen = best_choice(choices)
    assert chosen.objective == min(c.objective for c in choices)
    sigma = [c.prediction.noise_sigma[0] for c in choices]
    lag = [c.prediction.lag_error[0] for c in choices]
    assert sigma[0] < sigma[-1]
    assert lag[0] > lag[-1]
    assert shares[0] < chosen.settings["walk_per_sqrt_s"] < shares[-1]


def test_pinned_settings_are_kept():
    near = machine("dT_near_K")
    (kalman,) = design_kalman(near, walk=0.05)
    assert kalman.settings == {"walk_per_sqrt_s": 0.05}
    assert kalman.estimator.document()["walk_per_sqrt_s"] == [0.05]
    (kernel,) = design_kernel(near, PINNED)
    assert kernel.settings == PINNED
    assert kernel.estimator.document()["delay_s"] == 5.0


@pytest.mark.slow
def test_what_is_free_is_searched_around_what_is_pinned():
    near = machine("dT_near_K")
    pinned = {**SMOOTH, "cutoff_Hz": 0.05}
    choices = design_kernel(near, pinned)
    assert all(c.settings.items() >= pinned.items() for c in choices)
    chosen = best_choice(choices)
    worse = design_kernel(near, {**pinned, "delay_s": 5 * chosen.settings["delay_s"] + 20})[0]
    assert chosen.objective < worse.objective


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (fraser.MAIN_REGULARIZATION, "unstable: a zero lies in the right half-plane"),
        ({"A": 5.59e-3, "B": 1e-4, "c": 0.15}, "rings: damping ratio 0"),
    ],
)
def test_unusable_regularizations_are_refused(values, message):
    with pytest.raises(FitError, match=message):
        design_kernel(machine("dT_near_K"), {**values, "cutoff_Hz": 0.05, "delay_s": 5.0})
    with pytest.raises(FitError, match=message):
        design_kernel(machine("dT_near_K"), values)


def test_kernel_form_takes_one_sensor():
    with pytest.raises(FitError, match="one sensor and one drive"):
        design_kernel(machine())


# ---------------------------------------------------------------- model, noise, design


def test_a_machine_needs_sensors_or_deflections_and_noise():
    bare = document()
    bare = Model(bare.drives, bare.sensors, bare.terms[:2], DT)
    assert DesignModel.of(bare, NOISE, DT).outputs == ()
    with pytest.raises(ModelError, match="every drive is measured, and the model has no defl"):
        DesignModel.of(bare, NOISE, DT, ["Q_main_1"])
    with pytest.raises(ModelError, match="neither a deflection nor a sensor"):
        DesignModel.of(Model(bare.drives, (), (), DT), NOISE, DT)
    with pytest.raises(ModelError, match="the noise of dT_far_K is zero"):
        DesignModel.of(document(), {**NOISE, "dT_far_K": SensorNoise(0.0)}, DT)
    with pytest.raises(ModelError, match="no noise for the sensor dT_far_K"):
        DesignModel.of(document(), {"dT_near_K": NOISE["dT_near_K"]}, DT)
    lost = document()
    ghost = Drive("Q_other_1", "zero", 0.0, (0.0, 1.0))
    lost = Model(
        (*lost.drives, ghost), lost.outputs, (*lost.terms, Term("Q_other_1", "d_x_um", BEND)), DT
    )
    with pytest.raises(ModelError, match=r"no sensor sees the drive Q_other_1.*--measured Q_other"):
        DesignModel.of(lost, NOISE, DT)
    with pytest.raises(ModelError, match="nothing acts on the deflections"):
        DesignModel.of(Model((), bare.outputs[:0] + document().deflections, (), DT), {}, DT)


def test_without_a_sensor_every_drive_is_measured():
    trial = DesignModel.of(document(()), {}, DT)
    assert (trial.sensors, trial.drives) == ((), ())
    assert [(k.channel, k.role) for k in trial.known] == [("Q_main_1", "drive")]


def test_a_subset_of_the_sensors():
    assert [o.channel for o in only_sensors(document(), ["dT_far_K"]).sensors] == ["dT_far_K"]
    with pytest.raises(ModelError, match=r"no sensor dT_fur_K.*dT_near_K, dT_far_K"):
        only_sensors(document(), ["dT_fur_K"])


def designed(model, **options):
    channels = {name: {"white_sigma": 0.02} for name in NOISE}
    noise = SimpleNamespace(document=lambda: {"channels": channels})
    return tt.regularize(model, noise, form="kalman", walk=0.02, **options)


def test_a_band_has_its_digits_in_any_unit():
    near, far, bend = document().terms
    small = replace(BEND, A=BEND.A / 1e3, B=BEND.B / 1e3, D=BEND.D / 1e3)
    outputs = (*document().outputs[:2], replace(document().outputs[2], channel="d_x_mm"))
    terms = (near, far, replace(bend, output="d_x_mm", response=small))
    fine, coarse = designed(document()), designed(replace(document(), outputs=outputs, terms=terms))
    band = fine.design.best.prediction.band[0]
    assert f" {band:.3g} " in fine.table()
    assert f" {band / 1e3:.3g} " in coarse.table()


@forms
def test_a_design_belongs_to_its_parameters(estimators, form):
    model = document().with_design(estimators[form].document())
    back = loads(dumps(model))
    assert load_estimator(dict(back.estimator_design())).document() == estimators[form].document()
    edited = dumps(model).replace('"r": 5.12', '"r": 5.13')
    assert edited != dumps(model)
    with pytest.raises(ModelError, match="designed for other parameters"):
        loads(edited).estimator_design()
    with pytest.raises(ModelError, match="no estimator yet"):
        document().estimator_design()


@forms
def test_unsound_designs_are_told(estimators, form):
    good = estimators[form].document()
    for key in ("sensors", "drives", "outputs", "followed", "form"):
        with pytest.raises(ModelError):
            load_estimator({k: v for k, v in good.items() if k != key})
        with pytest.raises(ModelError):
            load_estimator({**good, key: 7})
    with pytest.raises(ModelError, match="unknown form"):
        load_estimator({**good, "form": "particle"})


@pytest.mark.parametrize(
    "damage",
    [
        {"noise": []},
        {"noise": [{"white_sigma": 0.0, "drift_sigma": 0.0, "drift_time_s": 1.0}] * 2},
        {"noise": [{"white_sigma": 0.1, "drift_sigma": 0.0, "drift_time_s": 0.0}] * 2},
        {"walk_per_sqrt_s": [float("inf")]},
        {"outputs": []},
    ],
)
def test_numbers_that_make_no_kalman_form_are_told(estimators, damage):
    with pytest.raises(ModelError, match="run thermaltool regularize again"):
        load_estimator({**estimators["kalman"].document(), **damage})


@forms
def test_terms_that_lead_nowhere_are_told(estimators, form):
    good = estimators[form].document()
    for damage in ({"to": 7}, {"to": -1}, {"to": False}, {"drive": 1}):
        with pytest.raises(ModelError, match="not there"):
            load_estimator({**good, "followed": [{**good["followed"][0], **damage}]})


@pytest.mark.parametrize("delay", [-5.0, float("nan"), "late"])
def test_delays_that_are_none_are_told(estimators, delay):
    with pytest.raises(ModelError, match="run thermaltool regularize again"):
        load_estimator({**estimators["kernel"].document(), "delay_s": delay})


def test_gains_are_solved_once_for_an_uneven_clock(estimators, monkeypatch):
    calls = []
    estimator = load_estimator(estimators["kalman"].document())
    solve = KalmanEstimator._solve_gain
    monkeypatch.setattr(
        KalmanEstimator, "_solve_gain", lambda self, k: (calls.append(k), solve(self, k))[1]
    )
    estimator.__post_init__()
    lengths = DT * np.geomspace(0.2, 5, 400)
    for dt in (*lengths, *lengths):
        estimator.recursion(dt)
    assert len(calls) == len(set(calls)) > 300


@forms
def test_modes_that_are_cut_short_are_told(estimators, form):
    good = estimators[form].document()
    term = good["followed"][0]
    for damage in ([1.0], [float("nan")] * len(term["modes"]["weight"])):
        modes = {**term["modes"], "weight": damage}
        with pytest.raises(ModelError, match="modes need"):
            load_estimator({**good, "followed": [{**term, "modes": modes}]})
