"""What the lines of a stream look like: time stamps, values alone, a pattern of the user's."""

import io
import json

import pyarrow
import pytest
from pyarrow import parquet

from thermaltool.errors import LogError, OutputError
from thermaltool.runtime.clocks import Stamp, StampClock
from thermaltool.runtime.compensation import offsets
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.settings import Settings
from thermaltool.runtime.stream import open_stream

ROWS = ("0,0", "0.5,1.25", "1.0,2.5")
STAMPS = ("2026-03-14T10:15:00.000Z", "2026-03-14T10:15:00.500Z", "2026-03-14T10:15:01.000Z")
ISO = "time,dT_pair1_K\n" + "".join(
    f"{stamp},{row.split(',')[1]}\n" for stamp, row in zip(STAMPS, ROWS, strict=True)
)
SECONDS = "time_s,dT_pair1_K\n" + "\n".join(ROWS) + "\n"


@pytest.fixture
def written(model, tmp_path):
    """Run the offsets of the model over `text`; the lines that come out."""

    def run(text=ISO, **chosen):
        (tmp_path / "in").write_text(text)
        settings = Settings(**{"limits": (-500.0, 500.0), **chosen})
        messages = Messages(run.said.append)
        with open(tmp_path / "in", "rb") as source, open(tmp_path / "out", "wb") as out:
            process = offsets(model, settings, messages)
            try:
                open_stream(process, settings, source.fileno(), out.fileno(), messages).run()
            finally:
                run.out = (tmp_path / "out").read_bytes()
        return run.out.decode().splitlines()

    run.said = []
    return run


def times(lines):
    return [line.split(",")[0] for line in lines]


def test_iso_stamps_come_out_as_they_went_in(written):
    assert times(written()) == ["time", *STAMPS, "2026-03-14T10:15:01.500Z"]


@pytest.mark.parametrize(
    ("first", "last"),
    [
        ("2026-03-14 10:15:00", "2026-03-14 10:15:00.500000"),
        ("2026-03-14T10:15:00,25+01:00", "2026-03-14T10:15:00.750+01:00"),
        ("2026-03-14T10:15:00.123456Z", "2026-03-14T10:15:00.623456Z"),
        ("20260314T101500", "2026-03-14T10:15:00.500000"),
    ],
)
def test_a_line_of_no_row_has_a_stamp_of_the_same_kind(written, first, last):
    separator = ";" if "," in first else ","
    line = f'"{first}"{separator}0'.replace(";", ",")
    assert written(f"time,dT_pair1_K\n{line}\n")[-1].startswith(f"{last},")


def test_a_line_that_is_refused_has_the_stamp_of_the_one_before(written):
    lines = ISO.splitlines()
    lines.insert(3, "no stamp,1.0")
    assert times(written("\n".join(lines) + "\n"))[2:4] == [STAMPS[1], STAMPS[1]]


def test_stamps_of_a_map_come_out_as_iso_8601(written, tmp_path):
    (tmp_path / "map.toml").write_text(
        '[time]\ncolumn = "Zeit"\nformat = "%d.%m.%Y %H:%M:%S"\n[columns]\n"Paar" = "dT_pair1_K"\n'
    )
    text = "Zeit,Paar\n14.03.2026 10:15:00,0\n14.03.2026 10:15:01,1\n"
    lines = written(text, columns=str(tmp_path / "map.toml"))
    assert times(lines)[:3] == ["time", "2026-03-14T10:15:00", "2026-03-14T10:15:01"]


def test_other_clocks_are_written_in_seconds(written):
    assert times(written(SECONDS)) == ["time_s", "0.0", "0.5", "1.0", "1.5"]
    assert times(written(ISO, clock="arrival"))[0] == "time_s"


def test_stamps_in_json_and_parquet(written):
    lines = [json.loads(line) for line in written(to_format="ndjson")]
    assert [line["time"] for line in lines[:-1]] == list(STAMPS)
    settings = {"to_format": "parquet", "status": True}
    with pytest.raises(UnicodeDecodeError):
        written(**settings)
    table = parquet.read_table(pyarrow.BufferReader(written.out)).to_pydict()
    assert table["time"][:-1] == list(STAMPS)
    assert table["status"][-1] == "safe"


def test_a_restart_goes_on_with_stamps(written, tmp_path):
    kept = {"checkpoint": str(tmp_path / "state.json"), "header": False}
    whole = written(header=False)
    first = written("\n".join(ISO.splitlines()[:3]) + "\n", **kept)
    names, *_, row = ISO.splitlines()
    second = written(f"{names}\n{row}\n", **kept)
    assert times(first[:-1] + second) == times(whole)
    assert first[:-1] == whole[:2]


