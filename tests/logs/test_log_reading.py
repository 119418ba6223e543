"""Reading logs: what is read, and one test for each kind of bad input."""

from __future__ import annotations

import contextlib
import io
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from thermaltool.errors import LogError
from thermaltool.logs import Log, read_log, write_table
from thermaltool.logs import csv_table as csv_table_module


@pytest.fixture
def log_of(tmp_path: Path):
    """Write bytes to a file of the given name and read it."""

    def read(data: str | bytes, name: str = "log.csv", **options: object) -> Log:
        path = tmp_path / name
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
        return read_log(str(path), **options)  # type: ignore[arg-type]

    return read


def place_of(error: LogError) -> tuple[str, int | None, str | None]:
    assert error.file is not None
    assert str(error).startswith(error.file + ":")
    assert "\n" not in str(error)
    return Path(error.file).name, error.line, error.column


def test_a_log(log_of) -> None:
    log = log_of("time_s,T_a_degC,Q_main_W\n0,20.5,0\n2,,280\n4,21.5,280\n")
    assert log.time.tolist() == [0, 2, 4]
    np.testing.assert_array_equal(log.column("T_a_degC"), [20.5, np.nan, 21.5])
    assert list(log.columns) == ["T_a_degC", "Q_main_W"]
    assert [channel.unit for channel in log.channel_summaries()] == ["degC", "W"]
    assert log.segments == (slice(0, 3),)
    assert log.period == 2
    assert log.epoch is None
    assert log.lines.tolist() == [2, 3, 4]
    assert len(log.digest) == 64


TYPO = "time_s,T_a_degC,Q_main_W,n_a_rpm\n0,20.5,0,1\n2,2l,280,1\n4,21.5,280,x\n6,2l,1,y\n"


def test_a_cell_that_nothing_needs_is_a_missing_value(log_of) -> None:
    log = log_of(TYPO, need=["Q_main_W"])
    np.testing.assert_array_equal(log.column("T_a_degC"), [20.5, np.nan, 21.5, np.nan])
    assert {channel: each.line for channel, each in log.unread.items()} == {
        "T_a_degC": 3, "n_a_rpm": 4,
    }  # fmt: skip
    assert [*log_of(TYPO, unread=True).unread] == ["T_a_degC", "n_a_rpm"]
    for needed in ({"need": ["T_a_degC"]}, {"outputs": ["T_a_degC"]}, {}):
        with pytest.raises(LogError, match="T_a_degC: not a number: '2l'"):
            log_of(TYPO, **needed)
    with pytest.raises(LogError, match="2 cells where the header has 4"):
        log_of(TYPO + "8,1\n", need=["Q_main_W"])


def test_a_cell_of_which_something_needed_is_computed_is_needed(log_of, tmp_path) -> None:
    path = tmp_path / "map.toml"
    path.write_text('[computed]\ndT_x_K = { difference = ["T_a_degC", "T_b_degC"] }\n')
    text = "time_s,T_a_degC,T_b_degC\n0,21,x\n1,22,2\n2,23,3\n"
    assert [*log_of(text, columns=str(path), need=["T_a_degC"]).unread] == ["T_b_degC"]
    with pytest.raises(LogError, match="T_b_degC: not a number"):
        log_of(text, columns=str(path), need=["dT_x_K"])


def test_header_only_is_a_log_without_rows(log_of) -> None:
    log = log_of("time_s,T_a_degC\n", need=["T_a_degC"])
    assert len(log) == 0
    assert log.column("T_a_degC").shape == (0,)
    assert log.segments == ()
    assert np.isnan(log.period)


