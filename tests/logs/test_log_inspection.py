"""What is wrong with a log is found, and nothing is found where nothing is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermaltool.logs import Log
from thermaltool.logs.clock import segments
from thermaltool.logs.inspect import Finding, inspect, jump

ROWS = 1000


@pytest.fixture
def log() -> Log:
    """A sensor with noise on a warming curve, and the heater that warms it."""
    time = 2.0 * np.arange(ROWS)
    noise = np.random.default_rng(1).normal(0, 0.02, ROWS)
    names = ("T_a_degC", "Q_main_W")
    values = (20 + 30 * (1 - np.exp(-time / 500)) + noise, np.where(time < 1000, 280.0, 0.0))
    return Log(
        name="log.csv",
        time=time,
        columns=dict(zip(names, values, strict=True)),
        segments=segments(time),
        digest="",
        lines=np.arange(2, ROWS + 2),
    )


def with_values(log: Log, part: slice | int, value: float) -> Log:
    values = log.columns["T_a_degC"].copy()
    values[part] = value
    return replace(log, columns={**log.columns, "T_a_degC": values})


def with_time(log: Log, time: np.ndarray) -> Log:
    return replace(log, time=time, segments=segments(time))


def only(log: Log) -> Finding:
    findings = inspect(log).findings
    assert len(findings) == 1, findings
    return findings[0]


def test_a_sound_log(log: Log) -> None:
    found = inspect(log)
    assert found.findings == ()
    assert (found.rows, found.duration, found.segments) == (ROWS, 1998.0, 1)
    summary = {channel.name: channel for channel in found.channels}["Q_main_W"]
    assert (summary.minimum, summary.maximum, summary.unit, summary.missing) == (0, 280, "W", 0)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("resolution", [0.0, 0.01, 0.0625, 0.5])
def test_noise_and_coarse_resolution_are_no_faults(log: Log, seed: int, resolution: float) -> None:
    values = log.columns["T_a_degC"] + np.random.default_rng(seed).normal(0, 0.05, ROWS)
    if resolution:
        values = resolution * np.round(values / resolution)
    assert inspect(replace(log, columns={**log.columns, "T_a_degC": values})).findings == ()


@pytest.mark.parametrize(
    ("part", "value", "kind", "line"),
    [
        (slice(100, 103), np.nan, "missing", 102),
        (500, 70.0, "spike", 502),
        (500, 48.0, "spike", 502),
        (500, -300.0, "implausible", 502),
        (slice(300, 330), 40.0, "frozen", 302),
        (slice(800, 900), 99.0, "saturated", 802),
    ],
)
def test_faults_of_a_channel(
    log: Log, part: slice | int, value: float, kind: str, line: int
) -> None:
    found = {
        (finding.kind, finding.line, finding.column)
        for finding in inspect(with_values(log, part, value)).findings
    }
    assert (kind, line, "T_a_degC") in found


def test_a_heater_may_rest_between_ramps(log: Log) -> None:
    ramp = np.clip(log.time - 1000, 0, 500)
    assert inspect(replace(log, columns={"Q_main_W": ramp})).findings == ()


def test_a_channel_may_be_constant_throughout(log: Log) -> None:
    assert inspect(with_values(log, slice(None), 20.0)).findings == ()


def test_a_gap(log: Log) -> None:
    time = log.time.copy()
    time[400:] += 300
    finding = only(with_time(log, time))
    assert (finding.kind, finding.line) == ("gap", 402)
    assert "302 s" in finding.message


def test_lost_rows(log: Log) -> None:
    time = log.time.copy()
    time[400:] += 8
    finding = only(with_time(log, time))
    assert (finding.kind, finding.line) == ("gap", 402)
    assert "lost" in finding.message


def test_jitter(log: Log) -> None:
    time = log.time.copy()
    time[600] += 0.5
    finding = only(with_time(log, time))
    assert (finding.kind, finding.line) == ("jitter", 602)
    assert inspect(with_time(log, log.time + 0.01 * np.sin(log.time))).findings == ()


def test_whole_seconds_are_no_jitter(log: Log) -> None:
    assert inspect(with_time(log, np.round(4.4 * np.arange(ROWS)))).findings == ()


def test_many_findings_of_one_kind_are_counted(log: Log) -> None:
    values = log.columns["T_a_degC"].copy()
    values[10:800:10] = np.nan
    findings = inspect(replace(log, columns={"T_a_degC": values})).findings
    assert len(findings) == 6
    assert "74 more" in findings[-1].message


def test_no_rows() -> None:
    empty = Log(np.empty(0), {"T_a_degC": np.empty(0)}, name="log.csv")
    assert only(empty).kind == "empty"


@pytest.mark.parametrize("size", [273.15, -5.0])
def test_a_gauge_that_was_set_to_zero_or_changed_its_unit_jumps(log, size):
    values = log.columns["T_a_degC"] + size * (np.arange(ROWS) >= 300)
    found = jump(replace(log, columns={**log.columns, "T_a_degC": values}), "T_a_degC",
                 ["Q_main_W"])  # fmt: skip
    assert found is not None
    assert found.line == log.lines[300]
    assert f"jumps by {size:.2g}"[:10] in found.message


def test_what_a_drive_moves_is_no_jump(log):
    assert jump(log, "T_a_degC", ["Q_main_W"]) is None
    # A spike goes back; and an output may follow at once, or after a dead time, what switches once.
    assert jump(with_values(log, 300, 90.0), "T_a_degC", ["Q_main_W"]) is None
    for late in (0, 7):
        heat = np.roll(log.columns["Q_main_W"], late)
        heat[:late] = 280.0
        follows = 0.1 * heat + np.random.default_rng(2).normal(0, 0.02, ROWS)
        direct = replace(log, columns={**log.columns, "T_a_degC": follows})
        assert jump(direct, "T_a_degC", []) is not None
        assert jump(direct, "T_a_degC", ["Q_main_W"]) is None
