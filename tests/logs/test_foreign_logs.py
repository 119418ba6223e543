"""Logs of other programs: drafted maps, and calibrations with them."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from machines.foreign_logs import (
    CASES,
    LAG,
    ROWS,
    klippy,
    lvm,
    matlab_5,
    matlab_73,
    moonraker,
    tdms,
    workbook,
)

from thermaltool.cli import group
from thermaltool.errors import LogError
from thermaltool.logs import draft_map, read_log
from thermaltool.logs.draft_clock import guess_clock
from thermaltool.logs.draft_names import guess_channel


@pytest.mark.parametrize("quick", [pytest.param(False, marks=pytest.mark.slow), True])
@pytest.mark.parametrize(("write", "drive", "output", "gain"), CASES)
def test_a_drafted_map_leads_to_a_calibration(
    tmp_path: Path, write: Callable[[Path], Path], drive: str, output: str, gain: float, quick: bool
) -> None:
    """No edit of the map: the gain and the time constant of the plant come back."""
    log, drafted = str(write(tmp_path)), str(tmp_path / "map.toml")
    checked = CliRunner().invoke(group, ["check", log, "--write-map", drafted])
    assert checked.exit_code in (0, 3), checked.output
    assert f"\n{drive} " in checked.output
    read = read_log(log, columns=drafted, nan_policy="omit", need=[drive, output])
    assert len(read) >= ROWS - 1
    kind = "--sensor" if output.startswith("T") else "--deflection"
    model = str(tmp_path / "model.json")
    arguments = ["calibrate", log, "--columns", drafted, "--drive", drive, kind, output]
    if quick:
        arguments += ["--response", f"{output}=rational1", "--starts", "1", "-q", "--linear"]
    done = CliRunner().invoke(group, [*arguments, "-o", model])
    assert done.exit_code == 0, done.output
    ((_, shown),) = json.loads(
        CliRunner().invoke(group, ["present", model, "--json"]).stdout
    ).items()
    assert shown["outputs"][0]["fit_percent"] > 97
    (found,) = shown["responses"]
    assert found["gain"][0] == pytest.approx(gain, rel=0.02)
    assert found["time_constants_s"][-1][0] == pytest.approx(LAG, rel=0.05)


@pytest.mark.parametrize(
    ("write", "library"), [(tdms, "nptdms"), (workbook, "openpyxl"), (matlab_73, "h5py")]
)
def test_an_absent_library_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write, library: str
) -> None:
    log = write(tmp_path)
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(LogError, match=r"pip install 'thermaltool\[formats\]'"):
        read_log(str(log))


@pytest.mark.parametrize("write", [lvm, tdms, workbook, matlab_5, matlab_73, moonraker])
def test_a_file_that_is_cut_short_is_one_line(tmp_path: Path, write) -> None:
    log = write(tmp_path)
    log.write_bytes(log.read_bytes()[:700])
    with pytest.raises(LogError, match=log.name):
        read_log(str(log), columns={"X": "time_s"})


def test_lvm_channels_with_clocks_of_their_own(tmp_path: Path) -> None:
    path = tmp_path / "multi.lvm"
    end = "***End_of_Header***"
    rows = ["X_Value\tA\tX_Value\tB\tComment", "0\t1\t0\t2", "1\t1\t1.5\t2", ""]
    head = ["LabVIEW Measurement", "X_Columns\tMulti", end, "Channels\t2", end]
    path.write_text("\n".join([*head, *rows]))
    with pytest.raises(LogError, match=r"multi.lvm:8: channels with clocks of their own"):
        read_log(str(path))


def test_content_counts_before_the_suffix(tmp_path: Path) -> None:
    renamed = workbook(tmp_path).rename(tmp_path / "run.csv")
    text = draft_map(str(renamed)).text
    assert 'column = ["Date", "Time"]' in text
    assert "skip = 2" in text


def test_a_klippy_log_with_stamps_before_its_lines(tmp_path: Path) -> None:
    log = klippy(tmp_path)
    plain = read_log(str(log), columns={"chamber.temp": "T_chamber_degC"}, strict=False)
    lines = [f"09-26 07:10:{k % 60:02d}.000:{x}" for k, x in enumerate(log.read_text().split("\n"))]
    log.write_text("\n".join(lines))
    found = read_log(str(log), columns={"chamber.temp": "T_chamber_degC"}, strict=False)
    np.testing.assert_array_equal(found.column("T_chamber_degC"), plain.column("T_chamber_degC"))


@pytest.mark.parametrize(
    ("name", "unit"), [("Temps (min)", "min"), ("Durée (s)", "s"), ("tempo [h]", "h")]
)
def test_a_clock_has_its_name_in_other_languages(name, unit):
    columns = {"T_bed": np.array([20.0, 20.5, 21.0]), name: np.array([0.0, 0.5, 1.0])}
    clock, _ = guess_clock({}, columns)
    assert (clock.column, clock.unit) == (name, unit)
    assert guess_clock({}, {"temps_bed": columns["T_bed"]}) is None


@pytest.mark.parametrize(
    ("name", "channel", "unit"),
    [
        ("air_F", "T_air_degC", "F"),
        ("air_C", "T_air_degC", None),
        ("Probe F", "d_Probe_F_um", None),
    ],
)
def test_a_letter_behind_a_line_is_a_unit_and_one_behind_a_blank_an_axis(name, channel, unit):
    found = guess_channel(name, "", np.array([70.0, 70.3, 71.0]))
    assert (found.name, found.unit) == (channel, unit)
    assert guess_channel("clamp_F", "", np.array([0.0, 812.0, 40.5])).name is None
