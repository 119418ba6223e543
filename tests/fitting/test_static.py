"""Curves fitted from logs: in front, behind, alone and together with the dynamics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from thermaltool.effects.curve import DriveCurve, OutputCurve
from thermaltool.errors import FitError, ModelError
from thermaltool.fitting import static
from thermaltool.fitting.output_noise import OutputNoise
from thermaltool.fitting.static import agreements, correct
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.model.combine import scheduled
from thermaltool.model.curves import Form
from thermaltool.record import Record
from thermaltool.responses.rational import Oscillation, Rational1, Rational2, Rational3

FIRST, SECOND, ANGLE, DEPTH = "Q_causal_W", "Q_stabilization_W", "phi_x_urad", "d_z_um"
RESPONSES = {
    (FIRST, ANGLE): Rational2(4.0, 1500.0, 0.5, 9000.0),
    (SECOND, ANGLE): Rational2(-4.0, 1200.0, -0.3, 8000.0),
    (FIRST, DEPTH): Rational1(1.5, 5000.0),
    (SECOND, DEPTH): Rational1(0.9, 6000.0),
}
CURVES = (
    DriveCurve(FIRST, {"level": 70.0, "c1": 0.4, "c2": 0.6}),
    DriveCurve(SECOND, {"level": 70.0, "c1": 0.8, "c2": 0.2}),
)


def model(*effects, outputs=(ANGLE, DEPTH), drives=(FIRST, SECOND), responses=RESPONSES):
    return Model(
        tuple(Drive(d, "zero", 0.0, (0.0, 40.0)) for d in drives),
        tuple(Output(o, "deflection", "first", (0.0, 1.0)) for o in outputs),
        tuple(Term(d, o, r) for (d, o), r in responses.items() if d in drives and o in outputs),
        60.0,
        effects=effects,
    )


def log(machine, seed=0, noise=0.3, rows=900):
    """Levels in any order, held for random times; noise and an offset of its own."""
    rng = np.random.default_rng(seed)
    time = 60.0 * np.arange(rows)
    table = {}
    for drive in machine.drives:
        u = np.zeros(rows)
        for start in np.sort(rng.integers(5, rows, 25)):
            u[start:] = rng.uniform(0, 70)
        u[rows // 2 : rows // 2 + 60] = 70.0
        table[drive.channel] = u
    y = machine.simulate(Record(time, table))
    for o in machine.outputs:
        table[o.channel] = y[o.channel] + 3.0 + noise * rng.standard_normal(rows)
    return Record(time, table, digest=str(seed))


def added(found, number):
    return found.model.effects[-number:]


def test_a_polynomial_in_front_is_found():
    found = correct(model(), [log(model(*CURVES))], (FIRST, SECOND), Form("polynomial", 2))
    for curve, true in zip(added(found, 2), CURVES, strict=True):
        assert curve.parameters["c1"] == pytest.approx(true.parameters["c1"], abs=0.02)
        assert curve.parameters["c2"] == pytest.approx(true.parameters["c2"], abs=0.02)
    for name in (ANGLE, DEPTH):
        assert found.before[name].rmse > 5 * found.after[name].rmse
        assert found.after[name].rmse == pytest.approx(0.3, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("refit", [False, True])
def test_a_spline_follows_a_curve_that_is_no_spline(refit):
    found = correct(model(), [log(model(*CURVES))], (FIRST, SECOND), Form("spline", 6), refit)
    u = np.linspace(0, 70, 50)
    for curve, true in zip(added(found, 2), CURVES, strict=True):
        np.testing.assert_allclose(curve.bent(u), true.bent(u), atol=1.0)


@pytest.mark.slow
def test_dynamics_and_curve_from_one_record():
    wrong = {
        ends: replace(r, **{n: getattr(r, n) * 1.6 for n in (*r.searched, *r.gains)})
        for ends, r in RESPONSES.items()
    }
    found = correct(
        model(responses=wrong), [log(model(*CURVES))], (FIRST, SECOND), Form("polynomial", 2), True
    )
    for term in found.model.terms:
        true = RESPONSES[term.drive, term.output]
        fresh = np.array([600.0, 3000.0, 2e4])
        np.testing.assert_allclose(
            term.response.step(fresh), true.step(fresh), atol=0.02 * abs(true.dc_gain())
        )
    assert added(found, 1)[0].bent(np.array(70.0)) == pytest.approx(70.0)
    unseen = log(model(*CURVES), seed=5)
    own = agreements(found.model, [unseen])[ANGLE]
    assert own.rmse_zero_free == pytest.approx(0.3, rel=0.15)
    assert own.rmse == pytest.approx(0.3, rel=0.35)


def test_several_logs_have_offsets_of_their_own():
    logs = [log(model(*CURVES), seed, rows=400) for seed in (1, 2)]
    moved = replace(logs[1], columns={**logs[1].columns, ANGLE: logs[1].columns[ANGLE] + 50})
    form = Form("polynomial", 2)
    one = correct(model(), logs, (FIRST,), form)
    other = correct(model(), [logs[0], moved], (FIRST,), form)
    for name, value in added(one, 1)[0].parameters.items():
        assert added(other, 1)[0].parameters[name] == pytest.approx(value, rel=1e-4)


def test_a_curve_behind_is_found():
    truth = OutputCurve(DEPTH, {"level": 100.0, "c1": 0.7, "c2": 0.3})
    found = correct(model(), [log(model(truth))], (DEPTH,), Form("spline", 5))
    (curve,) = added(found, 1)
    assert type(curve) is OutputCurve
    y = np.linspace(5, 100, 30)
    offset = np.mean(curve.bent(y) - truth.bent(y))
    np.testing.assert_allclose(curve.bent(y) - offset, truth.bent(y), atol=1.0)
    assert list(found.after) == [DEPTH]


def test_a_drive_of_both_signs():
    single = model(drives=(FIRST,), outputs=(ANGLE,))
    truth = DriveCurve(FIRST, {f"{a}{k}": v for k, (x, y) in enumerate(
        [(-30.0, -40.0), (0.0, 0.0), (30.0, 20.0)]) for a, v in (("x", x), ("y", y))})  # fmt: skip
    run = log(replace(single, effects=(truth,)))
    table = {**run.columns, FIRST: run.columns[FIRST] - 35.0}
    y = replace(single, effects=(truth,)).simulate(Record(run.time, table))[ANGLE]
    found = correct(single, [Record(run.time, {**table, ANGLE: y})], (FIRST,), Form("spline", 6))
    u = np.linspace(-35, 35, 40)
    np.testing.assert_allclose(added(found, 1)[0].bent(u), truth.bent(u), atol=1.0)


def test_a_schedule_can_be_corrected():
    members = [
        model(drives=(FIRST,), outputs=(ANGLE,), responses={(FIRST, ANGLE): r})
        for r in (Rational1(3.0, 900.0), Rational1(4.0, 1500.0))
    ]
    ladder = scheduled(members, FIRST, [20.0, 60.0])
    truth = replace(ladder, effects=(CURVES[0],))
    wrong = replace(ladder, terms=tuple(
        replace(t, response=replace(t.response, tau1=1.5 * t.response.tau1)) for t in ladder.terms
    ))  # fmt: skip
    found = correct(wrong, [log(truth)], (FIRST,), Form("polynomial", 2), True)
    assert found.after[ANGLE].rmse == pytest.approx(0.3, rel=0.1)
    assert [t.band for t in found.model.terms] == [t.band for t in ladder.terms]
    taus = [t.response.tau1 for t in found.model.terms]
    np.testing.assert_allclose(taus, [900.0, 1500.0], rtol=0.05)


@pytest.mark.slow
def test_a_damped_pair_stays_one():
    """On the way to a curve the damping must not leave its range."""
    pair = Oscillation(4.0, 0.0, 1e-3, 0.99)
    single = model(drives=(FIRST,), outputs=(ANGLE,))
    wrong = replace(single, terms=(replace(single.terms[0], response=pair),))
    found = correct(wrong, [log(replace(single, effects=CURVES[:1]))], (FIRST,),
                    Form("spline", 4), True)  # fmt: skip
    assert found.model.terms[0].response.zeta < 1
    assert found.after[ANGLE].rmse < found.before[ANGLE].rmse


def test_ranges_and_fit_are_told():
    found = correct(model(), [log(model(*CURVES))], (FIRST,), Form("spline", 4))
    assert found.model.drives[0].range == (0.0, 70.0)
    assert found.model.outputs[0].range[1] > 50
    assert found.model.outputs[0].fit["rmse"] == found.after[ANGLE].rmse


def test_the_noise_of_an_output_is_told_apart():
    """White noise of 0.3 with a drift of 1.5 (600 s) in two records, each with its own zero."""
    output = Output(ANGLE, "deflection", "first", (0.0, 1.0))
    rng, errors, runs = np.random.default_rng(9), [], []
    for zero in (0.0, 40.0):
        stays = np.exp(-60 / 600)
        steps = 1.5 * np.sqrt(1 - stays**2) * rng.standard_normal(4000)
        errors.append(zero + 0.3 * rng.standard_normal(4000) + lfilter([1], [1, -stays], steps))
        runs.append(Record(60.0 * np.arange(4000), {ANGLE: errors[-1]}))
    noise = OutputNoise.of_errors(output, runs, errors)
    assert noise.white == pytest.approx(0.3, rel=0.25)
    rows = [noise.whitened(k, error[:, None])[:, 0] for k, error in enumerate(errors)]
    # Whitened errors have a mean square of one for each reading, and no zero of their own.
    assert sum(float(r @ r) for r in rows) == pytest.approx(8000, rel=0.1)
    np.testing.assert_allclose(noise.whitened(0, np.ones((4000, 1))), 0.0, atol=1e-9)
    white = OutputNoise.white_noise(output, runs)
    assert all(factor.drift is None for factor in white.factors)


def test_the_logs_of_the_fit_are_told():
    before = replace(model(), provenance={"logs": [{"name": "step.csv", "sha256": "1"}]})
    found = correct(before, [log(model(*CURVES))], (FIRST,), Form("polynomial", 2))
    assert found.model.provenance["logs"] == [
        {"name": "step.csv", "sha256": "1"},
        {"name": "<record>", "sha256": "0"},
    ]


@pytest.mark.slow
def test_missing_readings_are_left_out():
    whole = log(model(*CURVES))
    holed = {**whole.columns, ANGLE: whole.columns[ANGLE].copy()}
    holed[ANGLE][100:200] = np.nan
    run = replace(whole, columns=holed)
    found = correct(model(), [run], (FIRST, SECOND), Form("polynomial", 2), True)
    assert found.after[ANGLE].rows == 800
    assert found.after[ANGLE].rmse == pytest.approx(0.3, rel=0.1)


def test_what_cannot_be_corrected():
    run = log(model(*CURVES))
    form = Form("spline", 6)
    with pytest.raises(ModelError, match="no drive or output Q_c_W in the model; there are: Q_ca"):
        correct(model(), [run], ("Q_c_W",), form)
    with pytest.raises(ModelError, match="has a curve already"):
        correct(model(CURVES[0]), [run], (FIRST,), form)
    with pytest.raises(ModelError, match="curves of drives"):
        correct(model(), [run], (ANGLE,), form, True)
    with pytest.raises(ModelError, match="beside output_curve"):
        correct(model(OutputCurve(DEPTH, {"level": 1.0, "c1": 1.0})), [run], (FIRST,), form, True)
    still = replace(run, columns={**run.columns, FIRST: np.zeros(len(run.time))})
    with pytest.raises(FitError, match="Q_causal_W never moves"):
        correct(model(), [still], (FIRST,), form)
    for kind, size in (("spline", 1), ("spline", 23), ("polynomial", 6)):
        with pytest.raises(FitError, match="it takes"):
            Form(kind, size)


def test_a_polynomial_that_falls_is_refused():
    share = np.linspace(0, 70, 7)
    dead = DriveCurve(FIRST, {f"{a}{k}": v for k, (x, y) in enumerate(
        zip(share, np.maximum(share - 50, 0.0), strict=True))
        for a, v in (("x", x), ("y", y))})  # fmt: skip
    with pytest.raises(FitError, match="does not rise over all levels"):
        correct(model(), [log(model(dead))], (FIRST,), Form("polynomial", 2))


@pytest.mark.slow
def test_a_drift_pulls_less_at_the_slow_lags(monkeypatch):
    """On unseen power, beside the same fit that takes all that is left for white noise."""
    truth, form = model(*CURVES, outputs=(ANGLE,)), Form("spline", 6)
    errors = {}
    for again in (0, static.NOISE_ROUNDS):
        monkeypatch.setattr(static, "NOISE_ROUNDS", again)
        found = []
        for seed in range(4):
            run, rng = log(truth, seed, rows=720), np.random.default_rng(100 + seed)
            stays = np.exp(-60 / 4000)
            steps = 4.0 * np.sqrt(1 - stays**2) * rng.standard_normal(720)
            table = {**run.columns, ANGLE: run.columns[ANGLE] + lfilter([1], [1, -stays], steps)}
            fit = correct(model(outputs=(ANGLE,)), [replace(run, columns=table)], (FIRST, SECOND),
                          form, True)  # fmt: skip
            unseen = log(truth, 50 + seed, 0.0, 2000)
            found.append(agreements(fit.model, [unseen])[ANGLE].rmse_zero_free)
        errors[again] = np.mean(found)
    assert errors[static.NOISE_ROUNDS] < 0.95 * errors[0]


@pytest.mark.slow
def test_gains_do_not_cancel():
    """Lags that nearly agree need no gains far beyond what output and drive move by."""
    single = model(drives=(FIRST,), outputs=(ANGLE,))
    triple = Rational3(2.0, 1600.0, 1.0, 1500.0, 1.0, 1400.0)
    wrong = replace(single, terms=(replace(single.terms[0], response=triple),))
    found = correct(wrong, [log(replace(single, effects=CURVES[:1]))], (FIRST,),
                    Form("spline", 6), True)  # fmt: skip
    gains = [abs(getattr(found.model.terms[0].response, name)) for name in ("K1", "K2", "K3")]
    assert max(gains) < 10 * 4.5
    assert found.after[ANGLE].rmse == pytest.approx(0.3, rel=0.15)
