"""What a diagnosis tells of the written model is what `simulate` makes of its file."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest

import thermaltool as tt
from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.diagnosis.gain import compare
from thermaltool.diagnosis.simulation import SimulatedLogs
from thermaltool.diagnosis.written import rezeroed, spoiled_by, steps_of, written_steps
from thermaltool.effects import effect_class
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.deflection import Deflection

LEVELS = np.repeat([0.0, 1.0, 0.0, 0.6, 0.3, 1.0, 0.0, 0.8, 0.0, 0.5], 120)
TIME = 3.0 * np.arange(len(LEVELS))
BED = 20.0 + 30.0 * (TIME > 900) * -np.expm1(-(TIME - 900) / 400)
HEADER = ["time_s", "Q_main_1", "T_bed_degC", "dT_pair1_K", "d_y_um"]


def table(seed: int, bed: float = 0.0, heat: float = 1.0, zero: float = 0.0) -> str:
    """Two masses and a bed by hand, in Euler steps, with noise; the zero is that of the day."""
    warm, rows = np.zeros(2), []
    for q in np.append(0.0, LEVELS[:-1]):
        warm = warm + 3.0 * np.array(
            [(20 * heat * q - warm[0]) / 150, (3 * warm[0] - warm[1]) / 500]
        )
        rows.append(warm)
    noise = np.random.default_rng([20261122, seed]).standard_normal((2, len(TIME)))
    rise = np.array(rows)[:, 0] + 0.2 * bed * (BED - 20.0) + 0.02 * noise[0]
    bend = np.array(rows)[:, 1] + bed * (BED - 20.0) + 0.1 * noise[1] + zero
    columns = zip(TIME, LEVELS, BED, rise, bend, strict=True)
    return "\n".join([",".join(HEADER), *(",".join(f"{x:.5f}" for x in row) for row in columns)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    found = tmp_path_factory.mktemp("written")
    for name, options in {
        "calm": {"seed": 1},
        "bed": {"seed": 2, "bed": 0.3, "zero": 7.0},
        "again": {"seed": 3, "bed": 0.3, "zero": -4.0},
    }.items():
        (found / f"{name}.csv").write_text(table(**options))
    return found


@pytest.fixture
def model(thermaltool, folder):
    target = folder / "model.json"
    if not target.exists():
        plan = ("--drive", "Q_main_1", "--sensor", "dT_pair1_K", "--deflection", "d_y_um")
        kinds = ("--response", "dT_pair1_K=deflection")
        assert thermaltool("calibrate", folder / "calm.csv", *plan, *kinds, "-o", target).code == 0
    return target


@pytest.mark.slow
@pytest.mark.parametrize("validated", [False, True])
def test_simulate_of_the_written_file_is_what_is_told(thermaltool, folder, model, validated):
    target = folder / f"extended_{validated}.json"
    unseen = ("--validate", folder / "again.csv") if validated else ()
    found = thermaltool("diagnose", model, folder / "bed.csv", *unseen, "-o", target)
    assert found.code == 3
    assert next(c["name"] for c in found.json["causes"]) == "second_source"
    roles = ("logs", "validated_on", "calibrated_on")
    names = {log["sha256"]: log["name"] for role in roles for log in found.json[role]}
    # The calibration's own log is found by its name, and judged beside the others.
    assert [log["name"] for log in found.json["calibrated_on"]] == [str(folder / "calm.csv")]
    # It did not know the bed: that is told, and is no reason to keep silent.
    assert any("of the calibration, is worse by the" in note for note in found.json["notes"])
    last = len(found.json["causes"])
    rows = found.json["written"]
    assert {row["step"] for row in rows} == set(range(last + 1))
    for row in rows:
        if row["step"] not in (0, last):
            continue
        run = model if row["step"] == 0 else target
        told = thermaltool("simulate", run, names[row["log"]], "--json").json[row["output"]]
        assert row["rmse"] == pytest.approx(told["rmse"], rel=1e-9)
        assert row["fit_percent"] == pytest.approx(told["fit_percent"], rel=1e-9)
        free = np.sqrt(told["rmse"] ** 2 - told["mean"] ** 2)
        assert row["rmse_zero_free"] == pytest.approx(free, rel=1e-6)
    # So is what the file tells of itself, of the log that was diagnosed.
    found_there = thermaltool("simulate", target, folder / "bed.csv", "--json").json
    presented = thermaltool("present", target, "--json").json[str(target)]
    assert presented["diagnosed"] == ["bed.csv"]
    for output in presented["outputs"]:
        simulated = found_there[output["channel"]]
        for key in ("rmse", "rmse_zero_free", "fit_percent", "rows"):
            assert output[key] == pytest.approx(simulated[key], rel=1e-5)
    # Gains of the causes make one chain, from the model that came in to the file.
    chain = [c["gain"]["d_y_um"] for c in found.json["causes"] if "d_y_um" in c["gain"]]
    for one, next_one in itertools.pairwise(chain):
        assert one["rms_after"] == pytest.approx(next_one["rms_before"])
    judged = str(folder / ("again.csv" if validated else "bed.csv"))
    ends = [
        row["rmse_zero_free"]
        for row in rows
        if names[row["log"]] == judged and row["output"] == "d_y_um" and row["step"] in (0, last)
    ]
    assert [chain[0]["rms_before"], chain[-1]["rms_after"]] == pytest.approx(ends, rel=1e-6)
    assert ends[1] < 0.2 < 1.0 < ends[0]


@pytest.mark.slow
def test_a_sensor_that_was_put_in_anew_has_a_new_zero(thermaltool, folder, model):
    """Half a kelvin more at rest, since the calibration: it goes into the file with the cause."""
    rows = [line.split(",") for line in (folder / "bed.csv").read_text().splitlines()]
    log, target = folder / "put_in_anew.csv", folder / "put_in_anew.json"
    moved = [[*r[:3], f"{float(r[3]) + 0.5:.5f}", r[4]] for r in rows[1:]]
    log.write_text("\n".join(",".join(r) for r in [rows[0], *moved]))
    found = thermaltool("diagnose", model, log, "-o", target).json
    assert found["causes"][0]["name"] == "second_source"
    told = thermaltool("simulate", target, log, "--json").json["dT_pair1_K"]
    assert abs(told["mean"]) < 0.01
    before = thermaltool("simulate", model, log, "--json").json["dT_pair1_K"]
    assert before["mean"] > 0.4


def test_zeros_that_logs_disagree_about_or_that_no_sensor_has_stay():
    time = np.arange(300.0)
    parts = Deflection(A=1.0, a=0.1, B=0.5, b=0.05, D=0.1, d=0.08)
    model = Model(
        drives=(Drive("Q_main_1", "zero", 0.0, (0.0, 1.0)),),
        outputs=(Output("dT_pair1_K", "sensor", 0.25, (0.0, 1.0)),),
        terms=(Term("Q_main_1", "dT_pair1_K", parts),),
        sample_period=1.0,
    )
    idle = np.zeros(300)

    def log(zero: float) -> Record:
        return Record(time, {"Q_main_1": idle, "dT_pair1_K": idle + zero}, digest=f"{zero}")

    assert rezeroed(model, [log(0.5), log(0.55)], {}).outputs[0].offset == pytest.approx(0.525)
    assert rezeroed(model, [log(0.5), log(-0.5)], {}) == model
    # More than the outputs of the calibration spread.
    assert rezeroed(model, [log(65.0)], {}) == model
    # A reading that repeats itself says nothing of its zero.
    stuck = effect_class("sensor_frozen")("dT_pair1_K", {"start": 0.0}, "0.5")
    beside = replace(model, effects=(stuck,))
    assert rezeroed(beside, [log(0.5)], {}) == beside


def without(path, column: str):
    """The same log without a column."""
    rows = [line.split(",") for line in path.read_text().splitlines()]
    at = rows[0].index(column)
    target = path.with_name(f"{path.stem}_without_{column}.csv")
    target.write_text("\n".join(",".join(r[:at] + r[at + 1 :]) for r in rows))
    return target


@pytest.mark.slow
def test_logs_that_lack_a_channel_are_told_and_the_others_count(thermaltool, folder):
    """The bed was not logged at the calibration: that is why the model does not know it."""
    calm, target = without(folder / "calm.csv", "T_bed_degC"), folder / "blind.json"
    plan = ("--drive", "Q_main_1", "--sensor", "dT_pair1_K", "--deflection", "d_y_um")
    kinds = ("--response", "dT_pair1_K=deflection")
    assert thermaltool("calibrate", calm, *plan, *kinds, "-o", target).code == 0
    unseen = ("--validate", without(folder / "again.csv", "d_y_um"))
    found = thermaltool("diagnose", target, folder / "bed.csv", *unseen).json
    assert found["causes"][0]["name"] == "second_source"
    assert [log["name"] for log in found["calibrated_on"]] == [str(calm)]
    assert any(f"{calm} cannot be run by the written" in note for note in found["notes"])
    assert {row["log"] for row in found["written"]} == {
        log["sha256"] for key in ("logs", "validated_on") for log in found[key]
    }


@pytest.mark.slow
def test_an_output_that_only_unseen_logs_have(thermaltool, folder, model):
    part = without(folder / "bed.csv", "d_y_um")
    found = thermaltool("diagnose", model, part, "--validate", folder / "again.csv")
    assert found.code in (0, 3)
    assert found.json["residuals"].keys() == {"dT_pair1_K"}
    assert "no column d_y_um (there are: " in found.err


@pytest.mark.slow
def test_outliers_change_nothing_of_the_model(thermaltool, folder, model):
    rows = (folder / "calm.csv").read_text().splitlines()
    for k in range(40, 1200, 45):
        *head, last = rows[k].split(",")
        rows[k] = ",".join([*head, str(float(last) + 3.0)])
    (folder / "spikes.csv").write_text("\n".join(rows))
    target = folder / "spiked.json"
    found = thermaltool("diagnose", model, folder / "spikes.csv", "-o", target)
    assert [c["name"] for c in found.json["causes"]] == ["outliers"]
    assert target.read_bytes() == model.read_bytes()
    assert "the written model takes" not in found.err


@pytest.mark.slow
def test_without_a_cause_the_file_is_the_input_byte_for_byte(thermaltool, folder, model):
    odd = folder / "odd.json"
    odd.write_text(json.dumps(json.loads(model.read_text()), indent=7) + "\n\n")
    target = folder / "same.json"
    assert thermaltool("diagnose", odd, folder / "calm.csv", "-q", "-o", target).code == 0
    assert target.read_bytes() == odd.read_bytes()


# ---------------------------------------------------------------- no log is spoiled

PLANT = Model(
    drives=(Drive("Q_main_1", "zero", 0.0, (0.0, 1.0)),),
    outputs=(Output("d_y_um", "deflection", "first", (0.0, 90.0), {}),),
    terms=(
        Term("Q_main_1", "d_y_um", Deflection(A=50.0, a=0.002, B=20.0, b=5e-4, D=-0.01, d=0.001)),
    ),
    sample_period=3.0,
)
# The same with lags that are over long before the log is.
QUICK = replace(
    PLANT,
    outputs=(replace(PLANT.outputs[0], offset=0.0),),
    terms=(
        Term("Q_main_1", "d_y_um", Deflection(A=50.0, a=0.02, B=20.0, b=5e-3, D=-0.01, d=0.01)),
    ),
)
DELAY = effect_class("transport_delay")("Q_main_1", {"delay": 60.0})
CURVE = effect_class("drive_nonlinearity")("Q_main_1", {"exponent": 1.1})


def record(model: Model, seed: int) -> Record:
    drives = Record(TIME, {"Q_main_1": LEVELS}, digest=f"log {seed}")
    noise = 0.1 * np.random.default_rng([20261122, 9, seed]).standard_normal(len(TIME))
    read = model.simulate(drives)["d_y_um"] + noise
    return Record(TIME, {"Q_main_1": LEVELS, "d_y_um": read}, digest=drives.digest)


def test_a_log_that_another_model_spoils_is_named():
    late = Model(**{**vars(PLANT), "effects": (DELAY,)})
    calm, delayed, noise = record(PLANT, 1), record(late, 2), {"d_y_um": 0.1}
    assert spoiled_by(PLANT, late, [delayed], {}, noise) is None
    assert spoiled_by(PLANT, PLANT, [calm, delayed], {}, noise) is None
    log, output = spoiled_by(PLANT, late, [delayed, calm], {}, noise)
    assert (log.digest, output) == ("log 1", "d_y_um")


def test_a_zero_that_moves_under_a_warm_start_is_worse():
    calm = record(QUICK, 1)
    decay = 200.0 * np.exp(-TIME / 200.0)
    warm = Record(TIME, {**calm.columns, "d_y_um": calm.columns["d_y_um"] + decay}, digest="warm")
    jump = effect_class("sensor_offset_step")("d_y_um", {"step": 0.4, "time": 12.0}, "warm")
    moved = replace(QUICK, effects=(jump,))
    assert SimulatedLogs(QUICK, (warm,), {}).warm_logs == (0,)
    log, output = spoiled_by(QUICK, moved, [warm], {}, {"d_y_um": 0.1})
    assert (log.digest, output) == ("warm", "d_y_um")


@pytest.mark.slow
def test_decays_that_cancel_are_a_start():
    response = replace(QUICK.terms[0].response, a=1 / 2500.0, b=0.01, D=0.0, d=0.1)
    slow = replace(QUICK, terms=(replace(QUICK.terms[0], response=response),))
    calm = record(slow, 1)
    noise = float(np.std(calm.columns["d_y_um"] - slow.simulate(calm)["d_y_um"]))
    hump = 300.0 * (np.exp(-TIME / 400.0) - np.exp(-TIME / 1200.0))
    warm = Record(TIME, {**calm.columns, "d_y_um": calm.columns["d_y_um"] + hump}, digest="warm")
    found = diagnose(slow, [warm])
    assert found.causes == ()
    assert found.residuals["d_y_um"].spread == pytest.approx(noise, rel=0.02)


def test_what_a_warm_start_hides_is_right_and_written():
    calm = record(QUICK, 1)
    # A drift that makes up for part of the start until it is taken off.
    drift = effect_class("sensor_drift")("d_y_um", {"rate": 6.0})
    read = calm.columns["d_y_um"] + 60.0 * np.exp(-TIME / 150.0) + 6.0 * TIME / 3600.0
    warm = Record(TIME, {**calm.columns, "d_y_um": read}, digest="warm")
    drifting, noise = replace(QUICK, effects=(drift,)), {"d_y_um": 0.1}
    left = [float(np.std(read - m.simulate(warm)["d_y_um"])) for m in (QUICK, drifting)]
    assert left[1] > 1.05 * left[0]
    # What simulate leaves, which estimates the start, says what the drift is worth.
    steps = written_steps([QUICK, drifting], [drift], [warm])
    assert [tt.simulate(m, warm).agreements["d_y_um"] for m in (QUICK, drifting)] == [
        step.agreement for step in steps
    ]
    assert steps[1].agreement.rmse < 0.11 < 0.2 < steps[0].agreement.rmse
    assert spoiled_by(QUICK, drifting, [warm], {}, noise) is None
    log, output = spoiled_by(drifting, QUICK, [warm], {}, noise)
    assert (log.digest, output) == ("warm", "d_y_um")


@pytest.mark.slow
def test_the_curves_of_a_report_are_those_of_simulate():
    calm = record(QUICK, 1)
    read = calm.columns["d_y_um"] + 60.0 * np.exp(-TIME / 150.0) + 3.0 * (TIME > 2000.0)
    warm = Record(TIME, {**calm.columns, "d_y_um": read}, digest="warm")
    found = diagnose(QUICK, [warm])
    assert [cause.effect.name for cause in found.causes] == ["geometry_step"]
    ((_, curves),) = found.curves
    for name, model in (("simulated", QUICK), ("extended", found.model)):
        error = curves.columns["measured"] - curves.columns[name]
        told = tt.simulate(model, warm).agreements["d_y_um"]
        assert np.std(error) == pytest.approx(np.sqrt(told.rmse**2 - told.mean**2), rel=1e-6)


def test_heat_that_goes_on_is_no_start():
    warm = replace(record(QUICK, 1), digest="warm")
    values = {"gain[d_y_um]": 40.0, "start": float(TIME[0]), "time_constant": 60.0}
    source = effect_class("second_source")("", values, "warm")
    jump = effect_class("sensor_offset_step")("d_y_um", {"step": 0.2, "time": 2700.0}, "warm")
    true, told = (replace(QUICK, effects=effects) for effects in ((source,), (source, jump)))
    noise = 0.1 * np.random.default_rng(5).standard_normal(len(TIME))
    warm = warm.with_columns({"d_y_um": true.simulate(warm)["d_y_um"] + noise})
    assert SimulatedLogs(QUICK, (warm,), {}).warm_logs == ()
    assert spoiled_by(QUICK, told, [warm], {}, {"d_y_um": 0.1}) is None


def test_a_loss_within_noise_is_none():
    calm = record(PLANT, 1)
    near = effect_class("transport_delay")("Q_main_1", {"delay": 0.05})
    slightly = Model(**{**vars(PLANT), "effects": (near,)})
    assert spoiled_by(PLANT, slightly, [calm], {}, {"d_y_um": 0.1}) is None
    error = np.random.default_rng(3).standard_normal(400)
    assert not compare(error, error, 1.02 * error).worse(1.0)
    assert compare(error, error, 1.1 * error).worse(1.0)


def test_steps_go_from_the_input_to_the_written_model():
    known = Model(**{**vars(PLANT), "effects": (CURVE,)})
    written = Model(**{**vars(known), "effects": (CURVE, DELAY), "sample_period": 4.0})
    first, last = steps_of(known, written, [DELAY])
    assert (first, last) == (known, written)
    both = steps_of(PLANT, written, [DELAY, CURVE])
    assert [m.effects for m in both] == [(), (DELAY,), (CURVE, DELAY)]
    # What else has changed, has changed with the first cause.
    assert both[1].sample_period == 4.0
