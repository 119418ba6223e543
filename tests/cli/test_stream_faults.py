"""What was done to a stream as a process, and must not stop it or move its actuator."""

import json
import os
import pty
import re
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from thermaltool.documents import content_digest
from thermaltool.estimation.estimator import KalmanEstimator, SensorNoise
from thermaltool.estimation.plausible_change import plausible_changes
from thermaltool.model import Drive, Model, Output, Term, dumps
from thermaltool.responses.rational import Rational2

TOOL = [sys.executable, "-c", "from thermaltool.cli import main; main()", "compensate"]
PERIOD = 0.5
SENSORS = ("T_near_degC", "T_far_degC", "T_wall_degC")
TAUS = ((9.0, 120.0), (15.0, 160.0), (30.0, 200.0))
HEADER = b"time_s,T_near_degC,T_far_degC,T_wall_degC\n"
# Slew rate and step of the set points where nothing is said, over two sample periods.
MOST = 10.0 * 2 * PERIOD + 1.25 * 0.5


def document(sensors):
    names = SENSORS[:sensors]
    responses = [Rational2(1.8, quick, 4.2, slow) for quick, slow in TAUS[:sensors]]
    bend = Rational2(60.0, 40.0, 30.0, 300.0)
    machine = Model(
        (Drive("Q_main_W", "zero", 0.0, (0.0, 1.0)),),
        (
            *(Output(name, "sensor", 20.0, (0.0, 6.0)) for name in names),
            Output("d_z_um", "deflection", "first", (0.0, 90.0)),
        ),
        (
            *(Term("Q_main_W", *each) for each in zip(names, responses, strict=True)),
            Term("Q_main_W", "d_z_um", bend),
        ),
        PERIOD,
    )
    noise = (SensorNoise(0.02, 0.01, 600.0),) * sensors
    sensed = tuple((k, 0, each.modes(PERIOD)) for k, each in enumerate(responses))
    estimator = KalmanEstimator(
        names, ("Q_main_W",), ("d_z_um",), sensed, ((0, 0, bend.modes(PERIOD)),), (0.02,), noise
    )
    change = plausible_changes(machine, dict(zip(names, names, strict=True)), noise, PERIOD)
    return machine.with_design({**estimator.document(), "plausible_change": change})


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model.json"
    path.write_text(dumps(document(1)))
    return path


@pytest.fixture
def watched(tmp_path):
    """The same with three sensors, which watch each other."""
    path = tmp_path / "watched.json"
    path.write_text(dumps(document(3)))
    return path


def readings(rows, heat=1.0, seed=3):
    """Of a heat that is on, by steps of explicit Euler: shares no code with the model."""
    x, out = np.zeros((3, 2)), np.empty((rows, 3))
    for k in range(rows):
        x += PERIOD / np.array(TAUS) * (heat * np.array([1.8, 4.2]) - x)
        out[k] = 20 + x.sum(axis=1)
    return (out + np.random.default_rng(seed).normal(0, 0.02, out.shape)).round(3)


def text(values, start=0):
    """Lines of the first sensor, or of all."""
    return b"".join(
        b"%g,%s\n" % ((start + k) * PERIOD, b",".join(b"%.3f" % x for x in np.atleast_1d(row)))
        for k, row in enumerate(values)
    )


ONE = b"time_s,T_near_degC\n"


def default_signals():
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def start(*arguments, **kept):
    kept = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | kept
    command = [*TOOL, *map(str, arguments)]
    return subprocess.Popen(command, bufsize=0, preexec_fn=default_signals, **kept)


def run(*arguments, data=b"", **kept):
    process = start(*arguments, **kept)
    out, err = process.communicate(data, timeout=60)
    return process.returncode, (out or b"").decode().splitlines(), err.decode()


def setpoints(lines):
    return np.array([float(line.split(",")[1]) for line in lines])


