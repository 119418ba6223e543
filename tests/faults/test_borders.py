"""Numbers, depths, names and inputs that nobody means, each where it was found."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from thermaltool.documents import atomic_output
from thermaltool.files import MARK, file_words

TOOL = [sys.executable, "-c", "from thermaltool.cli import main; main()"]


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("[" * 100_000, "nested deeper than 50"),
        ("[" * 60 + "]" * 60, "nested deeper than 50"),
        ("9" * 400, "sample_period_s: not a finite number: 9999"),
        ("9" * 5000, "sample_period_s: not a finite number: inf"),
        ("NaN", "sample_period_s: not a finite number: nan"),
        ("1e300", "sample_period_s: too large, above 1e+75: 1e+300"),
        ("1e-300", "sample_period_s: too small, below 1e-75: 1e-300"),
        ('"\\ud800"', "sample_period_s': not a text: '\\ud800'"),
    ],
    ids=["unclosed", "deep", "400", "5000", "nan", "large", "small", "surrogate"],
)
def test_a_value_that_no_model_holds(thermaltool, files, value, message) -> None:
    text = json.dumps({**json.loads(files.model.read_text()), "sample_period_s": "@"})
    files.model.write_text(text.replace('"@"', value))
    result = thermaltool("simulate", files.model, files.log)
    assert result.code == 1
    assert result.err.count("\n") == 1
    assert f"{files.model}" in result.err
    assert message in result.err


def test_numbers_in_a_design_have_bounds(thermaltool, files) -> None:
    document = json.loads(files.kalman.read_text())
    document["design"]["walk_per_sqrt_s"] = [1e200]
    files.kalman.write_text(json.dumps(document))
    result = thermaltool("estimate", files.kalman, files.log)
    assert result.code == 1
    assert "design: walk_per_sqrt_s[0]: too large, above 1e+75: 1e+200" in result.err


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("scale = inf", "columns.dT_pair1_K.scale: not a finite number: inf"),
        ("offset = nan", "columns.dT_pair1_K.offset: not a finite number: nan"),
        (f"offset = {'9' * 5000}", "not TOML: Exceeds the limit"),
        (f"offset = {'9' * 400}", "columns.dT_pair1_K.offset: not a finite number: 9999"),
        (f"offset = {'[' * 5000}", "nested deeper than 50"),
        ("scale = 1e300", "columns.dT_pair1_K.scale: too large, above 1e+75: 1e+300"),
    ],
    ids=["inf", "nan", "5000", "400", "deep", "large"],
)
def test_a_column_map_that_cannot_be_meant(thermaltool, files, line, message) -> None:
    path = files.folder / "map.toml"
    path.write_text(f'[columns.dT_pair1_K]\nname = "dT_pair1_K"\n{line}\n')
    result = thermaltool("check", files.log, "--columns", path)
    assert result.code == 1
    assert result.err.startswith(f"thermaltool check: {path}: {message}")
    assert result.err.count("\n") == 1


FITS = [
    "calibrate LOG --drive Q_main_1 --deflection d_x_um -o OUT",
    "identify LOG --input Q_main_1 --output d_x_um -o OUT",
    "identify LOG --input Q_main_1 --output d_x_um --structure arx --orders 1,1,0 -o OUT",
    "diagnose MODEL LOG -o OUT",
    "noise LOG -o OUT",
    "order LOG -C d_x_um",
    "fit LOG -C d_x_um --order 1 -o OUT",
    "correct MODEL LOG -o OUT",
]


NEEDING = ("calibrate", "identify", "correct")


@pytest.mark.parametrize("command", FITS)
@pytest.mark.parametrize("value", ["1e300", "1e160", "-1e76"])
def test_a_number_whose_square_overflows_is_refused(thermaltool, files, command, value) -> None:
    lines = files.log.read_text().splitlines()
    time_s, heat, warm, _, room = lines[20].split(",")
    lines[20] = ",".join([time_s, heat, warm, value, room])
    files.log.write_text("\n".join(lines) + "\n")
    out = files.folder / "out.json"
    out.write_text("old")
    words = {"LOG": files.log, "MODEL": files.model, "OUT": out}
    result = thermaltool(*(words.get(word, word) for word in command.split()))
    assert result.code == 1
    name = command.split()[0]
    expected = f"{files.log}:21: d_x_um: too large, above 1e+75: {float(value):g}"
    assert result.err == f"thermaltool {name}: {expected}\n"
    assert out.read_text() == "old"


@pytest.mark.parametrize("command", [f for f in FITS if f.split()[0] in NEEDING])
def test_a_channel_whose_squares_vanish_is_refused(thermaltool, files, command) -> None:
    rows = [line.split(",") for line in files.log.read_text().splitlines()]
    for row in rows[1:]:
        row[3] = f"{float(row[3]):.3f}e-302"
    files.log.write_text("\n".join(",".join(row) for row in rows) + "\n")
    words = {"LOG": files.log, "MODEL": files.model, "OUT": files.folder / "out.json"}
    result = thermaltool(*(words.get(word, word) for word in command.split()))
    assert result.code == 1
    assert f"{files.log}: d_x_um: too small, none above 1e-75\n" in result.err


def test_check_reports_a_number_that_is_too_large(thermaltool, files) -> None:
    files.log.write_text(files.log.read_text().replace("\n200,", "\n2e300,", 1))
    result = thermaltool("check", files.log)
    assert result.code == 3
    assert "time_s: too large for a clock: 2e+300" in result.out


def test_words_for_files_stay_in_their_folder_and_differ() -> None:
    names = ["d_x_um", "dT_/../../x_K", "dT_-..-..-x_K", "D_X_UM", "..", "", "a/b\\c:d\n\0",
             ".hidden", "µ" * 300, "µ" * 300, "con\u202etxt", "d_x_um"]  # fmt: skip
    words = file_words(names)
    assert words[0] == "d_x_um"
    assert len({word.casefold() for word in words}) == len(names)
    for word in words:
        assert os.path.basename(word) == word
        assert word.isprintable()
        assert not word.startswith(".")
        assert not set(word) & set('/\\:*?"<>|')
        assert 0 < len(word.encode()) < 120


@pytest.mark.slow
def test_a_report_writes_beside_itself_whatever_channels_are_called(thermaltool, files) -> None:
    folder = files.folder / "deep" / "er"
    folder.mkdir(parents=True)
    evil = "dT_/../../x_K"
    for path in (files.log, files.model):
        path.write_text(path.read_text().replace("dT_pair1_K", evil))
    # With this folder the channel's name would lead out of the report's.
    (folder / "why_dT_").mkdir()
    before = sorted(path for path in files.folder.rglob("*.png"))
    result = thermaltool("diagnose", files.model, files.log, "--report", folder / "why.md", "-q")
    assert result.code in (0, 3, 4)
    written = sorted(set(files.folder.rglob("*.png")) - set(before))
    assert written
    assert all(path.parent == folder for path in written)
    report = (folder / "why.md").read_text()
    assert all(f"(<{path.name}>)" in report for path in written)


def test_what_a_killed_run_left_is_taken_away(tmp_path) -> None:
    target = tmp_path / "out.csv"
    code = (
        "import os, signal, sys; from thermaltool.documents import atomic_output\n"
        "with atomic_output(sys.argv[1]) as f: f.write(b'half'); f.flush(); "
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", code, str(target)], check=False)
    (left,) = tmp_path.iterdir()
    assert left.name.endswith(MARK)
    other = tmp_path / f".other.csv.12345678{MARK}"
    other.write_bytes(b"of another target")

    def write() -> set[str]:
        with atomic_output(str(target)) as stream:
            stream.write(b"new")
        return {path.name for path in tmp_path.iterdir()}

    # It is young: it could belong to a run that has not locked it yet.
    assert write() == {"out.csv", left.name, other.name}
    old = time.time() - 3600
    for path in (left, other):
        os.utime(path, (old, old))
    assert write() == {"out.csv", other.name}


def test_what_a_slow_run_is_writing_stays(tmp_path) -> None:
    target = tmp_path / "out.csv"
    with atomic_output(str(target)) as slow:
        slow.write(b"slow")
        slow.flush()
        (temporary,) = tmp_path.iterdir()
        os.utime(temporary, (0, 0))
        with atomic_output(str(target)) as quick:
            quick.write(b"quick")
        assert target.read_bytes() == b"quick"
    assert target.read_bytes() == b"slow"


@pytest.mark.slow
def test_a_hang_up_takes_the_temporary_file_away(tmp_path) -> None:
    code = (
        "import os, signal, time, thermaltool.cli as cli\n"
        "from thermaltool.documents import atomic_output\n"
        "def half(*a, **k):\n"
        "    with atomic_output('OUT') as f:\n"
        "        f.write(b'half'); os.kill(os.getpid(), signal.SIGHUP); time.sleep(20)\n"
        "cli.group.main = half\n"
        "cli.main()"
    )
    result = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, timeout=15, check=False)
    assert result.returncode == 128 + signal.SIGHUP
    assert os.listdir(tmp_path) == []


def test_nohup_is_left_alone(tmp_path) -> None:
    code = (
        "import os, signal, thermaltool.cli as cli\n"
        "cli.group.main = lambda **k: os.kill(os.getpid(), signal.SIGHUP)\n"
        "cli.main()"
    )
    line = ["nohup", sys.executable, "-c", code]
    assert subprocess.run(line, cwd=tmp_path, capture_output=True, check=False).returncode == 0


ENDLESS = ["check {}", "simulate MODEL {}", "simulate {} LOG", "fit {} -C d_x_um --order 1",
           "check LOG --columns {}", "regularize MODEL --noise {}", "plot {} -o OUT"]  # fmt: skip


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="no /dev/zero here")
@pytest.mark.parametrize("line", ENDLESS)
def test_an_input_without_lines_and_without_end(thermaltool, files, line) -> None:
    words = {"LOG": files.log, "MODEL": files.model, "OUT": files.folder / "out.png"}
    words["{}"] = "/dev/zero"
    result = thermaltool(*(words.get(word, word) for word in line.split()))
    assert result.code == 1
    assert "/dev/zero: " in result.err
    assert "a line longer than 16 MiB" in result.err
    assert result.err.count("\n") == 1


def test_long_lines_are_bounded_and_long_logs_are_not(thermaltool, files, monkeypatch) -> None:
    def check():
        # The command takes back what was set.
        monkeypatch.setattr("thermaltool.sources.READ_AT_ONCE", 100)
        monkeypatch.setattr("thermaltool.sources.MAX_LINE", 200)
        return thermaltool("check", files.log)

    assert check().code == 0
    files.log.write_text(files.log.read_text() + "x" * 301)
    result = check()
    assert result.code == 1
    assert "a line longer than 0 MiB" in result.err


def test_an_input_with_lines_and_without_end(thermaltool, files) -> None:
    log = files.log.read_bytes()
    refused = "<stdin>: cannot be read: more than 1000 bytes"
    result = thermaltool("--max-bytes", "1kB", "check", "-", stdin=log)
    assert result.code == 1
    assert refused in result.err
    assert "thermaltool --max-bytes 20GB COMMAND ... reads as much" in result.err
    assert result.err.count("\n") == 1
    # What was set is of that command.
    assert thermaltool("check", files.log).code == 0
    assert thermaltool("--max-bytes", "4MB", "check", files.log).code == 0


@pytest.mark.parametrize("line", ENDLESS)
def test_a_file_is_refused_by_its_size_before_it_is_read(thermaltool, files, line) -> None:
    large = files.folder / "large.csv"
    with large.open("wb") as stream:
        stream.truncate(10**12)  # of holes
    words = {"LOG": files.log, "MODEL": files.model, "OUT": files.folder / "out.png", "{}": large}
    result = thermaltool(*(words.get(word, word) for word in line.split()))
    assert result.code == 1
    assert "more than 2 GiB" in result.err
    assert result.err.count("\n") == 1


@pytest.mark.parametrize("size", ["x", "0", "-1", "1e9", "nan", "9999999TB"])
def test_a_size_that_is_none(thermaltool, files, size) -> None:
    result = thermaltool("--max-bytes", size, "check", files.log)
    assert result.code == 2
    assert "--max-bytes" in result.err


def test_a_variable_of_the_environment_is_named(thermaltool, files, monkeypatch):
    for name, arguments in (
        ("THERMALTOOL_MAX_BYTES", ("check", files.log)),
        ("THERMALTOOL_CHECK_MAX_GAP", ("check", files.log)),
    ):
        with monkeypatch.context() as own:
            own.setenv(name, "foo")
            result = thermaltool(*arguments)
        assert (result.code, result.out) == (2, "")
        assert f"(from {name})" in result.err


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("line", ["check {}", "simulate {} LOG", "check LOG --columns {}"])
def test_a_pipe_that_nobody_writes_to(thermaltool, files, monkeypatch, line) -> None:
    fifo = files.folder / "fifo"
    os.mkfifo(fifo)
    monkeypatch.setattr("thermaltool.sources.TOLD_AFTER", 0.05)
    monkeypatch.setattr("thermaltool.sources.GIVEN_UP_AFTER", 0.1)
    words = {"LOG": files.log, "{}": fifo}
    result = thermaltool(*(words.get(word, word) for word in line.split()))
    assert result.code == 1
    told, refused = result.err.splitlines()
    assert told == f"{fifo}: nothing has come for 0.05 s: waits for who writes it"
    assert refused.endswith("nobody has written to this pipe for 0.1 s")


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("after", [0.0, 0.3])
def test_a_pipe_whose_writer_is_slow_is_waited_for(thermaltool, files, monkeypatch, after) -> None:
    fifo = files.folder / "fifo"
    os.mkfifo(fifo)
    monkeypatch.setattr("thermaltool.sources.TOLD_AFTER", 0.05)
    monkeypatch.setattr("thermaltool.sources.GIVEN_UP_AFTER", 0.1 if after else 5.0)
    shell = f"exec 3> '{fifo}'; sleep {after}; cat '{files.log}' >&3"
    with subprocess.Popen(["sh", "-c", shell]) as writer:
        # Where the writer only starts, the pipe has to be there for it longer.
        if after:
            time.sleep(0.1)
        result = thermaltool("check", fifo)
        assert writer.wait() == 0
    assert result.code == 0
    assert "nothing wrong" in result.out


def test_a_pipe_whose_writer_leaves_without_a_word(thermaltool, files) -> None:
    fifo = files.folder / "fifo"
    os.mkfifo(fifo)
    with subprocess.Popen(["sh", "-c", f"exec 3> '{fifo}'"]):
        result = thermaltool("check", fifo)
    assert result.code == 1
    assert "the file is empty" in result.err


FAILING = [
    ("identify LOG --input Q_main_1 --output d_x_um --orders 1,1,0 --structure arx -o OUT",
     "thermaltool.api.identification.Identification.table"),
    ("fit LOG -C d_x_um --order 1 -o OUT", "thermaltool.api.arma.ArmaFit.table"),
    ("simulate MODEL LOG -o OUT", "thermaltool.api.simulation.Simulation.table"),
    ("estimate KALMAN LOG -o OUT", "thermaltool.api.estimation.LogEstimate.table"),
    ("noise LOG -o OUT", "thermaltool.api.noise_report.NoiseReport.table"),
    ("regularize MODEL --noise NOISE --form kalman --walk 0.02 -o OUT",
     "thermaltool.api.estimation.DesignReport.table"),
]  # fmt: skip


@pytest.mark.parametrize(("line", "part"), FAILING)
def test_a_command_that_fails_at_the_end_leaves_the_old_file(
    thermaltool, files, monkeypatch, line, part
) -> None:
    out = files.folder / "out.json"
    out.write_text("old")
    words = {"LOG": files.log, "MODEL": files.model, "OUT": out, "NOISE": files.noise,
             "KALMAN": files.kalman}  # fmt: skip

    def fails(self: object) -> str:
        raise MemoryError

    monkeypatch.setattr(part, fails)
    result = thermaltool(*(words.get(word, word) for word in line.split()))
    assert result.code == 1
    assert out.read_text() == "old"


@pytest.mark.slow
def test_a_closed_stdout_leaves_the_old_file(files) -> None:
    out = files.folder / "out.json"
    out.write_text("old")
    line = [*TOOL, "fit", str(files.log), "-C", "d_x_um", "--order", "1", "-o", str(out)]
    shell = ["sh", "-c", 'exec "$@" >/dev/full', "sh", *line]
    result = subprocess.run(shell, stderr=subprocess.PIPE, check=False)
    assert result.returncode == 1
    assert out.read_text() == "old"


def test_out_of_memory_says_what_to_do(thermaltool, files, monkeypatch) -> None:
    from thermaltool.logs import reader

    def exhausted(*_, **__):
        raise MemoryError

    monkeypatch.setattr(reader, "open_mapped", exhausted)
    result = thermaltool("check", files.log)
    assert result.code == 1
    assert result.err.startswith("thermaltool check: out of memory: take a shorter log")
