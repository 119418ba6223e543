import json
import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from thermaltool.errors import LogError
from thermaltool.logs.columns import read_map
from thermaltool.runtime.clocks import PeriodClock
from thermaltool.runtime.rows.csv_rows import CsvRows
from thermaltool.runtime.rows.layout import Wanted
from thermaltool.runtime.rows.ndjson_rows import NdjsonRows

PAIR = ("dT_pair1_K",)


def csv(header=b"time_s,dT_pair1_K,n_rpm", sensors=PAIR, **wanted):
    records = CsvRows(Wanted(sensors, **wanted))
    assert records.open(header) is False
    return records


@given(
    time=st.floats(-1e9, 1e9),
    readings=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=2, max_size=2),
)
def test_numbers_come_through_exactly_in_both_formats(time, readings):
    names = ("dT_pair1_K", "dT_pair2_K")
    line = f"{time!r}, {readings[0]!r} ,{readings[1]!r}".encode()
    record = csv(b"time_s,dT_pair1_K,dT_pair2_K", names).row(line)
    assert (record.time, record.readings, any(record.faults)) == (time, readings, False)
    line = json.dumps(dict(zip(("time_s", *names), [time, *readings], strict=True))).encode()
    records = NdjsonRows(Wanted(names))
    assert records.open(line) is True
    assert records.row(line)[:2] == (time, readings)


@given(st.binary(max_size=40).filter(lambda line: b"\n" not in line))
@example(b'"\r0')
def test_no_line_raises(line):
    csv().row(line)
    records = NdjsonRows(Wanted(PAIR))
    records.open(b'{"time_s": 0, "dT_pair1_K": 1}')
    records.row(line)


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        (b"1.5,,0", "empty"),
        (b"1.5, ,0", "empty"),
        (b"1.5,--,0", "not a number: '--'"),
        (b"1.5,1_000,0", "not a number: '1_000'"),
        (b"1.5,\xff\xfe,0", "not a number"),
    ],
)
def test_a_bad_field_says_what_is_wrong_and_keeps_the_time(line, fault):
    record = csv().row(line)
    assert record.time == 1.5
    assert math.isnan(record.readings[0])
    assert record.faults[0].startswith(fault)


@pytest.mark.parametrize("line", [b"1.5,2.0", b"1.5,2.0,0,7"])
def test_a_line_with_other_fields_counts_for_nothing(line):
    """Any field may be another's, the time too."""
    record = csv().row(line)
    assert (record.time, math.isnan(record.readings[0])) == (None, True)
    assert record.faults[0] == f"{line.count(b',') + 1} fields instead of 3"


def test_a_bad_field_leaves_the_other_sensors_alone():
    record = csv(sensors=("dT_pair1_K", "n_rpm")).row(b"1.5,x,7")
    assert record.readings[1] == 7.0
    assert record.faults[1] == ""


@pytest.mark.parametrize("line", [b"x,2.0,0", b"nan,2.0,0", b"inf,2.0,0", b"1.5", b",2.0,0"])
def test_a_line_without_a_time(line):
    assert csv().row(line).time is None


@pytest.mark.parametrize(
    ("value", "fault"),
    [
        ("null", "empty"),
        ("true", "not a number: 'True'"),
        ('"2.0"', "not a number: '2.0'"),
        ("[1]", "not a number: '[1]'"),
        ("NaN", ""),
        ("1" + "0" * 400, "not a number: '1000"),
    ],
)
def test_ndjson_values_that_are_no_number(value, fault):
    records = NdjsonRows(Wanted(PAIR))
    records.open(b'{"time_s": 0, "dT_pair1_K": 1}')
    record = records.row(b'{"time_s": 2, "dT_pair1_K": %s}' % value.encode())
    assert record.time == 2.0
    assert record.faults[0].startswith(fault)
    assert math.isnan(record.readings[0])


