"""The loop on real pipes, in this process."""

import json
import math
import os
import signal
import threading
from dataclasses import replace
from itertools import pairwise

import pytest

from thermaltool.documents import content_digest
from thermaltool.errors import LogError, ModelError, OutputError
from thermaltool.runtime.compensation import offsets
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.pipe import LONGEST_LINE
from thermaltool.runtime.settings import Settings
from thermaltool.runtime.stream import open_stream

HEADER = b"time_s,dT_pair1_K\n"


def compensating(model, settings, source, sink, emit, name="<stdin>"):
    messages = Messages(emit, name)
    return open_stream(offsets(model, settings, messages), settings, source, sink, messages)


@pytest.fixture
def run(model):
    """Run a stream over `text`; returns (exit signal, lines out), messages in `run.said`."""

    def once(text: bytes, feed=None, machine=model, **settings):
        once.said = []
        source, inlet = os.pipe()
        outlet, sink = os.pipe()
        stream = compensating(machine, Settings(**settings), source, sink, once.said.append)
        if feed is None:
            os.write(inlet, text)
            os.close(inlet)
        else:

            def feeding() -> None:
                try:
                    feed(inlet, outlet)
                except BaseException:
                    # The stream would wait for the source for ever.
                    os.close(inlet)
                    raise

            feeder = threading.Thread(target=feeding)
            feeder.start()
        try:
            number = stream.run()
        finally:
            if feed is not None:
                feeder.join()
            os.close(sink)
            os.close(source)
            with os.fdopen(outlet, "rb") as result:
                once.out = result.read().decode().splitlines()
        return number, once.out

    return once


def test_one_line_in_one_line_out_and_the_safe_setpoint_last(run):
    text = b"\xef\xbb\xbf# log\n" + HEADER + b"0,0\n# comment\n\n0.5,1.25\r\n1.0,2.5\n"
    number, out = run(text)
    assert number == 0
    assert out[0] == "time_s,offset_x_um,offset_y_um"
    assert [line.split(",")[0] for line in out[1:]] == ["0.0", "0.5", "1.0", "1.5"]
    assert out[-1] == "1.5,0.0,0.0"
    assert float(out[-2].split(",")[2]) < 0


def test_ndjson_out_and_estimates(run):
    _, out = run(HEADER + b"0,0\n0.5,1.0\n", to_format="ndjson", estimates=True)
    rows = [json.loads(line) for line in out]
    assert list(rows[1]) == [
        "time_s",
        "offset_x_um",
        "offset_y_um",
        "Q_main_1",
        "d_x_um",
        "d_y_um",
    ]
    assert rows[1]["offset_y_um"] == -rows[1]["d_y_um"] < 0


def test_ndjson_in_equals_csv_in(run):
    _, plain = run(HEADER + b"0,0\n0.5,1.0\n1.0,x\n")
    lines = b'{"time_s":0,"dT_pair1_K":0}\n{"time_s":0.5,"dT_pair1_K":1.0}\n'
    _, same = run(lines + b'{"time_s":1.0,"dT_pair1_K":null}\n', from_format="ndjson")
    assert same == plain


def test_the_time_of_arrival_as_clock(run):
    seen = []

    def feed(inlet, outlet):
        os.write(inlet, b"dT_pair1_K\n1.0\n")
        seen.extend(read_lines(outlet, 2))
        threading.Event().wait(0.2)
        os.write(inlet, b"1.0\n")
        seen.extend(read_lines(outlet, 1))
        os.close(inlet)

    run(b"", feed, clock="arrival")
    times = [float(line.split(",")[0]) for line in seen[1:]]
    assert times[0] == 0.0
    assert 0.2 <= times[1] < 5.0


@pytest.mark.parametrize("safe", [0.0, 7.0])
def test_header_only_is_the_safe_setpoint(run, safe):
    assert run(HEADER, safe=safe)[1][1:] == [f",{safe},{safe}"]
    assert json.loads(run(HEADER, to_format="ndjson")[1][0])["time_s"] is None


@pytest.mark.parametrize("text", [b"", b"# only a comment\n", b"time_s,dT_pair1_K"])
def test_an_empty_stream_is_an_error_and_safe(run, text):
    with pytest.raises(LogError, match="<stdin>: empty"):
        run(text)
    assert run.out[-1] == ",0.0,0.0"


def test_a_header_that_lacks_a_sensor_names_line_and_near_columns(run):
    with pytest.raises(LogError, match=r"<stdin>:2: no column dT_pair1_K.*\(near: dT_pair2_K\)"):
        run(b"# log\ntime_s,dT_pair2_K\n0,0\n")
    assert run.out[-1] == ",0.0,0.0"


