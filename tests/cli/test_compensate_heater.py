"""``compensate --heater``: the power of a heater from lines, its ends and its errors."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from thermaltool.effects import load_effect
from thermaltool.logs import read_log
from thermaltool.model import Drive, Model, Output, Term, dumps
from thermaltool.record import Record
from thermaltool.responses.rational import Rational1, Rational2

HEATER, ANGLE = "Q_stabilization_W", "phi_x_urad"
DRIVES = (Drive("Q_causal_W", "zero", 0.0, (0.0, 60.0)), Drive(HEATER, "zero", 0.0, (0.0, 70.0)))
MODEL = Model(
    DRIVES,
    (Output(ANGLE, "deflection", "first", (-200.0, 200.0)),),
    (Term("Q_causal_W", ANGLE, Rational2(1.8, 1200.0, 0.9, 6000.0)),
     Term(HEATER, ANGLE, Rational2(-2.0, 900.0, -1.0, 5000.0))),
    60.0,
)  # fmt: skip
POWERS = [0.0] * 10 + [50.0] * 60 + [0.0] * 30 + [20.0] * 40


def text(powers):
    lines = [f"{60 * k},{power}" for k, power in enumerate(powers)]
    return "\n".join(["time_s,Q_causal_W", *lines, ""])


@pytest.fixture
def path(tmp_path):
    (tmp_path / "model.json").write_text(dumps(MODEL))
    (tmp_path / "log.csv").write_text(text(POWERS))
    return tmp_path


@pytest.fixture
def powers(path):
    """The stream as a process, which writes to its own standard output."""

    def run(*arguments):
        tool = [sys.executable, "-c", "from thermaltool.cli import main; main()", "compensate"]
        files = [str(path / name) for name in ("model.json", "log.csv")]
        call = [*tool, *files, "--heater", HEATER, *arguments]
        done = subprocess.run(call, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        run.err, run.out = done.stderr, done.stdout
        return [float(line.split(",")[1]) for line in done.stdout.splitlines()[1:]]

    return run


def test_powers_hold_the_angle_and_the_last_line_is_off(powers, path):
    powers("--also", "estimates", "--step", "0", "--slew", "1e6")
    assert powers.err.count("\n") == 1
    assert ": starts from rest" in powers.err
    (path / "out.csv").write_text(powers.out)
    out = read_log(str(path / "out.csv"))
    assert out.time[-1] == 60 * len(POWERS)
    power = out.column(HEATER)
    assert power[-1] == 0.0
    power, rows = power[:-1], len(POWERS)
    assert 0 == power.min() < power.max() <= 70
    columns = {"Q_causal_W": np.array(POWERS), HEATER: power}
    held = MODEL.simulate(Record(out.time[:rows], columns))[ANGLE]
    np.testing.assert_allclose(out.column(ANGLE)[:-1], held, atol=1e-8)
    free = MODEL.simulate(Record(out.time[:rows], {**columns, HEATER: 0 * power}))[ANGLE]
    assert np.mean(np.abs(held)) < 0.1 * np.mean(np.abs(free))


def test_unreadable_power_is_held_and_then_the_heater_is_off(powers, path):
    (path / "log.csv").write_text(text([*[50.0] * 40, *["broken"] * 20, *[50.0] * 5]))
    power = powers("--hold", "300", "--slew", "1e6")
    assert min(power[1:45]) > 0
    assert power[45:60] == [0.0] * 15
    assert min(power[60:65]) > 0
    assert power[65] == 0.0
    assert "broken" in powers.err
    assert "safe setpoint" in powers.err


def test_limits_and_steps_are_kept(powers):
    power = set(powers("--limit", "0:21", "--step", "2", "--lead", "60", "--target", ANGLE))
    assert max(power) == 20.0
    assert power <= set(np.arange(0.0, 21.0, 2.0))


def test_numpy_alone(path):
    code = (
        "import sys\n"
        "from thermaltool.cli import group\n"
        f"group(['compensate', {str(path / 'model.json')!r}, {str(path / 'log.csv')!r}, "
        f"'--heater', {HEATER!r}], standalone_mode=False)\n"
        "heavy = {'scipy', 'pandas', 'pyarrow', 'matplotlib', 'statsmodels', 'skfem'}\n"
        "print(sorted(heavy & {name.partition('.')[0] for name in sys.modules}), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.splitlines()[-1] == "[]"


WARM = Drive("T_far_degC", "first", "first", (0.0, 9.0))
LAG = {"name": "sensor_lag", "channel": ANGLE, "parameters": {"time_constant": 5.0}}


def changed(**changes):
    return replace(MODEL, **changes)


BAD = [
    ({}, ("--heater", "Q_other_W"), "Q_other_W is not a drive of the model; there are Q_causal_W"),
    ({}, ("--heater", HEATER, "--target", "d_z_um"), "d_z_um is not an output of the model"),
    ({}, ("--heater", HEATER, "--limit", ":-5"), "no power between 0 and -5"),
    ({}, ("--heater", HEATER, "--limit", "5:70"), "the safe setpoint 0 is outside the limits"),
    ({}, ("--heater", HEATER, "--sign", "1"), "--sign is for offsets"),
    ({}, ("--heater", HEATER, "--limit=-10:50"), "has no power below 0: give --limit 0:WATTS"),
    ({}, ("--heater", HEATER, "--safe", "30"), "the safe setpoint of a heater is no power"),
    ({}, ("--heater", HEATER, "--safe", "hold"), "the safe setpoint of a heater is no power"),
    ({}, ("--heater", "Q_causal_W", "--heater", HEATER),
     "Q_causal_W, Q_stabilization_W: there can be one only"),
    ({}, ("--target", ANGLE), "--target and --lead go with --heater"),
    ({}, ("--heater", HEATER, "--lead", "-3"), "-3.0 is not in the range"),
    ({"terms": MODEL.terms[1:]}, ("--heater", HEATER), "nothing but Q_stabilization_W acts"),
    ({"terms": MODEL.terms[:1]}, ("--heater", HEATER), "does not act on phi_x_urad"),
    ({"drives": (*DRIVES, WARM)}, ("--heater", "T_far_degC"), "is not set like a power"),
    ({"outputs": (*MODEL.outputs, Output("d_z_um", "deflection", "first", (0.0, 9.0)))},
     ("--heater", HEATER), "the deflections phi_x_urad, d_z_um: name what is held"),
    ({"effects": (load_effect(LAG),)}, ("--heater", HEATER), "with the effect sensor_lag"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "arguments", "message"), BAD)
def test_bad_input_is_one_clear_line(thermaltool, path, changes, arguments, message):
    (path / "model.json").write_text(dumps(changed(**changes)))
    done = thermaltool("compensate", path / "model.json", path / "log.csv", *arguments)
    assert done.code in (1, 2)
    assert message in done.err.splitlines()[-1]


def test_no_power_may_be_named_as_the_safe_setpoint(powers):
    assert powers("--safe", "zero") == powers()


def test_a_heater_from_a_file_of_settings(thermaltool, path):
    (path / "own.toml").write_text(f'[compensate]\nheater = "{HEATER}"\n')
    done = thermaltool("--config", path / "own.toml", "compensate", path / "model.json",
                       path / "log.csv", "--target", "d_z_um")  # fmt: skip
    assert "d_z_um is not an output of the model" in done.err.splitlines()[-1]


def test_a_causal_column_that_is_missing_is_named(thermaltool, path):
    (path / "log.csv").write_text("time_s,Q_casual_W\n0,1\n60,1\n")
    done = thermaltool("compensate", path / "model.json", path / "log.csv", "--heater", HEATER)
    assert done.code == 1
    line = done.err.splitlines()[-1]
    assert "no column Q_causal_W" in line
    assert "Q_casual_W" in line


def test_the_model_of_one_lag_needs_no_power_beyond_its_ratio(powers, path):
    """Equal lags, gains 1 and -2: half the causal power holds the angle still."""
    terms = (Term("Q_causal_W", ANGLE, Rational1(1.0, 900.0)),
             Term(HEATER, ANGLE, Rational1(-2.0, 900.0)))  # fmt: skip
    (path / "model.json").write_text(dumps(changed(terms=terms)))
    power = powers("--step", "0", "--slew", "1e6")[:-1]
    np.testing.assert_allclose(power, np.array(POWERS) / 2, atol=1e-9)
