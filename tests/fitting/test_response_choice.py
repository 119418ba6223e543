"""The kind of response is found on plants that share no code with the package."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from machines.cooled_chain import CooledChain
from machines.heated_rod import HeatedRod

from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.fitting.kind_candidate import LEFT_OUT
from thermaltool.fitting.output_fit import fit_output
from thermaltool.fitting.start_search import StartSearch
from thermaltool.model import agreements
from thermaltool.record import Record
from thermaltool.report.calibration import calibration_table, calibration_warnings

HEAT, ROOM, OUTPUT = "Q_main_W", "Q_second_W", "dT_a_K"
TIME = 10.0 * np.arange(900)


def switched(seed, time=TIME, block=500.0):
    level = np.random.default_rng(seed).choice([0.0, 50.0, 100.0], 1 + int(time[-1] // block))
    return np.where(time < 100, 0.0, level[(time // block).astype(int)])


def lags(u, gains, taus, delay=0, dt=10.0):
    """Held input through lags in parallel, each by its exact recursion; the delay in samples."""
    late = np.concatenate([np.zeros(delay), u])[: len(u)]
    y = np.zeros(len(u))
    for gain, tau in zip(gains, taus, strict=True):
        kept, x = np.exp(-dt / tau), 0.0
        for k in range(1, len(u)):
            x = kept * x + (1 - kept) * late[k - 1]
            y[k] += gain * x
    return y


@cache
def rod(seed):
    """A rod of 60 cells that loses heat along its length, heated at one end, read in its middle."""
    cells, u = 60, switched(seed)
    conduct, loss, heat = 0.04, 2e-4, 2e-3  # between cells, to the air [1/s], per power [K/W s]
    matrix = -(loss + 2 * conduct) * np.eye(cells)
    matrix += conduct * (np.eye(cells, k=1) + np.eye(cells, k=-1))
    matrix[0, 0] += conduct
    matrix[-1, -1] += conduct
    rates, shapes = np.linalg.eigh(matrix)
    kept = np.exp(10.0 * rates)
    into, out = shapes[0] * heat, shapes[cells // 4]
    x, y = np.zeros(cells), np.zeros(len(u))
    for k in range(1, len(u)):
        x = kept * x + (kept - 1) / rates * into * u[k - 1]
        y[k] = out @ x
    return u, y


def record(u, y, sigma, seed, **more):
    noise = sigma * np.random.default_rng(seed).standard_normal(len(u))
    return Record(TIME, {HEAT: u, OUTPUT: y + noise, **more}, digest=str(seed))


def fitted(log, drives=(HEAT,), kinds=None):
    plan = CalibrationPlan(drives, (OUTPUT,), kinds=kinds or {}, starts=2, choose=True)
    return calibrate([log], plan)


def chosen(model):
    (found,) = (each for each in model.outputs[0].fit["candidates"] if each["chosen"])
    return found


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_one_lag_is_one_lag(seed):
    u = switched(seed)
    model = fitted(record(u, lags(u, [0.05], [600.0]), 0.05, seed))
    assert chosen(model)["kinds"] == ["rational1"]
    assert chosen(model)["delays"] == [0.0]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_rod_is_followed_to_its_noise_on_another_input(seed):
    """The record is as long as the rod's slowest time constant: what comes later is not in it."""
    sigma = 0.02
    model = fitted(record(*rod(seed), sigma, seed))
    unseen = record(*rod(seed + 10), sigma, seed + 10)
    assert agreements(model, [unseen])[OUTPUT].rmse < 1.5 * sigma


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4])
def test_a_bar_of_aluminium_is_a_rod(seed):
    """Finite volumes; at less noise than a plate without ends leaves."""
    bar, generator, u = HeatedRod(), np.random.default_rng(seed), switched(seed)
    probe = generator.uniform(0.6, 0.8)
    rise = bar.step_responses((probe,), 10.0, len(u))[:, 0, 0]
    y = np.convolve(np.diff(u, prepend=0.0), 0.2 * rise)[: len(u)]
    model = fitted(record(u, y, 0.005, seed))
    assert chosen(model)["kinds"] == ["rod"]
    response = model.terms[0].response
    assert response.probe == pytest.approx(probe, abs=0.05)
    stored = bar.capacity * np.pi * bar.radius**2
    slow = stored / (bar.film * 2 * np.pi * bar.radius)
    assert response.tau / response.loss == pytest.approx(slow, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, pytest.param(6, marks=pytest.mark.slow)])
