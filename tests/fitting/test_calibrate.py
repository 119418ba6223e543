"""Calibration against records from simulators that share no code with the package."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference import fraser1997 as fraser
from reference.ring import ring_step
from reference.two_poles import TwoPoles
from scipy.integrate import solve_ivp

from thermaltool.errors import FitError
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.fitting.covariance import block_covariance
from thermaltool.fitting.output_fit import fit_output
from thermaltool.fitting.parametrization import Parametrization
from thermaltool.fitting.projection import CalibrationProblem, linear_least_squares
from thermaltool.fitting.start_search import StartSearch
from thermaltool.model import Drive, simulate_response
from thermaltool.record import Record
from thermaltool.responses import KINDS, response_class
from thermaltool.responses.conduction import Conduction

# A rational plant: gains [µm] and time constants [s].
GAINS, TAUS = np.array([60.0, 30.0, -20.0]), np.array([900.0, 300.0, 120.0])
NOISE = 0.3
LATER = np.geomspace(5, 6000, 60)
DRIVES, OUTPUT = ("Q_main_W", "Q_second_W"), "d_z_um"


def record_of(time, inputs, values):
    return Record(time, {**dict(zip(DRIVES, inputs, strict=False)), OUTPUT: values})


def drives_of(holds):
    return [Drive(c, hold, 0.0, (0.0, 1.0)) for c, hold in zip(DRIVES, holds, strict=False)]


def rational_step(t):
    return -np.expm1(-np.asarray(t)[..., None] / TAUS) @ GAINS


def rational(time, u, start=0.0):
    """Held input: the sum of a step for every change; `start` is a level held for ever before."""
    changes = np.diff(u, prepend=start)
    return rational_step(np.maximum(time[:, None] - time, 0)) @ changes + start * GAINS.sum()


def noisy(values, seed, sigma=NOISE):
    return values + sigma * np.random.default_rng(seed).standard_normal(len(values))


def worst_step(fit, at=LATER):
    return np.max(np.abs(fit.responses[0].step(at) - rational_step(at)))


def fit(records, **options):
    options = {"kinds": ["deflection"], "holds": ["zero"], "starts": 3, **options}
    return fit_output(records, drives_of(options.pop("holds")), OUTPUT, **options)


def pulses(time, seed=0):
    """Levels 0, 0.5, 1, each held for about 400 s; at rest at first."""
    level = np.random.default_rng(seed).choice([0.0, 0.5, 1.0], 1 + int(time[-1] // 400))
    u = level[(time // 400).astype(int)]
    return np.where(time < 100, 0.0, u)


UNIFORM = 10.0 * np.arange(600)


def test_a_step():
    u = (UNIFORM >= 100).astype(float)
    got = fit([record_of(UNIFORM, (u,), 7.0 + noisy(rational(UNIFORM, u), 1))])
    assert worst_step(got) < NOISE
    assert got.rmse == pytest.approx(NOISE, rel=0.1)
    assert got.offsets[0] == pytest.approx(7.0, abs=NOISE)
    assert got.fit_percent > 98


@pytest.mark.parametrize("clock", ["uniform", "random", "bursts"])
def test_any_input_on_any_clock(clock):
    rng = np.random.default_rng(4)
    time = {
        "uniform": UNIFORM,
        "random": np.cumsum(rng.uniform(2, 20, 600)),
        "bursts": (np.arange(60)[:, None] * 100.0 + 1.5 * np.arange(10)).ravel(),
    }[clock]
    u = pulses(time)
    got = fit([record_of(time, (u,), noisy(rational(time, u), 2))])
    assert worst_step(got) < 2 * NOISE
    assert got.rmse == pytest.approx(NOISE, rel=0.1)


def test_several_logs_with_their_own_zero_and_gaps():
    records = []
    for k, zero in enumerate((0.0, -50.0, 120.0)):
        time = UNIFORM[: 200 + 100 * k]
        u = pulses(time, seed=10 + k)
        values = zero + noisy(rational(time, u), k)
        values[40:80] = np.nan
        records.append(record_of(time, (u,), values))
    got = fit(records)
    assert worst_step(got) < 2 * NOISE
    assert got.offsets == pytest.approx((0, -50, 120), abs=NOISE)


def test_outliers_move_huber_less():
    u = pulses(UNIFORM)
    values = noisy(rational(UNIFORM, u), 3)
    values[15::25] += 40.0
    record = record_of(UNIFORM, (u,), values)
    robust, plain = fit([record]), fit([record], loss="linear")
    assert worst_step(robust) < 2 * NOISE
    assert worst_step(plain) > 4 * worst_step(robust)


@pytest.mark.slow
def test_free_initial_state():
    u = np.where(UNIFORM < 1500, 0.0, pulses(UNIFORM, seed=2))
    values = noisy(rational(UNIFORM, u, start=0.8), 5)  # cools down from an earlier level
    record = record_of(UNIFORM, (u,), values)
    free = fit([record], free_start=True)
    assert worst_step(free) < 3 * NOISE
    assert worst_step(fit([record])) > 4 * worst_step(free)


def test_a_temperature_drives():
    """Between samples it is a straight line; integrated numerically by Runge-Kutta."""
    time = 20.0 * np.arange(250)
    temperature = 3 * np.sin(time / 500) + np.interp(time, time[::25], pulses(time[::25], 3))

    def slope(t, x):
        return (np.interp(t, time, temperature) - x) / TAUS

    x = solve_ivp(slope, (0, time[-1]), np.zeros(3), t_eval=time, max_step=20, rtol=1e-8).y
    values = noisy(GAINS @ x, 6)
    got = fit([record_of(time, (temperature,), values)], holds=["first"])
    assert worst_step(got) < 3 * NOISE
    held = fit([record_of(time, (temperature,), values)], holds=["zero"])
    assert worst_step(held) > worst_step(got)


def test_two_drives_share_an_output():
    u, v = pulses(UNIFORM, 21), pulses(UNIFORM + 170, 22)
    v = v - v[0]
    second = 25 * -np.expm1(-np.maximum(UNIFORM[:, None] - UNIFORM, 0) / 500)
    values = noisy(rational(UNIFORM, u) + second @ np.diff(v, prepend=0.0), 7)
    got = fit(
        [record_of(UNIFORM, (u, v), values)],
        kinds=["deflection", "deflection"],
        holds=["zero", "zero"],
        starts=2,
    )
    assert worst_step(got) < 4 * NOISE
    error = got.responses[1].step(LATER) + 25 * np.expm1(-LATER / 500)
    assert np.max(np.abs(error)) < 4 * NOISE
    assert {"a[0]", "a[1]", "A[1]", "offset[0]"} <= set(got.names)
    assert got.covariance.shape == (len(got.names),) * 2


# ---------------------------------------------------------------- the ring source

SIGMA = 0.02
CLOCK = 5.0 * np.arange(240)
HEATED = ((CLOCK >= 100) & (CLOCK < 700)).astype(float)


def ring_record(seed):
    lag = np.maximum(CLOCK[:, None] - CLOCK, 0)
    step = np.interp(lag, CLOCK, ring_step(CLOCK, **fraser.PAIR))
    return record_of(CLOCK, (HEATED,), noisy(step @ np.diff(HEATED, prepend=0.0), seed, SIGMA))


def ring_fit(seed, **options):
    return fit(
        [ring_record(seed)], loss="linear", **{"kinds": ["conduction"], "starts": 1, **options}
    )


def test_ring_source():
    at = np.geomspace(20, 3000, 50)
    got = ring_fit(0, starts=3)
    error = got.responses[0].step(at) - ring_step(at, **fraser.PAIR)
    assert np.max(np.abs(error)) < 3 * SIGMA
    assert got.rmse == pytest.approx(SIGMA, rel=0.15)
    assert got.starts == tuple(sorted(got.starts))


def test_the_fixed_radius_sets_the_unit_of_length_only():
    """Times 2: r twice, a a quarter, α four times; K and the response stay."""
    one, two = ring_fit(0), ring_fit(0, fixed={"r0": 0.24})
    a, b = one.responses[0], two.responses[0]
    assert (b.r0, a.r0) == (0.24, 0.12)
    at = np.geomspace(20, 3000, 50)
    np.testing.assert_allclose(b.step(at), a.step(at), atol=0.2 * SIGMA)
    assert two.rmse == pytest.approx(one.rmse, rel=1e-4)
    # a, α and r trade against each other: the optimum is flat, and where a search stops on it
    # depends on the rounding of the machine.
    k = one.names.index("r")
    assert abs(b.r - 2 * a.r) < 2 * np.sqrt(one.covariance[k, k])


def standard_score(got, of):
    """Error of a derived quantity over its standard error, by the covariance."""
    response = got.responses[0]
    values = {name: getattr(response, name) for name in ("K", "a", "alpha", "r")}
    gradient = np.zeros(len(got.names))
    for name, value in values.items():
        ahead = of(Conduction(**{**values, name: value * (1 + 1e-5)}))
        behind = of(Conduction(**{**values, name: value * (1 - 1e-5)}))
        gradient[got.names.index(name)] = (ahead - behind) / (2e-5 * value)
    error = np.sqrt(gradient @ got.covariance @ gradient)
    return (of(response) - of(Conduction(**fraser.PAIR))) / error


@pytest.mark.slow
def test_the_covariance_is_honest_for_the_ring_source():
    """Mean square of the standard scores of 24 fits: 1 ± 0.29 under white noise."""
    fits = [ring_fit(seed) for seed in range(24)]
    for of in (Conduction.dc_gain, lambda response: np.log(response.slowest())):
        score = np.array([standard_score(each, of) for each in fits])
        assert 0.3 < np.mean(score**2) < 2.2


@pytest.mark.slow
@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_the_covariance_is_honest(monkeypatch, loss):
    """95 % intervals of gain and time constants under white noise, from 100 fits of a new kind."""
    monkeypatch.setitem(KINDS, "two_poles", "reference.two_poles:TwoPoles")
    truth = {"A": 60.0, "a": 1 / 800, "B": 30.0, "b": 1 / 100}
    time = 10.0 * np.arange(400)
    u = pulses(time, seed=3)
    clean = simulate_response(TwoPoles(**truth), time, u, "zero")
    inside = {"gain": 0, "a": 0, "b": 0}
    for seed in range(100):
        record = record_of(time, (u,), noisy(clean, seed))
        got = fit([record], kinds=["two_poles"], loss=loss, starts=1)
        index = {name: k for k, name in enumerate(got.names)}
        if got.responses[0].a > got.responses[0].b:
            index |= {"a": index["b"], "b": index["a"]}
        error = np.sqrt(np.diag(got.covariance))
        for name in ("a", "b"):
            value = getattr(got.responses[0], got.names[index[name]])
            inside[name] += abs(value - truth[name]) < 1.96 * error[index[name]]
        gain = [index["A"], index["B"]]
        spread = np.sqrt(np.sum(got.covariance[np.ix_(gain, gain)]))
        inside["gain"] += abs(got.responses[0].dc_gain() - 90) < 1.96 * spread
    assert all(88 <= count <= 99 for count in inside.values()), inside


def test_a_short_record_says_so():
    record = ring_record(1)
    got = fit([record.rows(slice(0, 60))], kinds=["conduction"], starts=2)
    sentences = " ".join(got.unidentified)
    assert "the steady state" in sentences
    assert "not settled" in sentences
    assert "slowest time constant" in sentences


@pytest.mark.slow
def test_a_record_of_less_than_three_time_constants_never_passes_for_settled():
    """600 s of 700 s: the fit may look certain of a steady state that it has not seen."""
    time = 2.0 * np.arange(300)
    rng = np.random.default_rng(5)
    for _ in range(5):
        values = 100 * -np.expm1(-time / 700) + 20 * -np.expm1(-time / 60)
        record = record_of(time, (np.ones(300),), values + 0.2 * rng.standard_normal(300))
        got = fit([record], starts=2)
        assert "not settled" in " ".join(got.unidentified)


def test_a_long_record_is_settled():
    time = 20.0 * np.arange(500)
    u = ((time >= 100) & (time < 6000)).astype(float)
    got = fit([record_of(time, (u,), noisy(rational(time, u), 1, 0.01))])
    assert not any("steady state" in sentence for sentence in got.unidentified)


def test_the_model_knows_its_channels_and_its_logs():
    u = pulses(UNIFORM)
    record = record_of(UNIFORM, (u,), noisy(rational(UNIFORM, u), 1))
    named = replace(record, name="run.csv", digest="ab12")
    plan = CalibrationPlan(DRIVES[:1], deflections=(OUTPUT,), loss="linear", starts=1)
    model = calibrate([named, record], plan)
    assert [d.channel for d in model.drives] == [DRIVES[0]]
    assert model.drives[0].range == (0.0, 1.0)
    assert model.provenance == {"logs": [{"name": "run.csv", "sha256": "ab12"}]}
    assert model.outputs[0].fit["rows"] == 2 * len(UNIFORM)
    fitted = fit([named, record], loss="linear", starts=1)
    assert model.terms[0].response == fitted.responses[0]
    covariance, names = fitted.response_covariance(0)
    assert names == ("a", "b", "d", "A", "B", "D")
    np.testing.assert_array_equal(model.terms[0].covariance, covariance)


def test_the_size_of_a_column_does_not_decide():
    """Two columns of which one is in other units, and one that is zero."""
    rng = np.random.default_rng(5)
    columns, wanted = rng.standard_normal((30, 3)), rng.standard_normal(30)
    columns[:, 2] = 0.0
    size = np.array([1.0, 1e-14, 1.0])
    plain, scaled = (linear_least_squares(c, wanted, 1e-12) for c in (columns, columns * size))
    np.testing.assert_allclose(scaled * size, plain, rtol=1e-10)
    np.testing.assert_allclose(
        plain[:2], np.linalg.lstsq(columns[:, :2], wanted, rcond=None)[0], rtol=1e-10
    )
    assert plain[2] == 0.0


# ---------------------------------------------------------------- refusals


def test_a_drive_that_never_moves():
    record = record_of(UNIFORM, (np.zeros(600),), noisy(np.zeros(600), 0))
    with pytest.raises(FitError, match="never leaves its reference"):
        fit([record])


def test_an_output_that_does_not_change():
    heat = np.where(UNIFORM > 60, 1.0, 0.0)
    for constant, message in ((21.5, "is constant"), (np.nan, "has no values")):
        record = record_of(UNIFORM, (heat,), np.full(len(heat), constant))
        with pytest.raises(FitError, match=message):
            fit([record])


def test_a_drive_that_is_on_all_the_time_is_a_step():
    record = record_of(UNIFORM, (np.ones(600),), noisy(rational(UNIFORM, np.ones(600)), 0))
    assert worst_step(fit([record]), LATER[LATER > 30]) < 2 * NOISE


@pytest.mark.parametrize("rows", [0, 1, 5, 7])
def test_too_few_rows(rows):
    record = record_of(UNIFORM[:rows], (np.ones(rows),), np.arange(rows, dtype=float))
    with pytest.raises(FitError, match="row"):
        fit([record])


def test_an_output_without_values():
    with pytest.raises(FitError, match="no value"):
        fit([record_of(UNIFORM, (pulses(UNIFORM),), np.full(600, np.nan))])


# ---------------------------------------------------------------- the covariance by itself


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_block_covariance_of_a_linear_fit(share):
    """A polynomial by Huber's weights: predicted against observed variance, with outliers too."""
    rng = np.random.default_rng(8)
    x = np.linspace(-1, 1, 200)
    J = np.polynomial.legendre.legvander(x, 5)
    fitted, predicted = [], []
    for _ in range(200):
        y = rng.standard_normal(200) + 30 * (rng.random(200) < share) * rng.standard_normal(200)
        weights = np.ones(200)
        for _ in range(20):
            c = np.linalg.lstsq(J * np.sqrt(weights)[:, None], y * np.sqrt(weights), rcond=None)[0]
            residual = y - J @ c
            spread = 1.4826 * np.median(np.abs(residual))
            weights = np.minimum(1, 2.5 * spread / np.abs(residual))
        covariance = block_covariance(J, residual, np.zeros(200, int), weights)
        fitted.append(c)
        predicted.append(np.diag(covariance))
    ratio = np.mean(predicted, axis=0) / np.var(fitted, axis=0)
    assert 0.8 < np.mean(ratio) < 1.25


