"""What rows of one time become, and columns that a map computes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from thermaltool.errors import LogError
from thermaltool.logs import read_log

# Every 20 s, stamps without seconds: the first and the last minute are cut by the record's ends.
TRUE = 40.0 + 20.0 * np.arange(10)
STAMPS = 60.0 * np.floor(TRUE / 60)


@pytest.fixture
def log(tmp_path: Path) -> str:
    path = tmp_path / "log.csv"
    rows = [f"{t:g},{k}" for k, t in enumerate(STAMPS)]
    path.write_text("\n".join(["time_s,T_a_degC", *rows, ""]))
    return str(path)


def test_the_message_names_the_cure(log: str) -> None:
    with pytest.raises(LogError, match="--duplicates first, mean or spread"):
        read_log(log)


def test_spread_gives_the_clock_back(log: str) -> None:
    read = read_log(log, duplicates="spread")
    np.testing.assert_allclose(read.time, TRUE)
    np.testing.assert_array_equal(read.column("T_a_degC"), np.arange(10))


@pytest.mark.parametrize(("word", "values"), [("first", [0, 1, 4, 7]), ("mean", [0, 2, 5, 8])])
def test_one_row_of_each_time(log: str, word: str, values: list[float]) -> None:
    read = read_log(log, duplicates=word)
    np.testing.assert_array_equal(read.time, [0, 60, 120, 180])
    np.testing.assert_array_equal(read.column("T_a_degC"), values)
    np.testing.assert_array_equal(read.lines, [2, 3, 6, 9])


def test_missing_readings_count_as_none(tmp_path: Path) -> None:
    path = tmp_path / "log.ndjson"
    path.write_text('{"time_s": 0, "T_a_degC": 1}\n{"time_s": 0, "T_b_degC": 3}\n')
    read = read_log(str(path), duplicates="mean")
    assert {name: values.tolist() for name, values in read.columns.items()} == {
        "T_a_degC": [1],
        "T_b_degC": [3],
    }


def test_another_word(log: str) -> None:
    with pytest.raises(ValueError, match="duplicates 'last': one of first, mean, spread"):
        read_log(log, duplicates="last")


def test_a_map_computes(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(
        "t,U,I,F,K,p\n0,10,2000,212,300,14.5037738\n1,20,0,32,273.15,0\n"
    )
    (tmp_path / "map.toml").write_text(
        """
[time]
column = "t"
[columns]
U = "U_heater_V"
I = { name = "I_heater_A", unit = "mA" }
F = { name = "T_f_degC", unit = "°F" }
K = { name = "T_k_degC", unit = "K" }
p = { name = "p_oil_bar", unit = "psi" }
[computed]
Q_heater_kW = { power = ["U_heater_V", "I_heater_A"] }
dT_mK = { difference = ["T_f_degC", "T_k_degC"] }
"""
    )
    read = read_log(str(tmp_path / "log.csv"), columns=tmp_path / "map.toml")
    np.testing.assert_allclose(read.column("Q_heater_kW"), [0.02, 0])
    np.testing.assert_allclose(read.column("T_f_degC"), [100, 0], atol=1e-12)
    np.testing.assert_allclose(read.column("T_k_degC"), [26.85, 0], atol=1e-12)
    np.testing.assert_allclose(read.column("dT_mK"), [73150, 0], atol=1e-9)
    np.testing.assert_allclose(read.column("p_oil_bar"), [1, 0], rtol=1e-6)


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        ('[computed]\nQ_W = { power = ["T_a_degC", "I_a_A"] }', "from a voltage and a current"),
        ('[computed]\nd_um = { difference = ["T_a_degC", "T_b_degC"] }', "not what the name says"),
        ('[computed]\nQ_W = { power = ["U_a_V"] }', "names two columns"),
        ('[columns]\na = { name = "T_a_degC", unit = "mm" }', "'mm' does not become degC"),
        ('encoding = "klingon"', "encoding: 'klingon' is none"),
        ("skip = -1", "skip is a number of lines"),
        ('duplicates = "last"', "duplicates is one of"),
    ],
)
def test_what_a_map_cannot_say(log: str, tmp_path: Path, toml: str, message: str) -> None:
    (tmp_path / "map.toml").write_text(toml)
    with pytest.raises(LogError, match=message):
        read_log(log, columns=tmp_path / "map.toml")