def test_a_wall_has_its_films(seed):
    """Sixty cells, heat into the first one, a film on either face, a probe in the hotter third."""
    cells, generator, u = 60, np.random.default_rng(seed), switched(seed)
    tau, biot, far = generator.uniform(1000, 4000), *10 ** generator.uniform(-1, 0.7, 2)
    probe = int(generator.uniform(0.1, 0.35) * cells)
    film = np.zeros(cells)
    film[[0, -1]] = [b / (1 + b / (2 * cells)) for b in (biot, far)]
    links = cells * (2 * np.eye(cells) - np.eye(cells, k=1) - np.eye(cells, k=-1))
    links[[0, -1], [0, -1]] = cells
    rates, shapes = np.linalg.eigh((links + np.diag(film)) * cells / tau)
    kept, into = np.exp(-10.0 * rates), shapes[0] / np.sum(shapes[probe] * shapes[0] / rates)
    x, y = np.zeros(cells), np.zeros(len(u))
    for k in range(1, len(u)):
        x = kept * x + (1 - kept) / rates * into * u[k - 1]
        y[k] = 0.5 * shapes[probe] @ x
    model = fitted(record(u, y, 0.02, seed))
    assert chosen(model)["kinds"] == ["slab"]
    wall = model.terms[0].response
    assert wall.tau == pytest.approx(tau, rel=0.1)
    assert wall.dc_gain() == pytest.approx(0.5, rel=0.01)
    assert (wall.biot, wall.biot_far) == pytest.approx((biot, far), rel=0.2)
    assert wall.depth == pytest.approx((probe + 0.5) / cells, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_delay_that_the_log_shows_is_found(seed):
    u = switched(seed)
    model = fitted(record(u, lags(u, [0.05, 0.03], [300.0, 1500.0], delay=12), 0.02, seed))
    assert chosen(model)["delays"][0] == pytest.approx(120.0, abs=8.0)
    assert model.terms[0].response.delay == chosen(model)["delays"][0]
    other = switched(seed + 5)
    late = lags(other, [0.05, 0.03], [300.0, 1500.0], delay=12)
    assert agreements(model, [record(other, late, 0.02, 9)])[OUTPUT].rmse < 0.025


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_drive_that_does_nothing_is_left_out_and_told(seed):
    u = switched(seed)
    idle = switched(seed + 20, block=700.0)
    log = record(u, lags(u, [0.05], [600.0]), 0.05, seed, **{ROOM: idle})
    model = fitted(log, (HEAT, ROOM))
    assert chosen(model)["kinds"][1] == LEFT_OUT
    assert [term.drive for term in model.terms] == [HEAT]
    assert f"{OUTPUT}: without {ROOM}: these logs show no response to it" in "\n".join(
        calibration_warnings(model)
    )
    assert agreements(model, [log])[OUTPUT].rmse == pytest.approx(0.05, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_lag_that_a_third_of_a_readings_noise_shows_is_taken(seed):
    time = 10.0 * np.arange(3000)
    u = switched(seed, time, 600.0)
    y = lags(u, (0.05, 0.0008), (1500.0, 150.0))
    y = y + np.random.default_rng(seed).normal(0, 0.05, len(time))
    record = Record(time, {HEAT: u, OUTPUT: y})
    term = calibrate([record], CalibrationPlan((HEAT,), (OUTPUT,), choose=True)).terms[0]
    assert term.response.kind == "rational2"
    gains = [term.covariance_names.index(name) for name in term.response.gains]
    error = np.sqrt(np.sum(term.covariance[np.ix_(gains, gains)]))
    assert term.response.dc_gain() == pytest.approx(0.0508, abs=3 * error)


@pytest.mark.slow
def test_two_drives_may_have_two_kinds():
    u, v = switched(4), switched(5, block=900.0)
    y = lags(u, [0.05], [200.0]) + lags(v, [0.08, -0.03], [2000.0, 300.0])
    model = fitted(record(u, y, 0.02, 4, **{ROOM: v}), (HEAT, ROOM))
    assert model.terms[0].response.kind == "rational1"
    assert agreements(model, [record(u, y, 0.02, 6, **{ROOM: v})])[OUTPUT].rmse < 0.023


def test_outliers_choose_nothing():
    u = switched(1)
    log = record(u, lags(u, [0.05], [600.0]), 0.05, 1)
    log.columns[OUTPUT][50::97] = -180.0
    assert chosen(fitted(log))["kinds"] == ["rational1"]


@pytest.mark.slow
def test_a_kind_that_is_given_is_taken_and_nothing_is_compared():
    u = switched(1)
    model = fitted(record(u, lags(u, [0.05], [600.0]), 0.05, 1), kinds={OUTPUT: "deflection"})
    assert model.terms[0].response.kind == "deflection"
    assert "candidates" not in model.outputs[0].fit


@pytest.mark.parametrize(
    ("gains", "taus", "sigma"),
    [([0.03, 0.02], [600.0, 150.0], 0.07), ([0.04, 0.02], [1500.0, 200.0], 0.4)],
)
def test_of_kinds_as_simple_the_evidence_decides(gains, taus, sigma):
    """The usual kind has as many parameters, and is no less likely only where it fits as well."""
    u = switched(1)
    model = fitted(record(u, lags(u, gains, taus), sigma, 1))
    assert chosen(model)["kinds"] == ["rational2"]


@pytest.mark.slow
def test_a_kind_that_is_truer_but_hardly_nearer_is_told():
    """What readings hardly show is left out; that intervals do not hold it is said."""
    u = switched(1)
    y = lags(u, [0.04, 0.014, 0.012], [1500.0, 300.0, 60.0])
    model = fitted(record(u, y, 0.22, 1))
    assert chosen(model)["kinds"] == ["rational2"]
    (told,) = (each for each in calibration_warnings(model) if "decisive evidence" in each)
    assert told.startswith(f'{OUTPUT}: "slab" has decisive evidence beside "rational2" (')
    plain = fitted(record(u, lags(u, [0.05], [600.0]), 0.05, 1))
    assert not any("decisive evidence" in each for each in calibration_warnings(plain))


def test_the_comparison_is_told_with_its_reason():
    u = switched(1)
    text = calibration_table(fitted(record(u, lags(u, [0.05], [600.0]), 0.05, 1)))
    assert f"{OUTPUT}: kinds compared" in text
    (line,) = (line for line in text.splitlines() if line.startswith("rational1 "))
    assert "chosen: no other is as good" in line
    # What a person asks for: 0.05 K/W and ten minutes.
    (line,) = (line for line in text.splitlines() if line.startswith(HEAT))
    assert "K/W" in line
    assert "10 min" in line or "9.9" in line or "10.1 min" in line


@pytest.mark.slow
def test_gains_that_cancel_are_told_and_not_chosen():
    """Two drives that go together: what one adds the other takes off."""
    u = switched(1)
    almost = u + 0.02 * np.random.default_rng(0).standard_normal(len(u))
    log = record(u, lags(u, [0.05], [600.0]), 0.05, 1, **{ROOM: almost})
    forced = fitted(log, (HEAT, ROOM), kinds={OUTPUT: "rational3"})
    assert any("gains cancel" in note for note in calibration_warnings(forced))
    free = fitted(log, (HEAT, ROOM))
    assert not any("gains cancel" in note for note in calibration_warnings(free))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("machine", "output"),
    [(1336930158, "T_housing_degC"), (43277377, "T_housing_degC"), (395248134, "T_motor_degC")],
)
def test_a_room_that_hardly_moves_is_given_no_gain_that_no_machine_has(machine, output):
    """A kind for each drive is judged by its best fit, and a gain of -8 °C/°C is no answer."""
    chain, drives = CooledChain.drawn(machine), ("P_motor_W", "T_room_degC")
    logs = []
    for seed, rows in ((1, 1800), (2, 1440), (3, 1440)):
        columns = chain.log(machine + seed, rows=rows)
        logs.append(Record(columns["time_s"], {c: columns[c] for c in (*drives, output)}))
    model = calibrate([logs[0]], CalibrationPlan(drives, (output,), choose=True))
    room = next(t.response for t in model.terms if t.drive == "T_room_degC")
    assert 0.5 < room.transfer(np.array([1e-9 + 0j]))[0].real < 1.5
    for log in logs[1:]:
        assert agreements(model, [log])[output].rmse < 0.15


def test_the_final_fit_stays_where_its_terms_do_not_cancel(monkeypatch):
    """A search that ends at two lags of one time constant, whose large gains cancel."""
    u = switched(1)
    log = record(u, lags(u, [0.05, 0.03], [100.0, 2000.0]), 0.02, 1)
    compared, ended = np.log([100.0, 2000.0]), np.log([600.0, 600.1])

    def refine(self, theta, triangle, most=None):
        # As close as where the comparison ended.
        return float(np.linalg.norm(self.errors(compared, triangle))), ended

    monkeypatch.setattr(StartSearch, "refine", refine)
    drives = [CalibrationPlan((HEAT,), (OUTPUT,)).drive(HEAT)]
    fits = [
        fit_output([log], drives, OUTPUT, ["rational2"], near=near) for near in (None, compared)
    ]
    assert "cancel" in " ".join(fits[0].unidentified)
    assert [fits[1].responses[0].tau1, fits[1].responses[0].tau2] == pytest.approx([100, 2000])
