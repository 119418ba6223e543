"""Column maps: foreign names, clocks, scales and dialects."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from reference.measured import MAPS, published, whole_log

from thermaltool.errors import LogError
from thermaltool.logs import Log, read_log, write_table


@pytest.fixture
def mapped(tmp_path: Path):
    """Read a CSV text through the text of a map."""

    def read(data: str, toml: str) -> Log:
        (tmp_path / "log.csv").write_text(data)
        (tmp_path / "map.toml").write_text(toml)
        return read_log(str(tmp_path / "log.csv"), columns=str(tmp_path / "map.toml"))

    return read


def test_names_scales_and_columns_left_out(mapped) -> None:
    log = mapped(
        "t,steps,temp,note,Q_main_W\n0,4,20,cold,1\n0.5,6,21,--,2\n",
        '[time]\ncolumn = "t"\nunit = "min"\n[columns]\nnote = false\ntemp = "T_a_degC"\n'
        'steps = { name = "d_z_um", scale = 2.5, offset = 1 }\n',
    )
    assert log.time.tolist() == [0, 30]
    assert log.column("d_z_um").tolist() == [11, 16]
    assert list(log.columns) == ["d_z_um", "T_a_degC", "Q_main_W"]


FOREIGN = "Kopf\nZeit;Schritte;Lager\n0;4;20,5\n0,5;6;21,5\n"
GERMAN = (
    'separator = ";"\ndecimal = ","\nskip = 1\n[time]\ncolumn = "Zeit"\nunit = "min"\n[columns]\n'
    'Lager = "T_a_degC"\nSchritte = { name = "d_z_um", scale = 2.5 }\n'
)


@pytest.mark.parametrize("suffix", ["csv", "parquet", "ndjson"])
def test_a_log_that_is_mapped_already_is_read_as_it_stands(mapped, tmp_path, suffix) -> None:
    """What was written under the names of a map, with scales applied, is not scaled again."""
    log = mapped(FOREIGN, GERMAN)
    assert log.spared_map is None
    again = tmp_path / f"again.{suffix}"
    write_table({"time_s": log.time, **log.columns}, str(again))
    read = read_log(str(again), columns=str(tmp_path / "map.toml"))
    assert read.spared_map == str(tmp_path / "map.toml")
    assert read.time.tolist() == [0, 30]
    assert read.column("d_z_um").tolist() == [10, 15]
    assert read.column("T_a_degC").tolist() == [20.5, 21.5]


@pytest.mark.parametrize(
    "data",
    [
        "time_s,d_z_um\n0,1\n1,2\n",  # a channel of the map is not there
        "time_s,Lager,T_a_degC,d_z_um\n0,1,2,3\n1,1,2,3\n",  # one of each
        "Zeit,T_a_degC,d_z_um\n0,2,3\n1,2,3\n",  # another clock
    ],
)
def test_half_mapped_is_refused(mapped, data) -> None:
    with pytest.raises(LogError, match="has no column"):
        mapped(data, GERMAN.replace("skip = 1", "skip = 0").replace('";"', '","'))


OPTIONAL = """
[columns]
bed = "T_bed_degC"
pump = { name = "U_pump_V", optional = true }
"""
# Beside a quantity that needs what is optional.
COMPUTED = """
[columns]
bed = "T_bed_degC"
air = { name = "T_air_degC", optional = true }
[computed]
dT_bed_K = { difference = ["T_bed_degC", "T_air_degC"] }
"""


@pytest.mark.parametrize("given", ["pump", "U_pump_V", None])
def test_a_column_that_some_logs_lack(mapped, given) -> None:
    """Under its foreign name, in a log that has the map's names already, or not at all."""
    bed = "T_bed_degC" if given == "U_pump_V" else "bed"
    names = ",".join(filter(None, ["time_s", bed, given]))
    log = f"{names}\n0,20,1\n1,21,0\n" if given else "time_s,bed\n0,20\n1,21\n"
    read = mapped(log, OPTIONAL)
    assert read.column("T_bed_degC").tolist() == [20, 21]
    assert ("U_pump_V" in read.columns) == (given is not None)


def test_what_is_computed_from_a_column_that_is_not_there_is_refused(mapped) -> None:
    assert mapped("time_s,bed,air\n0,20,19\n1,21,19\n", COMPUTED).column("dT_bed_K")[1] == 2
    with pytest.raises(LogError, match="T_air_degC"):
        mapped("time_s,bed\n0,20\n1,21\n", COMPUTED)


def test_optional_is_true_or_false(mapped) -> None:
    with pytest.raises(LogError, match="optional is true or false"):
        mapped("time_s,bed\n0,20\n", OPTIONAL.replace("true", '"yes"'))


def test_rows_without_a_clock(mapped) -> None:
    log = mapped("U_a_V\n1\n2\n3\n", "[time]\nperiod = 0.08\n")
    np.testing.assert_allclose(log.time, [0, 0.08, 0.16], rtol=0, atol=1e-15)