def test_ndjson_object_that_lacks_a_sensor_or_is_cut():
    records = NdjsonRows(Wanted(PAIR))
    records.open(b'{"time_s": 0, "dT_pair1_K": 1}')
    assert records.row(b'{"time_s": 2}').faults == ("missing",)
    assert records.row(b'{"time_s": 2, "dT').faults == ("not a JSON object",)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (b"time_s,dT_pair_K", "no column dT_pair1_K, which the estimator reads (near: dT_pair_K)"),
        (b"time_x,dT_pair1_K", "no clock: no column time_s or time (near: time_x)"),
        (b'{"time_s": 0}', "this is NDJSON, not CSV: use --from ndjson"),
        (b"\xff\xfet\0", "in UTF-16 or the like"),
        (b"t\xff", "not UTF-8: byte 0xff"),
    ],
)
def test_headers_that_do_not_fit(header, message):
    with pytest.raises(LogError) as caught:
        CsvRows(Wanted(PAIR)).open(header)
    assert message in str(caught.value)


def test_ndjson_that_is_csv():
    with pytest.raises(LogError, match="not a JSON object"):
        NdjsonRows(Wanted(PAIR)).open(b"time_s,dT_pair1_K")


def test_quoted_names_and_fields():
    records = csv(b'"time_s","note, long","dT_pair1_K"')
    assert records.row(b'2,"a, b",1.5').readings == [1.5]


@pytest.mark.parametrize(
    ("header", "line", "time"),
    [
        (b"time_min,dT_pair1_K", b"2,0", 120.0),
        (b"time_ms,dT_pair1_K", b"2,0", 0.002),
        (b"time,dT_pair1_K", b"2026-01-01T00:00:30.25+01:00,0", 30.25),
    ],
)
def test_clocks_by_name(header, line, time):
    records = csv(header)
    if header.startswith(b"time,"):
        records.row(b"2025-12-31T23:00:00Z,0")
    assert records.row(line).time == pytest.approx(time)


def test_a_period_counts_bad_lines_too():
    records = csv(b"dT_pair1_K", clock=PeriodClock(0.5))
    assert [records.row(line).time for line in (b"1", b"x", b"1,2", b"3")] == [0, 0.5, 1, 1.5]


def test_a_header_that_lacks_what_is_read_is_one():
    rows = csv()
    assert rows.is_header(b"time_s,dT_other_K,n_rpm")
    assert not rows.is_header(b"1.5,0.1,0")
    assert "no column dT_pair1_K" in rows.reopen(b"time_s,dT_other_K,n_rpm", 1.0)
    assert math.isnan(rows.row(b"2,0.5,0").readings[0])


def test_separators_behind_the_last_cell_are_no_cells():
    assert csv(b"time_s,dT_pair1_K,,").row(b"1,0.5,,").readings == [0.5]
    assert csv().row(b"1,0.5,0,,").readings == [0.5]
    assert "4 fields instead of 3" in csv().row(b"1,0.5,0,7").faults[0]


@pytest.mark.parametrize("twice", [b"time_s", b"dT_pair1_K"])
def test_what_is_read_is_there_once(twice):
    with pytest.raises(LogError, match="there twice"):
        csv(b"time_s,dT_pair1_K," + twice)