@pytest.mark.parametrize("noise", [0.1, 1e-4, 1e-8])
def test_what_no_row_says_anything_of_is_as_well_known_as_before(noise):
    """Two columns that are nearly one: their sum is known, their difference by the prior alone."""
    rng = np.random.default_rng(9)
    one = rng.standard_normal(300)
    J = np.column_stack([one, one + 1e-12 * rng.standard_normal(300)])
    residual = noise * rng.standard_normal(300)
    arguments = J, residual, np.zeros(300, int), np.ones(300), np.full(2, 3.0)
    covariance = block_covariance(*arguments)
    total, difference = (np.array(v) @ covariance @ np.array(v) for v in ([1, 1], [1, -1]))
    assert total == pytest.approx(noise**2 / 300, rel=0.5)
    # Each has a variance of 9 of its own.
    assert difference == pytest.approx(18.0, rel=0.1)


@pytest.mark.parametrize("kind", ["conduction", "rational2", "deflection"])
def test_slopes_of_a_search_are_those_of_its_errors(kind):
    time = 10.0 * np.arange(400)
    u = pulses(time, seed=4)
    record = record_of(time, (u,), noisy(rational(time, u), 5))
    classes = (response_class(kind),)
    parametrization = Parametrization(classes, (classes[0].fixed,))
    problem = CalibrationProblem.assemble([record], drives_of(["zero"]), OUTPUT, False)
    limits = parametrization.limits(10.0, record.duration)
    search = StartSearch(problem, parametrization, limits)
    triangle = problem.compress(np.ones(len(problem.measured)))
    theta = search.best(parametrization.starts(10.0, record.duration), triangle, 1, print)[0][1]
    theta = np.clip(theta + 0.2, *limits)
    gradient = search.slopes(theta, triangle).T @ search.errors(theta, triangle)
    for k, slope in enumerate(gradient):
        step = 1e-3 * np.eye(len(theta))[k]
        ahead, behind = (np.sum(search.errors(theta + s, triangle) ** 2) for s in (step, -step))
        assert slope == pytest.approx((ahead - behind) / 4e-3, rel=1e-3, abs=1e-9)
