"""Three verdicts, and what no cause explains: on a machine of two masses, written by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt
from thermaltool.diagnosis.assumptions import released
from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.no_signature import too_short
from thermaltool.diagnosis.residual_budget import ResidualBudget, misfit_of
from thermaltool.diagnosis.verdict import verdict_of
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.model import Model, Output
from thermaltool.record import Record
from thermaltool.report.calibration import calibration_warnings

DUTY = np.repeat([0.0, 1.0, 0.0, 0.6, 0.3, 1.0, 0.0, 0.8, 0.0, 0.5], 120)
TIME = 3.0 * np.arange(len(DUTY))
# A pump of a few irregular runs in the second half of the log.
PUMP = np.zeros(len(DUTY))
for begin, length in ((620, 40), (705, 25), (790, 70), (930, 35), (1060, 80)):
    PUMP[begin : begin + length] = 1.0


def machine(heat: np.ndarray, seed: int, noise: float = 0.1, slowness: float = 1.0) -> np.ndarray:
    """Deflection of a mass that a hotter one warms, read with noise [µm]."""
    hot = cold = 0.0
    found = []
    for q in np.append(0.0, heat[:-1]):
        hot += 3.0 * (20 * q - hot) / 150
        cold += 3.0 * (3 * slowness * hot - cold) / (500 * slowness)
        found.append(cold)
    return np.array(found) + noise * np.random.default_rng([1122, seed]).standard_normal(len(heat))


def log(deflection: np.ndarray, name: str, heat: np.ndarray = DUTY) -> Record:
    return Record(TIME[: len(heat)], {"Q_main_1": heat, "d_y_um": deflection}, digest=name)


@pytest.fixture(scope="module")
def model() -> Model:
    plan = CalibrationPlan(("Q_main_1",), (), ("d_y_um",))
    return calibrate([log(machine(DUTY, 1), "calibration")], plan)


def test_what_no_cause_explains_is_told_with_its_place(model: Model) -> None:
    """Something pulls at the probe now and then: no heat, no drift, no step of one instant."""
    found = diagnose(model, [log(machine(DUTY, 2) + 3.0 * PUMP, "pump")])
    (cause,) = [c for c in found.causes if c.effect.name == "unknown"]
    assert found.verdict == "not adequate"
    assert cause.location is not None
    assert (cause.effect.channel, cause.location.log) == ("d_y_um", "pump")
    # Its runs are in the second half.
    assert cause.location.start > TIME[560]
    assert 0.3 < cause.location.rms < 3.0
    assert found.document()["causes"][-1]["location"]["output"] == "d_y_um"
    # It is no part of what is written.
    assert all(effect.name != "unknown" for effect in found.model.effects)


@pytest.mark.parametrize("size", [1.0, 4.0])
@pytest.mark.slow
def test_one_bad_log_among_good_ones_is_not_averaged_away(model: Model, size: float) -> None:
    """Three humps of no cause in the second of four days."""
    humps = sum(
        height * np.exp(-0.5 * ((TIME - middle) / width) ** 2)
        for height, middle, width in ((1.2, 1500, 120), (-1.0, 2600, 200), (1.1, 4100, 160))
    )
    days = [machine(DUTY, seed) for seed in (20, 21, 22, 23)]
    days[1] = days[1] + size * humps
    found = diagnose(model, [log(day, f"day {k}") for k, day in enumerate(days)])
    (cause,) = found.causes
    assert (found.verdict, cause.effect.name) == ("not adequate", "unknown")
    assert cause.location is not None
    assert cause.location.log == found.residuals["d_y_um"].log == "day 1"
    assert found.noise_share < 0.2


@pytest.mark.parametrize("step", [0.0, 1.0])
@pytest.mark.slow
def test_a_noisier_log_among_others_has_a_noise_of_its_own(model: Model, step: float) -> None:
    """Three times the noise, or readings in whole micrometres."""
    days = [machine(DUTY, seed) for seed in (30, 31, 32, 33)]
    days[1] = machine(DUTY, 31, noise=0.1 if step else 0.3)
    if step:
        days[1] = step * np.round(days[1] / step)
    found = diagnose(model, [log(day, f"day {k}") for k, day in enumerate(days)])
    assert (found.verdict, found.causes) == ("adequate", ())


@pytest.mark.slow
def test_a_start_that_simulate_finds_is_told(model: Model) -> None:
    """Slow heat that is there at the first row, and a day that begins at rest."""
    warm = machine(DUTY, 41) - 6.0 * np.exp(-TIME / 900)
    found = diagnose(model, [log(machine(DUTY, 40), "cold"), log(warm, "warm")])
    assert found.verdict == "adequate"
    assert any("not begin at rest" in note for note in found.notes)


@pytest.mark.slow
def test_a_short_calibration_comes_before_any_cause() -> None:
    """Fifteen minutes with one step leave open what a machine of eight minutes does later."""
    rows = 300
    plan = CalibrationPlan(("Q_main_1",), (), ("d_y_um",))
    model = calibrate([log(machine(DUTY, 3)[:rows], "short", DUTY[:rows])], plan)
    found = diagnose(model, [log(machine(DUTY, 4), "long")])
    assert [cause.effect.name for cause in found.causes] == ["record_too_short"]
    # One that goes no further than twice the calibration does not say which of the two it is.
    found = diagnose(model, [log(machine(DUTY, 4)[:500], "as long", DUTY[:500])])
    assert (found.verdict, found.causes) == ("cannot judge", ())
    assert "calibrate on one that lasts three of them" in found.undecided[0]


def says_too_short(model: Model, deflection: np.ndarray, covered: float = 1.9) -> bool:
    """Whether 25 minutes say that a calibration of so many time constants is too short."""
    rows = 500
    outputs = tuple(replace(o, fit={**o.fit, "covered": covered}) for o in model.outputs)
    model = replace(model, outputs=outputs)
    tight = frozenset({"offset", "accepted", "effects", "tight"})
    later = log(deflection[:rows], "later", DUTY[:rows])
    before = Hypothesis.of(model, (later,), model, tight)
    cause = too_short(model, before, before.under(released(tight), model).fitted())
    return cause is not None


@pytest.mark.slow
def test_something_slow_besides_is_no_short_calibration(model: Model) -> None:
    """A model that is free bends with it, and does not come to be right."""
    for middle in (450.0, 700.0, 1200.0):
        for width in (100.0, 200.0, 400.0):
            hump = 3.0 * np.exp(-0.5 * ((TIME - middle) / width) ** 2)
            assert not says_too_short(model, machine(DUTY, 12) + hump)
    # One that has not even seen one time constant is too short whatever else there is.
    assert says_too_short(model, machine(DUTY, 12) + hump, covered=0.7)
    for slowness in (1.1, 1.3, 2.0):
        assert says_too_short(model, machine(DUTY, 11, slowness=slowness))


@pytest.mark.parametrize(
    ("shown", "unexplained", "calibrated", "misfit", "verdict"),
    [
        (1.2, 1.1, 1.1, 0.0, "adequate"),
        (9.0, 1.1, 1.1, 0.0, "cannot judge"),  # by what the calibration leaves open
        (9.0, 8.0, 1.1, 0.0, "not adequate"),
        (1.2, 1.1, 7.0, 0.0, "cannot judge"),  # the calibration itself is no better
        (9.0, 8.0, 3.2, 3.0, "cannot judge"),  # and leaves nearly as much on any log
        (9.0, 8.0, 2.2, 2.0, "not adequate"),
        (3.2, 3.0, 1.1, 0.0, "cannot judge"),  # most is explained, but a clean log has 1.4
        (3.2, 3.0, 1.1, 1.0, "adequate"),  # ... unless the calibration itself is off
    ],
)
def test_what_decides(
    shown: float, unexplained: float, calibrated: float, misfit: float, verdict: str
) -> None:
    budget = ResidualBudget(10.0, shown, unexplained, 1.0, 1.0, calibrated, misfit, 50.0)
    assert verdict_of({("d_y_um", 0): budget}, ()) == verdict


@pytest.mark.parametrize(("total", "verdict"), [(1.2, "adequate"), (4.0, "cannot judge")])
def test_a_calibration_that_is_far_off_is_no_measure_of_what_is_left(
    total: float, verdict: str
) -> None:
    """Off by seven times the noise: where later logs leave more than noise it says nothing."""
    budget = ResidualBudget(total, 1.2, 1.1, 1.0, 1.0, 7.0, 0.0, 50.0)
    assert verdict_of({("d_y_um", 0): budget}, ()) == verdict


def together(spread: float, kind: str | None, draw: int) -> Model:
    """Calibrated on a fan that went with the heater but for so much."""
    other = np.repeat(np.random.default_rng(6).uniform(-spread, spread, 60), 20)
    fan = np.clip(DUTY + other, 0, 1)
    kinds = {} if kind is None else {"d_y_um": kind}
    plan = CalibrationPlan(
        ("Q_main_1", "Q_fan_1"), (), ("d_y_um",), kinds=kinds, choose=kind is None
    )
    known = log(machine(DUTY + 0.5 * fan, draw), "together").with_columns({"Q_fan_1": fan})
    return calibrate([known], plan)


@pytest.fixture(scope="module")
def unparted() -> Model:
    """A fan that went with the heater so nearly that the model is without a response to it."""
    return together(0.01, None, 7)


@pytest.mark.slow
@pytest.mark.parametrize("day", ["alone", "apart"])
def test_what_the_calibration_leaves_open_is_told_by_its_drive(unparted: Model, day: str) -> None:
    """The fan runs alone another day, or beside the heater at other times."""
    heat, fan = {"alone": (0 * DUTY, DUTY), "apart": (DUTY, DUTY[::-1])}[day]
    other = log(machine(heat + 0.5 * fan, 8), day, heat).with_columns({"Q_fan_1": fan})
    found = diagnose(unparted, [other])
    assert (found.verdict, found.causes) == ("cannot judge", ())
    assert "leaves open" in found.undecided[0]
    assert "Q_fan_1" in found.undecided[0]


@pytest.mark.slow
def test_what_two_drives_share_is_left_open() -> None:
    """The model has a response to the fan, but hardly knows it."""
    alone = log(machine(0.5 * DUTY, 8), "alone", 0 * DUTY).with_columns({"Q_fan_1": DUTY})
    found = diagnose(together(0.03, None, 7), [alone])
    assert (found.verdict, found.causes) == ("cannot judge", ())
    assert "leaves open the response to Q_fan_1, which makes" in found.undecided[0]


@pytest.mark.slow
def test_a_drive_that_went_with_another_is_told_as_such(unparted: Model) -> None:
    (output,) = unparted.outputs
    assert [term.drive for term in unparted.terms] == ["Q_main_1"]
    known = output.fit["discrepancy"]
    fan = [k for k, (drive, _) in enumerate(known["lags"]) if drive == "Q_fan_1"]
    gains = np.array(known["spread"])[:, fan].sum(axis=1)
    # The true one is 30 µm.
    assert np.max(np.abs(gains)) > 15
    (told,) = [line for line in calibration_warnings(unparted) if "without Q_fan_1" in line]
    assert "these logs do not tell whose response is whose" in told


@pytest.mark.slow
@pytest.mark.parametrize("draw", [7, 17, 27, 37])
def test_ends_of_a_search_that_come_as_near_are_all_possible(draw: int) -> None:
    """Twelve parameters for what four do: drives share the response in many ways."""
    (output,) = together(0.1, "deflection", draw).outputs
    assert len(output.fit["discrepancy"]["spread"])


@pytest.mark.parametrize("is_drive", [False, True])
@pytest.mark.slow
def test_heat_of_an_unknown_channel_comes_by_two_lags(model: Model, is_drive: bool) -> None:
    """As that of the drive does: a column beside the model, or a drive without a response."""
    fan = np.repeat(np.append(0.0, np.random.default_rng(3).uniform(0, 1, 23)), 50)
    if is_drive:
        drive = replace(model.drives[0], channel="Q_fan_1")
        model = replace(model, drives=(*model.drives, drive))
    found = diagnose(
        model, [log(machine(DUTY + 0.5 * fan, 9), "fan").with_columns({"Q_fan_1": fan})]
    )
    (cause,) = found.causes
    assert (cause.effect.name, cause.effect.channel) == ("second_source", "Q_fan_1")
    low, high = cause.intervals["gain[d_y_um]"]
    assert low < 30 < high
    assert high - low < 3
    lags = [cause.effect.parameters[name] for name in ("time_constant", "slow_time_constant")]
    np.testing.assert_allclose(lags, [150, 500], rtol=0.1)


def test_what_a_log_shows_about_once_is_not_judged() -> None:
    slow, shown = (ResidualBudget(3.0, 3.0, 3.0, 1.0, 1.0, 1.1, 0.0, rows) for rows in (1.0, 50.0))
    assert verdict_of({("d_y_um", 0): slow}, ()) == "cannot judge"
    assert verdict_of({("d_y_um", 0): shown}, ()) == "not adequate"


def test_evidence_grows_with_what_is_left() -> None:
    small, large = (
        ResidualBudget(10.0, rms, rms, 1.0, 1.0, 1.1, 0.0, 50.0).evidence for rms in (2.0, 4.0)
    )
    assert 0 < small < large
    assert ResidualBudget(1.0, 1.0, 1.0, 1.0, 1.0, 1.1, 0.0, 50.0).evidence == 0


@pytest.mark.slow
@pytest.mark.parametrize("burst", [1, 3])
def test_wrong_bursts_are_found(model: Model, burst: int) -> None:
    """Readings come in threes; a wrong one is alone, or all three are wrong, by 4 mm."""
    time = np.repeat(60.0 * np.arange(400), 3) + np.tile([0.0, 4.0, 8.0], 400)
    wrong = np.zeros(len(time), bool)
    for k in (31, 77, 140, 255, 300, 344, 391):
        wrong[3 * k : 3 * k + burst] = True
    heat = np.where((time > 3000) & (time < 12000), 1.0, 0.0)
    fine = np.arange(0.0, time[-1] + 3, 3.0)
    clean = np.interp(time, fine, machine((((fine > 3000) & (fine < 12000)) * 1.0), 5, 0.0))
    noise = 0.1 * np.random.default_rng(1122).standard_normal(len(time))
    record = Record(
        time, {"Q_main_1": heat, "d_y_um": clean + noise + 4000.0 * wrong}, digest="bursts"
    )
    found = diagnose(model, [record])
    assert found.causes[0].effect.name == "outliers"
    assert found.residuals["d_y_um"].noise.white < 0.2


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_a_reading_that_stands_still_is_judged_in_silence(model: Model) -> None:
    found = diagnose(model, [log(np.full(len(DUTY), 5.0), "dead")])
    assert found.verdict == "not adequate"


OUTPUT = "T_a_degC"


def left_of_calibration(left: float) -> Model:
    """A model that has left so much of its calibration, beside 0.01 °C of white noise."""
    known = {"white_sigma": 0.01, "drift_sigma": 1.0}
    fit = {"rmse": left, "rmse_zero_free": left, "discrepancy": known}
    return Model((), (Output(OUTPUT, "sensor", 20.0, (0.0, 10.0), fit),), (), 1.0)


@pytest.mark.parametrize(("left", "share"), [(0.01, 0.0), (0.011, 0.0), (0.0225, 1.0), (0.05, 1.0)])
def test_a_misfit_that_is_lost_in_the_noise_does_not_count(left: float, share: float) -> None:
    misfit = misfit_of(left_of_calibration(left), OUTPUT)
    assert misfit == pytest.approx(share * np.sqrt(left**2 - 0.01**2), abs=1e-9)


def test_between_noise_and_misfit_there_is_no_cliff() -> None:
    lefts = np.linspace(0.01, 0.04, 200)
    found = [misfit_of(left_of_calibration(left), OUTPUT) for left in lefts]
    assert np.all(np.diff(found) >= 0)
    assert np.max(np.diff(found)) < 0.001


@pytest.mark.slow
def test_a_log_in_which_nothing_moves_cannot_judge():
    time, noise = np.arange(0.0, 6000.0, 10.0), np.random.default_rng(5)

    def log(heat, swing=0.0):
        rise, room = np.zeros(len(time)), 20 + swing * np.sin(time / 900)
        for k, each in enumerate(heat[:-1]):
            rise[k + 1] = rise[k] + (0.2 * each - rise[k]) * 10 / 400
        read = 1 + room + rise + 0.03 * noise.standard_normal(len(time))
        return pd.DataFrame(
            {"time_s": time, "Q_motor_W": heat, "T_room_degC": room, "T_frame_degC": read}
        )

    def quiet(line):
        pass

    duty = np.where((time > 500) & (time < 3000), 100.0, 0.0)
    drives = ["Q_motor_W"]
    both = tt.calibrate(
        log(duty, 1.0), [*drives, "T_room_degC"], sensors=["T_frame_degC"], warn=quiet
    )
    still = tt.diagnose(both, log(0 * duty, 1.0), warn=quiet).document()
    assert any("Q_motor_W never acts" in note for note in still["notes"])

    model = tt.calibrate(log(duty), drives, sensors=["T_frame_degC"], warn=quiet)
    idle, driven = (
        tt.diagnose(model, log(duty * share), warn=quiet).document() for share in (1e-5, 0.02)
    )
    assert idle["verdict"] == "cannot judge"
    assert "Q_motor_W" in idle["undecided"][0]
    assert driven["verdict"] == "adequate"


def driven_frame(heat, noise=None, frozen=False):
    """One mass by hand in Euler steps from its steady state at the first heat, by rows of 10 s."""
    time, rise = 10.0 * np.arange(len(heat)), np.full(len(heat), 0.2 * heat[0])
    for k, each in enumerate(heat[:-1]):
        rise[k + 1] = rise[k] + (0.2 * each - rise[k]) * 10 / 400
    read = np.full(len(time), 33.5) if frozen else 21 + rise
    if noise is not None:
        read = read + 0.03 * noise.standard_normal(len(time))
    return pd.DataFrame({"time_s": time, "Q_motor_W": heat, "T_frame_degC": read})


@pytest.fixture(scope="module")
def one_mass():
    time = np.arange(0.0, 6000.0, 10.0)
    duty = np.where((time > 500) & (time < 3000), 100.0, 0.0)
    log = driven_frame(duty, np.random.default_rng(7))
    fit = tt.calibrate(log, ["Q_motor_W"], sensors=["T_frame_degC"], warn=lambda line: None)
    return fit, duty


@pytest.mark.slow
def test_a_steady_state_cannot_judge(one_mass):
    """A drive that acts all along moves nothing that its steady state has not."""
    model, duty = one_mass
    log = driven_frame(np.full(len(duty), 60.0), np.random.default_rng(8))
    found = tt.diagnose(model, log, warn=lambda line: None).document()
    assert found["verdict"] == "cannot judge"
    assert "Q_motor_W" in found["undecided"][0]


@pytest.mark.slow
def test_a_sensor_that_never_moves_is_frozen(one_mass):
    model, duty = one_mass
    log = driven_frame(duty, frozen=True)
    found = tt.diagnose(model, log, warn=lambda line: None).document()
    assert [(c["name"], c["channel"]) for c in found["causes"]] == [
        ("sensor_frozen", "T_frame_degC")
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "told"),
    [
        (1.2, "and lasts: <frame> has it from the first row on"),
        pytest.param(0.6, "alone", marks=pytest.mark.slow),
    ],
)
def test_another_log_that_is_wrong_as_well_is_told(share, told):
    """What is as large there lasts, or has happened again; anything else is another trouble."""
    time, noise = np.arange(0.0, 6000.0, 10.0), np.random.default_rng(6)
    duty = np.where((time > 500) & (time < 4000), 100.0, 0.0)

    def log(acting):
        rise = np.zeros(len(time))
        for k, each in enumerate(acting[:-1]):
            rise[k + 1] = rise[k] + (0.2 * each - rise[k]) * 10 / 400
        read = 21 + rise + 0.03 * noise.standard_normal(len(time))
        return pd.DataFrame({"time_s": time, "Q_motor_W": duty, "T_frame_degC": read})

    def quiet(line):
        pass

    model = tt.calibrate(log(duty), ["Q_motor_W"], sensors=["T_frame_degC"], warn=quiet)
    step = np.where(time > 2000, 1.2 * duty, duty)
    found = tt.diagnose(model, log(step), validate=[log(share * duty)], warn=quiet)
    document = found.document()
    assert document["causes"][0]["name"] == "drive_gain_step"
    notes = [note for note in document["notes"] if "is wrong as well" in note]
    assert [", not by the same, and stays so" in each for each in notes] == [True] * (share < 1)
    (line,) = (each for each in found.table().splitlines() if each.startswith("Cause:"))
    assert f", in <frame> {told}: " in line
