"""Data frames and records at the border: read as a file of the same columns would be."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt
from thermaltool.errors import LogError, ThermalToolWarning, UnitError
from thermaltool.units import names

FRAME = pd.DataFrame(
    {
        "time_s": [0.0, 10.0, 20.0, 30.0],
        "T_a_degC": [20.0, 20.5, np.nan, 21.0],
        "Q_a_1": [0, 1, 1, 1],
    }
)
STAMPS = pd.date_range("2026-01-01T08:00:00", periods=4, freq="10s")


def test_a_frame_is_read_like_the_file_of_its_columns(tmp_path: Path) -> None:
    FRAME.to_csv(tmp_path / "a.csv", index=False)
    of_file, of_frame = tt.read_log(tmp_path / "a.csv"), tt.read_log(FRAME)
    np.testing.assert_array_equal(of_frame.time, of_file.time)
    assert of_frame.columns.keys() == of_file.columns.keys()
    for name, values in of_file.columns.items():
        np.testing.assert_array_equal(of_frame.columns[name], values)
    assert of_frame.channel_summaries() == of_file.channel_summaries()


@pytest.mark.parametrize(
    ("frame", "epoch"),
    [
        (FRAME.set_index("time_s"), None),
        (FRAME.assign(time_min=FRAME["time_s"] / 60).drop(columns="time_s"), None),
        (FRAME.drop(columns="time_s").set_index(pd.to_timedelta(FRAME["time_s"], "s")), None),
        (FRAME.drop(columns="time_s").set_index(STAMPS), "2026-01-01T08:00:00"),
        (FRAME.assign(time=STAMPS).drop(columns="time_s"), "2026-01-01T08:00:00"),
        (
            FRAME.drop(columns="time_s").set_index(STAMPS.tz_localize("UTC")),
            "2026-01-01T08:00:00+00:00",
        ),
    ],
)
def test_the_clock_may_be_a_column_or_the_index(frame: pd.DataFrame, epoch: str | None) -> None:
    log = tt.read_log(frame)
    np.testing.assert_allclose(log.time, FRAME["time_s"])
    assert log.epoch == epoch
    np.testing.assert_array_equal(log.columns["T_a_degC"], FRAME["T_a_degC"])


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        (FRAME.drop(columns="time_s"), "no clock: no column time_s or time"),
        (FRAME.rename(columns={"T_a_degC": "T_a_degF"}), "T_a_degF: unknown unit"),
        (FRAME.assign(T_a_degC=list("abcd")), "T_a_degC: not a number: the column holds"),
        (FRAME.assign(Q_a_1=True), "Q_a_1: not a number: the column holds bool"),
        (FRAME.replace({"T_a_degC": {20.5: np.inf}}), "<frame>:2: T_a_degC: infinite: inf"),
        (FRAME.iloc[::-1], "the clock goes backward: 20 s after 30 s"),
        (pd.concat([FRAME, FRAME[["Q_a_1"]]], axis=1), "Q_a_1: this name is there twice"),
    ],
)
def test_faults_of_a_frame_are_named(frame: pd.DataFrame, message: str) -> None:
    with pytest.raises(LogError, match=message):
        tt.read_log(frame)


def test_one_bad_cell_is_named_with_its_row_like_that_of_a_file(tmp_path: Path) -> None:
    frame = FRAME.assign(T_a_degC=[20.0, "20.5", "abc", None], Q_a_1=[" 0 ", "x", True, "inf"])
    frame.columns = ["time_s", " T_a_degC", "Q_a_1 "]
    frame.to_csv(tmp_path / "a.csv", index=False)
    of_frame, of_file = (tt.read_log(each, strict=False) for each in (frame, tmp_path / "a.csv"))
    assert [str(problem) for problem in of_frame.problems] == [
        "<frame>:3: T_a_degC: not a number: 'abc'",
        "<frame>:2: Q_a_1: not a number: 'x'",
        "<frame>:3: Q_a_1: not a number: True",
        "<frame>:4: Q_a_1: infinite: inf",
    ]
    assert len(of_file.problems) == 4
    for name in ("T_a_degC", "Q_a_1"):
        np.testing.assert_array_equal(of_frame.columns[name], of_file.columns[name])
    np.testing.assert_array_equal(of_frame.columns["T_a_degC"], [20.0, 20.5, np.nan, np.nan])
    empty = FRAME.assign(T_a_degC=[None] * 4)
    assert np.isnan(tt.read_log(empty).columns["T_a_degC"]).all()


def test_a_string_is_one_name() -> None:
    assert names("T_a_degC") == names(["T_a_degC"]) == ("T_a_degC",)
    assert names(()) == ()
    assert len(tt.read_log(FRAME, need="T_a_degC", nan_policy="omit")) == 3


@pytest.mark.slow
def test_a_string_is_one_name_for_fits() -> None:
    time = np.arange(0.0, 1200.0, 10.0)
    heat = np.where(time // 300 % 2 == 0, 0.0, 100.0)
    frame = pd.DataFrame({"time_s": time, "Q_motor_W": heat, "d_z_um": 0.0})
    for k in range(1, len(time)):
        frame.loc[k, "d_z_um"] = 0.95 * frame["d_z_um"][k - 1] + 0.01 * heat[k - 1]
    fit = tt.calibrate(frame, "Q_motor_W", deflections="d_z_um")
    assert [output.channel for output in fit.model.outputs] == ["d_z_um"]
    found = tt.identify(frame, "Q_motor_W", "d_z_um", orders=[(1, 1, 1)])
    assert found.model.needs() == ("Q_motor_W",)
    frame["d_z_um"] += np.random.default_rng(1).normal(0, 0.01, len(frame))
    assert list(tt.noise(frame, channels="d_z_um").frame.index) == ["d_z_um"]


FOREIGN = FRAME.rename(columns={"time_s": "t", "T_a_degC": "Temp 1"}).assign(note=list("abcd"))
COLUMNS = {"t": "time_s", "Temp 1": "T_a_degC", "note": False}


def test_a_column_map_may_be_a_dict_of_names(tmp_path: Path) -> None:
    FOREIGN.to_csv(tmp_path / "a.csv", index=False)
    expected = tt.read_log(FRAME)
    for data in (FOREIGN, tmp_path / "a.csv"):
        log = tt.read_log(data, columns=COLUMNS)
        np.testing.assert_array_equal(log.time, expected.time)
        assert log.columns.keys() == expected.columns.keys()
        np.testing.assert_array_equal(log.columns["T_a_degC"], expected.columns["T_a_degC"])
    scaled = {**COLUMNS, "Temp 1": {"name": "T_a_degC", "offset": 1.0}}
    assert tt.read_log(FOREIGN, columns=scaled).columns["T_a_degC"][0] == 21.0
    assert tt.check(FOREIGN, columns=COLUMNS).inspection.rows == 4
    values = np.random.default_rng(1).normal(size=300)
    series = pd.DataFrame({"t": 60.0 * np.arange(300), "Temp 1": values, "note": "a"})
    fit = tt.fit(series, "T_a_degC", (1, 0), columns=COLUMNS)
    assert (fit.model.channel, fit.model.period_s) == ("T_a_degC", 60.0)


@pytest.mark.parametrize(
    ("columns", "error", "message"),
    [
        (
            {"Temp 2": "T_a_degC"},
            LogError,
            r"<columns>: <frame> has no column Temp 2 \(near: Temp 1",
        ),
        ({"Temp 1": "T_a_degF"}, LogError, "<columns>: T_a_degF: unknown unit"),
        ({"Temp 1": 3}, LogError, "<columns>: columns.Temp 1 must be a name"),
        (5, TypeError, "columns: a file, or a dict of names to names, not 5"),
    ],
)
def test_faults_of_a_dict_of_names_are_named(columns, error, message) -> None:
    with pytest.raises(error, match=message):
        tt.read_log(FOREIGN, columns=columns)


@pytest.mark.parametrize("write", ["csv", "ndjson", "frame"])
def test_words_for_missing_values_hold_in_every_format(tmp_path: Path, write: str) -> None:
    frame = FRAME.assign(T_a_degC=[20.0, "n/a", "-999", None], Q_a_1=[0.0, -999.0, 1.0, 1.0])
    data: object = frame
    if write == "csv":
        frame.assign(Q_a_1=[0, -999, 1, 1]).to_csv(tmp_path / "a.csv", index=False)
        data = tmp_path / "a.csv"
    elif write == "ndjson":
        frame.to_json(tmp_path / "a.ndjson", orient="records", lines=True)
        data = tmp_path / "a.ndjson"
    (tmp_path / "map.toml").write_text("missing = ['n/a', '-999']")
    log = tt.read_log(data, columns=str(tmp_path / "map.toml"))  # type: ignore[arg-type]
    np.testing.assert_array_equal(log.columns["T_a_degC"], [20.0, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(log.columns["Q_a_1"], [0.0, np.nan, 1.0, 1.0])
    with pytest.raises(LogError, match="n/a"):
        tt.read_log(data)  # type: ignore[arg-type]


def test_numbers_for_missing_values_hold_in_parquet(tmp_path: Path) -> None:
    FRAME.assign(Q_a_1=[0, -999, 1, 1]).to_parquet(tmp_path / "a.parquet")
    (tmp_path / "map.toml").write_text("missing = ['n/a', '-999']")
    log = tt.read_log(tmp_path / "a.parquet", columns=tmp_path / "map.toml")
    np.testing.assert_array_equal(log.columns["Q_a_1"], [0.0, np.nan, 1.0, 1.0])


def test_a_log_prints_as_a_short_table() -> None:
    time = np.array([0.0, 10.0, 20.0, 7200.0])
    log = tt.read_log(FRAME.assign(time_s=time))
    assert (
        str(log).splitlines()
        == repr(log).splitlines()
        == [
            "<frame>: 4 rows, 7200 s, 2 segments",
            "period 10 s",
            "gap of 7180 s after 20 s",
            "channel            min           max  unit   missing",
            "T_a_degC            20            21  degC   25 %",
            "Q_a_1                0             1  1      0 %",
        ]
    )
    record = tt.Record(np.arange(60.0) ** 2, {"x": np.zeros(60)})
    gaps = tt.Record(record.time, record.columns, tuple(slice(k, k + 1) for k in range(60)))
    assert str(gaps).splitlines()[-3:-1] == [
        "54 more gaps", "channel           min           max  unit   missing",
    ]  # fmt: skip
    assert str(tt.Record(np.empty(0), {})).startswith("<record>: 0 rows, 0 s, 0 segments")


def test_an_unknown_nan_policy_is_refused() -> None:
    for data in (FRAME, tt.read_log(FRAME)):
        with pytest.raises(ValueError, match="nan_policy 'drop': one of raise, omit, hold"):
            tt.read_log(data, nan_policy="drop")


def test_a_warning_points_at_the_line_of_the_caller() -> None:
    frame = FRAME.assign(T_a_degC=20.0)
    with pytest.warns(ThermalToolWarning) as caught, contextlib.suppress(LogError):
        tt.noise(frame)
    assert {each.filename for each in caught} == {__file__}


def test_the_nan_policy_holds_for_frames_and_records() -> None:
    for data in (FRAME, tt.read_log(FRAME)):
        with pytest.raises(LogError, match="T_a_degC: missing value"):
            tt.read_log(data, need=["T_a_degC"])
        assert len(tt.read_log(data, need=["T_a_degC"], nan_policy="omit")) == 3
        held = tt.read_log(data, need=["T_a_degC"], nan_policy="hold")
        np.testing.assert_array_equal(held.columns["T_a_degC"], [20.0, 20.5, 20.5, 21.0])


def test_a_record_keeps_its_segments_unless_a_gap_is_named() -> None:
    time, values = np.array([0.0, 1.0, 5.0, 6.0]), np.zeros(4)
    record = tt.Record(time, {"Q_a_1": values}, segments=(slice(0, 2), slice(2, 4)))
    assert tt.read_log(record).segments == record.segments
    assert tt.read_log(record, max_gap=10.0).segments == (slice(0, 4),)
    assert tt.read_log(record).lines.tolist() == [1, 2, 3, 4]


def test_faults_of_a_record_are_named() -> None:
    with pytest.raises(UnitError, match="unknown unit"):
        tt.read_log(tt.Record(np.arange(2.0), {"spindle": np.zeros(2)}))
    with pytest.raises(LogError, match="the clock repeats"):
        tt.read_log(tt.Record(np.zeros(2), {"Q_a_1": np.zeros(2)}))
    with pytest.raises(ValueError, match="how a file or a frame is read"):
        tt.read_log(tt.Record(np.arange(2.0), {"Q_a_1": np.zeros(2)}), columns="map.toml")


def test_the_digest_follows_the_values() -> None:
    digest = tt.read_log(FRAME).digest
    assert digest == tt.read_log(FRAME.copy()).digest
    assert digest != tt.read_log(FRAME.assign(Q_a_1=[0, 1, 1, 0])).digest
    assert digest != tt.read_log(FRAME.rename(columns={"Q_a_1": "Q_b_1"})).digest
