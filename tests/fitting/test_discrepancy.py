"""What a calibration knows beyond its kind of response, on plants that are computed exactly."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.fitting.discrepancy import discrepancy
from thermaltool.fitting.gaussian_columns import beside, information_of, marginal
from thermaltool.record import Record

OUTPUT, NOISE = "dT_a_K", 0.01
LAGS = ((0.06, 90.0), (0.1, 1100.0))  # gain [K/W], time constant [s]


def log_of(seed, heat="Q_main_W", unit=1.0, between=False, wander=0.0):
    """Two lags under steps, at the rows or between them; beside them what wanders slowly [K]."""
    generator = np.random.default_rng(seed)
    time = 15.0 * np.arange(1200)
    at = np.sort(generator.uniform(200.0, time[-1], 40))
    if not between:
        at = time[np.unique(np.searchsorted(time, at))]
    change = np.diff(generator.choice([0.0, 50.0, 100.0], len(at)), prepend=0.0)
    since = time[:, None] - at
    on = np.where(since >= 0, since, np.nan)
    y = sum(np.nansum(change * gain * -np.expm1(-on / tau), axis=1) for gain, tau in LAGS)
    phase = 2 * np.pi * (time[:, None] / np.array([11000.0, 7300.0]) + generator.random(2))
    y = y + wander * np.sin(phase).sum(axis=1) + NOISE * generator.standard_normal(len(time))
    level = unit * np.nansum(change * (on >= 0), axis=1)
    return Record(time, {heat: level, OUTPUT: y}, digest="log")


def known_of(log, heat, kind):
    plan = CalibrationPlan((heat,), (OUTPUT,), kinds={OUTPUT: kind}, choose=True, linear=True)
    fit = calibrate([log], plan).outputs[0].fit
    return fit, fit["discrepancy"]


@pytest.mark.parametrize("kind", ["rational1", "rational2"])
def test_what_is_known_beyond_a_kind_does_not_depend_on_the_unit_of_a_drive(kind):
    found = []
    for heat, unit in (("Q_main_W", 1.0), ("Q_main_kW", 1e-3)):
        _, known = known_of(log_of(1, heat, unit), heat, kind)
        lags = slice(len(known["parameters"]), None)
        # By how much each lag moves the output at the largest heat: most likely, and how surely.
        largest = 100.0 * unit
        moves = largest * np.array(known["mean"])[lags]
        spread = largest * np.sqrt(np.diag(known["covariance"])[lags])
        found.append((known["white_sigma"], known["drift_sigma"], moves, spread))
    for one, other in zip(*found, strict=True):
        assert other == pytest.approx(one, rel=1e-3, abs=1e-4)
    # A kind that is true leaves no more open than a reading's noise.
    assert bool(np.max(found[0][3]) < NOISE) == (kind == "rational2")


def two_drives(units):
    """A log of two drives, each in its unit, and of its two lags the model has the faster one."""
    generator = np.random.default_rng(2)
    time, columns, y = 15.0 * np.arange(1200), {}, 0.0
    for (heat, unit), (gain, tau) in zip(units.items(), ((0.06, 90.0), (0.02, 400.0)), strict=True):
        level = np.repeat(generator.choice([0.0, 50.0, 100.0], 40), 30)
        level[:5] = 0.0
        since = np.arange(1200)[:, None] - np.arange(1200)
        for share, lag in ((gain, tau), (0.3 * gain, 1100.0)):
            rate = 15.0 / lag
            answer = np.where(since > 0, np.exp(-rate * (since - 1.0)), 0.0) * -np.expm1(-rate)
            y = y + share * answer @ level
        columns[heat] = unit * level
    noise = NOISE * generator.standard_normal(len(time))
    return Record(time, {**columns, OUTPUT: y + noise}, digest="log")


@pytest.mark.slow
@pytest.mark.parametrize(
    "units", [{"Q_a_kW": 1e-3, "Q_b_mW": 1e3}, {"Q_a_mW": 1e3, "Q_b_kW": 1e-3}]
)
def test_each_of_two_drives_has_a_unit_of_its_own(units):
    watts = {"Q_a_W": 1.0, "Q_b_W": 1.0}
    found = []
    for own in (watts, units):
        plan = CalibrationPlan(
            tuple(own), (OUTPUT,), kinds={OUTPUT: "rational1"}, choose=True, linear=True
        )
        known = calibrate([two_drives(own)], plan).outputs[0].fit["discrepancy"]
        scale = [own[d] if name == "K1" else 1.0 for d, name in known["parameters"]]
        scale += [own[d] for d, _ in known["lags"]]
        found.append(np.sqrt(np.diag(known["covariance"])) * scale)
    assert found[1] == pytest.approx(found[0], rel=1e-3)


def sums(columns, generator):
    """Products of residual and columns that are drawn."""
    rows = generator.standard_normal((400, 1 + columns))
    return rows.T @ rows


def test_what_is_integrated_out_first_is_as_likely():
    gram = sums(14, np.random.default_rng(3))
    p, q, m, free = 3, 4, 5, 2
    prior = information_of(14, p, (q, 0.7), (m, 0.1))
    at_once = marginal(gram, 0.0, 400, prior)
    less, price = beside(gram, 1 + p + q, m, 0.1)
    assert len(less) == 1 + p + q + free
    assert marginal(less, price, 400, information_of(9, p, (q, 0.7))) == pytest.approx(at_once)


@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_a_parameter_that_no_row_shows_is_open(unit):
    """The size of a rate, and a gain of a drive that acts where there are no readings."""
    generator = np.random.default_rng(4)
    time = 10.0 * np.arange(600)
    none = np.zeros(len(time))
    own = np.column_stack([np.sin(time / 300), none, np.cos(time / 500), none])
    lags = np.column_stack([np.sin(time / 900), np.cos(time / 200), none])
    known = discrepancy(
        time,
        np.zeros(len(time), np.int64),
        NOISE * generator.standard_normal(len(time)),
        own,
        np.ones((len(time), 1)),
        lags,
        None,
        np.array([2.0, 0.0]),
        np.array([1.0, 50.0 * unit, 1.0, 1.0, 50.0 * unit]),
        np.zeros((0, 3)),
        np.eye(4),
    )
    seen, hidden, gain, dead, *lagged = np.sqrt(np.diag(known.covariance))
    assert hidden == pytest.approx(0.3)
    assert max(seen, gain / 2.0) < 0.01
    # As much as the strongest gain makes, 2 at most.
    assert 50.0 * unit * dead == pytest.approx(0.3 * 2.0, rel=1e-3)
    assert 50.0 * unit * lagged[2] < 10 * NOISE


@pytest.mark.parametrize("seed", range(3))
def test_instants_leave_a_slow_drift_its_part(seed):
    """Not taken for instants of switches, of which each has a tail as slow as the response."""
    wander = 0.03  # a standard deviation [K]
    fit, known = known_of(log_of(seed, between=True, wander=wander), "Q_main_W", "rational2")
    left = float(np.hypot(wander, NOISE))
    assert fit["instants"]["rmse"] == pytest.approx(left, rel=0.2)
    assert fit["instants"]["rmse"] < fit["instants"]["rmse_without"]
    assert known["white_sigma"] == pytest.approx(NOISE, rel=0.1)
    # Periods of 7300 and 11000 s.
    assert 500.0 < known["drift_time_s"] < 5000.0
    assert known["drift_sigma"] > 0.5 * wander


def in_a_hall(seed):
    """Two lags in a hall that nobody logs: it walks, and the machine follows it slowly."""
    generator = np.random.default_rng([7, seed])
    log = log_of([8, seed])
    hall, follows = np.cumsum(generator.standard_normal(len(log.time))), 15.0 / 5000.0
    y = lfilter([follows], [1.0, follows - 1.0], 0.005 * hall)
    return Record(log.time, log.columns | {OUTPUT: log.columns[OUTPUT] + y}, digest="log")


@pytest.mark.slow
def test_what_wanders_leaves_open_what_its_parameters_take_up():
    """How much of a slow course is of the heat, and how much of the hall, no record tells well."""
    off, told = [], []
    for seed in range(8):
        plan = CalibrationPlan(
            ("Q_main_W",), (OUTPUT,), kinds={OUTPUT: "rational2"}, choose=True, linear=True
        )
        model = calibrate([in_a_hall(seed)], plan)
        term, known = model.terms[0], model.outputs[0].fit["discrepancy"]
        # Of the steady state for a unit of heat: as it is told, and with all that is known.
        gains = np.array([float(name[0] == "K") for _, name in known["parameters"]])
        makes = np.append(gains, np.ones(len(known["lags"])))
        steady = term.response.dc_gain() - sum(gain for gain, _ in LAGS)
        off.append((steady, steady + makes @ np.array(known["mean"])))
        errors = (gains @ np.array(term.covariance) @ gains,
                  makes @ np.array(known["covariance"]) @ makes)  # fmt: skip
        told.append(np.sqrt(errors))
    over = np.sqrt(np.mean(np.square(np.array(off) / told), axis=0))
    assert np.all((over > 0.5) & (over < 1.8))


def short_log(seed, rows=100):
    """One lag under noise alone."""
    generator = np.random.default_rng(seed)
    heat = np.repeat(generator.choice([0.0, 50.0, 100.0], rows // 5), 5)
    heat[:2] = 0.0
    kept = np.exp(-15.0 / 120.0)
    y = lfilter([0.0, 0.1 * (1 - kept)], [1.0, -kept], heat)
    read = y + NOISE * generator.standard_normal(rows)
    return Record(15.0 * np.arange(rows), {"Q_main_W": heat, OUTPUT: read}, digest="log")


@pytest.mark.slow
def test_a_short_log_of_noise_alone_has_its_own_intervals():
    """It cannot rule a disturbance out, and none is taken for granted."""
    off = []
    for seed in range(14):
        plan = CalibrationPlan(
            ("Q_main_W",), (OUTPUT,), kinds={OUTPUT: "rational1"}, choose=True, linear=True
        )
        term = calibrate([short_log(seed)], plan).terms[0]
        errors = np.sqrt(np.diag(np.array(term.covariance)))
        off.append((term.response.tau1 - 120.0, term.response.K1 - 0.1) / errors)
    over = np.sqrt(np.mean(np.square(off), axis=0))
    assert np.all((over > 0.6) & (over < 1.5))
