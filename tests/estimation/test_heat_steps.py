"""Steps of a heat by evidence, against densities and distributions that are written out."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from thermaltool.estimation import heat_steps, smoother, step_search
from thermaltool.estimation.estimator import KalmanEstimator, SensorNoise
from thermaltool.estimation.even_clock import steps_on_any_clock
from thermaltool.estimation.even_smoother import EvenSmoother
from thermaltool.estimation.heat_steps import find_steps, smooth_with_steps, why_no_steps
from thermaltool.estimation.likelihood import fit_sizes
from thermaltool.estimation.pauses import with_pauses
from thermaltool.estimation.smoother import smooth
from thermaltool.estimation.step_search import StepSearch
from thermaltool.responses.modes import Modes

DT, LEVEL, WHITE = 4.0, (10.0,), 0.05
QUIET = SensorNoise(WHITE)


def lag(time_constants, gain=3.0):
    rate = 1 / np.asarray(time_constants, float)
    return Modes(-rate.astype(complex), (gain * rate / len(rate)).astype(complex))


def machine(walk=0.3, drift=0.1):
    slow = np.array([20.0, 90.0, 400.0])
    return KalmanEstimator(
        ("dT_a_K", "dT_b_K"),
        ("Q_motor_W",),
        ("d_x_um",),
        ((0, 0, lag(slow)), (1, 0, lag(1.3 * slow))),
        ((0, 0, lag([200.0], 10.0)),),
        (walk,),
        (SensorNoise(WHITE, drift, 300.0), SensorNoise(WHITE)),
    )


def responses(kalman, rows):
    """Readings after a step of one at each row, shape (rows, rows x sensors)."""
    bare = replace(kalman, outputs=(), followed=())
    space = bare.state_space(DT)
    found = np.zeros((rows, rows, len(space.H)))
    for row in range(rows):
        x = np.zeros(len(space.F))
        x[bare.modal] = 1.0
        for k in range(row, rows):
            found[row, k] = space.H @ x
            x = space.F @ x
    return found.reshape(rows, -1)


def covariance(kalman, rows):
    """Of all readings, for a walk from rest."""
    X, noise = responses(kalman, rows), np.zeros((rows, 2, rows, 2))
    apart = np.abs(np.subtract.outer(np.arange(rows), np.arange(rows)))
    for k, each in enumerate(kalman.noise):
        slow = each.drift**2 * np.exp(-DT * apart / each.drift_time)
        noise[:, k, :, k] = each.white**2 * np.eye(rows) + slow
    changes = np.full(rows, kalman.walk[0] ** 2 * DT)
    changes[0] = LEVEL[0] ** 2
    return noise.reshape(2 * rows, -1) + (X.T * changes) @ X


def at_rest(kalman):
    """State at a first row, and its covariance."""
    P = kalman.start_covariance(DT, LEVEL, "rest")
    return np.zeros(len(P)), P


def duty(rows, seed=1):
    heat = np.zeros(rows)
    heat[rows // 5 :], heat[rows // 2 :], heat[3 * rows // 4 :] = 8.0, 3.0, 6.0
    clean = np.diff(heat, prepend=0.0) @ responses(machine(), rows)
    noise = WHITE * np.random.default_rng(seed).standard_normal(clean.shape)
    return heat, (clean + noise).reshape(rows, 2)


def test_scores_and_information_of_a_shock():
    kalman, rows = replace(machine(), outputs=(), followed=()), 30
    _, readings = duty(rows)
    start = kalman.start_covariance(DT, LEVEL, "rest")
    found = EvenSmoother(kalman.state_space(DT), start, rows, [kalman.modal])
    X, S = responses(kalman, rows), covariance(kalman, rows)
    expected = X @ np.linalg.solve(S, readings.ravel())
    assert found.scores(readings)[:, 0] == pytest.approx(expected, rel=1e-6, abs=1e-6)
    expected = np.einsum("ij,ij->i", X, np.linalg.solve(S, X.T).T)
    assert found.information()[:, 0] == pytest.approx(expected, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("rows", [20, 40])
@pytest.mark.parametrize("share", [1.0, 0.001])
def test_the_information_of_a_short_run_is_that_of_a_step_of_one(rows, share):
    slow = replace(machine(), outputs=(), followed=())
    kalman = replace(slow, walk=tuple(np.sqrt(share) * each for each in slow.walk))
    _, readings = duty(rows)
    search = StepSearch(kalman, DT, readings, LEVEL, *at_rest(kalman))
    own = np.array([search._column(place)[place] for place in range(rows)])
    assert search.information == pytest.approx(own, rel=1e-6, abs=1e-9 * own.max())


def test_the_prior_of_runs_is_that_of_the_record():
    kalman = replace(machine(), outputs=(), followed=())
    _, readings = duty(60)
    whole = StepSearch(kalman, DT, readings, LEVEL, *at_rest(kalman))
    first, second = (
        StepSearch(kalman, DT, part, LEVEL, *at_rest(kalman), 60, earlier)
        for part, earlier in ((readings[:20], None), (readings[20:], 2))
    )
    assert first._prior(2) + second._prior(3) == pytest.approx(whole._prior(5))
    assert second._prior(0) == 0.0
    assert second._prior(41) == -np.inf


def test_the_evidence_is_a_normal_density():
    kalman, rows = replace(machine(), outputs=(), followed=()), 30
    _, readings = duty(rows)
    search = StepSearch(kalman, DT, readings, LEVEL, *at_rest(kalman))
    X, S = responses(kalman, rows), covariance(kalman, rows)
    places = (6, 15, 22)
    stepped = S + LEVEL[0] ** 2 * X[list(places)].T @ X[list(places)]
    value, added = search._weighed(places)
    density = multivariate_normal(cov=stepped).logpdf(readings.ravel())
    assert multivariate_normal(cov=S).logpdf(readings.ravel()) == pytest.approx(
        search.alone, abs=1e-5
    )
    assert search.alone + value == pytest.approx(density + search._prior(3), abs=1e-4)
    assert search._weighed((6, 15, 22, 9))[0] - value == pytest.approx(added[9], abs=1e-4)


def test_the_draws_are_those_of_all_sets_of_rows(monkeypatch):
    """Rows of which few are sure: every set is weighed, and drawn as often."""
    monkeypatch.setattr(step_search, "DRAWS", 800)
    monkeypatch.setattr(step_search, "ROUNDS_BETWEEN", 1)
    kalman, rows = replace(machine(walk=0.05), outputs=(), followed=()), 7
    _, readings = duty(rows)
    search = StepSearch(kalman, DT, readings, LEVEL, *at_rest(kalman))
    sets = [s for n in range(rows + 1) for s in itertools.combinations(range(rows), n)]
    odds = np.exp([search._weighed(each)[0] for each in sets])
    odds /= np.sum(odds)
    inside = [sum(p for p, s in zip(odds, sets, strict=True) if row in s) for row in range(rows)]
    drawn = search.drawn((2,))
    often = [np.mean([row in s for s in drawn]) for row in range(rows)]
    assert max(inside) > 0.1
    assert min(inside) < 0.9
    assert often == pytest.approx(inside, abs=0.08)


def test_smoothing_with_steps_is_the_conditional_mean(monkeypatch):
    """A step is a walk of one row: a joint normal distribution of all changes of the heat."""
    monkeypatch.setattr(smoother, "HELD_CHANGE", 0.0)
    kalman, rows = machine(), 30
    _, readings = duty(rows)
    steps = np.zeros((rows, 1))
    steps[[6, 15], 0] = 100.0
    found = smooth(kalman, DT * np.arange(rows), readings, LEVEL, "rest", steps)
    X = responses(kalman, rows)
    changes = np.full(rows, kalman.walk[0] ** 2 * DT)
    changes[0] = LEVEL[0] ** 2
    changes[[6, 15]] += 100.0
    S = covariance(kalman, rows) + 100.0 * X[[6, 15]].T @ X[[6, 15]]
    summed = np.tril(np.ones((rows, rows)))
    both = (summed * changes) @ X
    mean = both @ np.linalg.solve(S, readings.ravel())
    assert found.estimates[:, 0] == pytest.approx(mean, abs=1e-5)
    variance = np.diag((summed * changes) @ summed.T - both @ np.linalg.solve(S, both.T))
    assert found.sigma[:, 0] ** 2 == pytest.approx(variance, rel=1e-4)


@pytest.mark.slow
def test_a_heat_that_steps_is_found_and_a_ramp_is_none():
    kalman, rows = machine(walk=1.0, drift=0.0), 250
    time = DT * np.arange(rows)
    heat, readings = duty(rows)
    found = find_steps(kalman, time, readings, LEVEL, "rest")
    assert found.are_likelier
    assert found.evidence > found.of_walk + 50
    assert np.flatnonzero(found.likeliest) == pytest.approx([50, 125, 187], abs=1)
    stepped = smooth_with_steps(found, time, readings, LEVEL)
    walked = smooth(kalman, time, readings, LEVEL)
    error = [np.sqrt(np.mean((each.estimates[:, 0] - heat) ** 2)) for each in (stepped, walked)]
    assert error[0] < 0.5 * error[1]
    ramp = np.interp(time, [100, 500, 900], [0.0, 10.0, 2.0])
    noise = WHITE * np.random.default_rng(4).standard_normal((rows, 2))
    clean = np.diff(ramp, prepend=0.0) @ responses(kalman, rows)
    quiet = replace(kalman, walk=(0.1,))
    found = find_steps(quiet, time, clean.reshape(rows, 2) + noise, LEVEL, "rest")
    assert not found.are_likelier
    assert found.draws == ()


def test_a_constant_heat_has_no_steps():
    clean = 5.0 * responses(machine(), 200)[0].reshape(200, 2)
    readings = clean + WHITE * np.random.default_rng(1).standard_normal(clean.shape)
    time = DT * np.arange(200)
    found = fit_sizes(machine(), time, readings).estimator
    assert not find_steps(found, time, readings, LEVEL, "rest").are_likelier


def test_why_no_steps_are_looked_for():
    kalman, rows = machine(), 50
    time, (_, readings) = DT * np.arange(rows), duty(rows)
    assert why_no_steps(kalman, time, readings, LEVEL) == ""
    # A pause is none of the reasons, nor are readings that are missing together.
    assert why_no_steps(kalman, np.where(time > 100, time + 3.0, time), readings, LEVEL) == ""
    dead = readings.copy()
    dead[20, 1] = np.nan
    assert why_no_steps(kalman, time, dead, LEVEL) == ""
    dead[::7] = np.nan
    assert why_no_steps(kalman, time, dead, LEVEL) == "too many readings are missing"
    late = time + 3.0 * (np.arange(rows) // 7)
    assert why_no_steps(kalman, late, readings, LEVEL) == "the clock is uneven"
    early = time - 2.0 * (time > 100)
    assert why_no_steps(kalman, early, readings, LEVEL) == "the clock is uneven"
    two = replace(kalman, drives=("Q_a_W", "Q_b_W"), walk=(1.0, 1.0))
    assert why_no_steps(two, time, readings, LEVEL) == "several drives are estimated"
    many = DT * np.arange(heat_steps.MAX_ROWS + 1)
    assert (
        why_no_steps(kalman, many, np.zeros((len(many), 2)), LEVEL)
        == "there are more than 20000 rows"
    )
    still = replace(kalman, walk=(1e-13,))
    assert why_no_steps(still, time, readings, LEVEL) == "the heat stands still"


def test_the_evidence_over_a_pause_is_a_normal_density(monkeypatch):
    """Run by run, each from what the runs before tell: together that of all readings at once."""
    monkeypatch.setattr(smoother, "HELD_CHANGE", 0.0)
    monkeypatch.setattr(heat_steps, "MIN_RUN", 5)
    kalman, rows = replace(machine(), outputs=(), followed=()), 40
    _, readings = duty(rows)
    kept = np.r_[0:12, 18:rows]
    time, readings = DT * kept, readings[kept]
    runs = heat_steps.even_runs(time, readings)
    assert runs == [slice(0, 12), slice(12, 34)]
    record = heat_steps._Record(kalman, time, readings, LEVEL, "rest", runs)
    X = responses(kalman, rows)

    def density(walk, steps):
        changes = np.full(rows, walk**2 * DT)
        changes[0] = LEVEL[0] ** 2
        # Over the pause the heat stays, and has changed by as much as it wanders.
        changes[12:18], changes[18] = 0.0, 7 * walk**2 * DT
        changes += steps
        quiet = covariance(replace(kalman, walk=(1e-9,)), rows)
        quiet -= LEVEL[0] ** 2 * np.outer(X[0], X[0])
        both = (quiet + (X.T * changes) @ X).reshape(rows, 2, rows, 2)
        some = both[kept][:, :, kept].reshape(2 * len(kept), -1)
        return multivariate_normal(cov=some).logpdf(readings.ravel())

    walk = kalman.walk[0]
    assert record.searched(1.0).evidence == pytest.approx(density(walk, np.zeros(rows)), abs=1e-4)
    found = record.searched(0.1)
    steps = np.zeros(rows)
    steps[kept] = (record.variances(found.searches, found.places) + record.pauses)[:, 0]
    assert np.count_nonzero(steps) > 3
    parts = zip(found.searches, found.places, strict=True)
    value = sum(one.alone + one._weighed(at)[0] - one._prior(len(at)) for one, at in parts)
    priors = sum(one._prior(len(at)) for one, at in zip(found.searches, found.places, strict=True))
    assert found.evidence == pytest.approx(value + priors, abs=1e-4)
    assert value == pytest.approx(density(np.sqrt(0.1) * walk, steps), abs=1e-4)


@pytest.mark.slow
def test_steps_beside_and_amid_a_pause():
    """The heat steps while nobody reads; what is known of its course there tells the rows after."""
    kalman, rows = machine(walk=0.5, drift=0.0), 250
    heat, readings = duty(rows, seed=5)
    kept = np.r_[0:110, 140:rows]
    time, readings, there = with_pauses(DT * kept, readings[kept])
    assert why_no_steps(kalman, time, readings, LEVEL) == ""
    found = find_steps(kalman, time, readings, LEVEL, "rest")
    assert (found.are_likelier, found.runs) == (True, 2)
    assert np.flatnonzero(found.likeliest) == pytest.approx([50, 187], abs=1)
    stepped = smooth_with_steps(found, time, readings, LEVEL)
    walked = smooth(kalman, time, readings, LEVEL)
    error = [(each.estimates[:, 0] - heat)[there] for each in (stepped, walked)]
    assert np.sqrt(np.mean(error[0] ** 2)) < 0.5 * np.sqrt(np.mean(error[1] ** 2))
    assert np.mean(np.abs(error[0]) < 1.96 * stepped.sigma[there, 0]) > 0.9


@pytest.mark.slow
def test_a_warm_machine_has_had_steps_before_the_first_row():
    """Hot for long, switched off soon before: the walk beside steps says nothing of that."""
    whole, rows, cut = machine(walk=1.0, drift=0.0), 500, 310
    kalman = replace(whole, sensors=whole.sensors[:1], sensed=whole.sensed[:1], noise=(QUIET,))
    heat, warm = np.zeros(rows), np.zeros(rows)
    heat[:300], heat[380:] = 10.0, 6.0
    for k in range(1, rows):
        warm[k] = warm[k - 1] + (1 - np.exp(-DT / 200)) * (10 * heat[k - 1] - warm[k - 1])
    clean = (np.diff(heat, prepend=0.0) @ responses(whole, rows)).reshape(rows, 2)
    time, off = DT * np.arange(rows - cut), []
    for seed in range(6):
        noise = WHITE * np.random.default_rng(seed).standard_normal((rows - cut, 1))
        readings = clean[cut:, :1] + noise
        found = find_steps(kalman, time, readings, LEVEL, "free")
        assert found.are_likelier
        both = smooth_with_steps(found, time, readings, LEVEL)
        off.append(((both.estimates - np.column_stack([heat, warm])[cut:]) / both.sigma)[:30])
    assert np.sqrt(np.mean(np.square(off))) < 1.5


def jittered(generator, heat, period=DT, pause=0):
    """Rows that come up to a third of a sample late, and some not at all, of a step known."""
    kalman = machine()
    late = generator.uniform(0, period / 3, len(heat))
    clock = period * np.arange(len(heat)) + late
    fine, x, at = 0.1, np.zeros(kalman.modal), 0
    space = replace(kalman, outputs=(), followed=()).state_space(fine)
    modal = kalman.modal - len(kalman.followed[0][2].poles)
    F, G, H = space.F[:modal, :modal], space.F[:modal, modal], space.H[:, :modal]
    x, read = np.zeros(modal), []
    for k in range(round(clock[-1] / fine) + 2):
        while at < len(clock) and clock[at] <= k * fine:
            read.append(H @ x)
            at += 1
        x = F @ x + G * heat[min(int(k * fine / period), len(heat) - 1)]
    read = np.array(read) + WHITE * generator.normal(size=(len(read), 2))
    kept = (np.arange(len(heat)) < 60) | (np.arange(len(heat)) >= 60 + pause)
    return kalman, clock[kept], read[kept]


@pytest.mark.slow
@pytest.mark.parametrize("pause", [0, 25])
def test_steps_are_found_where_rows_jitter(pause):
    heat = np.repeat([0.0, 10.0, 3.0], [20, 80, 100])
    kalman, time, readings = jittered(np.random.default_rng(21), heat, pause=pause)
    time, readings, there = with_pauses(time, readings)
    assert why_no_steps(kalman, time, readings, LEVEL, there) == "the clock is uneven"
    kalman = fit_sizes(kalman, time, readings).estimator
    found, reason = steps_on_any_clock(kalman, time, readings, LEVEL, "rest", there)
    assert reason == ""
    assert found.are_likelier
    # A step amid a sample is one in two rows.
    apart = np.abs(np.subtract.outer(time[np.flatnonzero(found.likeliest)], [80.0, 400.0]))
    assert apart.min(axis=0).max() < 1.5 * DT
    assert apart.min(axis=1).max() < 1.5 * DT
    smoothed = smooth_with_steps(found, time, readings, LEVEL)
    off = smoothed.estimates[there, 0] - heat[np.minimum(time[there] / DT, 199).astype(int)]
    assert np.sqrt(np.mean(off**2)) < 1.0


def test_why_no_steps_says_what_there_is_most_of():
    kalman, (_, readings) = machine(), duty(200)
    time = DT * np.arange(200) + 100 * DT * (np.arange(200) // 12)
    time, readings, there = with_pauses(time, readings)
    assert why_no_steps(kalman, time, readings, LEVEL, there) == "there are too many pauses"
    assert steps_on_any_clock(kalman, time, readings, LEVEL, "rest", there)[0] is None
