"""What every command shares: numbers in options, the file of defaults, a closed stdout."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest


@pytest.mark.parametrize("number", ["nan", "inf"])
@pytest.mark.parametrize(
    "arguments",
    [
        "check LOG --resample",
        "check LOG --max-gap",
        "noise LOG --start",
        "calibrate LOG --drive Q_main_1 --sensor dT_pair1_K --max-rmse",
        "simulate MODEL LOG --max-rmse",
        "estimate KALMAN LOG --max-gap",
        "regularize MODEL --noise NOISE --walk",
        "regularize MODEL --noise NOISE --dt",
        "regularize MODEL --noise NOISE --regularization 1 1",
        "invert KERNEL --dt",
        "compensate KALMAN LOG --slew",
        "compensate KALMAN LOG --hold",
        "compensate KALMAN LOG --timeout",
        "compensate KALMAN LOG --frozen-after",
        "compensate KALMAN LOG --step",
        "laplace 1/s --time",
        "laplace 1/s --time 1 --tol",
        "laplace 1/s --time 1 --abscissa",
        "plant frame --ambient",
    ],
)
def test_nan_and_infinity_are_no_numbers(thermaltool, files, arguments, number):
    words = [getattr(files, w.lower()) if w.isupper() else w for w in arguments.split()]
    result = thermaltool(*words, number)
    assert result.code == 2
    assert f"{number!r} is not a finite number" in result.err


def defaults(files, text):
    path = files.folder / "defaults.toml"
    path.write_text(text)
    return "--config", path


@pytest.mark.slow
def test_defaults_are_named_like_the_options(thermaltool, files):
    table = 'drive = ["Q_main_1"]\nsensor = ["dT_pair1_K"]\nstarts = 1\njson = true\n'
    config = defaults(files, f"[calibrate]\n{table}output = '{files.folder / 'made.json'}'\n")
    result = thermaltool(*config, "calibrate", files.log)
    assert result.code == 0
    assert [term["drive"] for term in result.json["terms"]] == ["Q_main_1"]
    from_flag = thermaltool(*config, "calibrate", files.log, "--sensor", "T_none_degC")
    assert "no column T_none_degC" in from_flag.err
    config = defaults(files, "[check]\nmax-gap = 5.0\n")
    assert "a gap of 10 s" in thermaltool(*config, "check", files.log).out


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("check = 3\n", "[check] is no command"),
        ("[chekc]\n", "[chekc] is no command"),
        ("[check]\nmax-gap = [5.0]\n", "[check] max-gap takes one value, not [5.0]"),
        ("[check]\nmax-gap = 2020-01-01\n", "[check] max-gap takes one value, not datetime"),
        ("[check]\nmax-gpa = 5.0\n", "[check] has no option 'max-gpa' (did you mean max-gap?)"),
    ],
)
def test_defaults_that_would_do_nothing(thermaltool, files, text, message):
    result = thermaltool(*defaults(files, text), "check", files.log)
    assert result.code == 2
    assert message in result.err


def test_a_closed_stdout(files):
    code = "from thermaltool.cli import main; main()"
    line = [sys.executable, "-c", code, "simulate", str(files.model), str(files.log), "-q"]
    result = subprocess.run(
        ["sh", "-c", 'exec "$@" >&-', "sh", *line], stderr=subprocess.PIPE, text=True, check=False
    )
    assert result.returncode == 1
    assert result.stderr == "thermaltool simulate: <stdout>: closed\n"


def test_a_report_of_another_format_is_refused(thermaltool, tmp_path) -> None:
    report = tmp_path / "why.html"
    result = thermaltool("diagnose", "model.json", "log.csv", "--report", report)
    assert result.code == 2
    assert "FILE.md" in result.err
    assert not report.exists()


@pytest.mark.parametrize(("given", "threads"), [(None, "1"), ("2", "2")])
def test_a_command_takes_one_thread_where_nobody_asks_for_more(given, threads):
    """Read when numpy is loaded: on busy cores two threads wait for each other."""
    code = (
        "import os, sys\n"
        "from thermaltool.cli import main\n"
        "assert 'numpy' not in sys.modules\n"
        "sys.argv = ['thermaltool', '--version']\n"
        "try:\n"
        "    main()\n"
        "except SystemExit:\n"
        "    print(os.environ['OMP_NUM_THREADS'], os.environ['OPENBLAS_NUM_THREADS'])\n"
    )
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    own = {name: value for name, value in os.environ.items() if name not in names}
    own |= {} if given is None else dict.fromkeys(names, given)
    done = subprocess.run(
        [sys.executable, "-c", code], env=own, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == f"{threads} {threads}"
