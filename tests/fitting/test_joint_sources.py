"""A joint is calibrated from levels of the heat, and refused where they cannot show one."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt
from thermaltool.control.design import ControlPlan, design_controller
from thermaltool.errors import FitError, LogError, ModelError
from thermaltool.plants import build
from thermaltool.runtime.heaters import held_output
from thermaltool.runtime.refusal import refused_setpoints

STEP, ROWS, SHORT = 45.0, 160, 9.0  # [s], rows, [s]
CONTACT, FAR, NEAR, BENT = "T_joint_degC", "T_far_degC", "dT_near_K", "d_y_um"
ROLES = {"drives": "Q_main_1", "sensors": NEAR, "deflections": BENT}
# Chosen before, so that nothing is searched that is not asked here.
KINDS = {NEAR: "rational1", CONTACT: "rational1", FAR: "rational1", BENT: "rational2"}
# Above this temperature beside the source heat goes another way [K].
OPENS, GAIN, NOISE = 4.0, -6.0, 0.005


def machine(heat, seed=1, opens=OPENS, gain=GAIN):
    """Lags by small steps; what the contact loses above `opens` bends the machine later."""
    rng = np.random.default_rng(seed)
    near = warm = late = bent = lost = behind = 0.0
    rows = []
    for level in heat:
        rows.append(
            [near, 20 + warm + lost, 20 + 0.8 * warm, 30 * late + 20 * bent + gain * behind]
        )
        for _ in range(round(STEP / SHORT)):
            near += SHORT * (5 * level - near) / 150
            warm += SHORT * (6 * level - warm) / 2000
            lost += SHORT * (-0.4 * max(near - opens, 0.0) - lost) / 900
            late += SHORT * (level - late) / 600
            bent += SHORT * (level - bent) / 2500
            behind += SHORT * (lost - behind) / 700
    read = dict(zip((NEAR, CONTACT, FAR, BENT), np.array(rows).T, strict=True))
    noise = {BENT: 10 * NOISE}
    columns = {c: y + noise.get(c, NOISE) * rng.normal(size=len(y)) for c, y in read.items()}
    return pd.DataFrame({"time_s": STEP * np.arange(len(heat)), "Q_main_1": heat, **columns})


def steps(*levels, **given):
    return [machine(np.full(ROWS, level), 1 + k, **given) for k, level in enumerate(levels)]


def fitted(data, joint=(), **options):
    contacts = [joint] if isinstance(joint, str) else list(joint)
    kinds = {c: k for c, k in KINDS.items() if c in (NEAR, BENT, *contacts)}
    return tt.calibrate(
        data, **ROLES, kinds=kinds, joint=contacts, starts=1, warn=lambda message: None, **options
    )


def off(fit, level):
    """Largest error at an unseen level, means over nine rows [µm]."""
    log = tt.read_log(machine(np.full(ROWS, level), 9))
    left = log.column(BENT) - fit.model.simulate(log)[BENT]
    return np.max(np.abs(np.convolve(left, np.ones(9) / 9, "valid")))


@pytest.fixture(scope="module")
def three():
    """Calibrated from three levels, and what was told."""
    told = []
    fit = tt.calibrate(
        steps(0.4, 0.7, 1.6), **ROLES, kinds=KINDS, joint=[FAR, CONTACT], starts=1, warn=told.append
    )
    return fit, told


def test_a_contact_temperature_tells_what_other_levels_do(three):
    fit, told = three
    linear = fitted(steps(0.7), initial="rest", linear=True)
    assert [effect.partner for effect in fit.model.effects if effect.partner] == [CONTACT]
    assert told == [f"{FAR}: left out: it says nothing more of the joint"]
    assert [output.channel for output in fit.model.outputs] == [NEAR, BENT, CONTACT]
    assert any(f"told by what {CONTACT} reads" in note for note in fit.notes)
    # Between the levels, and a quarter above them.
    assert off(linear, 1.2) > 3.0
    assert off(fit, 1.2) < 0.05 * off(linear, 1.2)
    assert off(fit, 2.0) < 0.05 * off(linear, 2.0)
    # No bend that the machine does not have, and what it has to a tenth.
    (joint,) = fit.model.effects
    _, _, contact, deviation = joint.gains(BENT)
    assert contact + deviation == pytest.approx(GAIN, rel=0.1)
    assert joint.parameters["time_constant"] == pytest.approx(700, rel=0.1)


def test_one_log_of_several_levels_will_do():
    fit = fitted([machine(np.repeat([0.7, 1.6, 0.4], ROWS))], CONTACT)
    assert {effect.partner for effect in fit.model.effects} == {CONTACT}
    assert off(fit, 1.2) < 0.6


def test_a_displacement_that_stays_takes_no_joint_from_another(three):
    still, rng = "d_z_um", np.random.default_rng(5)
    logs = [each.assign(**{still: 0.05 * rng.normal(size=ROWS)}) for each in steps(0.4, 0.7, 1.6)]
    roles = {**ROLES, "deflections": [BENT, still]}
    kinds = {c: k for c, k in KINDS.items() if c != FAR} | {still: "rational1"}
    fit = tt.calibrate(logs, **roles, kinds=kinds, joint=CONTACT, starts=1, warn=lambda m: None)
    (joint,) = fit.model.effects
    assert joint.partner == CONTACT
    assert joint.gains(BENT) == pytest.approx(three[0].model.effects[0].gains(BENT))
    assert joint.gains(still) == (0.0, 0.0, 0.0, 0.0)


def test_a_displacement_that_departs_otherwise_takes_no_contact_from_another(three):
    """By a power of the heat, and by more than a kelvin at the contact may bend it."""
    other, rng = "d_z_um", np.random.default_rng(5)
    logs = []
    for each in steps(0.4, 0.7, 1.6):
        rises = 1 - np.exp(-STEP * np.arange(ROWS) / 900)
        bends = 20 * each["Q_main_1"] ** 1.5 * rises + 10 * NOISE * rng.normal(size=ROWS)
        logs.append(each.assign(**{other: bends}))
    roles = {**ROLES, "deflections": [BENT, other]}
    kinds = {c: k for c, k in KINDS.items() if c != FAR} | {other: "rational1"}
    fit = tt.calibrate(logs, **roles, kinds=kinds, joint=CONTACT, starts=1, warn=lambda m: None)
    (joint,) = fit.model.effects
    assert joint.partner == CONTACT
    assert joint.gains(BENT) == pytest.approx(three[0].model.effects[0].gains(BENT))
    assert joint.gains(other) == (0.0, 0.0, 0.0, 0.0)


def test_what_one_kind_has_is_fixed_where_it_is():
    kinds = {NEAR: "conduction", CONTACT: "rational1", BENT: "rational2"}
    fit = tt.calibrate(
        steps(0.7, 1.6), **ROLES, kinds=kinds, joint=CONTACT, starts=1, fixed={"r0": 0.12},
        warn=lambda message: None,
    )  # fmt: skip
    (near,) = (term.response for term in fit.model.terms if term.output == NEAR)
    assert near.r0 == 0.12
    with pytest.raises(ModelError, match=r"cannot fix tau9: only .*r0.* can be fixed"):
        tt.calibrate(steps(0.7, 1.6), **ROLES, kinds=kinds, joint=CONTACT, fixed={"tau9": 1.0})


def test_a_contact_that_hardly_departs_is_refused_as_that():
    kinds = {c: KINDS[c] for c in (BENT, CONTACT)}
    with pytest.raises(FitError, match=f"as {CONTACT} tell, but by more a kelvin"):
        tt.calibrate(
            steps(0.4, 0.7, 1.6, gain=-60.0), "Q_main_1", deflections=BENT, kinds=kinds,
            joint=CONTACT, starts=1, warn=lambda message: None,
        )  # fmt: skip


@pytest.mark.slow
def test_a_contact_is_read_and_not_judged(three):
    fit, _ = three
    off_by = {output.channel: output.fit["rmse"] for output in fit.model.outputs}
    assert off_by[CONTACT] > 0.5 > max(off_by[NEAR], off_by[BENT])
    assert not fit.exceeds(0.5)
    log = machine(np.repeat([0.0, 1.2, 0.6], [10, 130, 60]), 9)
    simulated = tt.simulate(fit, log, warn=lambda message: None)
    assert simulated.agreements[CONTACT].rmse > 0.5
    assert not simulated.exceeds(0.5)
    assert not tt.simulate(fit, log[["time_s", "Q_main_1", CONTACT]], warn=lambda m: None).judged
    found = tt.diagnose(fit, log, warn=lambda message: None)
    assert found.adequate
    assert not found.diagnosis.causes


def test_a_contact_is_not_compensated(three, tmp_path):
    model = three[0].model
    assert [output.channel for output in model.deflections] == [BENT]
    assert held_output(model, None) == BENT
    with pytest.raises(ModelError, match=rf"{CONTACT} is no deflection .* there are {BENT}$"):
        design_controller(model, ControlPlan([("Q_main_1", 1.0)], outputs=[CONTACT]))
    tt.write_model(model, str(tmp_path / "model.json"))
    assert refused_setpoints(str(tmp_path / "model.json"), None) == ["offset_y_um"]


@pytest.mark.slow
def test_contacts_are_read_beside_the_sensors_and_are_no_setpoint(three):
    fit, _ = three
    rng = np.random.default_rng(3)
    idle = {c: 20 * (c == CONTACT) + NOISE * rng.normal(size=400) for c in (NEAR, CONTACT)}
    noise = tt.noise(pd.DataFrame({"time_s": STEP * np.arange(400), **idle}), warn=print)
    design = tt.regularize(fit, noise, warn=lambda message: None)
    log = machine(np.full(ROWS, 1.2), 9)
    frame = tt.estimate(design, log.drop(columns="Q_main_1"), warn=lambda message: None).frame
    assert CONTACT not in frame
    left = (log[BENT].to_numpy() - frame[BENT].to_numpy())[40:]
    assert np.max(np.abs(np.convolve(left, np.ones(9) / 9, "valid"))) < 0.5


@pytest.mark.parametrize(
    ("levels", "options", "error", "words"),
    [
        ((0.7, 0.7), {}, FitError, "these logs have one (Q_main_1 = 0.7)"),
        ((0.4, 0.7), {"opens": 99.0}, FitError, "no joint shows in these logs"),
        ((0.4, 0.7), {"joint": "T_lost_degC"}, LogError, "no column T_lost_degC"),
        ((0.4, 0.7), {"joint": "n_fan_rpm"}, LogError, "no column n_fan_rpm"),
        ((0.4, 0.7), {"joint": NEAR}, ModelError, "named twice"),
        ((0.4, 0.7), {"joint": "Q_main_1"}, ModelError, "not a temperature"),
        ((0.4, 0.7), {"initial": "free"}, ModelError, "--initial free"),
    ],
)
def test_what_shows_no_joint_is_refused_in_one_line(levels, options, error, words):
    given = {"opens": options.pop("opens")} if "opens" in options else {}
    with pytest.raises(error) as raised:
        fitted(steps(*levels, **given), **{"joint": CONTACT, **options})
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_joint_bends_a_displacement():
    with pytest.raises(ModelError, match="a displacement among the deflections"):
        tt.calibrate(steps(0.4, 0.7), "Q_main_1", sensors=NEAR, joint=CONTACT)


def test_a_joint_does_not_go_with_components():
    with pytest.raises(ValueError, match="--joint does not go with --reduce"):
        tt.calibrate(steps(0.4, 0.7), "Q_main_1", deflections=BENT, joint=CONTACT, reduce="pca")


@pytest.mark.slow
def test_the_joint_of_the_knee_mill_is_found_and_told():
    """More than half of a departure between the levels, where the joint is not known."""
    plant, names = build("knee-mill"), [f"T_joint{k}_degC" for k in (1, 2, 3, 4)]

    def run(level, seed, sigma=1.0):
        heat, rng = np.full(301, level), np.random.default_rng(seed)
        columns = {"time_s": STEP * np.arange(301), "Q_main_1": heat}
        for name, y in plant.simulate(heat, np.full(301, 20.0), STEP).items():
            columns[name] = y + sigma * rng.normal(size=301) * (
                0.2 if name.endswith("um") else 0.02
            )
        return pd.DataFrame(columns)

    roles = {"drives": "Q_main_1", "sensors": "dT_main_K", "deflections": ["d_x_um", "d_y_um"]}
    logs = [run(level, k) for k, level in enumerate((0.5, 1.0, 2.0))]
    fit = tt.calibrate(logs, **roles, joint=names, warn=lambda message: None)
    assert "T_joint1_degC" in {effect.partner for effect in fit.model.effects}
    truth, reference = tt.read_log(run(1.5, 9, sigma=0.0)), run(1.0, 9, sigma=0.0)
    found = fit.model.simulate(truth)
    for output in roles["deflections"]:
        departure = truth.column(output) - 1.5 * reference[output].to_numpy()
        left = np.max(np.abs(truth.column(output) - found[output]))
        assert left < 0.5 * np.max(np.abs(departure))
