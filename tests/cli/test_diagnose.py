"""``thermaltool diagnose`` from outside; what it finds is the engine's, which is replaced here."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from reference.diagnosed import BED, DRIVE, MODEL, OUTPUT, SOURCE, diagnosed, measured

from thermaltool.logs import write_table
from thermaltool.model import dumps


def csv(signals, **changed):
    """A log as text."""
    columns = {"time_s": signals.time, **signals.columns, **changed}
    lines = [",".join(columns)]
    lines += [",".join(f"{v:.6g}" for v in row) for row in zip(*columns.values(), strict=True)]
    return "\n".join(lines).replace("nan", "") + "\n"


@dataclass
class Case:
    """A folder with a model and two logs, and what the engine was called with."""

    folder: Path
    model: Path
    log: Path
    other: Path
    calls: list
    limits: object = None


@pytest.fixture(scope="module")
def texts():
    return csv(measured(4)), csv(measured(5))


@pytest.fixture
def case(tmp_path, texts):
    found = Case(tmp_path, *(tmp_path / n for n in ("model.json", "run.csv", "other.csv")), [])
    found.model.write_text(dumps(MODEL))
    found.log.write_text(texts[0])
    found.other.write_text(texts[1])
    return found


@pytest.fixture
def answer(case):
    """``answer(causes=…, verdict=…)`` sets what the engine says."""
    # Not the monkeypatch fixture, which `thermaltool` undoes after every command.
    patch = pytest.MonkeyPatch()

    def set_to(**answers):
        def engine(model, logs, validate=(), progress=print, calibration=(), limits=None, *_):
            case.calls.append((model, logs, validate))
            case.limits = limits
            shown = answers.get("causes", 1), answers.get("verdict", "not adequate")
            spoiled = answers.get("spoiled")
            result = replace(diagnosed(logs, *shown), spoiled=spoiled)
            return replace(result, model=replace(model, effects=(SOURCE,) * len(result.causes)))

        patch.setattr("thermaltool.diagnosis.diagnose.diagnose", engine)

    set_to()
    yield set_to
    patch.undo()


def test_json_verdict_and_exit_code(thermaltool, case, answer):
    result = thermaltool("diagnose", case.model, case.log)
    assert result.code == 3
    assert result.json["causes"][0]["name"] == "second_source"
    assert result.json["logs"][0]["name"] == str(case.log)
    assert result.err.startswith(
        "The model is not adequate for run.csv: of the residual of d_z_um, "
    )
    assert "\nCauses tried, each alone\n" in result.err
    assert thermaltool("diagnose", case.model, case.log, "--json").out == result.out
    quiet = thermaltool("diagnose", case.model, case.log, "-q")
    assert (quiet.code, quiet.out, quiet.err) == (3, result.out, "")


def test_what_the_engine_is_given(thermaltool, case, answer):
    thermaltool("diagnose", case.model, case.log, "--validate", case.other)
    _, (log,), (unseen,) = case.calls[0]
    assert set(log.columns) == {DRIVE, BED, OUTPUT}
    assert log.digest != unseen.digest
    assert len(log.digest) == 64


def test_tolerance_and_limits(thermaltool, case, answer):
    options = ("--tolerance", "10um", "--limits", f"switch=30s,run=4h,fixed={BED}")
    result = thermaltool("diagnose", case.model, case.log, *options)
    assert result.json["tolerance"] == {OUTPUT: 10.0}
    assert result.json["causes"][0]["severity"][OUTPUT]["times_tolerance"] == 2.4
    assert "2.4 times the tolerance of 10 µm" in result.err
    assert (case.limits.switch, case.limits.run, case.limits.fixed) == (30.0, 14400.0, {BED})


@pytest.mark.parametrize(
    "options", [("--tolerance", "5W"), ("--tolerance", "a lot"), ("--limits", "run=long")]
)
def test_tolerances_and_limits_that_cannot_be(thermaltool, case, answer, options):
    result = thermaltool("diagnose", case.model, case.log, *options)
    assert (result.code, result.out, result.err.count("\n")) == (1, "", 1)
    assert result.err.startswith("thermaltool diagnose: ")
    assert case.calls == []


@pytest.mark.parametrize(
    ("verdict", "share", "code"),
    [
        ("adequate", None, 0),
        ("not adequate", None, 3),
        ("cannot judge", None, 4),
        ("adequate", 0.05, 3),
        ("not adequate", 0.9, 0),
        ("cannot judge", 1, 0),
    ],
)
def test_exit_code(thermaltool, case, answer, verdict, share, code):
    answer(causes=0, verdict=verdict)  # noise accounts for 0.9 where it is adequate, else 0.12
    limit = () if share is None else ("--fail-above", share)
    assert thermaltool("diagnose", case.model, case.log, "-q", *limit).code == code


def test_a_share_is_between_zero_and_one(thermaltool, case):
    assert thermaltool("diagnose", case.model, case.log, "--fail-above", 12).code == 2
    assert thermaltool("diagnose", case.model, case.log, "--fail-above", "nan").code == 2


def test_extended_model_runs_in_the_other_commands(thermaltool, case, answer):
    target = case.folder / "extended.json"
    thermaltool("diagnose", case.model, case.log, "-q", "-o", target)
    extended = json.loads(target.read_text())
    assert [effect["name"] for effect in extended["effects"]] == ["second_source"]
    assert extended["provenance"]["diagnosed"]["logs"][0]["name"] == str(case.log)

    def rmse(model):
        return thermaltool("simulate", model, case.log, "--json").json[OUTPUT]["rmse"]

    assert rmse(case.model) > 10
    assert rmse(target) < 1.5
    # The bed is an input now.
    lines = case.log.read_text().splitlines()
    without = "\n".join(",".join(line.split(",")[:2] + line.split(",")[3:]) for line in lines)
    result = thermaltool("simulate", target, stdin=without + "\n")
    assert (result.code, f"no column {BED}" in result.err) == (1, True)


def test_a_model_without_a_cause_is_written_too(thermaltool, case, answer):
    answer(causes=0, verdict="adequate")
    target = case.folder / "extended.json"
    assert thermaltool("diagnose", case.model, case.log, "-q", "-o", target).code == 0
    assert "effects" not in json.loads(target.read_text())


def test_a_model_that_spoils_a_log_is_not_written(thermaltool, case, answer):
    answer(spoiled="d_z_um in other.csv")
    target = case.folder / "extended.json"
    target.write_text("what was there")
    result = thermaltool("diagnose", case.model, case.log, "-o", target, "--fail-above", 1)
    assert result.code == 3
    assert target.read_text() == "what was there"
    assert "d_z_um in other.csv would be worse" in result.err


def test_a_log_of_the_calibration_is_kept(thermaltool, case, answer):
    document = json.loads(case.model.read_text())
    digest = hashlib.sha256(case.other.read_bytes()).hexdigest()
    document["provenance"] = {"logs": [{"name": str(case.other), "sha256": digest}]}
    case.model.write_text(json.dumps(document))
    assert thermaltool("diagnose", case.model, case.log, "-o", case.other).code == 2
    assert hashlib.sha256(case.other.read_bytes()).hexdigest() == digest


def test_report_with_its_figures(thermaltool, case, answer):
    target = case.folder / "why.md"
    thermaltool("diagnose", case.model, case.log, "-q", "--report", target)
    text = target.read_text()
    for name in ("why_d_z_um.png", "why_evidence.png"):
        assert f"(<{name}>)" in text
        assert (case.folder / name).read_bytes().startswith(b"\x89PNG")


def test_logs_from_a_pipe_and_in_other_formats(thermaltool, case, answer):
    by_pipe = thermaltool("diagnose", case.model, "-q", stdin=case.log.read_text())
    assert by_pipe.json["logs"][0]["name"] == "<stdin>"
    signals = measured(4)
    target = case.folder / "run.parquet"
    write_table({"time_s": signals.time, **signals.columns}, str(target), None)
    assert thermaltool("diagnose", case.model, target, "-q").code == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("MODEL LOG -o -", "give the extended model a file"),
        ("MODEL LOG --report -", "--report a file"),
        ("MODEL LOG -o LOG", "would replace the input"),
        ("MODEL LOG -o MODEL", "would replace the input"),
        ("MODEL LOG --validate OTHER -o OTHER", "would replace the input"),
        ("MODEL LOG --report LOG", "name it FILE.md"),
        ("MODEL LOG -o NEW --report NEW", "would replace"),
        ("MODEL - --validate -", "only one input can be -"),
        ("- -", "only one input can be -"),
    ],
)
def test_usage(thermaltool, case, answer, arguments, message):
    files = {"MODEL": case.model, "LOG": case.log, "OTHER": case.other, "NEW": case.folder / "n.md"}
    kept = {path: path.read_text() for path in files.values() if path.exists()}
    result = thermaltool("diagnose", *(files.get(word, word) for word in arguments.split()))
    assert (result.code, result.out) == (2, "")
    assert message in result.err
    assert case.calls == []
    assert {path: path.read_text() for path in files.values() if path.exists()} == kept


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s.replace(OUTPUT, "d_y_um", 1), "no output of the model is in the log: d_z_um"),
        (lambda s: s.replace(DRIVE, "Q_other_1", 1), f"no column {DRIVE}"),
        (lambda s: s.partition("\n")[0] + "\n", "no rows: nothing to judge the model by"),
        (lambda s: "", "empty"),
    ],
)
def test_logs_that_say_nothing(thermaltool, case, answer, change, message):
    case.log.write_text(change(case.log.read_text()))
    result = thermaltool("diagnose", case.model, case.log)
    assert (result.code, result.out) == (1, "")
    assert result.err.startswith(f"thermaltool diagnose: {case.log}:")
    assert message in result.err
    assert result.err.count("\n") == 1
    assert case.calls == []


def test_a_dead_output(thermaltool, case, answer):
    case.log.write_text(csv(measured(), **{OUTPUT: [float("nan")] * 2160}))
    result = thermaltool("diagnose", case.model, case.log)
    assert result.code == 1
    assert f"{case.log}: {OUTPUT}: no values" in result.err


def test_a_log_is_not_held_out_from_itself(thermaltool, case, answer):
    copy = case.folder / "copy.csv"
    copy.write_text(case.log.read_text())
    for arguments in ((copy,), ("--validate", copy)):
        result = thermaltool("diagnose", case.model, case.log, *arguments)
        assert result.code == 1
        assert f"{copy}: the same log as {case.log}" in result.err


def test_what_the_engine_refuses_is_one_line(thermaltool, case):
    few = "".join(csv(measured()).splitlines(keepends=True)[:8])
    result = thermaltool("diagnose", case.model, stdin=few)
    assert (result.code, result.out) == (1, "")
    assert result.err.startswith("thermaltool diagnose: ")
    assert "too few to judge a model by" in result.err
    assert result.err.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("few", "LOG FEW", "FEW: 7 rows: too few to judge a model by"),
        ("few", "LOG --validate FEW", "FEW: 7 rows: too few to judge a model by"),
        ("undriven", "LOG UNDRIVEN", f"no column {DRIVE}"),
        ("log", "LOG --limits switch=abc", "limits switch=abc: 'abc' is not a number"),
    ],
)
def test_an_error_is_told_alone(thermaltool, case, answer, name, arguments, message):
    """No remark on another log stands before what stops the command."""
    beyond = csv(
        measured(), **{DRIVE: 5 * measured().columns[DRIVE]}
    )  # extrapolates, and that is told
    case.log.write_text(beyond)
    files = {"LOG": case.log, name.upper(): case.log if name == "log" else case.folder / name}
    files[name.upper()].write_text(
        {
            "log": beyond,
            "few": "".join(beyond.splitlines(keepends=True)[:8]),
            "undriven": beyond.replace(DRIVE, "Q_other_1", 1),
        }[name]
    )
    told = thermaltool("diagnose", case.model, case.log)
    assert "the model extrapolates" in told.err
    case.calls.clear()
    found = thermaltool("diagnose", case.model, *(files.get(w, w) for w in arguments.split()))
    assert (found.code, found.out, case.calls) == (1, "", [])
    assert found.err.startswith("thermaltool diagnose: ")
    assert found.err.count("\n") == 1
    assert message.replace(name.upper(), str(files[name.upper()])) in found.err


def test_a_folder_takes_no_model(thermaltool, case, answer):
    """It is refused before any work is done."""
    found = thermaltool("diagnose", case.model, case.log, "-o", case.folder)
    assert (found.code, found.out, case.calls) == (1, "", [])
    assert found.err == f"thermaltool diagnose: {case.folder}: Is a directory\n"


def test_a_report_that_cannot_be_written(thermaltool, case, answer):
    target = case.folder / "absent" / "why.md"
    result = thermaltool("diagnose", case.model, case.log, "-q", "--report", target)
    assert (result.code, result.out) == (1, "")
    assert "No such file or directory" in result.err
