"""The whole diagnosis on logs made by hand, on measured ones, and on bad ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference.measured import MAPS, whole_log

from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.errors import FitError, ModelError
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.logs import read_log
from thermaltool.model import Model, dumps, loads
from thermaltool.record import Record

LEVELS = np.repeat([0.0, 1.0, 0.0, 0.6, 0.3, 1.0, 0.0, 0.8, 0.0, 0.5], 120)
TIME = 3.0 * np.arange(len(LEVELS))


def machine(heat: np.ndarray, seed: int) -> dict[str, np.ndarray]:
    """Two masses by hand, with noise; `heat` is what acts."""
    warm, rows = np.zeros(2), []
    for q in np.append(0.0, heat[:-1]):
        warm = warm + 3.0 * np.array([(20 * q - warm[0]) / 150, (3 * warm[0] - warm[1]) / 500])
        rows.append(warm)
    noise = np.random.default_rng([20261121, seed]).standard_normal((2, len(heat)))
    rise, deflection = np.array(rows).T
    return {"dT_pair1_K": rise + 0.02 * noise[0], "d_y_um": deflection + 0.1 * noise[1]}


@pytest.fixture(scope="module")
def model() -> Model:
    plan = CalibrationPlan(
        ("Q_main_1",), ("dT_pair1_K",), ("d_y_um",), {"dT_pair1_K": "deflection"}
    )
    return calibrate([Record(TIME, {"Q_main_1": LEVELS, **machine(LEVELS, 1)})], plan)


def log(acting: np.ndarray, seed: int, **more: np.ndarray) -> Record:
    return Record(TIME, {"Q_main_1": LEVELS, **machine(acting, seed), **more}, digest=f"log {seed}")


@pytest.mark.slow
def test_a_clean_log_is_adequate(model: Model) -> None:
    found = diagnose(model, [log(LEVELS, 2)])
    assert found.adequate
    assert not found.causes
    assert found.model.effects == ()
    assert 0.8 < found.noise_share <= 1


@pytest.mark.slow
def test_heat_by_the_square_is_found_and_then_known(model: Model) -> None:
    wrong = log(LEVELS**2, 3)
    found = diagnose(model, [wrong])
    cause = found.causes[0]
    assert not found.adequate
    assert (cause.effect.name, cause.effect.channel) == ("drive_nonlinearity", "Q_main_1")
    low, high = cause.intervals["exponent"]
    assert low < 2.0 < high
    assert high - low < 0.3
    assert all(g.claimed for g in cause.gain.values())
    # The extended model is one file, simulates what was measured, and needs no further cause.
    extended = loads(dumps(found.model))
    before, after = (
        np.std(
            wrong.columns["d_y_um"]
            - m.simulate(Record(TIME, wrong.columns, digest=wrong.digest))["d_y_um"]
        )
        for m in (model, extended)
    )
    assert after < 0.15 < before
    again = diagnose(extended, [wrong])
    assert again.adequate
    assert not again.causes


@pytest.mark.slow
@pytest.mark.parametrize("off", [0.0, 4.0])
def test_a_limit_that_unseen_logs_do_not_reach_is_named(model: Model, off: float) -> None:
    """They say nothing of it, though a slow draught moves them by so many times the noise."""
    low = 0.5 * LEVELS
    read = machine(low, 6)
    for channel, noise in (("dT_pair1_K", 0.02), ("d_y_um", 0.1)):
        read[channel] = read[channel] + off * noise * np.sin(2 * np.pi * TIME / TIME[-1])
    unseen = Record(TIME, {"Q_main_1": low, **read}, digest="unseen")
    found = diagnose(model, [log(np.minimum(LEVELS, 0.8), 5)], validate=[unseen])
    cause = found.causes[0]
    assert cause.effect.name == "actuator_saturation"
    assert cause.effect.parameters["limit"] == pytest.approx(0.8, rel=0.01)
    assert cause.explained > 0.9


@pytest.mark.slow
def test_an_accident_acts_in_its_own_log_alone(model: Model) -> None:
    clean = log(LEVELS, 4)
    jumped = {**clean.columns, "d_y_um": clean.columns["d_y_um"] + 2.0 * (TIME > 1500)}
    words: list[str] = []
    found = diagnose(model, [replace(clean, columns=jumped)], progress=words.append)
    assert found.causes[0].effect.name == "geometry_step"
    # What there is none of is not worked at.
    assert "held-out gain of geometry_step" in words
    assert "unseen logs" not in words
    (effect,) = found.model.effects
    assert effect.log == clean.digest
    assert effect.parameters["time"] == pytest.approx(1500, abs=10)
    elsewhere = found.model.simulate(Record(TIME, clean.columns, digest="another log"))
    assert np.array_equal(
        elsewhere["d_y_um"], model.simulate(Record(TIME, clean.columns))["d_y_um"]
    )


@pytest.mark.slow
def test_an_accident_needs_no_unseen_log_to_show_it(model: Model) -> None:
    """What happened in the morning cannot help in the evening; it is told on the morning's rows."""
    hit = log(LEVELS, 4)
    hit.columns["d_y_um"][TIME > 1500] += 3.0
    found = diagnose(model, [hit], validate=[log(LEVELS, 5)])
    (cause,) = found.causes
    assert cause.effect.name in ("geometry_step", "sensor_offset_step")
    assert cause.effect.log == hit.digest
    assert cause.gain["d_y_um"].rms_after < 0.2 < cause.gain["d_y_um"].rms_before