def read_lines(process, count):
    data = b""
    while data.count(b"\n") < count:
        chunk = os.read(process.stdout.fileno(), 65536)
        assert chunk
        data += chunk
    return data.decode().splitlines()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pipe", "terminal"])
def test_a_stderr_that_nobody_reads_stops_nothing(model, kind):
    """Every line is bad and told; the pipe of the messages is full from the start."""
    reader, writer = os.pipe() if kind == "pipe" else pty.openpty()
    os.set_blocking(writer, False)
    try:
        while os.write(writer, b"x" * 1000):
            pass
    except BlockingIOError:
        os.set_blocking(writer, True)
    process = start(model, stderr=writer)
    values = readings(200)[:, 0]
    process.stdin.write(ONE + text(values[:1]))
    read_lines(process, 2)
    for k in range(1, 200):
        process.stdin.write(b"%g,%s\n" % (k * PERIOD, b"bad" if k % 2 else b"%.3f" % values[k]))
        assert len(read_lines(process, 1)) == 1
    process.send_signal(signal.SIGTERM)
    begin = time.monotonic()
    assert read_lines(process, 1)[-1].endswith(",0.0")
    assert time.monotonic() - begin < 1.0
    assert process.wait(5) == 128 + signal.SIGTERM
    for end in (reader, writer):
        os.close(end)
    process.stdin.close()
    process.stdout.close()


def test_a_state_of_another_record_is_not_gone_on_from(model, tmp_path):
    """A warm evening, then a cold morning whose clock begins anew."""
    state = tmp_path / "state.json"
    run(model, "--checkpoint", state, data=ONE + text(readings(800)[:, 0]))
    idle = ONE + text(readings(300, heat=0.0)[:, 0])
    _, kept, said = run(model, "--checkpoint", state, data=idle)
    _, fresh, _ = run(model, data=idle)
    assert np.max(np.abs(setpoints(kept[2:]) - setpoints(fresh[2:]))) <= 0.5
    assert "does not fit clock and readings: starts from rest" in said


@pytest.mark.slow
def test_an_old_state_is_told_and_left(model, tmp_path):
    state = tmp_path / "state.json"
    run(model, "--checkpoint", state, data=ONE + text(readings(100)[:, 0]))
    time.sleep(0.3)
    late = ONE + text(readings(101)[100:, 0], 100)
    _, _, said = run(model, "--checkpoint", state, "--checkpoint-max-age", "0.2", data=late)
    assert re.search(r"starts from rest: the kept state is [0-9.]+ s old \(--checkpoint-max", said)
    _, _, said = run(model, "--checkpoint", state, data=late)
    assert re.search(r"sha256 [0-9a-f]{12}\): starts from the state of [0-9.e-]+ s ago", said)


def test_one_stamp_ahead_changes_nothing(model):
    values = readings(400)[:, 0]
    whole = text(values)
    _, clean, _ = run(model, data=ONE + whole)
    lines = whole.splitlines(True)
    lines[200] = b"9" + lines[200]
    _, out, said = run(model, data=ONE + b"".join(lines))
    assert np.max(np.abs(setpoints(out[1:]) - setpoints(clean[1:]))) <= 1.0
    assert "line ignored" in said


@pytest.mark.parametrize("at", [3, 60, 150, 299])
def test_a_kill_in_a_ramp_leaves_no_step(model, tmp_path, at):
    """The last line that was written, not the last state that was kept, is where it goes on."""
    state, lines = tmp_path / "state.json", text(readings(600)[:, 0]).splitlines(True)
    process = start(model, "--checkpoint", state, "--checkpoint-every", "1000", "--slew", "0.5")
    process.stdin.write(ONE)
    read_lines(process, 1)
    last = ""
    for line in lines[:at]:
        process.stdin.write(line)
        last = read_lines(process, 1)[-1]
    process.kill()
    process.communicate()
    data = ONE + b"".join(lines[at:])
    _, out, _ = run(model, "--checkpoint", state, "--slew", "0.5", data=data)
    path = [float(last.split(",")[1]), *setpoints(out[1:-1])]
    assert np.max(np.abs(np.diff(path))) <= 0.5 * 2 * PERIOD + 1.25 * 0.5


