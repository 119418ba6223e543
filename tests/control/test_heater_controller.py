"""Controllers of heaters: foretold as simulated, within limits, on a plant that lags on its own."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import thermaltool as tt
from thermaltool.control.actuation import DEVIATION, PATIENCE, Actuation
from thermaltool.control.controller import load_controller
from thermaltool.control.design import ControlPlan, design_controller
from thermaltool.control.law_choice import law_of, linear_estimator
from thermaltool.control.methods import METHODS
from thermaltool.control.receding import MAX_FAILURES, Program, shortened, stretch_ends
from thermaltool.control.trial import least_heats
from thermaltool.errors import FitError, ModelError
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.report.control import control_notes
from thermaltool.responses.rational import Rational1, Rational2
from thermaltool.runtime.compensation import controlled_heaters
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.refusal import refused_setpoints
from thermaltool.runtime.rows.row import Row
from thermaltool.runtime.settings import Settings

MAIN, A, B, PROBE, X, Y = "Q_main_W", "Q_a_W", "Q_b_W", "dT_probe_K", "d_x_um", "d_y_um"
DT, FULL = 10.0, 100.0
# (drive, output): gain per W and time constant [s]; a heater bends quickly and lengthens slowly.
PATHS = {
    (MAIN, PROBE): [(0.08, 150.0)],
    (A, PROBE): [(0.004, 600.0)],
    (MAIN, X): [(-0.6, 200.0), (-0.3, 1500.0)],
    (MAIN, Y): [(0.9, 250.0), (1.2, 1800.0)],
    (A, X): [(1.5, 200.0), (-0.6, 1500.0)],
    (A, Y): [(-1.0, 250.0), (0.7, 1800.0)],
    (B, X): [(0.2, 300.0)],
    (B, Y): [(-1.6, 250.0), (1.2, 1800.0)],
}


def response(lags):
    if len(lags) == 1:
        return Rational1(*lags[0])
    (k1, t1), (k2, t2) = lags
    return Rational2(k1, t1, k2, t2)


def machine(paths=PATHS):
    drives = tuple(Drive(name, "zero", 0.0, (0.0, FULL)) for name in (MAIN, A, B))
    outputs = (
        Output(PROBE, "sensor", 0.0, (-1.0, 9.0)),
        Output(X, "deflection", "first", (-100.0, 100.0)),
        Output(Y, "deflection", "first", (-150.0, 250.0)),
    )
    terms = tuple(Term(*ends, response(lags)) for ends, lags in paths.items())
    return Model(drives, outputs, terms, DT)


def designed(model, measured=(A, B)):
    noise = {"channels": {PROBE: {"white_sigma": 0.01}}}
    return tt.regularize(
        model, SimpleNamespace(document=lambda: noise), measured=measured, walk=0.03,
        form="kalman", warn=lambda message: None,
    ).model  # fmt: skip


@pytest.fixture(scope="module")
def model():
    return designed(machine())


def controller(model, method="receding-horizon", **more):
    plan = ControlPlan([(A, FULL), (B, FULL)], method, **{"slew": 100.0, **more})
    return design_controller(model, plan).controller


class Plant:
    """The same machine as lags of its own: y' = (k u - y)/τ, exact for held heats."""

    def __init__(self, gain=1.0, slower=1.0):
        self.parts = [
            (drive, output, gain * k if output != PROBE else k, slower * tau)
            for (drive, output), lags in PATHS.items()
            for k, tau in lags
        ]
        self.state = np.zeros(len(self.parts))

    def advance(self, heats, dt):
        for i, (drive, _, k, tau) in enumerate(self.parts):
            keep = np.exp(-dt / tau)
            self.state[i] = keep * self.state[i] + (1 - keep) * k * heats[drive]

    def read(self, output):
        return sum(x for x, part in zip(self.state, self.parts, strict=True) if part[1] == output)