@pytest.mark.slow
def test_gain_on_a_log_that_no_fit_saw(model: Model) -> None:
    source = np.where(np.sin(TIME / 300) > 0.3, 1.0, 0.0)
    first = log(LEVELS + 0.2 * source, 5, Q_pump_W=40 * source)
    second = log(LEVELS + 0.2 * source[::-1], 6, Q_pump_W=40 * source[::-1])
    found = diagnose(model, [first], [second])
    cause = found.causes[0]
    assert (cause.effect.name, cause.effect.channel) == ("second_source", "Q_pump_W")
    assert cause.gain["dT_pair1_K"].claimed
    assert cause.gain["dT_pair1_K"].rms_after < 0.5 * cause.gain["dT_pair1_K"].rms_before


@pytest.mark.parametrize(
    ("columns", "error", "message"),
    [
        ({"Q_other_1": LEVELS, "d_y_um": LEVELS}, ModelError, "Q_main_1 is not in the log"),
        ({"Q_main_1": LEVELS}, ModelError, "no output of the model"),
        ({"Q_main_1": LEVELS, "d_y_um": np.nan * LEVELS}, ModelError, "fewer than 20 values"),
        ({"Q_main_1": np.nan * LEVELS, "d_y_um": LEVELS}, ModelError, "missing values"),
    ],
)
def test_bad_logs_are_refused_in_one_line(
    model: Model, columns: dict[str, np.ndarray], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message) as caught:
        diagnose(model, [Record(TIME, columns, digest="bad")])
    assert "\n" not in str(caught.value)


def test_a_log_of_few_rows_is_refused(model: Model) -> None:
    short = log(LEVELS, 7)
    few = Record(TIME[:9], {k: v[:9] for k, v in short.columns.items()}, digest="few")
    with pytest.raises(FitError, match="9 rows: too few"):
        diagnose(model, [few])


@pytest.mark.slow
def test_the_gantry_names_its_bed() -> None:
    runs = []
    for part in ("morning", "evening"):
        run = read_log(
            str(whole_log(f"gantry/run_2021-06-13_{part}.csv")), columns=str(MAPS / "gantry.toml")
        )
        runs.append(Record(run.time, dict(run.columns), digest=run.digest))
    morning, evening = runs
    plan = CalibrationPlan(("T_frame_degC",), (), ("d_z_um",))
    model = calibrate([morning], plan)
    found = diagnose(model, [morning], [evening])
    assert (found.causes[0].effect.name, found.causes[0].effect.channel) == (
        "second_source",
        "T_bed_degC",
    )
    held_out = found.causes[0].held_out["d_z_um"]
    assert held_out.claimed
    assert held_out.rms_after < 9.0 < 20.0 < held_out.rms_before
    # By the model that came in and the one that is written, as a user runs them.
    gain = found.causes[0].gain["d_z_um"]
    assert gain.rms_after < 9.0 < 12.0 < gain.rms_before


@pytest.mark.slow
def test_a_law_that_meets_the_straight_line_elsewhere_is_one_cause(model: Model) -> None:
    (cause,) = diagnose(model, [log(0.8 * LEVELS**1.4, 9)]).causes
    assert (cause.effect.name, cause.effect.channel) == ("drive_nonlinearity", "Q_main_1")
    assert cause.effect.parameters["exponent"] == pytest.approx(1.4, abs=0.05)
    # Where 0.8 u^1.4 is u.
    assert cause.effect.parameters["agrees_at"] == pytest.approx(0.8**-2.5, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("at", [0.125, 1.0])
def test_a_parabola_that_meets_the_straight_line_anywhere(model: Model, at: float) -> None:
    wrong = log(LEVELS * (1 + 1.5 * LEVELS) / (1 + 1.5 * at), 10)
    (cause,) = diagnose(model, [wrong]).causes
    assert (cause.effect.name, cause.effect.channel) == ("drive_nonlinearity", "Q_main_1")
    level = cause.effect.parameters["level"]
    found = cause.effect.parameters["curvature"] / level
    assert found == pytest.approx(1.5 / (1 + 1.5 * at), rel=0.05)
    assert cause.effect.parameters["agrees_at"] == pytest.approx(at, rel=0.1)


@pytest.mark.slow
def test_a_drive_that_is_only_on_or_off(model: Model) -> None:
    wrong = log((LEVELS > 0) * 1.0, 8)
    (cause,) = diagnose(model, [wrong]).causes
    assert (cause.effect.name, cause.effect.channel) == ("drive_nonlinearity", "Q_main_1")
    assert cause.effect.parameters["exponent"] < 0.05