def test_the_actuator_stands_where_the_user_says(model):
    values = text(readings(100, heat=0.0)[:, 0])
    _, out, _ = run(model, "--at", "-30", "--slew", "2", data=ONE + values)
    path = setpoints(out[1:-1])
    assert path[0] == -30.0
    assert np.max(np.abs(np.diff(path))) <= 2.0 * PERIOD + 0.5
    assert abs(path[-1]) <= 1.0
    code, _, said = run(model, "--at", "offset_x_um=3", data=ONE + values)
    assert (code, "no set point offset_x_um" in said) == (2, True)


def test_columns_in_another_order_are_found_by_their_header(watched):
    values = readings(400)
    lines = text(values).splitlines()
    order = (2, 0, 3, 1)
    turned = [b",".join(line.split(b",")[k] for k in order) for line in lines[200:]]
    names = HEADER.strip().split(b",")
    again = b",".join(names[k] for k in order)
    data = HEADER + b"\n".join([*lines[:200], again, *turned]) + b"\n"
    _, out, said = run(watched, data=data)
    _, clean, _ = run(watched, data=HEADER + text(values))
    assert out == clean
    assert "a header: columns found anew" in said
    broken = text(values).splitlines()
    broken.insert(200, b"time_s,T_near_degC,T_fra_degC,T_wall_degC")
    broken = HEADER + b"\n".join(broken) + b"\n"
    _, out, said = run(watched, data=broken)
    assert "no column T_far_degC" in said
    assert float(out[-5].split(",")[1]) == 0.0


def test_a_flipped_bit_in_a_model_is_refused_with_a_safe_line(model):
    content = model.read_text()
    place = re.search(r'"white_sigma": 0\.0(2)', content).start(1)
    model.write_text(content[:place] + "7" + content[place + 1 :])
    code, out, said = run(model, data=ONE + text(readings(50)[:, 0]))
    assert (code, out) == (1, ["time_s,offset_z_um", ",0.0"])
    assert "changed or damaged since it was written" in said


@pytest.mark.parametrize("content", ["", "{", '{"channel": "d_z_um", ', "[[[["])
def test_a_model_that_is_none_gets_what_can_be_said(model, content):
    model.write_text(content)
    code, out, said = run(model, data=ONE)
    assert (code, said.count("\n")) == (1, 1)
    assert out == (["time_s,offset_z_um", ",0.0"] if "d_z_um" in content else [])


def test_a_flipped_bit_in_a_checkpoint_takes_the_state_before(model, tmp_path):
    state = tmp_path / "state.json"
    lines = text(readings(200)[:, 0])
    run(model, "--checkpoint", state, data=ONE + lines)
    content = state.read_text()
    place = re.search(r'"estimator": \[-?\d+\.(\d)', content).start(1)
    flipped = chr(ord(content[place]) ^ 1)
    state.write_text(content[:place] + flipped + content[place + 1 :])
    code, _, said = run(model, "--checkpoint", state, data=ONE + text(readings(250)[200:, 0], 200))
    assert code == 0
    assert "changed or damaged since it was written (its checksum): the state before it" in said


def test_two_streams_on_one_checkpoint(model, tmp_path):
    state = tmp_path / "state.json"
    first = start(model, "--checkpoint", state)
    first.stdin.write(ONE + text(readings(2)[:, 0]))
    read_lines(first, 3)
    code, out, said = run(model, "--checkpoint", state, data=ONE)
    # The first one has the actuator.
    assert (code, out) == (1, ["time_s,offset_z_um"])
    assert "another stream runs on this checkpoint" in said
    first.stdin.write(text(readings(3)[2:, 0], 2))
    assert len(read_lines(first, 1)) == 1
    first.communicate()
    assert first.returncode == 0


