"""``thermaltool plant``."""

import numpy as np
import pytest
from click.testing import CliRunner

from thermaltool.cli.plant import command
from thermaltool.logs import read_log
from thermaltool.plants import COMMON, PLANTS
from thermaltool.plants.boring_bar import PARTS
from thermaltool.plants.duties import DUTIES
from thermaltool.plants.excitation import INPUTS

HEADER = (
    "time_s,Q_main_1,T_ambient_degC,T_column_degC,dT_pair1_K,dT_pair2_K,dT_pair3_K,d_x_um,d_y_um"
)


def run(*arguments, **options):
    return CliRunner().invoke(command, [str(a) for a in arguments], **options)


def test_help_lists_the_shapes_there_are():
    assert set(PLANTS["frame"].inputs) == set(INPUTS)
    assert PLANTS["quill"].inputs == PLANTS["c-frame"].inputs == tuple(DUTIES)
    words = " ".join(run("--help").stdout.split())
    for shapes in (INPUTS, PARTS):
        assert "|".join(shapes) in words.replace(" ", "")


def test_clean_log_rests_until_the_heat():
    result = run("frame", "--start", 2, "--duration", 4, "--clean")
    assert result.exit_code == 0
    assert result.stderr == ""
    lines = result.stdout.splitlines()
    assert lines[0] == HEADER
    assert len(lines) == 1 + 9
    assert lines[4] == "1.5,0,20,20,0,0,0,0,0"
    assert lines[5] == "2,1,20,20,0,0,0,0,0"
    assert not lines[6].endswith(",0,0")


@pytest.mark.slow
def test_a_seed_repeats_a_log():
    first, again = (run("frame", "--duration", 3, "--seed", 7).stdout for _ in range(2))
    assert first == again
    assert len(set(first.splitlines()[1:])) == 7


def test_a_log_drives_the_plant(tmp_path):
    source, target = str(tmp_path / "drive.csv"), str(tmp_path / "out.parquet")
    (tmp_path / "drive.csv").write_text(
        "time_s,Q_main_1,T_ambient_degC\n100,0.5,21\n101,1,22\n102,0,22\n"
    )
    result = run("frame", "--input", source, "--level", 0.5, "--start", 1, "--duration", 4,
                 "--clean", "-o", target)  # fmt: skip
    assert result.exit_code == 0, result.output
    log = read_log(target)
    np.testing.assert_array_equal(log.column("Q_main_1"), [0, 0, 0.25, 0.25, 0.5, 0.5, 0, 0, 0])
    np.testing.assert_array_equal(log.column("T_ambient_degC"), [21] * 4 + [22] * 5)
    assert log.column("T_column_degC")[0] == 21.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("lathe",), "'lathe' is not"),
        (("frame", "--input", "ramp"), "'ramp' is no file and none of step"),
        (("frame", "--dt", "nan"), "not a finite number"),
        (("frame", "--duration", "inf"), "not a finite number"),
        (("frame", "--dt", 0), "--dt"),
        (("frame", "--sigma", -1), "--sigma"),
        (
            ("frame", "--duration", 0.4),
            "--duration: 0.4 s is shorter than the sample period",
        ),
        (("quill", "--duration", 10), "--duration: 10 s is shorter than the sample period of 60 s"),
        (
            ("boring-bar", "--duration", 1e-4),
            "0.0001 s is shorter than the sample period",
        ),
        (("quill", "--sigma", 0.1), "--sigma is not for quill, but for frame, knee-mill"),
        (("c-frame", "--sigma-d", 0.1), "--sigma-d is not for c-frame, but for frame, knee-mill"),
        (("c-frame", "--level", 1), "--level is not for c-frame, but for frame, knee-mill"),
        (("frame", "--swing", 1), "--swing is not for frame, but for quill, c-frame"),
        (("frame", "--part", "taper"), "--part is not for frame, but for boring-bar"),
        (
            ("boring-bar", "--clean"),
            "--clean is not for boring-bar, but for frame, quill, c-frame, knee-mill",
        ),
        (("boring-bar", "--input", "step"), "--input is not for boring-bar"),
    ],
)
def test_bad_usage_is_named(arguments, message):
    result = run(*arguments)
    assert result.exit_code == 2
    assert message in result.stderr


def test_every_option_is_of_some_plant():
    """And one that is taken is not refused."""
    options = {p.name for p in command.params}
    every = {"name", "to_format", "as_json", "output"}.union(COMMON)
    assert every.union(*(offer.options for offer in PLANTS.values())) == options
    done = run("quill", "--duration", 120, "--heater", "both", "--power", 50, "--swing", 0,
               "--ambient", 25, "--start", 60, "--dt", 30, "--clean")  # fmt: skip
    assert done.exit_code == 0, done.output
    assert len(done.stdout.splitlines()) == 6


@pytest.mark.parametrize(
    ("arguments", "on"),
    [((), (1, 0)), (("--heater", "stabilization"), (0, 1)), (("--heater", "both"), (1, 1))],
)
def test_the_causal_heater_is_on_where_none_is_named(arguments, on):
    done = run("quill", "--duration", 120, "--start", 60, *arguments)
    powers = [float(field) for field in done.stdout.splitlines()[-1].split(",")[1:3]]
    assert [power > 0 for power in powers] == [bool(each) for each in on]


def test_the_environment_may_speak_of_any_plant(monkeypatch):
    monkeypatch.setenv("PLANT_SIGMA", "0.5")
    done = run("quill", "--duration", 120, auto_envvar_prefix="PLANT")
    assert done.exit_code == 0, done.output


@pytest.mark.parametrize("option", [("--heater", "both"), ("--power", 9)])
def test_a_log_has_its_own_powers(tmp_path, option):
    (tmp_path / "drive.csv").write_text("time_s,Q_causal_W,Q_stabilization_W\n0,50,20\n60,50,0\n")
    arguments = ("quill", "--input", tmp_path / "drive.csv", "--duration", 180)
    assert run(*arguments).exit_code == 0
    done = run(*arguments, *option)
    assert done.exit_code == 2
    assert "--heater and --power are for shapes" in done.stderr


def test_a_log_without_heat_or_rows_is_refused(tmp_path):
    other, empty = tmp_path / "other.csv", tmp_path / "empty.csv"
    other.write_text("time_s,Q_man_1\n0,1\n1,1\n")
    empty.write_text("time_s,Q_main_1\n")
    assert "Q_main_1" in str(run("frame", "--input", other).exception)
    assert "no rows" in str(run("frame", "--input", empty).exception)