@pytest.mark.parametrize(
    "data",
    [
        b"\xef\xbb\xbftime_s,T_a_degC\n0,1\n1,2\n",
        b"time_s,T_a_degC\r\n0,1\r\n1,2\r\n",
        b"time_s,T_a_degC\r0,1\r1,2\r",
        b"time_s,T_a_degC\n0,1\n1,2",
        b"# made by a logger, v2\n\n#\ntime_s,T_a_degC\n0,1\n# pause\n\n1,2\n",
        b'"time_s","T_a_degC"\n"0","1"\n"1","2"\n',
        b"time_s , T_a_degC\n 0, 1\n1 ,2 \n",
    ],
    ids=["bom", "crlf", "cr", "no-last-newline", "comments", "quotes", "blanks"],
)
def test_layouts_of_csv(log_of, data: bytes) -> None:
    log = log_of(data)
    assert log.time.tolist() == [0, 1]
    assert log.column("T_a_degC").tolist() == [1, 2]


@pytest.mark.parametrize(
    ("data", "line", "column", "words"),
    [
        ("", None, None, "empty"),
        (" \n\n", None, None, "empty"),
        ("# only\n# comments\n", None, None, "only comments"),
        ("time_s,T_a_degC\n0,1\n1,2,3\n", 3, None, "3 cells where the header has 2"),
        ("time_s,T_a_degC\n0,1\n1\n2,3\n", 3, None, "1 cells"),
        ("# c\ntime_s,T_a_degC\n0,1\n# c\n1,--\n", 5, "T_a_degC", "not a number: '--'"),
        ("time_s,T_a_degC\n0,1_000\n", 2, "T_a_degC", "not a number: '1_000'"),
        ("time_s,T_a_degC\n0,inf\n", 2, "T_a_degC", "infinite: 'inf'"),
        ("time_s,T_a_degC\n0,1\n1,1e999\n", 3, "T_a_degC", "infinite"),
        ("time_s,T_a_degF\n0,1\n", 1, "T_a_degF", "unknown unit 'degF'"),
        ("time_s,temperature\n0,1\n", 1, "temperature", "unknown unit"),
        ("time_s,dT_a_degC\n0,1\n", 1, "dT_a_degC", "in K"),
        ("time_s,T_a_degC,T_a_degC\n0,1,2\n", 1, "T_a_degC", "twice"),
        ("time_s,,T_a_degC\n0,1,2\n", 1, None, "column 2 has no name"),
        ("t,T_a_degC\n0,1\n", 1, None, "no clock"),
        ("tims_s,T_a_degC\n0,1\n", 1, None, "near: tims_s"),
        ("time_s;T_a_degC\n0;1\n", 1, None, "separator = ';'"),
        ('time_s,T_a_degC\n0,"1,5"\n', 2, "T_a_degC", "decimal = ','"),
        ("0,1\n1,2\n", 1, None, "numbers where the names belong"),
        ("time_s,T_a_degC\n0,1\n2,1\n1,1\n", 4, "time_s", "backward: 1 s after 2 s"),
        ("time_s,T_a_degC\n0,1\n2,1\n2,1\n", 4, "time_s", "repeats: 2 s"),
        ("time_s,T_a_degC\n0,1\n,1\n2,1\n", 3, "time_s", "missing time"),
        ("time,T_a_degC\n2021-06-13T05:42,1\nyesterday,1\n", 3, "time", "not an ISO 8601"),
        ("time,T_a_degC\n0.5,1\n", 2, "time", "not an ISO 8601"),
        ("time,T_a_degC\n2021-06-13T05:42,1\n2021-06-13T05:43Z,1\n", None, "time", "time zone"),
        ('{"time_s": 0}\n', 1, None, "--from ndjson"),
    ],
)
def test_bad_csv_is_named_by_file_line_and_column(
    log_of, data: str, line: int | None, column: str | None, words: str
) -> None:
    with pytest.raises(LogError) as caught:
        log_of(data)
    assert place_of(caught.value) == ("log.csv", line, column)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ("time_s,T_a_degC\n0,1\n".encode("utf-16-le"), "not text"),
        (b"# \xb0C\ntime_s,T_a_degC\n0,1\n", "not UTF-8: byte 0xb0"),
    ],
)
def test_bytes_that_are_no_text(log_of, data: bytes, words: str) -> None:
    with pytest.raises(LogError, match=words) as caught:
        log_of(data)
    assert caught.value.line == 1