def test_a_closed_stdout_ends_at_once(model):
    done = subprocess.run(
        ["sh", "-c", '"$@" >&-', "sh", *TOOL, str(model)],
        input=ONE, stderr=subprocess.PIPE, timeout=20, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr == b"thermaltool compensate: <stdout>: closed\n"


def test_a_closed_stdin_is_an_error_behind_a_safe_line(model):
    call = ["sh", "-c", '"$@" <&-', "sh", *TOOL, str(model)]
    done = subprocess.run(call, capture_output=True, timeout=20, check=False)
    assert (done.returncode, done.stdout) == (1, b"time_s,offset_z_um\n,0.0\n")
    assert done.stderr == b"thermaltool compensate: <stdin>: closed\n"


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGQUIT, signal.SIGALRM, signal.SIGUSR1, signal.SIGHUP])
def test_other_signals_end_with_the_safe_line_too(model, number):
    process = start(model)
    process.stdin.write(ONE + text(readings(50)[:, 0]))
    read_lines(process, 51)
    process.send_signal(number)
    assert read_lines(process, 1)[-1].endswith(",0.0")
    process.communicate()
    assert process.returncode == 128 + number


def test_a_frozen_sensor_stays_bad_over_a_restart(model, tmp_path):
    values, state = readings(700)[:, 0], tmp_path / "state.json"
    values[300:] = values[299]
    run(model, "--checkpoint", state, data=ONE + text(values[:500]))
    late = ONE + text(values[500:], 500)
    _, out, _ = run(model, "--checkpoint", state, "--also", "status", data=late)
    assert {line.rpartition(",")[2] for line in out[20:-1]} == {"safe"}


def test_a_kept_state_from_the_future_is_gone_on_from(model, tmp_path):
    """The clock of a board without a battery begins in the past."""
    state = tmp_path / "state.json"
    run(model, "--checkpoint", state, data=ONE + text(readings(100)[:, 0]))
    document = json.loads(state.read_text())
    document["written_s"] += 600.0
    del document["sha256"]
    state.write_text(json.dumps({**document, "sha256": content_digest(document)}))
    late = ONE + text(readings(140)[100:, 0], 100)
    _, out, said = run(model, "--checkpoint", state, "--also", "status", data=late)
    assert "line ignored" not in said
    assert {line.rpartition(",")[2] for line in out[2:-1]} == {"ok"}


@pytest.mark.slow
def test_where_the_actuator_stands_is_left_for_the_safe_setpoint_without_any_line(model):
    process = start(model, "--at", "-30", "--timeout", "0.2", "--slew", "20")
    process.stdin.write(ONE)
    lines = read_lines(process, 6)[1:]
    assert np.all(np.diff(setpoints(lines)) >= 0)
    assert setpoints(lines)[-1] > -30.0
    process.communicate()


def test_a_spike_behind_a_filter_is_left_as_it_came(model):
    values = readings(600)[:, 0]
    values[300:] += 6.0 * np.exp(-np.arange(300) * PERIOD / 5.0)
    _, out, _ = run(model, "--also", "status", data=ONE + text(values))
    words = [line.rpartition(",")[2] for line in out[1:]]
    assert words[301] == "held"
    assert set(words[420:-1]) == {"ok"}


@pytest.mark.slow
def test_a_sensor_that_others_confirm_counts_again(watched):
    """It went wrong slowly and came back at once: what jumped was right."""
    values = readings(1600)
    bad = values.copy()
    bad[400:700, 0] += np.minimum(np.linspace(0, 12, 300), 3.0)
    _, clean, _ = run(watched, data=HEADER + text(values))
    _, out, said = run(watched, "--also", "status", data=HEADER + text(bad))
    assert "which the machine cannot" in said
    assert out[-2].endswith(",ok")
    assert np.max(np.abs(setpoints(out[1201:-1]) - setpoints(clean[1201:-1]))) <= 2.0