def closed_loop(control, level, duration, *, steps=None, fault=None, plant=None, missing=None,
                noise=0.01, process=None, said=None, back=np.inf,
                read=lambda power: power):  # fmt: skip
    """Deflections, setpoints and status of every line."""
    rng, plant = np.random.default_rng(8), plant or Plant()
    said = [] if said is None else said
    settings = Settings(slew=None, step=0.0, estimates=True, status=True)
    process = process or controlled_heaters(control, settings, Messages(said.append, "log"))
    given, power, time = np.zeros(2), np.zeros(2), 0.0
    steps = [DT] * int(duration / DT) if steps is None else steps
    moved, powers, states = [], [], []
    for k, dt in enumerate([0.0, *steps]):
        if k:
            power = given if fault is None else fault(time, given)
            plant.advance({MAIN: level, A: power[0], B: power[1]}, dt)
            time += dt
        values = {PROBE: plant.read(PROBE) + noise * rng.standard_normal()}
        values |= {A: read(power[0]), B: read(power[1])}
        gone = missing if missing and 200 < time < back else ""
        row = [np.nan if name == gone else values[name] for name in process.columns]
        _, reply = process.take(Row(time, row, [""] * len(row)))
        given = np.array(reply[:2])
        moved.append([plant.read(X), plant.read(Y)])
        powers.append(given)
        states.append(reply[-1])
    return np.array(moved), np.array(powers), states, said, process