def test_values_alone_and_no_header(written):
    lines = written(SECONDS)
    assert written(SECONDS, header=False) == lines[1:]
    values = written(SECONDS, to_format="values")
    assert values == [line.partition(",")[2] for line in lines[1:]]
    status = written(ISO, to_format="values", status=True)
    assert status[-1] == "0.0,0.0,safe"


def template(text, **chosen):
    return {"to_format": "template", "template": text, **chosen}


def test_a_template_with_the_safe_line(written):
    rows = [line.split(",") for line in written(SECONDS)[1:]]
    lines = written(SECONDS, **template("SET_GCODE_OFFSET X={offset_x_mm:.4f} MOVE=1"))
    assert lines == [f"SET_GCODE_OFFSET X={float(x) / 1000:.4f} MOVE=1" for _, x, _ in rows]
    assert lines[-1] == "SET_GCODE_OFFSET X=0.0000 MOVE=1"


def test_fields_of_a_template(written):
    text = "{time}|{time_s:.2f}|{offset_x_um}|{offset_y_m:+.3e}|{d_x_um:.1f}|{status}|{{}}"
    lines = written(**template(text, status=True, estimates=True))
    assert lines[0] == f"{STAMPS[0]}|0.00|0.0|+0.000e+00|0.0|ok|{{}}"
    assert lines[-1].startswith("2026-03-14T10:15:01.500Z|1.50|0.0|+0.000e+00|")
    assert lines[-1].endswith("|safe|{}")


def test_a_template_before_any_time_is_known(written):
    """Nothing was read: the safe line is the only one."""
    with pytest.raises(LogError):
        written("", **template("{time}{time_s:.1f} X{offset_x_um:.1f}"))
    assert written.out == b" X0.0\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "Z={offset_z_um}",
            "no field 'offset_z_um': there are time, time_s, offset_x_um, offset_y_um",
        ),
        ("Z={d_x_um}", "no field 'd_x_um'"),
        ("Z={offset_x_K}", "no field 'offset_x_K'"),
        ("Z={}", "no field ''"),
        ("Z={0}", "no field '0'"),
        ("Z={offset_x_um.real}", "no field 'offset_x_um.real'"),
        ("Z={offset_x_um[0]}", r"no field 'offset_x_um\[0\]'"),
        ("Z={offset_x_um:d}", "Unknown format code 'd'"),
        ("Z={offset_x_um:.f}", "Format specifier missing precision"),
        ("Z={offset_x_um!r}", "is written as it is: no r"),
        ("Z={offset_x_um:{time}}", "Invalid format specifier"),
        ("Z={offset_x_um:99999999999}", "--template"),
        ("Z={offset_x_um:5000}", "above 4096"),
        ("Z={offset_x_um", "expected '}'"),
        ("Z=}", "Single '}'"),
        ("MOVE=1", "no set point in it"),
        ("{time}", "no set point in it"),
        ("", "no set point in it"),
        ("{time:.1f} {offset_x_um}", "is written as it is"),
        ("\udcff{offset_x_um}", "surrogates not allowed"),
        (None, "needs the pattern of a line"),
    ],
)
def test_a_template_that_cannot_be_is_refused_before_the_first_line(written, text, message):
    with pytest.raises(ValueError, match=message):
        written(SECONDS, **template(text))
    assert written.out == b""


def test_a_header_waits_for_the_first_line_alone(model):
    """Silence comes first: the time of stamps is then written in seconds."""
    said = []
    settings, messages = Settings(), Messages(said.append)
    process = offsets(model, settings, messages)
    out = io.BytesIO()
    stream = open_stream(process, settings, 0, 1, messages)
    stream.sink._sink._output = out
    stream._step_to_safe(3.0)
    assert [*stream._replies(b"time,dT_pair1_K")] == []
    assert [*stream._replies(f"{STAMPS[0]},0".encode())] == [(0.0, [0.0, 0.0])]
    assert out.getvalue() == b"time_s,offset_x_um,offset_y_um\n,0.0,0.0\n"
    assert "times are written in seconds" in "".join(said)


def test_a_sink_that_cannot_be_opened_gets_nothing(written, monkeypatch):
    calls = []

    def fails(self, names):
        calls.append(names)
        raise OutputError("no such controller")

    monkeypatch.setattr("thermaltool.runtime.sinks.line_sinks.LineSink.open", fails)
    for end in ("safe", "ramp"):
        with pytest.raises(OutputError, match="no such controller"):
            written(end=end)
        assert written.out == b""
    assert len(calls) == 2


def test_a_stamp_beyond_every_calendar():
    clock = StampClock(0)
    assert clock.stamp([b"9999-12-31T23:59:59"]) == 0.0
    assert clock.written(0.0) == "9999-12-31T23:59:59"
    assert clock.written(10.0) == Stamp("", 10.0)
    assert StampClock(0).written(1.0) == 1.0