@pytest.mark.slow
def test_a_sensor_that_was_lost_long_is_not_trusted_through_the_others(watched):
    """The filter without B has taken what A was held at: it does not stand in for B next."""
    values = readings(1200)
    values[200:700, 0] = np.nan
    values[705:, 1] = np.nan
    _, clean, _ = run(watched, data=HEADER + text(readings(1200)))
    _, out, _ = run(watched, "--also", "status", data=HEADER + text(values))
    error = np.abs(setpoints(out[1:-1]) - setpoints(clean[1:-1]))
    words = np.array([line.rpartition(",")[2] for line in out[1:-1]])
    assert np.max(error[words == "reduced"]) <= 6.0


def test_lines_with_other_fields_do_not_set_the_clock(model):
    values = text(readings(300)[:, 0])
    lines = values.splitlines(True)
    lines.insert(150, b"1e6,25,7\n")
    lines.insert(150, b"9000\n")
    _, out, _ = run(model, data=ONE + b"".join(lines))
    _, clean, _ = run(model, data=ONE + values)
    assert [line for k, line in enumerate(out) if k not in (151, 152)] == clean


@pytest.mark.slow
def test_lost_lines_of_a_stream_without_a_clock_are_counted(model):
    process = start(model, "--period", "0.1")
    process.stdin.write(b"T_near_degC\n")
    read_lines(process, 1)
    for k in range(30):
        if k not in (11, 12, 13):
            process.stdin.write(b"20.%d\n" % (k % 3))
            last = read_lines(process, 1)[-1]
        time.sleep(0.1)
    _, said = process.communicate()
    assert b"3 lines lost: counted, 0.1 s each" in said
    assert float(last.split(",")[0]) == pytest.approx(2.9)


@pytest.mark.slow
@pytest.mark.parametrize(("sensors", "change"), [(1, 6.0), (1, -5.0), (3, 6.0)])
def test_one_reading_that_jumps_is_not_used(model, watched, sensors, change):
    values = readings(500)[:, :sensors]
    spiked = values.copy()
    spiked[300, 0] += change
    names, path = (ONE, model) if sensors == 1 else (HEADER, watched)
    _, clean, _ = run(path, data=names + text(values))
    _, out, said = run(path, data=names + text(spiked))
    assert np.max(np.abs(setpoints(out[1:]) - setpoints(clean[1:]))) <= 1.0
    assert "which the machine cannot" in said


def test_a_sensor_that_steps_for_good_is_lost_and_alone_leads_to_the_safe_setpoint(model):
    values = readings(500)[:, 0]
    values[300:] += 5.0
    _, out, said = run(model, "--also", "status", data=ONE + text(values))
    words = [line.split(",")[2] for line in out[1:]]
    assert words[299] == "ok"
    assert words[305] == "held"
    assert set(words[330:]) == {"safe"}
    assert "safe setpoint" in said


@pytest.mark.slow
@pytest.mark.parametrize("what", ["steps", "is lost", "comes off", "was never there"])
def test_one_of_three_sensors_is_left_out_and_the_others_go_on(watched, what):
    values = readings(1200)
    bad = values.copy()
    if what == "steps":
        bad[400:, 1] += 5.0
    elif what == "is lost":
        bad[400:, 1] = np.nan
    elif what == "was never there":
        bad[:, 1] = np.nan
    else:
        bad[400:, 1] -= np.linspace(0, 5.0, 800)
    _, clean, _ = run(watched, data=HEADER + text(values))
    _, out, said = run(watched, "--also", "status", data=HEADER + text(bad))
    # One that comes off slowly bends the estimate until a tenth of its range shows.
    error = np.max(np.abs(setpoints(out[1:-1]) - setpoints(clean[1:-1])))
    assert error <= (12.0 if what == "comes off" else 6.0)
    assert out[-2].endswith(",reduced")
    assert "T_far_degC: left out" in said


