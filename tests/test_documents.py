"""Nothing that existed is lost, whatever happens while writing."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from thermaltool.documents import (
    DocumentFormat,
    Part,
    atomic_output,
    finite,
    jsonable,
    read_text,
    write_json,
)
from thermaltool.errors import ModelError, OutputError


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


TEA = DocumentFormat("tea", 2, "a recipe of tea")


def test_a_document_says_what_it_is_and_is_read_back() -> None:
    text = TEA.dumps({"minutes": 4})
    assert text == '{\n "format": "tea",\n "minutes": 4,\n "version": 2\n}\n'
    assert TEA.loads(text, "t.json") == {"format": "tea", "version": 2, "minutes": 4}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"a":\n', r"t\.json:2: not JSON: .* \(not a recipe of tea\)"),
        ("[1]", r't\.json: not a recipe of tea \(no "format": "tea"\)'),
        ('{"format": "soup"}', r"t\.json: not a recipe of tea: format 'soup' is not tea"),
        ('{"format": "tea"}', r"t\.json: no version of the format: None"),
        ('{"format": "tea", "version": true}', r"t\.json: no version of the format: True"),
        ('{"format": "tea", "version": 3}', r"version 3 is newer .* reads \(2\): update it"),
    ],
)
def test_another_document_is_refused_by_name(text: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        TEA.loads(text, "t.json")


def test_an_early_document_may_have_no_version() -> None:
    early = DocumentFormat("tea", 2, "a recipe of tea", needs_version=False)
    assert early.loads('{"format": "tea"}', "t.json") == {"format": "tea"}


def test_the_place_of_a_field_is_named() -> None:
    part = Part({"cups": [{"ml": 200}, {"ml": "many"}]})
    assert [each.names() for each in part.parts("cups")] == [("ml",), ("ml",)]
    with pytest.raises(ModelError, match=r"cups\[1\]\.ml: not a finite number: 'many'"):
        [cup.read("ml", finite) for cup in part.parts("cups")]


def test_json_holds_plain_data_and_null_for_nan() -> None:
    given = {1: (np.float64(2.0), np.nan), "a": np.array([1.0, np.inf]), "b": np.bool_(True)}
    assert jsonable(given) == {"1": [2.0, None], "a": [1.0, None], "b": True}


def test_json_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    target = tmp_path / "a.json"
    write_json({"b": 1, "a": [2]}, str(target))
    assert list(json.loads(target.read_text())) == ["a", "b"]
    with pytest.raises(ValueError, match="b: not a finite number: nan"):
        write_json({"b": float("nan")}, str(target))
    assert json.loads(read_text(str(target))[0]) == {"a": [2], "b": 1}
    assert read_text(str(target))[1] == str(target)


def test_what_is_no_text_is_told(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ModelError, match=r"a\.json: not a text file"):
        read_text(str(tmp_path / "a.json"))