@pytest.mark.parametrize("last", ["2", "2,", "2,1e", "2,-"])
def test_a_line_still_being_written_is_left_out(log_of, last: str) -> None:
    data = f"time_s,T_a_degC\n0,1\n1,2\n{last}"
    if last == "2,":  # complete: its cell is missing
        assert np.isnan(log_of(data).column("T_a_degC")[-1])
        return
    assert log_of(data).time.tolist() == [0, 1]
    assert "unfinished" in str(log_of(data, strict=False).problems[0])
    with pytest.raises(LogError):
        log_of(data + "\n")


def test_a_missing_column_is_told_with_its_neighbours(log_of) -> None:
    data = "time_s,T_spindle_degC,d_z_um\n0,1,2\n"
    with pytest.raises(LogError, match=r"no column T_spindel_degC \(near: T_spindle_degC\)"):
        log_of(data, need=["T_spindel_degC"])
    with pytest.raises(LogError, match=r"there are: T_spindle_degC, d_z_um"):
        log_of(data).column("Q_main_W")
    line = r'\[columns\] of a map turns it: d_z_um = \{ name = "d_z_mm", unit = "um" \}'
    with pytest.raises(LogError, match=rf"there is d_z_um; a line under {line}"):
        log_of(data).column("d_z_mm")


def test_missing_values_by_policy(log_of) -> None:
    data = "time_s,T_a_degC,T_b_degC\n0,1,\n1,nan,5\n2,,6\n3,4,7\n"
    with pytest.raises(LogError, match="missing value") as caught:
        log_of(data, need=["T_a_degC"])
    assert place_of(caught.value) == ("log.csv", 3, "T_a_degC")
    omitted = log_of(data, need=["T_a_degC"], nan_policy="omit")
    assert omitted.time.tolist() == [0, 3]
    assert omitted.lines.tolist() == [2, 5]
    held = log_of(data, need=["T_a_degC"], nan_policy="hold")
    assert held.column("T_a_degC").tolist() == [1, 1, 1, 4]
    assert np.isnan(held.column("T_b_degC")[0])  # not needed: stays as it is
    with pytest.raises(LogError, match="none before it to hold"):
        log_of(data, need=["T_b_degC"], nan_policy="hold")


def test_an_iso_clock_counts_from_its_first_row(log_of) -> None:
    log = log_of("time,T_a_degC\n2021-06-13T05:42:16,1\n2021-06-13 05:42:20.5,2\n")
    assert log.time.tolist() == [0, 4.5]
    assert log.epoch == "2021-06-13T05:42:16"


def test_an_iso_clock_is_read_to_its_last_digit(log_of) -> None:
    stamps = ("05:42:16.000000250", "05:42:16.000001500", "05:42:17.123456789")
    log = log_of("time,T_a_degC\n" + "".join(f"2021-06-13T{s},1\n" for s in stamps))
    np.testing.assert_allclose(log.time, [0.0, 1.25e-6, 1.123456539], rtol=0, atol=1e-15)


@pytest.mark.parametrize(("unit", "seconds"), [("ns", 1e-9), ("us", 1e-6), ("d", 86400.0)])
def test_clocks_from_nanoseconds_to_days(log_of, unit: str, seconds: float) -> None:
    log = log_of(f"time_{unit},T_a_degC\n0,1\n1.5,2\n")
    assert log.time.tolist() == [0, 1.5 * seconds]


def test_a_clock_in_minutes(log_of) -> None:
    assert log_of("time_min,T_a_degC\n0,1\n1.5,2\n").time.tolist() == [0, 90]


