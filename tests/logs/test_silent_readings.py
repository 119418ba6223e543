"""What was read as something else than it says, without a word."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from thermaltool.errors import LogError, OutputError
from thermaltool.logs import draft_map, read_log, resample, write_table
from thermaltool.logs.log import Log
from thermaltool.runtime.rows.csv_rows import csv_number


def written(tmp_path, text, name="log.csv"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return str(path)


def test_a_row_without_a_time_is_told(tmp_path):
    log = written(
        tmp_path, "time,T_a_degC\n2026-03-14T10:00:00,20\n,20.5\n2026-03-14T10:00:02,21\n"
    )
    (told,) = read_log(log, strict=False).problems
    assert (told.line, told.message) == (3, "missing time")
    # One that is mistyped is told once.
    log = written(tmp_path, "time_s,T_a_degC\n0,20\no1,20.5\n2,21\n")
    (told,) = read_log(log, strict=False).problems
    assert "not a number" in told.message


def test_another_column_is_not_taken_for_the_clock(tmp_path):
    log = written(tmp_path, "t,time_s,T_a_degC\n0,100,20\n1000,200,21\n")
    clock = "[time]\ncolumn = 't'\nunit = 'ms'\n"
    with pytest.raises(LogError, match="time_s is the name of the clock, which is t here"):
        read_log(log, columns=written(tmp_path, clock, "map.toml"))
    left_out = clock + "[columns]\ntime_s = false\n"
    assert read_log(log, columns=written(tmp_path, left_out, "map.toml")).time[-1] == 1.0


COMMA = "separator = ';'\ndecimal = ','\n"


def test_a_point_of_thousands_is_no_decimal_point(tmp_path):
    text = "time_s;n_a_rpm;e_a_um\n0;950,5;1,0\n1;1.500;2.500\n"
    mapping = written(tmp_path, COMMA, "map.toml")
    with pytest.raises(LogError, match="a point, where decimals have a comma"):
        read_log(written(tmp_path, text), columns=mapping)
    number = csv_number(",", (), "utf-8")
    assert number(b"2,5") == 2.5
    with pytest.raises(ValueError, match=r"2\.500"):
        number(b"2.500")


def test_groups_of_thousands_are_drafted_as_no_missing_values(tmp_path):
    rows = [
        f"{k};{value};20,{k}" for k, value in enumerate(["980,5", "980,5", "980,5", "1.000,5"] * 4)
    ]
    draft = draft_map(written(tmp_path, "\n".join(["time_s;n_a_rpm;T_a_degC", *rows, ""])))
    assert "missing" not in draft.text
    assert draft.typos


@pytest.mark.parametrize("rows", [3, 40_000])
@pytest.mark.parametrize("cell", ["-999", "  -999", "-999.0"])
def test_a_number_that_is_missing_is_so_however_it_is_written(tmp_path, rows, cell):
    lines = ["time_s,T_a_degC,T_b_degC", *(f"{k},     20.5,{cell}" for k in range(rows)), ""]
    log = read_log(
        written(tmp_path, "\n".join(lines)),
        columns=written(tmp_path, "missing = ['-999']\n", "map.toml"),
    )
    assert np.isnan(log.columns["T_b_degC"]).all()
    assert not np.isnan(log.columns["T_a_degC"]).any()


def test_a_missing_number_in_single_precision(tmp_path):
    path = tmp_path / "log.parquet"
    values = np.array([20.0, -999.9], np.float32)
    pd.DataFrame({"time_s": [0.0, 1.0], "T_a_degC": values}).to_parquet(path)
    for text in ("missing = ['-999.9']\n", "[columns]\nT_a_degC = { missing = [-999.9] }\n"):
        log = read_log(str(path), columns=written(tmp_path, text, "map.toml"))
        assert np.isnan(log.columns["T_a_degC"]).tolist() == [False, True]


@pytest.mark.parametrize(
    ("names", "rows"),
    [
        ("T [°C];time_s;d_a_um", ["20.1;0;1", "20.2;10;2", "20.4;20;1"]),
        ("X;time_s;d_a_um", ["1;0;1", "2;10;2", "3;20;1"]),
        ("d_a_um;time_s;T_b_degC", ["1;0;20", "2;10;21", "1;20;20", "2;15;21", "1;30;20"]),
    ],
)
def test_the_clock_of_a_draft_is_the_one_that_is_named_so(tmp_path, names, rows):
    draft = draft_map(written(tmp_path, "\n".join([names, *rows, ""])))
    assert 'column = "time_s"' in draft.text


@pytest.mark.parametrize("name", ["note", ""])
def test_columns_that_a_map_leaves_out_may_have_one_name(tmp_path, name):
    log = written(tmp_path, f"time_s,{name},T_a_degC,{name},Q_a_W\n0,x,20,y,1\n1,x,21,y,1\n")
    with pytest.raises(LogError):
        read_log(log)
    mapping = written(tmp_path, f"[columns]\n{json.dumps(name)} = false\n", "map.toml")
    assert [*read_log(log, columns=mapping).columns] == ["T_a_degC", "Q_a_W"]


def test_a_key_that_is_there_twice_is_refused(tmp_path):
    line = '{"time_s": 0, "T_a_degC": 20, "T_a_degC": 21}\n'
    with pytest.raises(LogError, match="there twice"):
        read_log(written(tmp_path, line, "log.ndjson"))


def test_commands_are_held_between_the_rows_of_another_clock():
    time, heat = 10.0 * np.arange(5), np.array([0.0, 0.0, 100.0, 100.0, 0.0])
    columns = {"Q_a_W": heat, "T_a_degC": heat}
    log = Log(time, columns, segments=(slice(0, 5),), lines=np.arange(1, 6))
    even = resample(log, 5.0)
    assert even.columns["Q_a_W"].tolist() == [0, 0, 0, 0, 100, 100, 100, 100, 0]
    assert even.columns["T_a_degC"].tolist() == [0, 0, 0, 50, 100, 100, 100, 50, 0]


@pytest.mark.parametrize("suffix", ["xlsx", "json", "csv.gz"])
def test_no_file_is_written_whose_name_says_another_format(tmp_path, suffix):
    target = str(tmp_path / f"out.{suffix}")
    with pytest.raises(OutputError, match="is written, but csv"):
        write_table({"time_s": np.arange(3.0)}, target)
    write_table({"time_s": np.arange(3.0)}, target, "csv")


def test_a_log_and_its_map_are_not_overwritten(tmp_path, thermaltool):
    log = written(tmp_path, "time_s,T_a_degC\n0,20\n1,oops\n")
    mapping = written(tmp_path, "[columns]\n", "map.toml")
    for target in (log, mapping):
        refused = thermaltool("check", log, "--columns", mapping, "-o", target)
        assert (refused.code, "would replace the input" in refused.err) == (2, True)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[time]\ncolumn = 'time'\nformat = '%H:%M:%S %H'\n", "says one part twice"),
        ("encoding = 'hex'\n", "encoding: 'hex' is none"),
    ],
)
def test_maps_that_no_reader_can_use(tmp_path, text, said):
    log = written(tmp_path, "time_s,T_a_degC\n0,20\n")
    with pytest.raises(LogError, match=said):
        read_log(log, columns=written(tmp_path, text, "map.toml"))


def test_a_map_saved_with_a_byte_order_mark(tmp_path):
    mapping = written(tmp_path, b"\xef\xbb\xbf[columns]\nx = 'T_a_degC'\n", "map.toml")
    log = written(tmp_path, "time_s,x\n0,20\n1,21\n")
    assert [*read_log(log, columns=mapping).columns] == ["T_a_degC"]
