"""What a stream tells beside its estimates: late ones, standard errors, the alarm; restarts."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from machines.wall import Wall

from thermaltool.errors import ModelError
from thermaltool.estimation.estimator import KalmanEstimator, SensorNoise
from thermaltool.estimation.fixed_lag import fixed_lag
from thermaltool.estimation.innovation_test import (
    BLIND_TIME,
    MAX_PAUSE,
    Alarm,
    InnovationTest,
    record_alarm,
)
from thermaltool.estimation.running_error import RunningError, running_errors
from thermaltool.responses.modes import Modes
from thermaltool.responses.sample_clock import CLOCK_STEP
from thermaltool.runtime.monitor import Monitor

DT = 2.0
# The largest flux in the calibration [W/m²].
LEVEL = 2e4
TICKS = round(DT / CLOCK_STEP)
PLACES = (5, 39)


def wall_estimator(sensors=2):
    """A filter that knows the wall's modes: its front and its back give the flux."""
    A, b, _ = Wall().matrices()
    rates, vectors = np.linalg.eigh(A)
    weights = vectors * (vectors.T @ b)
    return KalmanEstimator(
        ("T_in_degC", "T_back_degC")[-sensors:],
        ("Q_front_W",),
        (),
        tuple(
            (k, 0, Modes(rates.astype(complex), weights[place].astype(complex)))
            for k, place in enumerate(PLACES[-sensors:])
        ),
        (),
        (300.0,),
        (SensorNoise(0.05, 0.02, 600.0),) * sensors,
    )


DESIGN = {"bands": {"relative": [0.02], "model_error": [0.02, 0.02]}}