def test_foreign_names_by_a_map(run, tmp_path):
    path = tmp_path / "map.toml"
    path.write_text('[time]\ncolumn = "t"\nunit = "min"\n[columns]\nK1 = "dT_pair1_K"\n')
    _, out = run(b"t,K1\n0,0\n0.5,1.0\n", columns=str(path))
    _, same = run(HEADER + b"0,0\n30,1.0\n")
    assert out == same


def test_messages_name_line_and_channel(run):
    run(HEADER + b"0,0\n0.5,--\n1.0\n0.2,1\n1.5,1\n")
    assert run.said == [
        "<stdin>:3: dT_pair1_K: not a number: '--': holding 0.0",
        "<stdin>:4: 1 field instead of 2: ignored",
        "<stdin>:5: time 0.2 s after 0.5 s: line ignored",
        "<stdin>:6: dT_pair1_K: good again",
    ]


def test_a_last_line_of_a_pipe_without_its_end_is_not_used(run):
    """27.35 cut to 2 looks like a reading."""
    _, out = run(HEADER + b"0,0\n0.5,2")
    assert [line.split(",")[0] for line in out[1:]] == ["0.0", "0.5"]
    assert run.said == ["<stdin>:3: the last line has no end, it may be cut: not used"]


def test_a_last_line_of_a_file_needs_no_end(model, tmp_path):
    path, said = tmp_path / "log.csv", []
    path.write_bytes(HEADER + b"0,0\n0.5,1.25")
    with open(path, "rb") as source, open(tmp_path / "out.csv", "wb") as sink:
        compensating(model, Settings(), source.fileno(), sink.fileno(), said.append).run()
    out = (tmp_path / "out.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in out[1:]] == ["0.0", "0.5", "1.0"]
    assert said == []


def test_a_line_that_never_ends_does_not_fill_the_memory(run):
    def feed(inlet, outlet):
        with os.fdopen(inlet, "wb") as stream:
            stream.write(HEADER + b"0,0\n0.5," + b"7" * (3 * LONGEST_LINE) + b"\n1.0,1.0\n")

    _, out = run(b"", feed)
    assert out[-2].startswith("1.0,")
    assert len(out) < 10


def read_lines(descriptor, count):
    data = b""
    while data.count(b"\n") < count:
        data += os.read(descriptor, 4096)
    return data.decode().splitlines()


def test_each_answer_comes_while_the_source_waits(run):
    """No answer is kept back until more input comes."""
    seen = []

    def feed(inlet, outlet):
        os.write(inlet, HEADER)
        seen.extend(read_lines(outlet, 1))
        for k in range(5):
            os.write(inlet, b"%d,1.0\n" % k)
            seen.extend(read_lines(outlet, 1))
        os.close(inlet)

    run(b"", feed)
    assert [line.split(",")[0] for line in seen[1:]] == ["0.0", "1.0", "2.0", "3.0", "4.0"]


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_in_the_safe_setpoint(run, number):
    def feed(inlet, outlet):
        os.write(inlet, HEADER + b"0,0\n60,5.0\n60.5,5.0\n")
        read_lines(outlet, 4)
        signal.pthread_kill(threading.main_thread().ident, number)
        # The source stays open: only the signal ends the stream.
        assert read_lines(outlet, 1) == ["61.0,0.0,0.0"]
        os.close(inlet)

    handler = signal.getsignal(number)
    assert run(b"", feed)[0] == number
    assert signal.getsignal(number) is handler


def ramp_of(lines):
    return [[float(cell) for cell in line.split(",")] for line in lines]


@pytest.mark.parametrize("number", [0, signal.SIGTERM])
def test_the_end_goes_to_the_safe_setpoint_at_the_slew_rate(run, model, number):
    def feed(inlet, outlet):
        os.write(inlet, HEADER + b"0,0\n60,5.0\n120,5.0\n180,5.0\n")
        read_lines(outlet, 5)
        if number:
            signal.pthread_kill(threading.main_thread().ident, number)
            # The source stays open until the ramp has begun.
            read_lines(outlet, 1)
        os.close(inlet)

    quick = replace(model, sample_period=0.02)
    came, out = run(b"", feed, machine=quick, slew=50.0, max_gap=100.0, end="ramp")
    assert came == number
    ramp = ramp_of(out)
    assert len(ramp) > 5
    assert ramp[0][2] < -20
    for (t0, _, y0), (t1, _, y1) in pairwise(ramp):
        assert t1 > t0
        assert abs(y1 - y0) <= 50.0 * (t1 - t0) + 1e-9
    assert ramp[-1][1:] == [0.0, 0.0]
    assert "ends: to the safe setpoint at the slew rate" in run.said


def test_a_second_signal_ends_at_once(run, model):
    seen = []

    def feed(inlet, outlet):
        os.write(inlet, HEADER + b"0,0\n60,5.0\n120,5.0\n180,5.0\n")
        read_lines(outlet, 5)
        for _ in range(2):
            signal.pthread_kill(threading.main_thread().ident, signal.SIGTERM)
            seen.extend(read_lines(outlet, 1))
        os.close(inlet)

    quick = replace(model, sample_period=0.02)
    # At this rate the ramp would take minutes.
    _, out = run(b"", feed, machine=quick, slew=0.01, max_gap=1e5, end="ramp")
    lines = ramp_of([*seen, *out])
    assert lines[0][2] < -1
    assert lines[-1][1:] == [0.0, 0.0]
    assert len(lines) < 200


def test_the_last_setpoint_can_stay(run):
    number, out = run(HEADER + b"0,0\n0.5,1.25\n1.0,2.5\n", end="hold")
    assert number == 0
    assert out[-1].startswith("1.0,")
    assert float(out[-1].split(",")[2]) < 0


@pytest.mark.slow
def test_a_signal_ends_a_stream_whose_reader_sleeps_without_tearing_a_line(run):
    def feed(inlet, outlet):
        rows = b"".join(b"%d,1.0\n" % k for k in range(20000))
        os.set_blocking(inlet, False)
        os.write(inlet, HEADER)
        for at in range(0, len(rows), 4096):
            try:
                os.write(inlet, rows[at : at + 4096])
            except BlockingIOError:
                threading.Event().wait(0.02)
        signal.pthread_kill(threading.main_thread().ident, signal.SIGTERM)
        os.close(inlet)

    number, out = run(b"", feed, estimates=True)
    assert number == signal.SIGTERM
    assert all(len(line.split(",")) == 6 for line in out)


def test_silence_ends_in_the_safe_setpoint_and_resumes(run):
    seen = []

    def feed(inlet, outlet):
        os.write(inlet, HEADER + b"0,0\n1,5.0\n2,5.0\n")
        seen.extend(read_lines(outlet, 4))
        seen.extend(read_lines(outlet, 1))
        os.write(inlet, b"3,5.0\n")
        seen.extend(read_lines(outlet, 1))
        os.close(inlet)

    run(b"", feed, timeout=0.1, max_gap=100.0)
    time, *setpoints = map(float, seen[4].split(","))
    assert setpoints == [0.0, 0.0]
    assert 2.1 <= time < 3
    assert float(seen[5].split(",")[2]) < -0.1
    assert run.said == ["<stdin>:4: no usable line for 0.1 s: safe setpoint"]


def test_silence_is_slewed_line_by_line(run, model):
    seen = []

    def feed(inlet, outlet):
        os.write(inlet, HEADER + b"0,0\n60,5.0\n120,5.0\n180,5.0\n")
        while not seen or not seen[-1].endswith(",0.0,0.0") or len(seen) < 6:
            seen.extend(read_lines(outlet, 1))
        os.close(inlet)

    quick = replace(model, sample_period=0.02)
    run(b"", feed, machine=quick, timeout=0.1, slew=50.0, max_gap=100.0)
    ramp = [[float(cell) for cell in line.split(",")] for line in seen[4:]]
    assert len(ramp) > 5
    for (t0, _, y0), (t1, _, y1) in pairwise(ramp):
        assert abs(y1 - y0) <= 50.0 * (t1 - t0) + 1e-9
    assert len([line for line in run.said if "safe setpoint" in line]) == 1


def test_lines_without_a_usable_time_do_not_feed_the_watchdog(run):
    seen = []

    def feed(inlet, outlet):
        os.write(inlet, HEADER + b"0,0\n2,5.0\n")
        read_lines(outlet, 3)
        for _ in range(200):
            os.write(inlet, b"2,5.0\n")
            seen.extend(read_lines(outlet, 1))
            threading.Event().wait(0.005)
        os.close(inlet)

    run(b"", feed, timeout=0.1)
    assert not seen[0].endswith(",0.0,0.0")
    assert seen[-1].endswith(",0.0,0.0")


def test_a_full_disk_is_an_error(model):
    source, inlet = os.pipe()
    os.write(inlet, HEADER)
    sink = os.open("/dev/full", os.O_WRONLY)
    stream = compensating(model, Settings(), source, sink, print)
    with pytest.raises(OutputError, match="<stdout>: No space left"):
        stream.run()
    for descriptor in (source, inlet, sink):
        os.close(descriptor)


def test_a_reader_that_leaves_ends_the_stream_while_the_source_waits(model):
    source, inlet = os.pipe()
    outlet, sink = os.pipe()
    threading.Timer(0.1, os.close, (outlet,)).start()
    stream = compensating(model, Settings(), source, sink, print)
    with pytest.raises(BrokenPipeError):
        stream.run()
    for descriptor in (source, inlet, sink):
        os.close(descriptor)


def test_a_folder_as_source(model, tmp_path):
    source = os.open(tmp_path, os.O_RDONLY)
    outlet, sink = os.pipe()
    with pytest.raises(LogError, match="cannot be read"):
        compensating(model, Settings(), source, sink, print, str(tmp_path)).run()
    for descriptor in (source, outlet, sink):
        os.close(descriptor)


def rows(start, stop):
    return b"".join(b"%d,%.9f\n" % (k, 5 * -math.expm1(-k / 30)) for k in range(start, stop))


def test_a_restart_from_a_checkpoint_goes_on_without_a_step(run, tmp_path):
    path = str(tmp_path / "state.json")
    _, whole = run(HEADER + rows(0, 400), step=0.5)
    _, first = run(HEADER + rows(0, 200), step=0.5, checkpoint=path, safe=None)
    _, second = run(HEADER + rows(200, 400), step=0.5, checkpoint=path, safe=None)
    assert first[1:-1] + second[1:-1] == whole[1:-1]


def test_a_restart_after_a_safe_end_comes_back_at_the_slew_rate(run, tmp_path):
    path = str(tmp_path / "state.json")
    run(HEADER + rows(0, 400), checkpoint=path)
    _, out = run(HEADER + rows(400, 500), checkpoint=path, slew=3.0)
    path = [0.0, *(float(line.split(",")[2]) for line in out[1:-1])]
    moves = [abs(b - a) for a, b in pairwise(path)]
    assert max(moves) <= 3.0 + 1e-9
    assert path[-1] < -60


def sealed(change):
    """A change of the document behind which its checksum is right again."""

    def changed(text):
        document = json.loads(text)
        del document["sha256"]
        change(document)
        return json.dumps({**document, "sha256": content_digest(document)})

    return changed


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: "{}", "not a checkpoint .*; remove the file to start from rest"),
        (lambda d: d[: len(d) // 2], "json:1: not JSON: .* .not a checkpoint.; remove the file"),
        (lambda d: "\0\xff", "not JSON: .* .not a checkpoint.; remove the file"),
        (lambda d: d.replace('-checkpoint"', '-model"'), "-model. is not thermal"),
        (lambda d: d.replace('"version": 2', '"version": 3'), "version 3 is newer"),
        (lambda d: d.replace('"version": 2', '"versions": 2'), "no version of the format"),
        (lambda d: d.replace('"time_s": 19.0', '"time_s": 18.0'), "changed or damaged since"),
        (sealed(lambda d: d.update(states=d.pop("state"))), "json: 'state' is missing; remove"),
        (sealed(lambda d: d.update(design_sha256="0")), "of another model"),
        (sealed(lambda d: d["state"]["estimator"].append(0.0)), "damaged; remove the file"),
        (sealed(lambda d: d["state"].pop("time_s")), "damaged; remove the file"),
        (sealed(lambda d: d["state"].pop("clock")), "damaged; remove the file"),
    ],
)
def test_a_checkpoint_that_does_not_fit_is_an_error_that_names_the_mend(
    run, tmp_path, change, message
):
    path = tmp_path / "state.json"
    run(HEADER + rows(0, 20), checkpoint=str(path))
    (tmp_path / "state.json.previous").unlink()
    text = path.read_text()
    assert change(text) != text
    path.write_text(change(text))
    with pytest.raises(ModelError, match=message):
        run(HEADER + rows(20, 30), checkpoint=str(path))
    assert run.out == ["time_s,offset_x_um,offset_y_um", ",0.0,0.0"]
    assert path.read_text() == change(text)


def test_a_checkpoint_in_a_folder_that_is_missing(run, tmp_path):
    with pytest.raises(OutputError, match="the folder does not exist"):
        run(HEADER, checkpoint=str(tmp_path / "none" / "state.json"))


def test_a_checkpoint_that_cannot_be_written_does_not_stop_the_stream(run, tmp_path):
    """The state is written beside the stream: a busy machine may say only later that it failed."""
    path, last = tmp_path / "folder", 0

    def feed(inlet, outlet):
        nonlocal last
        os.write(inlet, HEADER + rows(0, 1))
        read_lines(outlet, 2)
        path.mkdir()
        while last < 39 or (last < 20_000 and not run.said):
            last += 1
            os.write(inlet, rows(last, last + 1))
            read_lines(outlet, 1)
        os.close(inlet)

    with pytest.raises(OutputError, match="folder"):
        run(b"", feed, checkpoint=str(path), checkpoint_every=1.0)
    assert any("checkpoint not written" in message for message in run.said)
    assert run.out == [f"{last}.5,0.0,0.0"]
