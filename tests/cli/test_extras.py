"""An install of numpy and click alone: streams run, other commands say what they need."""

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from thermaltool.cli import COMMANDS
from thermaltool.cli.extras import DISTRIBUTIONS, EXTRAS, OF_COMMANDS, OF_OPTIONS, missing_package

ROOT = Path(__file__).parents[2]
BARE = f"""
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {set(EXTRAS)!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Absent())
from thermaltool.cli import main
main()
"""


def bare(*arguments, stdin=""):
    line = [sys.executable, "-c", BARE, *map(str, arguments)]
    return subprocess.run(line, input=stdin, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("design", ["kalman", "kernel"])
def test_a_stream_runs_on_numpy_alone(files, design, tmp_path):
    state = tmp_path / "state.json"
    log = files.log.read_text()
    result = bare("compensate", getattr(files, design), "--checkpoint", state, stdin=log)
    assert result.returncode == 0, result.stderr
    assert len(result.stdout.splitlines()) == len(log.splitlines()) + 1
    again = bare("compensate", getattr(files, design), "--template", "X{offset_x_mm:.4f}",
                 "--checkpoint", state, stdin=log)  # fmt: skip
    assert again.returncode == 0, again.stderr
    assert again.stdout.endswith("X0.0000\n")


@pytest.mark.slow
def test_other_streams_and_checks_run_on_numpy_alone(files):
    assert bare("check", files.log).returncode == 0
    assert bare("check", files.log, "-o", "-", "--to", "ndjson").returncode == 0
    fcc = bare("fcc", "-C", "d_x_um", "--period", "10", "--delay", "20", "--gain", "1",
               stdin="time_s,d_x_um\n" + "".join(f"{10 * k},0.0\n" for k in range(30)))  # fmt: skip
    assert fcc.returncode == 0, fcc.stderr


def test_long_tables_are_read_and_written_without_pyarrow(tmp_path):
    path = tmp_path / "long.csv"
    rows = "".join(f"{k},{k / 7:.6f}\n" for k in range(60_000))
    path.write_text("time_s,T_a_degC\n" + rows)
    result = bare("check", path, "-o", tmp_path / "again.csv")
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "again.csv").read_text().count("\n") == 60_001


@pytest.mark.parametrize(
    ("line", "extra"),
    [
        ("simulate MODEL LOG", "batch"),
        ("calibrate LOG --drive Q_main_1 --deflection d_x_um", "batch"),
        ("noise LOG --plot x.png", "plot"),
        ("plot LOG -o x.png", "plot"),
        ("plant frame --input step", "plants"),
        ("check x.parquet", "batch"),
    ],
)
def test_other_commands_say_in_one_line_what_to_install(files, tmp_path, line, extra):
    (tmp_path / "x.parquet").write_bytes(b"PAR1")
    words = {"LOG": files.log, "MODEL": files.model, "x.parquet": tmp_path / "x.parquet"}
    result = bare(*(words.get(word, word) for word in line.split()))
    assert (result.returncode, result.stdout) == (1, "")
    name = line.split()[0]
    assert re.fullmatch(
        rf"thermaltool {name}: needs \w+, which is not installed \(streams do without\): "
        rf"pip install 'thermaltool\[{extra}\]', or 'thermaltool\[all\]' for all commands\n",
        result.stderr,
    ), result.stderr


def test_help_needs_nothing():
    assert bare("--help").returncode == 0
    for name in ("compensate", "calibrate", "plot"):
        assert bare(name, "--help").returncode == 0


@pytest.mark.slow
def test_every_package_that_is_imported_has_an_extra():
    seen = set()
    for path in (ROOT / "thermaltool").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                seen |= {each.name for each in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
                seen.add(node.module)
    roots = {name.partition(".")[0] for name in seen} - set(sys.stdlib_module_names)
    assert roots - {"thermaltool", "numpy", "click", "__future__"} <= set(EXTRAS)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = {
        name: {re.split(r"[<>=]", each)[0] for each in packages}
        for name, packages in project["optional-dependencies"].items()
    }
    for package, extra in EXTRAS.items():
        assert DISTRIBUTIONS.get(package, package) in extras[extra]
    # One extra is enough for a command: each has what batch work takes.
    assert all(extras["batch"] <= packages for packages in extras.values())
    assert extras["all"] == set.union(*extras.values())
    assert set(OF_COMMANDS) <= set(COMMANDS)
    assert {*OF_COMMANDS.values(), *OF_OPTIONS.values()} <= set(extras)


def test_a_fault_of_the_program_is_no_missing_package():
    assert missing_package("thermaltool.cli.nothing", "check", []) is None
    assert missing_package(None, "check", []) is None
