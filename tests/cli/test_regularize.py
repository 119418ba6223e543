"""``thermaltool regularize`` from outside."""

from __future__ import annotations

import json

import pytest

PINNED = ("--regularization", 0.01, 1e-4, 0.02, "--cutoff", 0.02, "--delay", 10)


def test_kalman_form(thermaltool, files):
    target = files.folder / "new.json"
    result = thermaltool(
        "regularize", files.model, "--noise", files.noise, "--form", "kalman", "-o", target
    )
    assert (result.code, result.out) == (0, "")
    lines = result.err.splitlines()
    assert lines[0].split()[:3] == ["form", "setting", "lag"]
    assert sum(" <" in line for line in lines) == 1
    assert lines[-1].startswith("chosen: kalman, walk_per_sqrt_s = ")
    design = json.loads(target.read_text())["design"]
    assert (design["form"], design["sensors"]) == ("kalman", ["dT_pair1_K"])
    assert design["sample_period_s"] == 10
    assert design["noise"] == [{"white_sigma": 0.01, "drift_sigma": 0.02, "drift_time_s": 900}]
    assert len(design["parameters_sha256"]) == 64


def test_json_reports_both_forms(thermaltool, files):
    target = files.folder / "new.json"
    result = thermaltool("regularize", files.model, "--noise", files.noise, *PINNED, "--walk",
                         0.02, "--json", "-o", target)  # fmt: skip
    assert {"chosen", "sample_period_s", "forms"} <= set(result.json)
    assert set(result.json["forms"]) == {"kalman", "kernel"}
    kernel = result.json["forms"]["kernel"]
    assert kernel["settings"] == {"A": 0.01, "B": 1e-4, "c": 0.02, "cutoff_Hz": 0.02, "delay_s": 10}
    band = {name: form["predicted"]["band"][0] for name, form in result.json["forms"].items()}
    assert result.json["chosen"] == min(band, key=band.get)
    assert json.loads(target.read_text())["design"]["form"] == result.json["chosen"]
    clash = thermaltool("regularize", files.model, "--noise", files.noise, "--json")
    assert clash.code == 2


def test_another_sample_period(thermaltool, files):
    result = thermaltool("regularize", files.model, "--noise", files.noise, "--form", "kalman",
                         "--walk", 0.05, "--dt", 2)  # fmt: skip
    design = json.loads(result.out)["design"]
    assert design["sample_period_s"] == 2
    assert design["walk_per_sqrt_s"] == [0.05]


def test_model_and_noise_in_a_pipe(thermaltool, files):
    arguments = ("--form", "kalman", "--walk", 0.02, "-q")
    expected = files.kalman.read_text()
    result = thermaltool("regularize", "-", "--noise", files.noise, *arguments,
                         stdin=files.model.read_text())  # fmt: skip
    assert (result.out, result.err) == (expected, "")
    result = thermaltool("regularize", files.model, "--noise", "-", *arguments,
                         stdin=files.noise.read_text())  # fmt: skip
    assert result.out == expected
    assert thermaltool("regularize", "-", "--noise", "-").code == 2


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ((-0.01, 1e-4, 0.02), "the regularized inverse is unstable"),
        ((0, 1e-4, 0.02), "A other than 0"),
        ((0.01, 1e-4, -0.02), "c above 0"),
        ((5.59e-3, 1e-4, 0.15), "the kernel rings: damping ratio 0."),
    ],
)
def test_unusable_regularizations(thermaltool, files, shape, message):
    target = files.folder / "old.json"
    target.write_text("old")
    result = thermaltool("regularize", files.model, "--noise", files.noise, "--form", "kernel",
                         "--regularization", *shape, "-o", target)  # fmt: skip
    assert result.code == 1
    assert message in result.err
    assert result.err.count("\n") == 1
    assert target.read_text() == "old"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not what thermaltool noise -o writes"),
        ("[]", "not what thermaltool noise -o writes"),
        ('{"format": "else", "channels": {}}', "'else' is not thermaltool-noise"),
        ('{"format": "thermaltool-noise", "version": 7, "channels": {}}', "version 7 is newer"),
        ('{"format": "thermaltool-noise", "channels": {}}', "no noise for the sensor dT_pair1_K"),
        ('{"format": "thermaltool-noise", "channels": []}', "not what thermaltool noise -o writes"),
        (
            '{"format": "thermaltool-noise", "channels": {"dT_pair1_K": {"white_sigma": "x"}}}',
            "not what thermaltool noise -o writes",
        ),
    ],
)
def test_noise_that_cannot_be_used(thermaltool, files, text, message):
    files.noise.write_text(text)
    result = thermaltool("regularize", files.model, "--noise", files.noise, "--form", "kalman")
    assert (result.code, result.out) == (1, "")
    assert message in result.err
    assert result.err.count("\n") == 1


def test_unknown_sensor(thermaltool, files):
    result = thermaltool("regularize", files.model, "--noise", files.noise, "--sensor", "dT_b_K")
    assert result.code == 1
    assert "no sensor dT_b_K in the model; there are: dT_pair1_K" in result.err