def test_everything_is_reported_where_reading_goes_on(log_of) -> None:
    data = "time_s,T_a_degC,T_b_degF\n0,--,1\n1,1\n1,inf,2\n0.5,3,4\n"
    log = log_of(data, strict=False)
    assert log.time.tolist() == [0, 1, 0.5]
    np.testing.assert_array_equal(log.column("T_a_degC"), [np.nan, np.nan, 3])
    assert "T_b_degF" in log.columns
    assert [channel.unit for channel in log.channel_summaries()] == ["degC", "?"]
    assert {(problem.line, problem.column) for problem in log.problems} == {
        (1, "T_b_degF"),
        (2, "T_a_degC"),
        (3, None),
        (4, "T_a_degC"),
        (5, "time_s"),
    }


def test_many_problems_of_one_kind_are_counted(log_of) -> None:
    rows = "".join(f"{i},x\n" for i in range(1000))
    problems = log_of("time_s,T_a_degC\n" + rows, strict=False).problems
    assert len(problems) == 6
    assert "995 more like this, the last at line 1001" in str(problems[-1])


@pytest.mark.parametrize(
    ("cell", "words"), [("--", "not a number: '--'"), ("inf", "infinite"), ("1,2", "cells")]
)
def test_the_fast_reader_hands_faults_to_the_exact_one(
    log_of, monkeypatch: pytest.MonkeyPatch, cell: str, words: str
) -> None:
    monkeypatch.setattr(csv_table_module, "FAST_BYTES", 0)
    rows = "".join(f"{i},{i / 7}\n" for i in range(100))
    with pytest.raises(LogError, match=words) as caught:
        log_of(f"# c\ntime_s,T_a_degC\n{rows}100,{cell}\n")
    assert caught.value.line == 103


@pytest.mark.parametrize("text", ["0,1\n1,2\n", "0,\n1,nan\n", "0,1\n\n1,2\n", "0,1\n# c\n1,+2\n"])
def test_both_csv_readers_agree(log_of, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    slow = log_of("time_s,T_a_degC\n" + text)
    monkeypatch.setattr(csv_table_module, "FAST_BYTES", 0)
    fast = log_of("time_s,T_a_degC\n" + text)
    np.testing.assert_array_equal(slow.time, fast.time)
    np.testing.assert_array_equal(slow.column("T_a_degC"), fast.column("T_a_degC"))
    np.testing.assert_array_equal(slow.lines, fast.lines)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(body=st.lists(st.text('0123456789.,-+eEnaif_# "\r\n', max_size=12)))
def test_both_csv_readers_agree_on_anything(log_of, body: list[str]) -> None:
    data = "time_s,T_a_degC\n" + "\n".join(body)
    slow = log_of(data, strict=False)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(csv_table_module, "FAST_BYTES", 0)
        fast = log_of(data, strict=False)
    np.testing.assert_array_equal(slow.time, fast.time)
    np.testing.assert_array_equal(slow.column("T_a_degC"), fast.column("T_a_degC"))
    np.testing.assert_array_equal(slow.lines, fast.lines)
    assert list(map(str, slow.problems)) == list(map(str, fast.problems))


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    data=st.binary() | st.text('{}[]":,time_s0123 \n#').map(str.encode),
    name=st.sampled_from(["log.csv", "log.ndjson"]),
    strict=st.booleans(),
)
def test_any_bytes_give_a_log_or_a_log_error(log_of, data: bytes, name: str, strict: bool) -> None:
    with contextlib.suppress(LogError):
        assert log_of(data, name, strict=strict).time.ndim == 1


def test_ndjson(log_of) -> None:
    data = '{"time_s": 0, "T_a_degC": 1.5}\n{"time_s": 1, "T_a_degC": null, "d_z_um": 2}\n'
    log = log_of(data, "log.ndjson")
    np.testing.assert_array_equal(log.column("T_a_degC"), [1.5, np.nan])
    np.testing.assert_array_equal(log.column("d_z_um"), [np.nan, 2])


