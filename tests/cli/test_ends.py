"""How a command ends that somebody else ends."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

TOOL = [sys.executable, "-c", "from thermaltool.cli import main; main()"]


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