def test_time_stamps_of_a_given_pattern(mapped) -> None:
    data = "time,T_a_degC\n13.06.2021 05:42:16,1\n13.06.2021 05:43:16,2\n"
    log = mapped(data, '[time]\ncolumn = "time"\nformat = "%d.%m.%Y %H:%M:%S"\n')
    assert log.time.tolist() == [0, 60]
    assert log.epoch == "2021-06-13T05:42:16"


def test_seconds_in_a_column_named_time(mapped) -> None:
    assert mapped("time,T_a_degC\n5,1\n7,2\n", '[time]\ncolumn = "time"\n').time.tolist() == [5, 7]


def test_semicolons_decimal_commas_and_a_word_for_missing(mapped) -> None:
    log = mapped(
        "time_s;T_a_degC\n0;20,5\n1;--\n2;-999\n",
        "separator = ';'\ndecimal = ','\nmissing = ['--', '-999']\n",
    )
    np.testing.assert_array_equal(log.column("T_a_degC"), [20.5, np.nan, np.nan])


def test_unmapped_columns(mapped) -> None:
    data = "time_s,a,T_b_degC\n0,1,2\n"
    with pytest.raises(LogError, match="a: unknown unit"):
        mapped(data, '[columns]\nT_b_degC = "T_c_degC"\n')
    log = mapped(data, 'unmapped = "drop"\n[columns]\nT_b_degC = "T_c_degC"\n')
    assert list(log.columns) == ["T_c_degC"]


@pytest.mark.parametrize(
    ("toml", "words"),
    [
        ("[columns", "not TOML"),
        ("[column]\n", "knows no 'column' (near: columns)"),
        ('[columns]\ntempp = "T_a_degC"\n', "no column tempp (near: temp)"),
        ('[time]\ncolumn = "tt"\n', "no column tt"),
        ("[time]\n", "either a column or a period"),
        ('[time]\ncolumn = "t"\nperiod = 1\n', "either a column or a period"),
        ("[time]\nperiod = 0\n", "above 0 s"),
        ('[time]\ncolumn = "t"\nunit = "year"\n', "one of 's'"),
        ('[time]\ncolumn = "t"\nunit = "s"\nformat = "%s"\n', "goes with"),
        ('[columns]\ntemp = "temperature"\n', "temperature: unknown unit"),
        ("[columns]\ntemp = 3\n", "columns.temp"),
        ("[columns]\ntemp = {scale = 2}\n", "columns.temp.name"),
        ('[columns]\ntemp = {name = "T_a_degC", scale = "2"}\n', "columns.temp.scale"),
        ('[columns]\ntemp = {name = "T_a_degC", scal = 2}\n', "(near: scale)"),
        ('unmapped = "no"\n', "'keep', 'drop'"),
        ("decimal = ';'\n", "decimal is one of"),
    ],
)
def test_bad_maps(mapped, toml: str, words: str) -> None:
    with pytest.raises(LogError) as caught:
        mapped("t,temp\n0,1\n", toml)
    assert caught.value.file is not None
    assert caught.value.file.endswith("map.toml")
    assert words in str(caught.value)


def test_two_columns_of_one_name(mapped) -> None:
    with pytest.raises(LogError, match="b: two columns are mapped to T_a_degC"):
        mapped("time_s,a,b\n0,1,2\n", '[columns]\na = "T_a_degC"\nb = "T_a_degC"\n')


@pytest.mark.parametrize(
    ("find", "path", "name", "rows", "channels", "period"),
    [
        (whole_log, "cnc_spindle/spindle_first_28h.csv", "cnc_spindle.toml", 6668, 22, 15.0),
        (published, "spindle/spindle_first_10min.csv", "cnc_spindle.toml", 40, 22, 15.0),
        (whole_log, "gantry/run_2021-06-13_morning.csv", "gantry.toml", 1203, 6, 4.0),
        (whole_log, "gantry/run_2021-06-13_evening.csv", "gantry.toml", 990, 6, 4.0),
        (whole_log, "daisy/heating_system.csv", "heating_system.toml", 801, 2, 2.0),
        (whole_log, "daisy/hairdryer_ljung.csv", "hairdryer.toml", 1000, 2, 0.08),
    ],
)
def test_measured_logs_load_as_they_are(
    find: Callable[[str], Path], path: str, name: str, rows: int, channels: int, period: float
) -> None:
    log = read_log(str(find(path)), columns=str(MAPS / name))
    assert len(log) == rows
    assert len(log.channel_summaries()) == len(log.columns) == channels
    assert log.period == pytest.approx(period)
    assert log.segments == (slice(0, rows),)
    assert all(np.isfinite(values).all() for values in log.columns.values())


