"""Messages of one sensor each: rows by the rule of logs, whatever the order and whatever lacks."""

import json
import math
import os
import random
import threading

import numpy as np
import pytest

from thermaltool.errors import LogError
from thermaltool.estimation.batch import estimate
from thermaltool.estimation.pipeline import EstimatorPipeline
from thermaltool.logs import read_log
from thermaltool.logs.columns import read_map
from thermaltool.runtime.clocks import ArrivalClock, PeriodClock
from thermaltool.runtime.compensation import offsets
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.rows import merger_of
from thermaltool.runtime.rows.layout import Wanted
from thermaltool.runtime.rows.merger import Merger
from thermaltool.runtime.rows.ndjson_rows import NdjsonRows
from thermaltool.runtime.rows.row import Row
from thermaltool.runtime.settings import Settings
from thermaltool.runtime.stream import open_stream

MAP = """
duplicates = "{duplicates}"
{unmapped}
[messages]
name = "sensor"
value = "value"
[time]
column = "ts"
within = 0.2
[columns]
"pair 1" = "dT_pair1_K"
"far" = {{ name = "T_far_degC", offset = 20.0 }}
"""


@pytest.fixture
def column_map(tmp_path):
    def write(duplicates="first", unmapped='unmapped = "drop"'):
        path = tmp_path / f"{duplicates}.toml"
        path.write_text(MAP.format(duplicates=duplicates, unmapped=unmapped))
        return str(path)

    return write


def message(time, sensor, value):
    return json.dumps({"ts": round(time, 3), "sensor": sensor, "value": value}) + "\n"


def broker(rows=400, seed=None, lost=0.1, period=0.5):
    """Lines of a broker: two sensors that we read and one that we do not, in any order.

    After the first rows some are lost, and some are no number; some come twice.
    """
    draw = random.Random(seed)
    lines = []
    for k in range(rows):
        pair, far = 5 * -math.expm1(-k / 30), 3 * -math.expm1(-k / 90)
        parts = [("pair 1", pair), ("far", far), ("fan", 900.0)]
        draw.shuffle(parts)
        late = 0.0
        for name, value in parts:
            if k > 5 and draw.random() < lost:
                continue
            late += draw.uniform(0.0, 0.08)
            broken = k > 5 and draw.random() < 0.02
            lines.append(message(period * k + late, name, None if broken else value))
            if draw.random() < 0.05:
                lines.append(message(period * k + late, name, value + 0.01))
    return lines


@pytest.fixture
def stream(make_machine, make_kalman, column_map, tmp_path):
    """Runs a stream over lines; returns its answers as arrays by name."""

    def run(lines, duplicates="first", feed=None, **settings):
        model = make_machine(make_kalman(2))
        chosen = Settings(from_format="ndjson", to_format="ndjson", columns=column_map(duplicates),
                          estimates=True, status=True, safe=None, trust=True, period=0.5,
                          **settings)  # fmt: skip
        run.said = []
        messages = Messages(run.said.append)
        source, inlet = os.pipe()
        with (tmp_path / "out").open("w+b") as out:
            process = offsets(model, chosen, messages)
            made = open_stream(process, chosen, source, out.fileno(), messages)

            def write():
                with os.fdopen(inlet, "wb") as stream:
                    if feed is None:
                        stream.write("".join(lines).encode())
                    else:
                        feed(stream)

            feeder = threading.Thread(target=write)
            feeder.start()
            made.run()
            feeder.join()
            os.close(source)
            out.seek(0)
            # The last line is that of the end.
            return [json.loads(line) for line in out.read().decode().splitlines()[:-1]]

    run.said = []
    return run


@pytest.mark.parametrize("duplicates", ["first", "mean"])
def test_a_stream_of_messages_gives_the_estimates_of_the_log(
    stream, column_map, make_machine, make_kalman, tmp_path, duplicates
):
    lines = broker()
    answers = stream(lines, duplicates)
    path = tmp_path / "log.ndjson"
    path.write_text("".join(lines))
    log = read_log(path, columns=column_map(duplicates), nan_policy="hold",
                   need=["dT_pair1_K", "T_far_degC"])  # fmt: skip
    assert len(answers) == len(log)
    assert [each["time_s"] for each in answers] == log.time.tolist()
    model = make_machine(make_kalman(2))
    batch = estimate(model, EstimatorPipeline.of(model), log).estimates
    for name in ("Q_main_1", "d_x_um", "d_y_um"):
        ours = np.array([each[name] for each in answers])
        np.testing.assert_allclose(ours, batch[name], rtol=0, atol=1e-9 * abs(ours).max())
    assert {each["status"] for each in answers} >= {"held"}


@pytest.mark.slow
def test_a_restart_anywhere_goes_on_with_what_was_pending(stream, tmp_path):
    lines = broker(120)
    whole = stream(lines)
    for cut in random.Random().sample(range(20, len(lines) - 1), 6):
        kept = str(tmp_path / f"{cut}.json")
        parts = [stream(part, checkpoint=kept) for part in (lines[:cut], lines[cut:])]
        answers = [each for part in parts for each in part]
        # The last row of the whole leaves at its end; here it waits in the checkpoint.
        assert len(answers) >= len(whole) - 1
        for ours, theirs in zip(answers, whole, strict=False):
            assert {**ours, "status": ""} == {**theirs, "status": ""}


def test_a_silent_sensor_is_held_and_told_then_lost(stream):
    lines = [line for line in broker(200, lost=0.0) if '"far"' not in line or '"ts": 0.' in line]
    answers = stream(lines, hold=20.0)
    states = [each["status"] for each in answers]
    assert "held" in states
    assert states[-1] in ("safe", "reduced")
    assert any("T_far_degC: missing: holding" in line for line in stream.said)
    assert any("T_far_degC: missing: no good reading for" in line for line in stream.said)


