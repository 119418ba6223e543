"""How a command ends that somebody else ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

TOOL = [sys.executable, "-c", "from thermaltool.cli import main; main()"]


@pytest.mark.slow
def test_sigterm_leaves_the_old_file_and_nothing_beside_it(tmp_path):
    target = tmp_path / "log.csv"
    target.write_text("old\n")
    process = subprocess.Popen(
        [*TOOL, "check", "-", "-o", str(target)], stdin=subprocess.PIPE, stderr=subprocess.PIPE
    )
    time.sleep(1.5)  # it waits for its input
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate()
    assert process.returncode == 143
    assert b"Traceback" not in err
    assert target.read_text() == "old\n"
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]


def test_the_package_runs_as_a_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "thermaltool", "simulate"], capture_output=True, text=True
    )
    assert done.returncode == 2
    assert "Usage: thermaltool simulate" in done.stderr


LOADED = (
    "import os, signal, sys\n"
    "from thermaltool.cli import group, main\n"
    "invoke = group.invoke\n"
    "def early(ctx):\n"
    "    for _ in range({times}):\n"
    "        os.kill(os.getpid(), signal.{name})\n"
    "    return invoke(ctx)\n"
    "group.invoke = early\n"
    "main()"
)


@pytest.mark.parametrize(
    ("name", "times", "code", "out"),
    [
        ("SIGTERM", 1, 143, "time_s,offset_x_um\n,0.0\n"),
        ("SIGINT", 1, 130, "time_s,offset_x_um\n,0.0\n"),
        ("SIGTERM", 2, 143, ""),
    ],
)
def test_a_signal_while_a_stream_loads_waits_for_the_safe_line(files, name, times, code, out):
    call = [sys.executable, "-c", LOADED.format(name=name, times=times)]
    done = subprocess.run(
        [*call, "compensate", str(files.kalman)], input="", capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (code, out)


def test_a_signal_while_another_command_loads_ends_it(files):
    call = [sys.executable, "-c", LOADED.format(name="SIGTERM", times=1)]
    done = subprocess.run([*call, "check", str(files.log)], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (143, "", "")


def test_a_stream_that_waits_for_its_log_ends_with_the_safe_line(files):
    fifo = files.folder / "fifo"
    os.mkfifo(fifo)
    call = [*TOOL, "compensate", str(files.kalman), str(fifo), "--no-header"]
    process = subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    time.sleep(1.0)
    process.send_signal(signal.SIGTERM)
    out, _ = process.communicate(timeout=10)
    assert (process.returncode, out) == (143, ",0.0\n")
