"""``thermaltool fcc`` as a process, in a loop with the boring bar, and what may go wrong."""

import math
import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from thermaltool.logs import read_log
from thermaltool.plants.boring_bar import build

TOOL = [sys.executable, "-c", "from thermaltool.cli import main; main()"]
OPTIONS = ["-C", "e_tool_um", "--period", "0.0005"]
HEADER = "time_s,e_tool_um\n"


def lines_of(values, period=0.0005):
    return HEADER + "".join(f"{k * period:.4f},{x}\n" for k, x in enumerate(values))


def run(*arguments, text=""):
    done = subprocess.run(
        [*TOOL, "fcc", *OPTIONS, *map(str, arguments)],
        input=text.encode(),
        capture_output=True,
        timeout=60,
    )
    return done.returncode, done.stdout.decode().splitlines(), done.stderr.decode().splitlines()


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    """A log of the piezo moved at random, free of the wall."""
    volts = np.random.default_rng(3).uniform(0, 10, 60)
    columns = build().probe(np.repeat(volts, 40)).columns(0.0)
    path = tmp_path_factory.mktemp("trial") / "trial.csv"
    rows = zip(*(columns[name].tolist() for name in columns), strict=True)
    path.write_text("\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows)]))
    return path


@pytest.mark.slow
def test_a_loop_of_two_processes(tmp_path, trial):
    """plant | fcc > pipe > plant: the cut is deeper and rounder than without."""
    pipe, closed = tmp_path / "commands", tmp_path / "closed.csv"
    os.mkfifo(pipe)
    cut = ["plant", "boring-bar", "--part", "taper", "--duration", "2", "--seed", "5"]
    control = ["--identify", str(trial), "--low-pass", "753:0.707", "--spindle", "n_spindle_rpm"]
    plant = subprocess.Popen(
        [*TOOL, *cut, "--commands", str(pipe), "-o", str(closed)], stdout=subprocess.PIPE
    )
    with open(pipe, "wb") as commands:
        fcc = subprocess.Popen(
            [*TOOL, "fcc", *OPTIONS, *control, "--limit=-2:10"],
            stdin=plant.stdout,
            stdout=commands,
            stderr=subprocess.PIPE,
        )
    plant.stdout.close()
    _, told = fcc.communicate(timeout=60)
    assert plant.wait(60) == 0
    assert "explain 9" in told.decode().splitlines()[0]
    assert "4000 samples: error" in told.decode().splitlines()[-1]
    log = read_log(str(closed))
    without = build().cut(_part("taper"), 600.0, 4000, seed=5).deflection[2000:]
    left = log.column("d_tool_um")[2000:]
    assert abs(left.mean()) < 0.05 * abs(without.mean())
    assert left.std() < 0.5 * without.std()


def _part(name):
    from thermaltool.plants.boring_bar import PARTS

    return PARTS[name]


def test_one_line_in_one_line_out_and_the_safe_command_last():
    code, out, err = run("--delay", 0.001, "--gain", 2, text=lines_of([1.0] * 5))
    assert code == 0
    assert out[0] == "time_s,U_command_V"
    assert len(out) == 1 + 5 + 1
    # the error is taken to stay until something is known of it
    assert float(out[1].split(",")[1]) == pytest.approx(-0.5)
    assert out[-1] == "0.0025,0.0"
    assert err[0].startswith("thermaltool fcc: 5 samples: error 1 RMS as read")


def test_limits_steps_and_more_columns():
    code, out, _ = run(
        "--delay", 0.001, "--limit=-3:3", "--step", 0.5, "--also", text=lines_of([1.2, 9, 9, 9])
    )
    assert code == 0
    assert out[0] == "time_s,U_command_V,wanted,uncompensated,forecast"
    commands = [float(line.split(",")[1]) for line in out[1:-1]]
    assert commands[0] == -1.0
    assert min(commands) == -3.0
    assert float(out[1].split(",")[3]) == 1.2


def test_bad_readings_are_bridged_then_safe():
    text = lines_of([1.0, 1.0, "nan", "", "--", *["nan"] * 10, 1.0])
    code, out, err = run("--delay", 0.001, "--hold", 0.003, text=text)
    assert code == 0
    commands = [float(line.split(",")[1]) for line in out[1:]]
    assert all(map(math.isfinite, commands))
    assert commands[:5] == pytest.approx([-1.0] * 5)
    assert commands[12] == 0.0
    assert any("safe setpoint" in line for line in err)
    assert any("good again" in line for line in err)


def test_a_time_that_repeats_is_ignored_and_a_pause_is_told():
    text = HEADER + "0,1\n0.0005,1\n0.0005,7\n0.001,1\n3,1\n3.0005,1\n"
    code, out, err = run("--delay", 0.001, text=text)
    assert code == 0
    assert len(out) == 1 + 6 + 1
    assert "line ignored" in err[0]
    assert "a pause of 2.9995 s" in err[2]


def test_a_stream_without_a_clock():
    code, out, _ = run("--delay", 0.001, "--clock", "none", text="e_tool_um\n1\n1\n")
    assert code == 0
    assert [line.split(",")[0] for line in out[1:]] == ["0.0", "0.0005", "0.001"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_with_the_safe_command(number):
    process = subprocess.Popen(
        [*TOOL, "fcc", *OPTIONS, "--delay", "0.001", "--safe", "1.5", "--timeout", "0"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        bufsize=0,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    process.stdin.write(lines_of([3.0]).encode())
    data = b""
    while data.count(b"\n") < 2:
        data += os.read(process.stdout.fileno(), 4096)
    process.send_signal(number)
    rest, _ = process.communicate(timeout=30)
    assert process.returncode == 128 + number
    assert rest == b"0.0005,1.5\n"


def test_silence_leads_to_the_safe_command():
    process = subprocess.Popen(
        [*TOOL, "fcc", *OPTIONS, "--delay", "0.001", "--timeout", "0.2"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        bufsize=0,
    )
    process.stdin.write(lines_of([3.0]).encode())
    data = b""
    while data.count(b"\n") < 3:
        data += os.read(process.stdout.fileno(), 4096)
    assert data.splitlines()[-1].endswith(b",0.0")
    _, err = process.communicate(timeout=30)
    assert b"no usable line for 0.2 s" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "give --delay or --identify"),
        (("--delay", 0.001, "--horizon", 1), "within the delay: at least 3"),
        (("--delay", 0.001, "--limit=1:3"), "safe command 0 is outside the limits"),
        (("--delay", 0.001, "--gain", 1, "--hysteresis", "0:1"), "leave --gain out"),
        (("--delay", 0.001, "--hysteresis", "0:1,1:-2"), "partial sum"),
        (("--delay", 0.001, "--hysteresis", "0:x"), "is not R:W"),
        (("--delay", 0.001, "--low-pass", "753"), "is not OMEGA:DAMPING"),
        (("--delay", 0.001, "--low-pass", "753:-1"), "low-pass"),
        (("--delay", 0.001, "--error-model", "0"), "is not direct|P|P,Q"),
    ],
)
def test_usage(arguments, message):
    code, out, err = run(*arguments, text=HEADER)
    assert code == 2
    assert out == []
    assert message in err[-1]


@pytest.mark.parametrize(
    ("arguments", "text", "message"),
    [
        (("--delay", 0.001), "", "empty"),
        (("--delay", 0.001), "time_s,d_z_um\n0,1\n", "no column e_tool_um"),
        (("--delay", 0.001, "--spindle", "n_main_rpm"), HEADER, "no column n_main_rpm"),
    ],
)
def test_what_cannot_be_read(arguments, text, message):
    code, _, err = run(*arguments, text=text)
    assert code == 1
    assert message in " ".join(err)


@pytest.mark.slow
def test_a_trial_in_which_nothing_moves(tmp_path):
    still = tmp_path / "still.csv"
    still.write_text(
        "time_s,U_command_V,e_tool_um\n" + "".join(f"{k * 0.0005},0,1\n" for k in range(99))
    )
    code, _, err = run("--identify", still, text=HEADER)
    assert code == 1
    assert "the command does not move" in err[-1]


@pytest.mark.slow
def test_a_trial_of_another_period(trial):
    code, _, err = run("--period", "0.001", "--identify", trial)
    assert code == 2
    assert "has a sample each 0.0005 s, --period says 0.001 s" in err[-1]


def test_one_reading_that_stands_alone_is_bridged():
    errors = np.random.default_rng(11).normal(0, 1, 400) + 3
    errors[200] = 1e6
    options = ["--delay", "0.001", "--gain", "1", "--limit=-8:8", "--also"]
    code, told, err = run(*options, text=lines_of(errors.tolist()))
    assert code == 0
    forecasts = np.array([float(line.split(",")[-1]) for line in told[1:-1]])
    assert np.abs(forecasts).max() < 100
    assert "1 reading stood alone" in err[-1]


@pytest.mark.parametrize("huge", [1e300, -1e300])
def test_a_reading_too_large_for_its_square(huge):
    code, told, _ = run(
        "--delay", "0.001", "--gain", "1", "--limit=-8:8", text=lines_of([0, 1, huge, 1, 0])
    )
    assert code == 0
    assert all(-8 <= float(line.split(",")[-1]) <= 8 for line in told[1:])


def test_commands_that_the_readings_do_not_follow():
    errors = np.cumsum(np.random.default_rng(12).normal(0, 1, 4000)).tolist()
    code, told, err = run("--delay", "0.0028", "--gain", "1.5", text=lines_of(errors))
    assert code == 1
    assert "the commands run away: the readings do not follow them" in err[-1]
    assert float(told[-1].split(",")[-1]) == 0  # the safe command


def test_a_delay_of_thousands_of_samples():
    code, _, err = run("--delay", "50", "--gain", "1")
    assert code == 2
    assert "100000 samples: at most 20000" in err[-1]


def test_commands_at_their_limit_are_told():
    code, _, err = run(
        "--delay", "0.001", "--gain", "1", "--limit=-0.1:0.1", text=lines_of([5.0] * 99)
    )
    assert code == 0
    assert "at the limit in" in err[-1]


@pytest.mark.slow
def test_a_loop_whose_commands_end_early_keeps_what_was_cut(tmp_path):
    pipe, log = tmp_path / "commands", tmp_path / "cut.csv"
    os.mkfifo(pipe)
    plant = subprocess.Popen(
        [*TOOL, "plant", "boring-bar", "--duration", "1", "--commands", str(pipe), "-o", str(log)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    with open(pipe, "w") as commands:
        commands.write("time_s,U_command_V\n")
        commands.writelines(f"{k},0.5\n" for k in range(40))
    _, told = plant.communicate(timeout=60)
    assert plant.returncode == 1
    assert b"ended before the cut: 40 of 2000 samples" in told
    assert len(log.read_text().splitlines()) == 41


def test_an_error_model_that_nobody_can_follow():
    code, _, err = run("--delay", 0.001, "--gain", 1, "--error-model", "5000")
    assert code == 2
    assert "at most 200 coefficients" in err[-1]


@pytest.mark.parametrize("factor", [0.25, 0.5, 2.0, 4.0])
def test_lines_of_another_period_are_refused(factor):
    period = 0.0005 * factor
    text = HEADER + "".join(f"{k * period:.7f},{math.sin(k / 9)}\n" for k in range(200))
    code, _, messages = run("--delay", 0.001, "--limit=-2:10", text=text)
    assert code == 1
    assert f"lines come each {period:g} s, the period is 0.0005 s" in messages[-1]


def test_a_gauge_that_starts_on_zero_is_no_run_away():
    code, lines, _ = run("--delay", 0.001, "--gain", 2.1, "--safe", 1, text=lines_of([0.0] * 30))
    assert code == 0
    assert len(lines) >= 30


def test_the_summary_counts_good_samples_only():
    values = (2.0 + 0.1 * np.random.default_rng(1).standard_normal(400)).tolist()
    values[120:130] = [math.nan] * 10
    values[300] = 1e12
    _, _, messages = run("--delay", 0.001, "--gain", 2, "--limit=-0.1:0.1", text=lines_of(values))
    told = messages[-1]
    good = [x for x in values if not math.isnan(x) and x < 1e3]
    root_mean_square = math.sqrt(sum(x * x for x in good) / len(good))
    assert f" {len(good)} samples: error {root_mean_square:.3g} RMS as read" in told
    assert float(told.split("at the limit in ")[1].split("%")[0]) <= 100
