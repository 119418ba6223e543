"""Sinks by the table: one that a newcomer adds, lines of text, and Parquet."""

import ast
import importlib
import io
import os
import re
import socket
from pathlib import Path

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

from thermaltool.cli import compensate, fcc
from thermaltool.errors import LogError, OutputError
from thermaltool.runtime.compensation import offsets
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.rows import ROW_FORMATS
from thermaltool.runtime.settings import Settings
from thermaltool.runtime.sinks import RECORDING_SINKS, SINKS, open_sink
from thermaltool.runtime.sinks import parquet_sink as parquet_module
from thermaltool.runtime.stream import open_stream

TEXT = b"time_s,dT_pair1_K\n0,0\n0.5,1.25\n1.0,2.5\n"


class Output:
    """Keeps what is written; full after `room` bytes."""

    def __init__(self, room=10**9):
        self.data, self.room = b"", room

    def write(self, data):
        if len(self.data) + len(data) > self.room:
            raise OutputError("<stdout>: No space left on device")
        self.data += data


@pytest.fixture
def stream_into(model, tmp_path):
    """Run the offsets of the model over `text` into a sink; what stdout gets."""

    def run(to_format, text=TEXT, **chosen):
        (tmp_path / "in").write_bytes(text)
        settings, messages = Settings(to_format=to_format, **chosen), Messages(lambda line: None)
        with open(tmp_path / "in", "rb") as source, open(tmp_path / "out", "wb") as out:
            process = offsets(model, settings, messages)
            files = source.fileno(), out.fileno()
            try:
                open_stream(process, settings, *files, messages).run()
            finally:
                run.out = (tmp_path / "out").read_bytes()
        return run.out

    return run


DEAF = """from thermaltool.errors import OutputError


class Deaf:
    def __init__(self, output): ...
    def open(self, names): ...
    def write(self, replies): raise OutputError("nobody listens")
    def close(self): ...
"""

TOY = '''
REPLIES, CALLS = [], []

class Board:
    """Each reply to a row of lamps."""

    def __init__(self, output):
        self.output = output

    def open(self, names):
        CALLS.append(("open", tuple(names)))

    def write(self, replies):
        REPLIES.extend((time, list(values)) for time, values in replies)
        self.output.write(b"." * len(replies))

    def close(self):
        CALLS.append(("close",))
'''


def test_a_sink_is_one_file_and_one_line(stream_into, tmp_path, monkeypatch):
    (tmp_path / "board_sink.py").write_text(TOY)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(SINKS, "board", "board_sink:Board")
    assert stream_into("board", limits=(-9.0, 9.0)) == b"...."
    toy = importlib.import_module("board_sink")
    assert toy.CALLS == [("open", ("time_s", "offset_x_um", "offset_y_um")), ("close",)]
    lines = stream_into("csv", limits=(-9.0, 9.0)).decode().splitlines()[1:]
    assert [
        (time, values) for time, *values in (map(float, line.split(",")) for line in lines)
    ] == toy.REPLIES
    # The safe setpoint is the last one.
    assert toy.REPLIES[-1] == (1.5, [0.0, 0.0])


