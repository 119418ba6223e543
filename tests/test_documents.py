"""Nothing that existed is lost, whatever happens while writing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from thermaltool.documents import atomic_output
from thermaltool.errors import OutputError


def write(target: Path | str, data: bytes = b"new") -> None:
    with atomic_output(str(target)) as stream:
        stream.write(data)


def test_a_file_appears_complete(tmp_path: Path) -> None:
    target = tmp_path / "out.csv"
    with atomic_output(str(target)) as stream:
        stream.write(b"new")
        assert not target.exists()
    assert target.read_bytes() == b"new"
    assert os.listdir(tmp_path) == ["out.csv"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_an_interrupted_write_leaves_the_old_file(
    tmp_path: Path, error: type[BaseException]
) -> None:
    target = tmp_path / "out.csv"
    target.write_bytes(b"old")

    def interrupted() -> None:
        with atomic_output(str(target)) as stream:
            stream.write(b"half")
            raise error

    with pytest.raises(error):
        interrupted()
    assert target.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["out.csv"]


def test_the_mode_of_the_old_file_stays(tmp_path: Path) -> None:
    target = tmp_path / "out.csv"
    target.write_bytes(b"old")
    target.chmod(0o640)
    write(target)
    assert target.stat().st_mode & 0o777 == 0o640


def test_a_symbolic_link_stays_one(tmp_path: Path) -> None:
    (tmp_path / "real.csv").write_bytes(b"old")
    link = tmp_path / "link.csv"
    link.symlink_to("real.csv")
    write(link)
    assert link.is_symlink()
    assert (tmp_path / "real.csv").read_bytes() == b"new"


def test_folder_missing_or_given_as_file(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="No such file or directory"):
        write(tmp_path / "absent" / "out.csv")
    with pytest.raises(OutputError, match="Is a directory"):
        write(tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes to read-only folders")
def test_folder_read_only(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(OutputError, match="Permission denied"):
            write(tmp_path / "out.csv")
    finally:
        tmp_path.chmod(0o700)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_disk_full() -> None:
    with pytest.raises(OutputError, match=r"/dev/full: No space left on device"):
        write("/dev/full")


SCRIPT = """
from thermaltool.errors import OutputError
from thermaltool.documents import atomic_output
try:
    with atomic_output("-") as stream:
        stream.write(b"x" * {size})
except OutputError as error:
    raise SystemExit(f"told: {{error}}")
except BrokenPipeError:
    import os
    os._exit(7)
"""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("size", [1, 1_000_000])
def test_stdout_full_is_told_once(size: int) -> None:
    with open("/dev/full", "wb") as full:
        result = subprocess.run(
            [sys.executable, "-c", SCRIPT.format(size=size)],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert result.stderr == "told: <stdout>: No space left on device\n"
    assert result.returncode == 1


def test_a_closed_pipe_is_a_broken_pipe() -> None:
    read, wrote = os.pipe()
    os.close(read)
    command = [sys.executable, "-c", SCRIPT.format(size=1_000_000)]
    result = subprocess.run(command, stdout=wrote, stderr=subprocess.PIPE)
    os.close(wrote)
    assert result.returncode == 7
