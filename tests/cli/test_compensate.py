"""``thermaltool compensate`` as a process: start, ends, exit codes, and the shell pipe."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from thermaltool.estimation.estimator import KalmanEstimator, SensorNoise
from thermaltool.model import Drive, Model, Output, Term, dumps
from thermaltool.responses.conduction import Conduction
from thermaltool.responses.deflection import Deflection
from thermaltool.responses.modes import Modes

ROOT = Path(__file__).parents[2]
HEADER = b"time_s,dT_pair1_K\n"
TOOL = [sys.executable, "-c", "from thermaltool.cli import main; main()"]


@pytest.fixture
def model(tmp_path):
    """A model file with a conduction term, as calibrate writes it, and a small estimator."""
    y = Deflection(100.4, 9.1e-4, 142.0, 1.6e-3, -0.01, 0.009)
    pair = Modes(np.array([-0.03, -0.4], complex), np.array([0.15, 0.8], complex))
    estimator = KalmanEstimator(
        ("dT_pair1_K",),
        ("Q_main_1",),
        ("d_y_um",),
        ((0, 0, pair),),
        ((0, 0, y.modes(0.5)),),
        (0.02,),
        (SensorNoise(0.02, 0.03, 600.0),),
    )
    machine = Model(
        (Drive("Q_main_1", "zero", 0.0, (0.0, 1.0)),),
        (
            Output("dT_pair1_K", "sensor", 0.0, (0.0, 8.0)),
            Output("d_y_um", "deflection", "first", (0.0, 250.0)),
        ),
        (
            Term("Q_main_1", "dT_pair1_K", Conduction(3.5, 0.0157, 0.117, 5.12)),
            Term("Q_main_1", "d_y_um", y),
        ),
        0.5,
    )
    path = tmp_path / "model.json"
    path.write_text(dumps(machine.with_design(estimator.document())))
    return path


def rows(start, stop):
    return b"".join(b"%d,%.6f\n" % (k, 5 * -math.expm1(-k / 60)) for k in range(start, stop))


def default_signals():
    # A shell that runs the tests in the background ignores SIGINT, and that is inherited.
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def start(*arguments, **kept):
    kept = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | kept
    command = [*TOOL, "compensate", *map(str, arguments)]
    return subprocess.Popen(command, bufsize=0, preexec_fn=default_signals, **kept)


def run(*arguments, text=b"", **kept):
    process = start(*arguments, **kept)
    out, err = process.communicate(text)
    return process.returncode, (out or b"").decode(), without_start(err).decode()


def without_start(err):
    """Messages behind the one that says which model runs."""
    return b"".join(line for line in err.splitlines(True) if b": starts from " not in line)


def read_lines(process, count):
    data = b""
    while data.count(b"\n") < count:
        chunk = os.read(process.stdout.fileno(), 4096)
        assert chunk, process.stderr.read()
        data += chunk
    return data.decode().splitlines()


def test_end_of_input_is_safe_and_exits_with_0(model):
    code, out, err = run(model, "--slew", "1000", text=HEADER + rows(0, 60))
    lines = out.splitlines()
    assert (code, err) == (0, "")
    assert len(lines) == 62
    assert float(lines[-2].split(",")[1]) < -5
    assert float(lines[-2].split(",")[1]) % 0.5 == 0
    assert lines[-1] == "59.5,0.0"


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["INT", "TERM"]
)
def test_signals_end_safely_with_their_exit_codes(model, number, code):
    process = start(model)
    process.stdin.write(HEADER + rows(0, 100))
    assert len(read_lines(process, 101)) == 101
    process.send_signal(number)
    out, err = process.communicate()
    assert (process.returncode, out, without_start(err)) == (code, b"99.5,0.0\n", b"")


def test_closed_pipe_exits_with_141(model):
    process = start(model)
    process.stdout.close()
    process.stdin.write(HEADER)
    assert process.wait(30) == 141
    assert process.stderr.read() == b""
    process.stdin.close()
    process.stderr.close()


def test_full_disk(model):
    with open("/dev/full", "wb") as full:
        code, _, err = run(model, text=HEADER + rows(0, 5), stdout=full)
    assert code == 1
    assert err == "thermaltool compensate: <stdout>: No space left on device\n"


def test_numpy_alone(model, tmp_path):
    """Start-up and memory rest on this: whatever else is imported, these are not."""
    log = tmp_path / "log.csv"
    log.write_bytes(HEADER + rows(0, 20))
    code = (
        "import sys\n"
        "from thermaltool.cli import group\n"
        f"group(['compensate', {str(model)!r}, {str(log)!r}], standalone_mode=False)\n"
        "heavy = {'scipy', 'pandas', 'pyarrow', 'matplotlib', 'statsmodels', 'skfem'}\n"
        "print(sorted(heavy & {name.partition('.')[0] for name in sys.modules}), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.splitlines()[-1] == "[]"
    assert len(done.stdout.splitlines()) == 22


def checkpoint_time(path):
    return json.loads(path.read_text())["state"]["time_s"] if path.exists() else 0.0


@pytest.mark.slow
def test_kill_9_leaves_no_step(model, tmp_path):
    """The restarted stream goes on where the killed one was, up to one step of the quantizer."""
    _, whole, _ = run(model, text=HEADER + rows(0, 400))
    whole = [line.split(",") for line in whole.splitlines()[1:-1]]
    kept = ["--checkpoint", tmp_path / "state.json", "--checkpoint-every", "10"]
    killed = start(model, *kept)
    killed.stdin.write(HEADER)
    lines = read_lines(killed, 1)
    for k in range(205):
        killed.stdin.write(rows(k, k + 1))
        lines += read_lines(killed, 1)
        # The checkpoint is written beside the stream: on a busy disk let it keep up.
        patience = time.monotonic() + 20
        while k > 150 and checkpoint_time(tmp_path / "state.json") < k - 30:
            assert time.monotonic() < patience
            time.sleep(0.01)
    killed.kill()
    killed.communicate()
    assert 150 <= checkpoint_time(tmp_path / "state.json") <= 204
    _, rest, _ = run(model, *kept, text=HEADER + rows(205, 400))
    both = [line.split(",") for line in [*lines[1:], *rest.splitlines()[1:-1]]]
    assert [at for at, _ in both] == [at for at, _ in whole]
    setpoints, expected = (np.array([float(y) for _, y in part]) for part in (both, whole))
    assert np.max(np.abs(setpoints - expected)) <= 0.5
    assert np.max(np.abs(np.diff(setpoints))) <= 0.5 + np.max(np.abs(np.diff(expected)))


def damaged(document):
    document["design"]["predicted_lag_s"] = 7.0


def without_design(document):
    del document["design"]


def newer(document):
    document["version"] = 99


def other_parameters(document):
    document["terms"][1]["parameters"]["A"] = 1.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (without_design, "the model has no estimator yet: run thermaltool regularize"),
        (newer, "version 99 is newer than this thermaltool reads"),
        (damaged, "model.json: changed or damaged since it was written (its checksum): write it"),
        (other_parameters, "designed for other parameters: run thermaltool regularize again"),
    ],
)
def test_models_that_cannot_run(model, change, message):
    document = json.loads(model.read_text())
    change(document)
    model.write_text(json.dumps(document))
    code, out, err = run(model, text=HEADER + rows(0, 5))
    assert (code, out) == (1, "time_s,offset_y_um\n,0.0\n")
    assert message in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--limit", "5"], "'5' is not LOW:HIGH"),
        (["--limit", "5:1"], "'5:1' is not LOW:HIGH"),
        (
            ["--limit", "0.1:0.4", "--safe", "0.2"],
            "no multiple of the step 0.5 lies between 0.1 and 0.4",
        ),
        (["--range", "0:1"], "'0:1' is not CHANNEL=LOW:HIGH"),
        (["--safe", "nan"], "'nan' is not hold|zero|VALUE"),
        (["--safe", "7", "--limit", ":5"], "the safe setpoint 7 is outside the limits"),
        (["--slew", "0"], "is not above 0"),
        (["--template", "Z={offset_y_um}", "--no-header"], "lines of a template have none"),
        (["--template", "Z={offset_y_um}", "--to", "csv"], "a format: not with --to csv"),
    ],
)
def test_options_that_make_no_sense(model, arguments, message):
    code, out, err = run(model, *arguments, text=HEADER)
    assert (code, out) == (2, "")
    assert message in err


def test_options_reach_the_stream(model):
    arguments = ["--sign", "1", "--step", "0", "--to", "ndjson", "--also", "estimates"]
    arguments += ["--limit", ":2", "--safe", "hold", "--range", "dT_pair1_K=:4.5", "-q"]
    code, out, err = run(model, *arguments, text=HEADER + rows(0, 200))
    answers = [json.loads(line) for line in out.splitlines()]
    assert (code, err) == (0, "")
    assert list(answers[0]) == ["time_s", "offset_y_um", "Q_main_1", "d_y_um"]
    assert answers[20]["offset_y_um"] == pytest.approx(answers[20]["d_y_um"])
    assert answers[-1]["offset_y_um"] == 2.0


def test_the_shell_pipe(model, tmp_path):
    log = tmp_path / "log.csv"
    log.write_bytes(HEADER + rows(0, 60))
    tool = tmp_path / "thermaltool"
    tool.write_text(f'#!/bin/sh\nexec "{sys.executable}" -c "{TOOL[2]}" "$@"\n')
    tool.chmod(0o755)
    environment = os.environ | {
        "PATH": f"{tmp_path}:{os.environ['PATH']}",
        "MODEL": str(model),
        "SOURCE": f"cat {log}",
        "SINK": f"cat > {tmp_path / 'setpoints.csv'}",
        "CHECKPOINT": str(tmp_path / "state.json"),
    }
    subprocess.run([ROOT / "pipelines" / "compensate.sh"], env=environment, check=True)
    lines = (tmp_path / "setpoints.csv").read_text().splitlines()
    assert len(lines) == 62
    assert lines[-1] == "59.5,0.0"
    assert json.loads((tmp_path / "state.json").read_text())["state"]["time_s"] == 59.0


def test_a_warm_start_is_told_and_can_be_settled(model):
    warm = HEADER + rows(100, 110)
    _, cold, told = run(model, text=warm)
    assert "<stdin>:2: " in told
    assert "see --initial settled" in told
    _, settled, silence = run(model, "--initial", "settled", "--slew", "1000", text=warm)
    assert silence == ""
    assert float(cold.splitlines()[1].split(",")[1]) == 0
    assert float(settled.splitlines()[1].split(",")[1]) < -5


def test_json_lines(model):
    code, out, _ = run(model, "--json", text=HEADER + rows(0, 3))
    lines = [json.loads(line) for line in out.splitlines()]
    assert code == 0
    assert [line["time_s"] for line in lines] == [0.0, 1.0, 2.0, 2.5]


def test_bands_late_estimates_and_what_they_rest_on(thermaltool, files):
    run = ("compensate", files.kalman, files.log, "--timeout", 0)
    beside = ("--also", "estimates", "--also", "bands", "--also", "status", "--lag", 30)
    done = subprocess.run([*TOOL, *map(str, (*run, *beside))], capture_output=True, check=True)
    header, *lines = (line.split(",") for line in done.stdout.decode().splitlines())
    assert header == ["time_s", "offset_x_um", "Q_main_1", "d_x_um", "sigma_Q_main_1",
                      "sigma_d_x_um", "late_Q_main_1", "late_d_x_um", "alarm",
                      "status"]  # fmt: skip
    bands = thermaltool("estimate", files.kalman, files.log, "--bands", "--walk", "design", "-q")
    found = np.array([line.split(",")[1:] for line in bands.out.splitlines()[1:]], float)
    stream = np.array([line[2:6] for line in lines[:-1]], float)
    np.testing.assert_allclose(stream, found, rtol=1e-9, atol=1e-9)
    assert found[0, 2] > 5 * found[-1, 2]
    batch = thermaltool("estimate", files.kalman, files.log, "--lag", 30, "-q")
    whole = [line.split(",") for line in batch.out.splitlines()[1:]]
    for now, then in zip(lines[3:-1], whole, strict=False):
        assert [float(each) for each in now[6:8]] == [float(each) for each in then[1:]]
    # Said before the first line, and in each: one sensor contradicts nothing.
    said = b"%s: no alarm is possible where model and machine part" % str(files.log).encode()
    assert done.stderr.count(b"no alarm") == done.stderr.count(said) == 1
    assert {line[-2] for line in lines} == {"not possible"}
    assert {line[-1] for line in lines} <= {"ok", "safe", "extrapolates", "settles"}
    # What is written is a log like any other: its words are no channel.
    read = thermaltool("check", "-", stdin=done.stdout).err
    assert "status" not in read
    assert "alarm" not in read
    picture = files.log.parent / "s.png"
    drawn = thermaltool("plot", "-", "-o", picture, stdin=done.stdout)
    assert (drawn.code, drawn.err) == (0, "")


def test_a_kernel_has_no_late_estimates(thermaltool, files):
    kernel = thermaltool("compensate", files.kernel, files.log, "--lag", 30)
    assert kernel.code == 1
    assert "take the Kalman form" in kernel.err


def test_a_design_of_before_has_no_bands(model):
    run = [*TOOL, "compensate", str(model), "-", "--also", "bands"]
    done = subprocess.run(run, input=HEADER, capture_output=True, check=False)
    assert done.returncode == 1
    assert b"no standard errors: run regularize again" in done.stderr