def readings(wall, rows, generator):
    """Of a duty of the wall, with the noise that the filter knows."""
    flux = 2e4 * np.repeat(generator.uniform(0, 1, rows // 100 + 1), 100)[:rows]
    F, g, _ = wall.recursion(DT)
    x, out = np.zeros(wall.cells), np.empty((rows, 2))
    for k, q in enumerate(flux):
        out[k] = x[list(PLACES)]
        x = F @ x + g * q
    out += 0.05 * generator.normal(size=out.shape)
    return out


def test_late_estimates_go_on_after_a_restart_and_are_those_of_the_batch():
    generator, said = np.random.default_rng(40), []
    y = readings(Wall(), 200, generator)
    estimator = wall_estimator()
    time = DT * np.arange(200)
    batch = fixed_lag(estimator, time, y, 30.0)[:, 0]
    errors = running_errors(RunningError(estimator, DT, [LEVEL]), time)[:, 0]

    def fresh():
        return Monitor(
            estimator,
            DESIGN,
            DT,
            lambda *each: said.append(each),
            bands=True,
            lag=30.0,
            level=[LEVEL],
        )

    monitor = fresh()
    assert monitor.names == ("sigma_Q_front_W", "late_Q_front_W", "alarm")
    assert monitor.values([5000.0])[-1] == "untested"
    monitor.start(y[0], "rest")
    for k in range(1, 200):
        monitor.step(TICKS, y[k], True)
        sigma, late, alarm = monitor.values([5000.0])
        assert alarm == "quiet"
        assert sigma == pytest.approx(np.hypot(errors[k], 100.0), rel=1e-12)
        assert late == (batch[k - 15] if k >= 15 else 0.0)
        if k == 90:
            kept = json.loads(json.dumps(monitor.state()))
            monitor = fresh()
            monitor.resume(kept)
    assert said == []


def test_a_loss_that_grows_is_an_alarm_and_a_step_of_heat_is_none():
    generator = np.random.default_rng(41)
    rows, alarms = 5000, {}
    for name, film in (("as calibrated", 65.0), ("half as much again", 97.5)):
        found = []
        for _ in range(3):
            y = readings(Wall(film=film), rows, generator)
            test = InnovationTest(wall_estimator(), DT, [0.02, 0.02])
            found.append(record_alarm(test, DT * np.arange(rows), y).row)
        alarms[name] = found
    assert alarms["as calibrated"] == [None] * 3
    assert all(row is not None for row in alarms["half as much again"])
    told = Alarm("parted", "why", 7).document(DT * np.arange(9))
    assert told == {"word": "parted", "reason": "why", "time_s": 7 * DT}


def test_with_one_sensor_for_one_drive_nothing_contradicts():
    said = []
    monitor = Monitor(wall_estimator(1), {"bands": {**DESIGN["bands"], "model_error": [0.0]}}, DT,
                      lambda *each: said.append(each),
                      bands=True, lag=None, level=[LEVEL])  # fmt: skip
    assert "no alarm is possible" in said[0][1]
    monitor.start([0.0], "rest")
    monitor.step(TICKS, [1.0], True)
    assert monitor.values([5000.0])[-1] == "not possible"
    test = InnovationTest(wall_estimator(1), DT, [0.0])
    found = record_alarm(test, DT * np.arange(9), np.ones((9, 1)))
    assert found.document(DT * np.arange(9))["word"] == "not possible"
    assert "no more sensors than drives" in found.reason


def test_a_sensor_that_is_never_there_leaves_no_test():
    y = readings(Wall(), 50, np.random.default_rng(47))
    y[:, 1] = np.nan
    found = record_alarm(InnovationTest(wall_estimator(), DT, [0.02] * 2), DT * np.arange(50), y)
    assert (found.word, found.row) == ("not possible", None)
    assert "no two rows have readings of all sensors" in found.reason


def test_what_no_other_sensor_shows_is_named():
    """Two sensors of one drive check each other; a third has another drive for itself."""
    both = wall_estimator()
    alone = (2, 1, both.sensed[0][2])
    three = replace(
        both,
        sensors=(*both.sensors, "T_motor_degC"),
        drives=("Q_front_W", "Q_motor_W"),
        sensed=(*both.sensed, alone),
        walk=(300.0, 300.0),
        noise=both.noise[:1] * 3,
    )
    test = InnovationTest(three, DT, [0.02] * 3)
    assert test.can_tell
    assert test.blind_spot.startswith("no alarm of T_motor_degC: no other sensor")
    # Sensors that no drive moves have nothing to contradict.
    unseen = replace(three, sensed=both.sensed[:1], drives=("Q_front_W",), walk=(300.0,))
    assert not InnovationTest(unseen, DT, [0.02] * 3).can_tell


def warm(rows, before, changes, generator):
    """Of a duty that began `before` rows ago; the wall loses more from row `changes` on."""
    flux = 2e4 * np.repeat(generator.uniform(0, 1, (before + rows) // 100 + 1), 100)
    x, out = np.zeros(40), np.empty((before + rows, 2))
    machines = [Wall(film=film).recursion(DT) for film in (65.0, 97.5)]
    for k in range(len(out)):
        out[k] = x[list(PLACES)]
        F, g, _ = machines[k - before >= changes]
        x = F @ x + g * flux[k]
    return (out + 0.05 * generator.normal(size=out.shape))[before:]


@pytest.mark.slow
def test_a_machine_that_is_warm_at_the_first_row_is_no_alarm_and_a_loss_later_is_one():
    """Taken for settled, most of these starts are alarms within some rows."""
    generator, rows, changes = np.random.default_rng(48), 300, 150
    time, quiet, hasty, found = DT * np.arange(rows), 0, 0, []
    for draw in range(20):
        y = warm(rows, int(generator.integers(50, 500)), rows, generator)
        test = InnovationTest(wall_estimator(), DT, [0.02, 0.02], [0.01, 0.01], [2e4])
        quiet += record_alarm(test, time, y, "free").word == "quiet"
        hasty += record_alarm(test, time[:20], y[:20], "settled").word == "parted"
        if draw < 5:
            y = warm(rows, int(generator.integers(50, 500)), changes, generator)
            found.append(record_alarm(test, time, y, "free").row)
    assert quiet == 20
    assert hasty > 5
    assert all(row is not None and changes < row < changes + 100 for row in found)


def test_a_design_without_standard_errors_and_states_of_others():
    with pytest.raises(ModelError, match="no standard errors: run regularize again"):
        Monitor(wall_estimator(), {}, DT, print, bands=True, lag=None, level=[LEVEL])
    with pytest.raises(ModelError, match=r"design\.bands: cannot be read"):
        Monitor(wall_estimator(), {"bands": {**DESIGN["bands"], "relative": []}}, DT, print,
                bands=True, lag=None, level=[LEVEL])  # fmt: skip
    monitor = Monitor(wall_estimator(), DESIGN, DT, print, bands=True, lag=10.0, level=[LEVEL])
    other = Monitor(wall_estimator(1), {}, DT, print, bands=False, lag=10.0)
    other.start([0.0], "rest")
    for state in ([None, None, [0.0]], [[[1.0], []], [[1.0], 1.0, 1.0], [0.0]]):
        with pytest.raises(ValueError, match="not a state"):
            monitor.resume(state)


def test_what_a_kept_state_lacks_begins_as_on_a_warm_machine():
    """Bands are asked for at a restart; a machine at rest would be another one."""
    generator, rows = np.random.default_rng(44), 1500
    y = readings(Wall(), rows, generator)
    before = Monitor(wall_estimator(), DESIGN, DT, print, bands=False, lag=10.0, level=[LEVEL])
    before.start(y[0], "rest")
    for row in y[1:700]:
        before.step(TICKS, row, True)
    for state in (before.state(), None):
        said = []
        after = Monitor(wall_estimator(), DESIGN, DT, lambda *each, to=said: to.append(each[1]),
                        bands=True, lag=10.0, level=[LEVEL])  # fmt: skip
        after.resume(state)
        for row in y[700:]:
            after.step(TICKS, row, True)
        assert len(said) == 1
        assert said[0].endswith("they begin as those of a warm machine")


@pytest.mark.slow
@pytest.mark.parametrize(("film", "alarmed"), [(65.0, 0), (97.5, 3)])
def test_a_sensor_that_drops_out_and_a_pause_are_no_alarm(film, alarmed):
    generator, rows = np.random.default_rng(44), 5000
    streams, records = 0, 0
    for _ in range(3):
        y = readings(Wall(film=film), rows, generator)
        said = []
        monitor = Monitor(wall_estimator(), DESIGN, DT, lambda *each, to=said: to.append(each),
                          bands=True, lag=30.0, level=[LEVEL])  # fmt: skip
        monitor.start(y[0], "rest")
        lost = slice(900, 1200)
        for k in range(1, rows):
            held = np.where([True, lost.start <= k < lost.stop], y[lost.start], y[k])
            held[0] = y[k, 0]
            monitor.step(TICKS, held, not lost.start <= k < lost.stop)
        streams += any("have parted" in message for _, message in said)
        there = np.r_[0 : lost.start, lost.stop : rows]
        test = InnovationTest(wall_estimator(), DT, [0.02, 0.02])
        records += record_alarm(test, DT * there, y[there]).row is not None
    assert (streams, records) == (alarmed, alarmed)


def test_late_estimates_count_the_rows_without_readings():
    y = readings(Wall(), 300, np.random.default_rng(45))
    late = {}
    for name, lost in (("whole", []), ("lost", range(100, 160))):
        monitor = Monitor(wall_estimator(), DESIGN, DT, lambda *each: None, bands=False, lag=30.0)
        monitor.start(y[0], "rest")
        for k in range(1, 178):
            monitor.step(TICKS, y[k] * (np.nan if k in lost else 1.0), True)
        (late[name],) = monitor.values([5000.0])
    assert late["lost"] == pytest.approx(late["whole"], rel=0.1)


def test_a_sensor_that_is_left_out_is_not_used():
    y = readings(Wall(), 400, np.random.default_rng(46))
    found, steady = {}, RunningError(wall_estimator(), DT, [LEVEL]).sigma[0]
    for held in (0.0, 40.0, None):
        monitor = Monitor(
            wall_estimator(), DESIGN, DT, lambda *each: None, bands=True, lag=30.0, level=[LEVEL]
        )
        monitor.start(y[0], "rest")
        late = []
        for k in range(1, 400):
            out = {0} if held is not None and 100 <= k < 300 else set()
            now = [held, y[k][1]] if out else y[k]
            monitor.step(TICKS, now, not out, out)
            sigma, own, alarm = monitor.values([5000.0])
            # After the pause of a sensor the test begins anew, as of a warm machine.
            again = held is not None and k == 300
            soon = held is not None and 300 < k < 300 + max(BLIND_TIME / DT, MAX_PAUSE)
            assert alarm == ("untested" if out or again else "quiet") or (
                soon and alarm in ("quiet", "untested")
            )
            late.append(own)
            wider = sigma > 1.05 * np.hypot(steady, 100.0)
            assert wider or not out or k == 100
            assert not wider or k < 30 or 100 <= k < 320
            if k == 200:  # a restart amid it
                kept = json.loads(json.dumps(monitor.state()))
                monitor.resume(kept)
        found[held] = np.array(late)
    assert found[0.0].tolist() == found[40.0].tolist()
    # As the back alone says it, and soon as both when the front is there again.
    alone = fixed_lag(wall_estimator(1), DT * np.arange(400), y[:, 1:], 30.0)[186:286, 0]
    own, both = (each[200:300] for each in (found[0.0], found[None]))
    assert np.std(own - alone) < 0.1 * np.std(both) < 0.5 * np.std(own - both)
    np.testing.assert_allclose(found[0.0][-30:], found[None][-30:], rtol=0.01)