def test_lines_that_a_map_skips(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text("skip = 2\nskip_after_names = 1\n[columns]\nx = 'dT_pair1_K'\n")
    rows = CsvRows(Wanted(PAIR, mapping=read_map(str(path))))
    lines = [b"Logger X", b"", b"time_s,x", b"s,K", b"0,1", b"1,2"]
    taken = []
    for number, line in enumerate(lines, 1):
        if not rows.skips(line, number) and (rows.clock is not None or rows.open(line)):
            taken.append(rows.row(line).readings)
    assert taken == [[1.0], [2.0]]
    # The logger begins anew.
    assert rows.is_header(b"time_s,x")
    assert rows.reopen(b"time_s,x", 1.0) == ""
    assert [rows.skips(line, 9) for line in (b"s,K", b"2,3")] == [True, False]
    # Lines with the channels' own names have no such head.
    own = CsvRows(Wanted(PAIR, mapping=read_map(str(path))))
    assert not own.skips(b"time_s,dT_pair1_K", 1)


def test_two_columns_of_one_channel(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text("[columns]\nx = 'dT_pair1_K'\n")
    with pytest.raises(LogError, match="two columns are mapped to dT_pair1_K"):
        csv(b"x,time_s,dT_pair1_K", mapping=read_map(str(path)))


def test_a_header_is_no_period():
    rows = csv(b"dT_pair1_K", clock=PeriodClock(0.5))
    rows.row(b"1")
    rows.row(b"dT_pair1_K")
    rows.clock.take_back()
    assert rows.row(b"2").time == 0.5


def test_foreign_names_scales_and_decimal_commas(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text(
        """
        separator = ";"
        decimal = ","
        missing = ["-999"]
        [time]
        column = "Zeit"
        unit = "ms"
        [columns]
        "Kanal 1" = {name = "dT_pair1_K", scale = 0.1, offset = 1.0}
        """
    )
    records = csv(b"Zeit;Kanal 1", mapping=read_map(str(path)))
    record = records.row(b"1500;12,5")
    assert record.time == 1.5
    assert record.readings == pytest.approx([2.25])
    assert records.row(b"1500;-999").faults[0] == "not a number: '-999'"
    with pytest.raises(LogError, match="no column Zeit"):
        csv(b"Z;Kanal 1", mapping=read_map(str(path)))


def test_the_encoding_of_a_map(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text('encoding = "cp1252"\nmissing = ["–"]\n[columns]\n"Läger °C" = "dT_pair1_K"\n')
    header = "time_s,Läger °C".encode("cp1252")
    records = csv(header, mapping=read_map(str(path)))
    assert records.row(b"1,2.5").readings == [2.5]
    assert records.row("1,–".encode("cp1252")).faults[0].startswith("not a number")
    assert records.row('1,"2.5"'.encode("cp1252")).readings == [2.5]
    assert records.is_header(header)
    with pytest.raises(LogError, match=r"byte 0xe4 \(a map for --columns says another"):
        csv(header)
    wide = "time_s,dT_pair1_K\n".encode("utf-16")
    path.write_text('encoding = "utf-16-le"\n')
    for mapping in (read_map(str(path)), None):
        with pytest.raises(LogError, match="iconv -f UTF-16 -t UTF-8"):
            csv(wide[:-1], mapping=mapping)


def test_a_byte_order_mark_is_no_part_of_a_word(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text('encoding = "utf-8-sig"\nmissing = ["-999"]\n')
    header = b"time_s,dT_pair1_K"
    records = csv(header, mapping=read_map(str(path)))
    assert records.is_header(header)
    assert records.row(b"1,-999").faults[0].startswith("not a number")


def test_two_columns_of_one_name():
    with pytest.raises(LogError, match=r"log\.csv:3: dT_pair1_K: this name is there twice"):
        CsvRows(Wanted(PAIR)).open(b"time_s,dT_pair1_K,dT_pair1_K", "log.csv", 3)
    # One that nobody reads may be there as often as it likes.
    csv(b"time_s,dT_pair1_K,x,x")


def test_values_that_a_column_cannot_have():
    limits = {"valid": [-40, 150], "missing": [85.0]}
    records = csv(b"time_s,dT_pair1_K", mapping=read_map({"dT_pair1_K": limits}))
    for field in (b"85", b"-127", b"200"):
        row = records.row(b"1," + field)
        assert math.isnan(row.readings[0])
        assert row.faults[0].startswith(field.decode())
    assert records.row(b"1,84.9") == (1.0, [84.9], ("",))


def test_keys_of_objects_in_objects_are_read_as_in_logs():
    mapping = read_map({"time_s": "time_s", "status.bed.temperature": "T_bed_degC"})
    records = NdjsonRows(Wanted(("T_bed_degC",), mapping))
    line = b'{"time_s": 2.5, "status": {"bed": {"temperature": 60.5, "target": null}, "x": []}}'
    assert records.open(line) is True
    assert records.row(line)[:2] == (2.5, [60.5])
    for other in (b'{"time_s": 3, "status": 4}', b'{"time_s": 3, "status": {"bed": {}}}'):
        row = records.row(other)
        assert row.time == 3
        assert row.faults == ("missing",)
    deep = b'{"a":' * 500 + b"1" + b"}" * 500
    assert records.row(deep).time is None