@pytest.mark.slow
def test_what_is_left_out_stays_out_over_a_restart(watched, tmp_path):
    state, values = tmp_path / "state.json", readings(1600)
    bad = values.copy()
    bad[400:, 1] -= np.minimum(np.linspace(0, 6.0, 1200), 3.0)
    _, clean, _ = run(watched, data=HEADER + text(values))
    run(watched, "--checkpoint", state, data=HEADER + text(bad[:1400]))
    lines = text(bad).splitlines(True)
    options = ("--checkpoint", state, "--also", "status", "--slew", "1000")
    _, out, _ = run(watched, *options, data=HEADER + b"".join(lines[1400:]))
    assert {line.rpartition(",")[2] for line in out[3:-1]} == {"reduced"}
    assert np.max(np.abs(setpoints(out[3:-1]) - setpoints(clean[1403:-1]))) <= 6.0


def test_a_sensor_that_freezes_is_found_by_its_noise(model):
    values = readings(500)[:, 0]
    values[300:] = values[299]
    _, out, said = run(model, "--also", "status", data=ONE + text(values))
    assert "frozen at" in said
    assert out[-2].endswith(",safe")


def test_every_reading_counts_for_who_trusts_his_sensors(model):
    values = readings(300)[:, 0]
    values[200:] += 3.0
    _, out, said = run(model, "--trust-sensors", "--also", "status", data=ONE + text(values))
    assert out[-2].rpartition(",")[2] in ("ok", "extrapolates")
    assert "machine cannot" not in said


@pytest.mark.slow
def test_while_it_is_safe_each_tick_has_a_line(model):
    process = start(model, "--timeout", "0.2", "--also", "status")
    process.stdin.write(ONE + text(readings(20)[:, 0]))
    read_lines(process, 21)
    words = {line.split(",")[2] for line in read_lines(process, 3)}
    assert words == {"safe"}
    process.communicate()


@pytest.mark.slow
def test_the_audit_log_has_every_change_of_state(model, tmp_path):
    path = tmp_path / "audit.ndjson"
    os.mkfifo(tmp_path / "fifo")
    path.write_text('{"utc": "", "event": "before"}\n')
    values = readings(100)[:, 0]
    values[50] += 6.0
    run(model, "--audit", path, data=ONE + text(values))
    events = [json.loads(line) for line in path.read_text().splitlines()]
    assert [event["event"] for event in events][:2] == ["before", "start"]
    assert "sha256" in events[1]["of"]
    states = [event["status"] for event in events if event["event"] == "state"]
    assert states == ["ok", "held", "ok"]
    assert events[-1]["event"] == "end"
    assert events[-1]["setpoints"] == [0.0]
    for bad in (tmp_path / "no" / "audit", tmp_path / "fifo"):
        code, out, said = run(model, "--audit", bad, data=ONE)
        assert (code, out) == (1, ["time_s,offset_z_um", ",0.0"])
        assert f"{bad}: No such" in said
    before = model.read_bytes()
    _, _, said = run(model, "--audit", model, data=ONE)
    assert "model.json: not an audit log, nothing is appended to it" in said
    assert model.read_bytes() == before


def test_systemd_hears_that_it_lives(model, tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(20)
        environment = os.environ | {
            "NOTIFY_SOCKET": str(tmp_path / "notify"),
            "WATCHDOG_USEC": "200000",
        }
        process = start(model, env=environment)
        words = [systemd.recv(100) for _ in range(4)]
        assert words == [b"READY=1", *[b"WATCHDOG=1"] * 3]
        process.communicate(ONE)
        words = [systemd.recv(100)]
        while words[-1] == b"WATCHDOG=1":
            words.append(systemd.recv(100))
        assert words[-1] == b"STOPPING=1"