def test_a_row_leaves_with_its_last_sensor_or_after_a_period(stream):
    """Nothing more comes after the second row, which lacks a sensor: the computer's clock acts."""
    answered = threading.Event()
    said = stream.said

    def feed(inlet):
        for time in (0.0, 0.5):
            inlet.write((message(time, "pair 1", 1.0) + message(time, "far", 1.0)).encode())
        inlet.write(message(1.0, "pair 1", 1.0).encode())
        inlet.flush()
        for _ in range(100):
            if any("missing" in line for line in stream.said):
                answered.set()
                return
            threading.Event().wait(0.05)

    answers = stream([], feed=feed)
    assert answered.is_set(), said
    assert [each["time_s"] for each in answers] == [0.0, 0.5, 1.0]


NAN = math.nan
FULL, LEFT, RIGHT = ("", ""), ("", "missing"), ("missing", "")


def test_rows_of_a_merger():
    merger = Merger(2, within=0.1)
    assert merger.take(Row(0.0, [1.0, NAN], LEFT)) == []
    assert merger.take(Row(0.05, [NAN, 2.0], RIGHT)) == [Row(0.0, [1.0, 2.0], FULL)]
    # What comes later of this time changes nothing.
    assert merger.take(Row(0.1, [7.0, NAN], LEFT)) == []
    assert merger.flush() == []
    assert merger.take(Row(1.0, [NAN, NAN], ("not a number: 'x'", "missing"))) == []
    (row,) = merger.take(Row(2.0, [3.0, NAN], LEFT))
    assert row.time == 1.0
    assert row.faults == ("not a number: 'x'", "missing")
    # A line without a time is another matter.
    assert merger.take(Row(None, [1.0, 2.0], FULL)) == [Row(None, [1.0, 2.0], FULL)]
    (row,) = merger.flush()
    assert row.time == 2.0
    assert row.readings[0] == 3.0


def test_a_stream_that_begins_amid_messages_starts_with_a_whole_row():
    merger = Merger(2)
    assert merger.take(Row(0.0, [NAN, 1.0], RIGHT)) == []
    assert merger.take(Row(1.0, [2.0, NAN], LEFT)) == []
    assert merger.take(Row(1.0, [NAN, 2.0], RIGHT)) == [Row(1.0, [2.0, 2.0], FULL)]
    # A sensor that is dead from the beginning does not keep the others waiting for ever.
    merger, first = Merger(2), []
    for k in range(12):
        first += [row.time for row in merger.take(Row(float(k), [2.0, NAN], LEFT))]
    assert first[0] == 5.0


def test_the_mean_waits_for_the_end_of_its_time():
    merger = Merger(1, within=0.1, mean=True)
    assert merger.take(Row(0.0, [1.0], ("",))) == merger.take(Row(0.1, [2.0], ("",))) == []
    assert merger.take(Row(1.0, [5.0], ("",))) == [Row(0.0, [1.5], ("",))]


@pytest.mark.parametrize("time", [-5.0, 100.0])
def test_what_was_kept_of_another_time_is_dropped(time):
    before = Merger(2)
    before.take(Row(3.0, [1.0, NAN], LEFT))
    after = Merger(2)
    after.resume(json.loads(json.dumps(before.state())))
    assert after.take(Row(time, [1.0, 2.0], FULL)) == [Row(time, [1.0, 2.0], FULL)]


@pytest.mark.parametrize("unmapped", ["", 'unmapped = "drop"'])
def test_messages_of_brokers(column_map, unmapped):
    mapping = read_map(column_map(unmapped=unmapped))
    rows = NdjsonRows(Wanted(("dT_pair1_K", "T_far_degC"), mapping))
    assert rows.open(b'{"ts": 1, "sensor": "fan", "value": 900}') is True
    row = rows.row(b'{"ts": 2, "sensor": "far", "value": "21.5"}')
    assert row.time == 2
    assert row.readings[1] == 41.5
    assert row.faults == ("missing", "")
    bad = rows.row(b'{"ts": 2, "sensor": "far", "value": "on"}')
    assert bad.faults[1] == "not a number: 'on'"


def test_messages_that_nothing_merges():
    with pytest.raises(LogError, match=r"no column T_a_degC.*take a map with \[messages\]"):
        NdjsonRows(Wanted(("T_a_degC",))).open(b'{"time_s": 1, "sensor": "T_a_degC", "value": 2}')


def test_messages_are_no_periods(column_map):
    wanted = Wanted(("dT_pair1_K",), read_map(column_map()), PeriodClock(0.5))
    assert not wanted.merges
    with pytest.raises(LogError, match="they need a clock"):
        NdjsonRows(wanted).open(b'{"ts": 1, "sensor": "far", "value": 900}')


def test_messages_without_a_clock_make_rows_by_when_they_arrive(tmp_path):
    path = tmp_path / "map.toml"
    messages = MAP.format(duplicates="first", unmapped='unmapped = "drop"').partition("[time]")[0]
    path.write_text(messages + '[columns]\n"pair 1" = "dT_pair1_K"\n"far" = "T_far_degC"\n')
    wanted = Wanted(("dT_pair1_K", "T_far_degC"), read_map(str(path)), ArrivalClock(1.0))
    merger = merger_of(wanted, 1.0)
    rows = []
    for second in range(4):
        rows += merger.take(Row(float(second), [1.0, NAN], LEFT))
        rows += merger.take(Row(second + 0.05, [NAN, 2.0], RIGHT))
    assert rows == [Row(float(second), [1.0, 2.0], FULL) for second in range(4)]