@pytest.mark.parametrize(
    ("data", "line", "column", "words"),
    [
        ("", None, None, "empty"),
        ('{"time_s": 0}\n{"time_s":\n', 2, None, "not a JSON object"),
        ('{"time_s": 0}\n[1]\n', 2, None, "not a JSON object"),
        ('{"time_s": 0, "T_a_degC": "1.5"}\n', 1, "T_a_degC", 'not a number: "1.5"'),
        ('{"time_s": 0, "T_a_degC": true}\n', 1, "T_a_degC", "not a number: true"),
        ('{"time_s": 0, "T_a_degC": Infinity}\n', 1, "T_a_degC", "infinite"),
        ('{"time_s": 0, "T_a_degC": 1' + "0" * 400 + "}\n", 1, "T_a_degC", "infinite"),
        ('{"time_s": 1}\n{"time_s": 0}\n', 2, "time_s", "backward"),
    ],
)
def test_bad_ndjson(log_of, data: str, line: int | None, column: str | None, words: str) -> None:
    with pytest.raises(LogError) as caught:
        log_of(data, "log.ndjson")
    assert place_of(caught.value) == ("log.ndjson", line, column)
    assert words in str(caught.value)


def test_an_ndjson_line_still_being_written_is_left_out(log_of) -> None:
    log = log_of('{"time_s": 0, "T_a_degC": 1}\n{"time_s": 1, "T_', "log.ndjson")
    assert log.time.tolist() == [0]


@pytest.fixture
def parquet(tmp_path: Path) -> Path:
    path = tmp_path / "log.parquet"
    write_table({"time_s": np.arange(500.0), "T_a_degC": np.sin(np.arange(500.0))}, str(path))
    return path


@pytest.mark.parametrize("size", [0, 3, 100, -1])
def test_a_truncated_parquet_file(parquet: Path, size: int) -> None:
    parquet.write_bytes(parquet.read_bytes()[:size])
    with pytest.raises(LogError, match=r"truncated|empty") as caught:
        read_log(str(parquet))
    assert place_of(caught.value)[0] == "log.parquet"


def test_a_parquet_column_of_text_and_of_time_stamps(tmp_path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    stamps = pa.array([0, 1_500_000], pa.timestamp("us"))
    path = str(tmp_path / "log.parquet")
    parquet.write_table(pa.table({"time": stamps, "T_a_degC": pa.array([1, 2])}), path)
    log = read_log(path)
    assert log.time.tolist() == [0, 1.5]
    assert log.epoch == "1970-01-01T00:00:00"
    parquet.write_table(pa.table({"time": stamps, "T_a_degC": pa.array(["1", "2"])}), path)
    with pytest.raises(LogError, match="the column holds string"):
        read_log(path)
    parquet.write_table(pa.table({"time": stamps, "T_a_degC": pa.array([1, np.inf])}), path)
    with pytest.raises(LogError, match="infinite") as caught:
        read_log(path)
    assert caught.value.line == 2


def test_parquet_given_as_csv(parquet: Path) -> None:
    with pytest.raises(LogError, match="--from parquet"):
        read_log(str(parquet), from_format="csv")


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="folder"):
        read_log(str(tmp_path))
    with pytest.raises(LogError, match="No such file"):
        read_log(str(tmp_path / "absent.csv"))
    with pytest.raises(LogError, match="cannot be read"):
        read_log("/proc/self/mem")


def test_stdin(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = SimpleNamespace(buffer=io.BytesIO(b"time_s,T_a_degC\n0,--\n"))
    monkeypatch.setattr(sys, "stdin", pipe)
    with pytest.raises(LogError, match=r"^<stdin>:2: T_a_degC: not a number: '--'; check LOG -o"):
        read_log("-")


def test_reading_a_short_log_imports_neither_pandas_nor_pyarrow() -> None:
    code = (
        "import sys; from thermaltool.logs import read_log; read_log('-');"
        "print([name for name in ('pandas', 'pyarrow', 'scipy', 'click') if name in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", code],
        input="time_s,T_a_degC\n0,1\n",
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stdout == "[]\n"