def test_the_sink_of_the_documentation_as_it_stands(stream_into, tmp_path, monkeypatch):
    page = (Path(__file__).parents[2] / "docs/development/extending.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    (code,) = (block for block in blocks if "class UdpSink" in block)
    (line,) = (block for block in blocks if "udp_sink:UdpSink" in block)
    (tmp_path / "udp_sink.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    ((name, place),) = ast.literal_eval("{" + line + "}").items()
    assert place == "thermaltool.runtime.sinks.udp_sink:UdpSink"
    monkeypatch.setitem(SINKS, name, "udp_sink:UdpSink")
    with pytest.raises(OutputError, match="takes its address from UDP_SINK=HOST:PORT"):
        stream_into("udp")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as controller:
        controller.bind(("127.0.0.1", 0))
        controller.settimeout(10)
        monkeypatch.setenv("UDP_SINK", f"127.0.0.1:{controller.getsockname()[1]}")
        assert stream_into("udp") == b""
        heard = [controller.recv(200).decode() for _ in range(4)]
    assert heard[0] == "time_s=0.0 offset_x_um=0.0 offset_y_um=0.0"
    assert heard[-1] == "time_s=1.5 offset_x_um=0.0 offset_y_um=0.0"


def test_a_sink_is_closed_after_an_error(stream_into, tmp_path, monkeypatch):
    (tmp_path / "closed_sink.py").write_text(TOY)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(SINKS, "board", "closed_sink:Board")
    with pytest.raises(LogError, match="no column dT_pair1_K"):
        stream_into("board", b"time_s,x\n0,1\n")
    toy = importlib.import_module("closed_sink")
    assert toy.CALLS[-1] == ("close",)
    assert toy.REPLIES == [(None, [0.0, 0.0])]


def test_messages_come_where_a_sink_fails_twice(stream_into, tmp_path, monkeypatch):
    """The checkpoint and the messages of the end do not hang on the sink."""
    (tmp_path / "deaf_sink.py").write_text(DEAF)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(SINKS, "deaf", "deaf_sink:Deaf")
    with pytest.raises(OutputError, match="nobody listens"):
        stream_into("deaf", checkpoint=str(tmp_path / "state.json"))
    assert (tmp_path / "state.json").exists()


@pytest.mark.parametrize("command", [compensate.command, fcc.command])
def test_commands_offer_what_the_tables_have(command):
    choices = {option.name: option.type.choices for option in command.params
               if option.name in ("from_format", "to_format")}  # fmt: skip
    # What moves an actuator goes out at once: a recording is no choice for it.
    assert tuple(choices["to_format"]) == tuple(n for n in SINKS if n not in RECORDING_SINKS)
    assert tuple(choices["from_format"]) == tuple(ROW_FORMATS)


def test_a_sink_or_a_format_that_nobody_knows(stream_into):
    with pytest.raises(ValueError, match="no stream is written as xlsx: there are csv, ndjson"):
        stream_into("xlsx")
    with pytest.raises(ValueError, match="a stream reads lines, not parquet: there are csv, ndj"):
        stream_into("csv", from_format="parquet")


def test_a_name_with_a_percent_sign_in_both_texts():
    for form, last in (("csv", "1.0,2.5"), ("ndjson", '{"time_s": 1.0, "hum_%": 2.5}')):
        output = Output()
        sink = open_sink(form, output)
        sink.open(("time_s", "hum_%"))
        sink.write([(1.0, [2.5])])
        sink.close()
        assert output.data.decode().splitlines()[-1] == last


def test_a_stamp_with_a_decimal_comma_is_one_cell():
    output = Output()
    sink = open_sink("csv", output)
    sink.open(("time", "x_um"))
    sink.write([("2024-01-01 12:00:00,500", [1.5])])
    assert output.data.decode().splitlines()[-1] == '"2024-01-01 12:00:00,500",1.5'


def test_a_missing_time():
    for form, last in (("csv", ",0.5"), ("ndjson", '{"time_s": null, "x_um": 0.5}')):
        output = Output()
        sink = open_sink(form, output)
        sink.open(("time_s", "x_um"))
        sink.write([(None, [0.5])])
        assert output.data.decode().splitlines()[-1] == last


def test_no_sink_gets_a_minus_zero(stream_into):
    """The setpoint is -1 times a deflection that is 0 at first."""
    lines = stream_into("csv", estimates=True).decode().split()
    assert "-0.0" not in {cell for line in lines for cell in line.split(",")}
    columns = table_of(stream_into("parquet", estimates=True)).values()
    assert "-0.0" not in {repr(value) for column in columns for value in column}


def table_of(data):
    return parquet.read_table(pyarrow.BufferReader(data)).to_pydict()


@pytest.mark.parametrize("row_group", [1, 3, 50_000])
def test_a_parquet_stream_is_a_whole_file_of_the_same_numbers(stream_into, monkeypatch, row_group):
    monkeypatch.setattr(parquet_module, "ROW_GROUP", row_group)
    table = table_of(stream_into("parquet", estimates=True))
    lines = stream_into("csv", estimates=True).decode().splitlines()
    assert list(table) == lines[0].split(",")
    rows = [[float(cell) for cell in line.split(",")] for line in lines[1:]]
    np.testing.assert_array_equal(np.column_stack(list(table.values())), rows)


def test_a_parquet_stream_of_a_header_only_is_whole(stream_into):
    table = table_of(stream_into("parquet", TEXT[: TEXT.index(b"\n") + 1]))
    assert table == {"time_s": [None], "offset_x_um": [0.0], "offset_y_um": [0.0]}


def test_a_parquet_stream_that_fails_is_whole_up_to_there(stream_into):
    with pytest.raises(LogError, match="no column"):
        stream_into("parquet", b"time_s,x\n0,1\n")
    assert table_of(stream_into.out)["offset_x_um"] == [0.0]


def test_a_parquet_stream_keeps_few_rows_in_memory(monkeypatch):
    monkeypatch.setattr(parquet_module, "ROW_GROUP", 10)
    output = Output()
    sink = open_sink("parquet", output)
    sink.open(("time_s", "x_um"))
    sizes = []
    for k in range(100):
        sink.write([(float(k), [0.5 * k])])
        assert len(sink._rows) < 10
        sizes.append(len(output.data))
    assert len(set(sizes)) == 11
    sink.close()
    assert table_of(output.data)["x_um"] == [0.5 * k for k in range(100)]
    assert parquet.ParquetFile(io.BytesIO(output.data)).num_row_groups == 10


def test_a_parquet_stream_to_a_full_disk():
    sink = open_sink("parquet", Output(room=100))
    sink.open(("time_s", "x_um"))
    sink.write([(float(k), [0.5]) for k in range(10)])
    with pytest.raises(OutputError, match="No space left"):
        sink.close()


def test_a_parquet_stream_whose_reader_has_left(model):
    source, inlet = os.pipe()
    outlet, out = os.pipe()
    os.write(inlet, TEXT)
    os.close(inlet)
    os.close(outlet)
    settings, messages = Settings(to_format="parquet"), Messages(lambda line: None)
    stream = open_stream(offsets(model, settings, messages), settings, source, out, messages)
    with pytest.raises(BrokenPipeError):
        stream.run()
    os.close(source)
    os.close(out)
