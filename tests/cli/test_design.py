"""``design`` and the stream that runs its controller: files, lines, and one line for each error."""

import json
import subprocess
import sys

import pytest

import thermaltool as tt
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.responses.rational import Rational1

MAIN, PAD = "Q_main_W", "Q_pad_W"
MODEL = Model(
    tuple(Drive(name, "zero", 0.0, (0.0, 80.0)) for name in (MAIN, PAD)),
    (Output("d_z_um", "deflection", "first", (-30.0, 50.0)),),
    (Term(MAIN, "d_z_um", Rational1(0.5, 900.0)), Term(PAD, "d_z_um", Rational1(-0.8, 600.0))),
    10.0,
)
LINES = ["time_s,Q_main_W,Q_pad_W"] + [f"{10 * k},{50 * (k > 5)},0" for k in range(40)]


@pytest.fixture
def paths(tmp_path, thermaltool):
    tt.write_model(tt.regularize(MODEL), str(tmp_path / "model.json"))
    (tmp_path / "log.csv").write_text("\n".join([*LINES, ""]))
    made = thermaltool(
        "design", tmp_path / "model.json", "--control", f"{PAD}:60", "-o", tmp_path / "c.json"
    )
    assert made.code == 0, made.err
    assert "receding-horizon, horizon 600 s, Q_pad_W 0 to 60" in made.err
    return tmp_path


def compensate(*arguments):
    """The stream as a process, which writes to its own standard output."""
    tool = [sys.executable, "-c", "from thermaltool.cli import main; main()", "compensate"]
    return subprocess.run([*tool, *map(str, arguments)], capture_output=True, text=True)


def test_a_controller_runs_and_names_a_heater_that_gives_nothing(paths):
    result = compensate(paths / "c.json", paths / "log.csv", "--also", "status")
    assert result.returncode == 0, result.stderr
    header, *rows = result.stdout.splitlines()
    assert header == "time_s,Q_pad_W,status"
    assert all(0 <= float(row.split(",")[1]) <= 60 for row in rows)
    assert rows[-1].split(",")[1:] == ["0.0", "safe"]
    assert "Q_pad_W: does not follow: " in result.stderr
    assert any(row.endswith(",fault") for row in rows)


def test_a_controller_has_a_figure(paths, thermaltool):
    result = thermaltool("plot", paths / "c.json", "--json", "-o", paths / "c.svg")
    assert result.code == 0, result.err
    assert result.json["drawn"][0]["kind"] == "controller"
    drawn = (paths / "c.svg").read_text()
    assert all(f"<!-- {text} -->" in drawn for text in ("tolerance", "limits: 0, 60", "set"))
    result = thermaltool("plot", paths / "c.json", "--channel", "Q_pda_W", "-o", paths / "c.svg")
    assert result.code == 1
    assert "no channel Q_pda_W" in result.err


def test_the_report_as_json(paths, thermaltool):
    result = thermaltool("design", paths / "model.json", "--control", PAD, "--method", "output-lqr",
                         "--json", "-o", paths / "c.json")  # fmt: skip
    assert result.code == 0, result.err
    assert result.json["control"] == [{"channel": PAD, "maximum": 80.0, "slew_per_s": 10.0}]
    assert (
        result.json["trials"][0]["held"]["d_z_um"]
        < 5
        < result.json["trials"][0]["without"]["d_z_um"]
    )


@pytest.mark.slow
def test_errors_are_one_line_and_heaters_are_off(paths, thermaltool):
    document = json.loads((paths / "c.json").read_text())
    document["control"][0]["maximum"] = 600.0
    (paths / "changed.json").write_text(json.dumps(document))
    result = compensate(paths / "changed.json", paths / "log.csv")
    assert (result.returncode, result.stderr.count("\n")) == (1, 1)
    assert "changed or damaged" in result.stderr
    assert result.stdout == "time_s,Q_pad_W\n,0.0\n"
    no_power = "\n".join(line.rpartition(",")[0] for line in LINES)
    (paths / "short.csv").write_text(no_power)
    result = compensate(paths / "c.json", paths / "short.csv")
    # Behind the line that says where the stream starts.
    assert (result.returncode, result.stderr.count("\n")) == (1, 2)
    assert "no column Q_pad_W" in result.stderr
    assert result.stdout == "time_s,Q_pad_W\n,0.0\n"
    for more in (("--slew", "3"), ("--heater", PAD), ("--limit", "0:5")):
        result = compensate(paths / "c.json", paths / "log.csv", *more)
        assert result.returncode == 2
        assert f"{more[0]} is in the controller" in result.stderr
    # A step beyond full power would leave the heater off for good.
    result = compensate(paths / "c.json", paths / "log.csv", "--step", "100")
    assert result.returncode == 2
    assert "between 0 and 60 the step 100 has nothing but 0" in result.stderr
    for more, said in (
        (("--control", "Q_pda_W"), "is not a drive"),
        (("--control", f"{PAD}:-1"), "no power between"),
        (("--control", PAD, "--lead", "3"), "--lead is of --method inversion"),
        (
            ("--control", PAD, "--method", "inversion", "--axis", "d_z_um=5"),
            "--axis is of --method receding-horizon",
        ),
        (("--control", MAIN, "--control", PAD), "nothing to hold off"),
    ):
        result = thermaltool("design", paths / "model.json", *more)
        assert result.code in (1, 2)
        assert said in result.err