def test_the_gantry_moves_by_2_5_um_per_step() -> None:
    log = read_log(
        str(whole_log("gantry/run_2021-06-13_evening.csv")), columns=str(MAPS / "gantry.toml")
    )
    assert log.column("d_z_um")[:2].tolist() == [-3051 * 2.5, -3047 * 2.5]
    assert log.epoch == "2021-06-13T20:05:00"


GANTRY = """# step_dist=0.0125
sample,time,mcu_pos_z,frame_t,chamber_t,bed_t,bed_target,he_t,he_target
0,2024/02/28-23:59:56,-40,22.5,23.5,25.25,105.0,25.0,100.0
0,2024/02/29-00:00:00,-38,22.5,23.75,30.5,105.0,34.5,100.0
1,2024/02/29-00:00:56,-30,22.625,24.0,61.0,105.0,100.5,100.0
"""


def test_a_log_as_the_gantry_writes_it(tmp_path: Path) -> None:
    """With numbers of our own: the measured ones are not in every checkout."""
    (tmp_path / "run.csv").write_text(GANTRY)
    log = read_log(str(tmp_path / "run.csv"), columns=str(MAPS / "gantry.toml"))
    assert log.column("d_z_um").tolist() == [-100.0, -95.0, -75.0]
    assert log.time.tolist() == [0.0, 4.0, 60.0]
    assert log.epoch == "2024-02-28T23:59:56"
    assert list(log.columns) == [
        "d_z_um", "T_frame_degC", "T_chamber_degC", "T_bed_degC", "T_bed_target_degC",
        "T_hotend_degC",
    ]  # fmt: skip


def test_classic_series_load_as_they_are() -> None:
    paths = sorted(published("series").glob("*.csv"))
    assert len(paths) == 8
    for path in paths:
        log = read_log(str(path), columns=str(MAPS / "series.toml"))
        assert list(log.columns) == ["x_series_1"]
        assert log.time[-1] == len(log) - 1


ANGLES = '[angles]\nphi_x_urad = { probes = ["d_1_um", "d_2_mm"], distance_mm = 200 }\n'


def test_an_angle_from_two_probes(mapped) -> None:
    """φ = (δ2 − δ1)/Δ: 4 µm over 200 mm are 20 µrad."""
    log = mapped("time_s,d_1_um,d_2_mm\n0,1,0.005\n1,,0\n", ANGLES)
    np.testing.assert_allclose(log.column("phi_x_urad"), [20.0, np.nan], rtol=1e-12)
    assert log.channel_summaries()[-1].unit == "urad"
    other = ANGLES.replace("phi_x_urad", "phi_x_rad")
    log = mapped("time_s,d_1_um,d_2_mm\n0,1,0.005\n1,,0\n", other)
    assert log.column("phi_x_rad")[0] == pytest.approx(20e-6)


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        (ANGLES.replace("d_1_um", "d_3_um"), "no column d_3_um"),
        (ANGLES.replace("d_1_um", "T_a_degC"), "T_a_degC is no displacement"),
        (ANGLES.replace("d_1_um", "d_2_mm"), "names two columns"),
        (ANGLES.replace("phi_x_urad", "phi_x_um"), "no angle by its name"),
        (ANGLES.replace("200", "0"), "distance_mm must be above 0"),
        (ANGLES.replace("distance_mm", "distance"), "knows no 'distance'"),
        (ANGLES.replace("phi_x_urad", "phi_y_urad"), "has this column"),
    ],
)
def test_angles_that_cannot_be(mapped, toml, message) -> None:
    with pytest.raises(LogError, match=message):
        mapped("time_s,d_1_um,d_2_mm,phi_y_urad\n0,1,0.005,3\n1,1,0,3\n", toml)


def test_values_that_a_column_cannot_have_are_missing(mapped) -> None:
    log = mapped(
        "time_s,probe,T_b_degC\n0,20.5,1\n1,85,85\n2,-127.0,3\n3,850,4\n4,86,5\n",
        'columns.probe = { name = "T_a_degC", offset = 1, valid = [-200, 150], '
        "missing = [85.0, -127] }\n[columns.T_b_degC]\nmissing = [3]\n",
    )
    np.testing.assert_array_equal(log.column("T_a_degC"), [21.5, np.nan, np.nan, np.nan, 87])
    np.testing.assert_array_equal(log.column("T_b_degC"), [1, 85, np.nan, 4, 5])


@pytest.mark.parametrize(
    ("entry", "fault"),
    [
        ("valid = [1]", "lowest, highest"),
        ("valid = [2, 1]", "lowest, highest"),
        ('missing = ["x"]', "columns.T_a_degC.missing"),
        ("missing = 85", "columns.T_a_degC.missing"),
    ],
)
def test_limits_of_a_column_that_are_none(mapped, entry: str, fault: str) -> None:
    with pytest.raises(LogError, match=fault):
        mapped("time_s,T_a_degC\n0,1\n", f"columns.T_a_degC = {{ {entry} }}\n")