def test_outputs_are_foretold_as_the_model_simulates_them(model):
    law = law_of(controller(model), linear_estimator(model)[1])
    z, time = law.prediction.held([60.0]), 7.0 * np.arange(400)
    heats = {MAIN: np.full(400, 60.0), A: np.full(400, 20.0), B: np.full(400, 5.0)}
    simulated = model.simulate(Record(time, heats))
    for k in (1, 50, 399):
        at = float(time[k])
        y = law.prediction.free(at) @ z + law.prediction.steps(np.array(at)) @ [20.0, 5.0]
        np.testing.assert_allclose(y, [simulated[X][k], simulated[Y][k]], rtol=1e-9)
        transition, heated = law.prediction.transition(at)
        again = law.prediction.readout @ (transition @ z + heated @ [20.0, 5.0])
        np.testing.assert_allclose(again, y, rtol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_heats_stay_within_limits_and_documents_come_back(model, method):
    control = controller(model, method)
    document = json.loads(json.dumps(control.document()))
    assert json.loads(json.dumps(load_controller(document, "file").document())) == document
    _, powers, _, _, _ = closed_loop(load_controller(document, "file"), 60.0, 600.0)
    assert powers.min() >= 0
    assert powers.max() <= FULL


@pytest.mark.slow
def test_a_plan_of_known_duration_holds_less_than_the_regulator_that_saturates(model):
    duration, level = 3000.0, 70.0
    planned, powers, _, _, _ = closed_loop(controller(model, duration=duration), level, duration)
    cut, _, states, _, _ = closed_loop(controller(model, "output-lqr"), level, duration)
    assert "saturated" in states
    band, regulated = (np.ptp(y, axis=0).max() for y in (planned, cut))
    assert band <= 0.7 * regulated
    assert powers.min() >= 0


@pytest.mark.slow
@pytest.mark.parametrize(("gain", "slower"), [(0.8, 1.3), (1.2, 0.7)])
def test_the_loop_is_stable_where_the_machine_differs(model, gain, slower):
    plant = Plant(gain, slower)
    y, powers, _, _, _ = closed_loop(controller(model), 20.0, 7000.0, plant=plant)
    last = slice(-100, None)
    assert np.ptp(y[last], axis=0).max() < 3.0
    assert np.ptp(powers[last], axis=0).max() < 0.2 * FULL


@pytest.mark.slow
def test_noise_moves_heaters_little_where_limits_bind(model):
    _, powers, states, _, _ = closed_loop(controller(model), 90.0, 1500.0, noise=0.05)
    last = powers[-75:]
    assert states[-1] == "saturated"
    # Within a minute; weighed the same whatever is left it is a quarter of full power.
    assert max(np.ptp(last[k : k + 6], axis=0).max() for k in range(70)) < 0.2 * FULL


@pytest.mark.slow
def test_where_axes_suffice_there_is_next_to_no_heat(model):
    wide = controller(model, axes={X: 1000.0, Y: 1000.0})
    y, powers, _, _, process = closed_loop(wide, 70.0, 250.0)
    assert process.names[:4] == (A, B, "offset_x_um", "offset_y_um")
    assert powers.mean() < 0.1 * FULL
    np.testing.assert_allclose(process.values()[2:], -y[-1], atol=2.0)


@pytest.mark.slow
def test_heaters_hold_what_goes_beyond_the_range_of_an_axis(model):
    y, powers, _, _, process = closed_loop(controller(model, axes={Y: 20.0}), 70.0, 1500.0)
    alone, more, _, _, _ = closed_loop(controller(model), 70.0, 1500.0)
    assert process.values()[2] == pytest.approx(-20.0, abs=0.5)
    left = y[:, 1] - np.clip(y[:, 1], -20.0, 20.0)
    assert np.abs(left).max() <= np.abs(alone[:, 1]).max()
    assert np.abs(y[:, 0]).max() < np.abs(alone[:, 0]).max() + 1.0
    assert powers[-50:, 1].mean() < 0.9 * more[-50:, 1].mean()


@pytest.mark.slow
def test_a_controller_with_an_axis_comes_back_and_names_its_offset(model, tmp_path):
    made = controller(model, axes={X: 30.0})
    text = json.dumps(made.document())
    assert load_controller(json.loads(text), "file").axes == {X: 30.0}
    (tmp_path / "c.json").write_text(text)
    assert refused_setpoints(str(tmp_path / "c.json"), None) == [A, B, "offset_x_um"]
    for more, said in (
        ({"axes": {"d_q_um": 5.0}}, "an axis for d_q_um, which is not held"),
        ({"axes": {X: 0.0}}, "an axis cannot correct d_x_um by 0"),
        ({"axes": {X: 5.0}, "method": "output-lqr"}, "output-lqr leaves nothing to an axis"),
    ):
        with pytest.raises(ModelError, match=said):
            controller(model, **more)


@pytest.mark.slow
def test_an_axis_holds_what_no_heater_moves():
    no_x = {ends: lags for ends, lags in PATHS.items() if ends not in ((A, X), (B, X))}
    made = design_controller(
        designed(machine(no_x)), ControlPlan([(A, FULL), (B, FULL)], slew=100.0, axes={X: 500.0})
    )
    assert np.abs(made.trials[0].free[X]).max() > 50
    assert np.abs(made.trials[0].held[X]).max() == 0


@pytest.mark.slow
def test_samples_of_any_length(model):
    steps = np.random.default_rng(2).uniform(5.0, 20.0, 100).round(3)
    for method in ("receding-horizon", "output-lqr"):
        uneven = closed_loop(controller(model, method), 20.0, 0.0, steps=steps)[0]
        even = closed_loop(controller(model, method), 20.0, float(steps.sum()))[0]
        assert np.ptp(uneven, axis=0).max() < np.ptp(even, axis=0).max() + 2.0


def test_without_a_plan_the_last_one_goes_on_then_there_is_no_heat(model, monkeypatch):
    control, said = controller(model), []
    plant = Plant()
    _, powers, _, _, process = closed_loop(control, 40.0, 300.0, plant=plant, said=said)
    assert powers[-1].max() > 5

    def none(*arguments):
        raise FitError("no plan: stopped")

    time, replies = 300.0, []
    with monkeypatch.context() as patch:
        patch.setattr(Program, "solve", none)
        for _ in range(MAX_FAILURES + 3):
            time += DT
            row = [plant.read(PROBE), *process.values()]
            values = dict(zip((PROBE, A, B), row, strict=True))
            replies.append(process.take(Row(time, [values[c] for c in process.columns], [""] * 3)))
    states = [values[-1] for _, values in replies]
    assert states == ["old-plan"] * MAX_FAILURES + ["safe"] * 3
    assert max(replies[1][1][:2]) > 5
    # Nor does the integral of the actuation error give any.
    assert list(replies[-1][1][:2]) == [0.0, 0.0]
    values = dict(zip((PROBE, A, B), [plant.read(PROBE), 0.0, 0.0], strict=True))
    process.take(Row(time + DT, [values[c] for c in process.columns], [""] * 3))
    assert [line.rpartition("log")[2].split(": ", 1)[1] for line in said] == [
        "no plan: stopped: the last one goes on",
        "no plan: stopped: no heat",
        "planned again",
    ]


@pytest.mark.slow
@pytest.mark.parametrize("power", [0.0, FULL])
def test_a_heater_that_does_not_follow_is_found_and_the_other_goes_on(model, power):
    def fault(time, given):
        return np.array([given[0], power]) if 300 < time < 900 else given

    said = []
    free = closed_loop(controller(model, "output-lqr"), 40.0, 0.0, steps=[DT] * 120, fault=lambda
                       time, given: np.array([0.0, fault(time, given)[1]]))[0]  # fmt: skip
    y, powers, states, said, _ = closed_loop(
        controller(model), 40.0, 1200.0, fault=fault, said=said
    )
    assert len(said) == 2
    assert f"{B}: does not follow: " in said[0]
    assert said[1].endswith(f"{B}: follows again")
    # Found within a few lines of the first difference, and told on each.
    assert states[31 + 2 * PATIENCE] == "fault"
    assert states[-1] != "fault"
    # Full on it bends as the other heater would: then that one keeps out.
    assert np.abs(y[60:90]).max() <= np.abs(free[60:90]).max() + 0.1
    assert (powers[40:90, 0].max() > 1) == (power == 0)
    if power:
        assert powers[60, 1] == 0


def test_the_setpoint_stands_in_for_a_power_that_is_not_measured(model):
    said = []
    y, _, states, said, _ = closed_loop(controller(model), 20.0, 800.0, missing=B, said=said)
    assert any("the power of Q_b_W counts as it is set" in line for line in said)
    assert states[-1] != "safe"
    assert np.ptp(y, axis=0).max() < 30


def heats_of_lines(control, **more):
    """What was told of each line after readings of the probe end at 200 s, and the setpoints."""
    y, powers, states, said, process = closed_loop(
        control, 40.0, 700.0, missing=PROBE, said=[], **more
    )
    return y, powers, states, said, process


@pytest.mark.slow
@pytest.mark.parametrize("method", ["receding-horizon", "output-lqr"])
def test_without_its_temperature_the_model_goes_on_then_the_last_heats_then_none(model, method):
    y, powers, states, said, _ = heats_of_lines(controller(model, method))
    (foretold,) = [line for line in said if "is trusted for" in line]
    trusted = float(foretold.rpartition("about ")[2].split()[0])
    first, last = states.index("reduced"), len(states) - states[::-1].index("reduced")
    assert trusted == pytest.approx(DT * (last - first), rel=0.3)
    assert states[last : last + MAX_FAILURES + 1] == ["old-plan"] * MAX_FAILURES + ["safe"]
    assert set(states[last + MAX_FAILURES :]) == {"safe"}
    # Foretold as well as read while nothing changes; the heat goes once there is no plan.
    read = closed_loop(controller(model, method), 40.0, DT * last)[0]
    np.testing.assert_allclose(y[:last], read[:last], atol=4.0)
    assert powers[last - 1].max() > 10
    assert powers[-1].max() == 0.0


def test_readings_that_come_back_count_again(model):
    _, _, states, said, process = heats_of_lines(controller(model), back=400.0)
    assert "reduced" in states
    assert said[-1].endswith("all sensors count again")
    assert states[-1] not in ("reduced", "safe", "old-plan")
    kept = json.loads(json.dumps(process.state()))
    process.resume(kept)
    assert json.loads(json.dumps(process.state())) == kept


@pytest.mark.slow
def test_what_is_foretold_is_what_a_quiet_sensor_reads(model):
    # Without noise and with the disturbance known to the filter nothing parts them.
    read = closed_loop(controller(model), 40.0, 400.0, noise=0.0)[0]
    blind, _, states, _, _ = closed_loop(controller(model), 40.0, 400.0, noise=0.0, missing=PROBE)
    assert states[-1] == "reduced"
    np.testing.assert_allclose(blind, read, atol=0.05)


def test_a_meter_that_answers_a_sample_late_is_no_heater_that_fails():
    rng = np.random.default_rng(3)
    actuation, before, trims = Actuation(np.array([FULL]), DT), 0.0, []
    for given in 50 + 12 * rng.standard_normal(300):
        assert actuation.take(DT, np.array([given]), [before]) == []
        before = given
        trims.append(actuation.trim[0])
    assert np.abs(trims[30:]).max() < 0.01
    # One that gives a tenth less than it is set to is still told from it.
    for given in 50 + 12 * rng.standard_normal(300):
        actuation.take(DT, np.array([given]), [0.9 * before])
        before = given
    assert actuation.trim[0] == pytest.approx(5, abs=2)
    for _ in range(2 * PATIENCE):
        actuation.take(DT, np.array([80.0]), [20.0])
    assert actuation.stuck[0]


def test_a_power_that_is_held_counts_as_it_is_set(model):
    # The heaters rise from zero while the power is not read: the last reading says nothing.
    control = controller(model)
    settings = Settings(slew=None, step=0.0, estimates=True, status=True)
    said = []
    process = controlled_heaters(control, settings, Messages(said.append, "log"))
    given, plant = np.zeros(2), Plant()
    for k in range(9):
        if k:
            plant.advance({MAIN: 80.0, A: given[0], B: given[1]}, DT)
        values = {PROBE: plant.read(PROBE), A: given[0] if k < 2 else np.nan, B: given[1]}
        row = [values[name] for name in process.columns]
        _, reply = process.take(Row(DT * k, row, [""] * len(row)))
        given = np.array(reply[:2])
    assert given[0] > DEVIATION * FULL
    assert not any("does not follow" in line for line in said)


@pytest.mark.slow
def test_a_meter_of_the_wrong_sign_does_not_count():
    _, powers, states, said, _ = closed_loop(
        controller(designed(machine())), 40.0, 600.0, read=lambda power: -power
    )
    right = closed_loop(controller(designed(machine())), 40.0, 600.0)[1]
    np.testing.assert_allclose(powers[-10:], right[-10:], atol=5)
    assert states[-1] == "reduced"
    assert any("Q_a_W: out of range: -" in line for line in said)


def test_no_heater_that_follows_is_told_as_what_is_done(model):
    _, powers, _, said, _ = closed_loop(
        controller(model), 40.0, 300.0, read=lambda power: power / 1000
    )
    assert any("0.0" in line and "measured (is it in kW?)" in line for line in said)
    assert any("no heater is left: what gives too little is tried with 25%" in s for s in said)
    np.testing.assert_allclose(powers[-1], FULL / 4)


def test_what_is_delivered_too_little_is_added():
    heaters, given = Actuation(np.array([100.0]), DT), 50.0
    for _ in range(60):
        assert heaters.take(DT, np.array([given]), [0.95 * given]) == []
        given = heaters.setpoint(0, 50.0, given, 0.95 * given)
    assert 0.95 * given == pytest.approx(50.0, abs=0.1)
    assert abs(0.05 * given) < DEVIATION * 100


def test_a_state_of_another_controller_is_refused(model):
    law = law_of(controller(model), linear_estimator(model)[1])
    above, below, left = law.state()
    for state in ([above, below], [above, below, -1.0], [above, below, float("nan")]):
        with pytest.raises(ValueError, match=r"state|unpack"):
            law.resume(state)
    law.resume([above, below, left])


@pytest.mark.slow
def test_a_stream_goes_on_from_what_it_kept(model):
    control, plant = controller(model, duration=1500.0), Plant()
    process = closed_loop(control, 50.0, 400.0, plant=plant)[-1]
    settings = Settings(slew=None, step=0.0, estimates=True, status=True)
    again = controlled_heaters(control, settings, Messages(lambda message: None, "log"))
    again.resume(json.loads(json.dumps(process.state())))
    row = dict(zip((PROBE, A, B), [plant.read(PROBE), *process.values()], strict=True))
    replies = [
        each.take(Row(410.0, [row[c] for c in each.columns], [""] * 3))[1]
        for each in (process, again)
    ]
    np.testing.assert_allclose(replies[1][:-1], replies[0][:-1], atol=1e-3)


def test_stretches_grow_and_end_where_they_should():
    ends = stretch_ends(10.0, 3600.0)
    lengths = np.diff(ends, prepend=0.0)
    assert (len(ends), ends[0], ends[-1]) == (20, 10.0, pytest.approx(3600.0))
    np.testing.assert_allclose(lengths[1:] / lengths[:-1], lengths[1] / lengths[0], rtol=1e-6)
    np.testing.assert_allclose(stretch_ends(10.0, 50.0), [10, 20, 30, 40, 50])
    assert shortened(ends, 300.0)[-1] == 300.0


def test_heats_above_zero_come_as_near_as_they_can():
    steps = np.array([[1.0, 0.0], [0.0, 2.0]])
    np.testing.assert_allclose(least_heats(steps, np.array([3.0, -4.0])), [3.0, 0.0])
    np.testing.assert_allclose(least_heats(steps, np.array([-1.0, -1.0])), [0.0, 0.0])


def test_the_inversion_says_where_it_asks_for_negative_heat(model):
    mixed = {**PATHS, (A, Y): [(1.0, 250.0)], (B, Y): [(0.5, 250.0)]}
    design = design_controller(
        designed(machine(mixed)), ControlPlan([(A, FULL), (B, FULL)], "inversion", slew=100.0)
    )
    trial = design.trials[0]
    assert min(power for power, _ in trial.asked.values()) < 0
    assert "d_x_um alone (--hold) needs none" in trial.needs
    assert "a heater that moves" in trial.needs


@pytest.mark.slow
def test_a_power_that_was_calibrated_as_measured_is_set_and_a_dead_time_becomes_lags():
    # Heat needs a while from a pad to what bends: a calibration may take it for a dead time.
    late = replace(response(PATHS[A, X]), delay=12.0)
    bare = machine()
    drives = tuple(replace(d, hold="first" if d.channel == A else d.hold) for d in bare.drives)
    terms = tuple(
        replace(t, response=late) if (t.drive, t.output) == (A, X) else t for t in bare.terms
    )
    plan = ControlPlan([(A, FULL), (B, FULL)], slew=100.0)
    design = design_controller(designed(replace(bare, drives=drives, terms=terms)), plan)
    assert [each.hold for each in design.controller.model.drives] == ["zero"] * 3
    assert "d_x_um: a dead time of 12 s stands as lags, within" in design.notes[0]
    again = load_controller(design.controller.document(), "c.json")
    prediction = law_of(again, linear_estimator(again.model)[1]).prediction
    times = np.arange(60.0, 3000.0, 50.0)
    np.testing.assert_allclose(
        prediction.steps(times)[:, 0, 0], late.modes(DT).step(times), atol=0.02
    )
    moved, *_ = closed_loop(again, 30.0, 900.0)
    assert np.ptp(moved, axis=0).max() < 4
    longer = tuple(
        replace(t, response=replace(late, delay=2000.0)) if t.response is late else t for t in terms
    )
    with pytest.raises(ModelError, match=r"d_x_um: a dead time of 2e\+03 s, too long"):
        design_controller(designed(replace(bare, drives=drives, terms=longer)), plan)


@pytest.mark.slow
def test_heaters_that_bend_the_same_way_as_the_step_are_told():
    turned = {
        (drive, output): [(k if drive == MAIN or output == PROBE else -k, tau) for k, tau in lags]
        for (drive, output), lags in PATHS.items()
    }
    plan = ControlPlan([(A, FULL), (B, FULL)], slew=100.0)
    design = design_controller(designed(machine(turned)), plan)
    assert design.trials[0].holds_nothing
    (note,) = control_notes(design)
    assert note.startswith("nothing of a step of Q_main_W is held by Q_a_W, Q_b_W: a heater that")
    assert not control_notes(design_controller(designed(machine()), plan))
    one = {ends: lags if ends[0] == A else PATHS[ends] for ends, lags in turned.items()}
    one[A, X], one[A, Y] = [(-1.5, 200.0)], [(1.0, 250.0)]
    (note,) = control_notes(design_controller(designed(machine(one)), plan))
    assert note.startswith("Q_a_W stays off in every trial")


@pytest.mark.slow
def test_a_limit_beyond_the_calibration_is_told(model):
    design = design_controller(model, ControlPlan([(A, 3 * FULL), (B, FULL)]))
    assert "Q_a_W: what more than 100 does is extrapolated" in design.notes[0]
    assert not design_controller(model, ControlPlan([(A, FULL), (B, FULL)])).notes


@pytest.mark.parametrize("output", [X, Y])
def test_weights_of_states_are_no_lack_of_a_heater(model, output):
    # Held alone it asks for negative heat as well, so that --hold is no advice.
    plan = ControlPlan([(A, FULL), (B, FULL)], "state-lqr", outputs=[output])
    alone = design_controller(model, plan).trials[0]
    assert min(power for power, _ in alone.asked.values()) < 0
    together = design_controller(model, replace(plan, outputs=())).trials[0]
    for trial in (alone, together):
        assert trial.needs == "the other methods need none"


def test_what_is_held_within_the_slew_rate_is_what_is_told(model):
    def held(slew):
        plan = ControlPlan([(A, FULL), (B, FULL)], "output-lqr", slew=slew)
        return design_controller(model, plan).trials[0]

    slow, quick = held(0.05), held(100.0)
    heats = np.column_stack(list(slow.heats.values()))
    assert np.diff(heats, axis=0).max() <= 0.05 * DT + 1e-9
    assert np.ptp(slow.held[X]) > 5 * np.ptp(quick.held[X])


@pytest.mark.slow
def test_what_cannot_be_is_refused_in_a_line(model):
    def refused(paths, plan):
        with pytest.raises(ModelError) as found:
            design_controller(designed(machine(paths)), plan)
        assert "\n" not in str(found.value)
        return str(found.value)

    both = [(A, FULL), (B, FULL)]
    assert "Q_c_W is not a drive" in refused(PATHS, ControlPlan([("Q_c_W", 1.0)]))
    assert "no power between 0 and -5" in refused(PATHS, ControlPlan([(A, -5.0)]))
    assert "given twice" in refused(PATHS, ControlPlan([(A, FULL), (A, 5.0)]))
    assert "no deflection" in refused(PATHS, ControlPlan(both, outputs=["d_q_um"]))
    assert "cannot be -1" in refused(PATHS, ControlPlan(both, tolerance={X: -1.0}))
    assert "below the sample period" in refused(PATHS, ControlPlan(both, horizon=2.0))
    no_x = {ends: lags for ends, lags in PATHS.items() if ends not in ((A, X), (B, X))}
    assert "d_x_um cannot be controlled" in refused(no_x, ControlPlan(both))
    idle = {ends: lags for ends, lags in PATHS.items() if ends[0] != B or ends[1] == PROBE}
    idle[B, PROBE] = [(0.002, 700.0)]
    assert "Q_b_W acts on none" in refused(idle, ControlPlan(both))
    # A calibration has a term for each, and a gain of next to nothing where nothing acts.
    faint = {**no_x, (A, X): [(1e-4, 200.0)], (B, X): [(-1e-3, 200.0)]}
    said = refused(faint, ControlPlan(both))
    assert "d_x_um cannot be controlled: full power of Q_a_W, Q_b_W moves it by 0.1 " in said
    faint = {**idle, (B, X): [(1e-4, 200.0)], (B, Y): [(1e-3, 200.0)]}
    assert "Q_b_W acts on none of d_x_um, d_y_um: full" in refused(faint, ControlPlan(both))
    assert "power of Q_main_W is not measured" in refused(PATHS, ControlPlan([(MAIN, 9.0)]))
    said = refused(PATHS, ControlPlan(both, slew=1e-9))
    assert "d_x_um cannot be controlled: what the slew rate allows of Q_a_W, Q_b_W moves" in said
    assert "is it in mW?" in refused(PATHS, ControlPlan([(A, 1000 * FULL), (B, FULL)]))
    assert "is it in kW?" in refused(PATHS, ControlPlan([(A, FULL / 1000), (B, FULL)]))
    one = design_controller(model, ControlPlan([(A, FULL)]))
    assert "together: not all of them can be held" in one.notes[0]
    assert replace(one.controller, duration=100.0).document()["duration_s"] == 100.0
