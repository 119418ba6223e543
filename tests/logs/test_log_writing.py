"""Writing tables, and what is written read back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from thermaltool.errors import OutputError
from thermaltool.logs import csv_table as csv_table_module
from thermaltool.logs import read_log, write_table
from thermaltool.logs import text as text_module
from thermaltool.logs.formats import FORMATS, TableFormat

# Larger ones are refused where logs are read.
numbers = st.one_of(st.floats(-1e75, 1e75), st.just(float("nan")))


@st.composite
def tables(draw: st.DrawFn) -> dict[str, np.ndarray]:
    rows = draw(st.integers(1, 20))
    time = np.sort(draw(hnp.arrays(float, rows, elements=st.floats(-1e12, 1e12), unique=True)))
    count = draw(st.integers(1, 3))
    columns = {
        f"T_p{i}_degC": draw(hnp.arrays(float, rows, elements=numbers)) for i in range(count)
    }
    return {"time_s": time, **columns}


@pytest.mark.parametrize("form", FORMATS)
@given(table=tables(), fast=st.booleans())
def test_round_trip(
    tmp_path_factory: pytest.TempPathFactory, form: str, table: dict[str, np.ndarray], fast: bool
) -> None:
    path = str(tmp_path_factory.mktemp("log") / f"log.{form}")
    with pytest.MonkeyPatch.context() as patch:
        if fast:
            patch.setattr(text_module, "FAST_CELLS", 0)
            patch.setattr(csv_table_module, "FAST_BYTES", 0)
        write_table(table, path)
        log = read_log(path)
    np.testing.assert_array_equal(log.time, table.pop("time_s"))
    for name, values in table.items():
        np.testing.assert_array_equal(log.column(name), values)


@given(values=hnp.arrays(float, st.integers(1, 30), elements=numbers))
def test_a_number_has_the_same_text_however_long_the_table(values: np.ndarray) -> None:
    layout = ([values], [""], "\n", "null")
    short = text_module._short_lines(*layout)
    assert short == text_module._fast_lines(*layout)
    written = [float(line) for line in short.decode().split("\n") if line not in ("", "null")]
    np.testing.assert_array_equal(written, values[~np.isnan(values)])


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.1, "0.1"),
        (20.0, "20"),
        (-0.0, "-0"),
        (1e-5, "0.00001"),
        (-1.5e-6, "-0.0000015"),
        (1.5e-7, "1.5e-7"),
        (12345678901.5, "1.23456789015e+10"),
        (1e300, "1e+300"),
        (float("nan"), "null"),
        (10**12, "1000000000000"),
    ],
)
def test_number_text(value: float, text: str) -> None:
    assert text_module.number_text(value, "null") == text


def test_missing_values(tmp_path: Path) -> None:
    table = {"time_s": np.array([0, 1]), "T_a_degC": np.array([np.nan, 2.5])}
    for form, text in [
        ("csv", "time_s,T_a_degC\n0,\n1,2.5\n"),
        ("ndjson", '{"time_s": 0, "T_a_degC": null}\n{"time_s": 1, "T_a_degC": 2.5}\n'),
    ]:
        path = tmp_path / f"log.{form}"
        write_table(table, str(path))
        assert path.read_text() == text
    json.loads((tmp_path / "log.ndjson").read_text().splitlines()[0])


def test_a_lone_missing_cell_is_no_empty_line(tmp_path: Path) -> None:
    path = tmp_path / "column.csv"
    write_table({"T_a_degC": np.array([1.0, np.nan])}, str(path))
    assert path.read_text() == 'T_a_degC\n1\n""\n'


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_no_rows(tmp_path: Path, form: str) -> None:
    path = str(tmp_path / f"log.{form}")
    write_table({"time_s": np.empty(0), "T_a_degC": np.empty(0)}, path)
    log = read_log(path)
    assert len(log) == 0
    assert list(log.columns) == ["T_a_degC"]


@pytest.mark.parametrize("form", FORMATS)
def test_infinity_is_not_written_and_the_old_file_stays(tmp_path: Path, form: str) -> None:
    path = tmp_path / f"log.{form}"
    path.write_text("old")
    with pytest.raises(OutputError, match="T_a_degC: infinite value in row 2"):
        write_table({"time_s": np.arange(2), "T_a_degC": np.array([0, -np.inf])}, str(path))
    assert path.read_text() == "old"


def test_columns_of_different_lengths(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="different lengths"):
        write_table({"time_s": np.arange(2), "T_a_degC": np.arange(3)}, str(tmp_path / "x.csv"))


def test_a_format_is_one_module_and_one_line(tmp_path: Path, monkeypatch) -> None:
    """Read and written by its name and by its suffix, once it stands in the table."""
    (tmp_path / "tabs_table.py").write_text(
        """
from thermaltool.logs.columns import Dialect
from thermaltool.logs.csv_table import CsvTable

def open_table(source, mapping):
    return CsvTable(source, Dialect(separator="\\t"))

def write_columns(columns, stream):
    rows = zip(*(values.tolist() for values in columns.values()))
    stream.write("\\t".join(columns).encode() + b"\\n")
    stream.writelines("\\t".join(map(repr, row)).encode() + b"\\n" for row in rows)
"""
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(FORMATS, "tabs", TableFormat("tabs_table", (".tsv",)))
    table = {"time_s": np.array([0.0, 1.0]), "T_p1_degC": np.array([20.0, 20.5])}
    for path, chosen in ((str(tmp_path / "log.tsv"), None), (str(tmp_path / "log"), "tabs")):
        write_table(table, path, chosen)
        assert Path(path).read_text() == "time_s\tT_p1_degC\n0.0\t20.0\n1.0\t20.5\n"
        read = read_log(path, from_format=chosen)
        np.testing.assert_array_equal(read.column("T_p1_degC"), table["T_p1_degC"])


def test_a_format_that_nobody_knows(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no format 'xlsx': there are csv, ndjson, parquet"):
        write_table({"time_s": np.zeros(1)}, str(tmp_path / "log"), "xlsx")
