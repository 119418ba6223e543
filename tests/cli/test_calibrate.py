"""``thermaltool calibrate`` from outside."""

from __future__ import annotations

import json

import numpy as np
import pytest

ROLES = ("--drive", "Q_main_1", "--sensor", "dT_pair1_K", "--deflection", "d_x_um")
SENSOR = ROLES[:4]
QUICK = ("--starts", 1)
# No choice among kinds, where the fit is not what counts.
ONE_KIND = (*QUICK, "--response", "dT_pair1_K=conduction")


@pytest.mark.slow
def test_a_log_becomes_a_model(thermaltool, files):
    target = files.folder / "new.json"
    result = thermaltool("calibrate", files.log, *ROLES, "--starts", 2, "-o", target)
    assert (result.code, result.out) == (0, "")
    assert [line.split()[0] for line in result.err.splitlines()[:3]] == [
        "output",
        "dT_pair1_K",
        "d_x_um",
    ]
    document = json.loads(target.read_text())
    assert (document["format"], document["version"]) == ("thermaltool-model", 1)
    assert document["drives"] == [
        {"channel": "Q_main_1", "hold": "zero", "reference": 0.0, "range": [0.0, 1.0]}
    ]
    sensor, deflection = document["outputs"]
    assert (sensor["role"], deflection["role"]) == ("sensor", "deflection")
    assert sensor["fit"]["rmse"] == pytest.approx(0.01, rel=0.2)
    assert deflection["fit"]["rmse"] == pytest.approx(0.1, rel=0.2)
    assert deflection["offset"] == "first"
    assert document["provenance"]["logs"][0]["name"] == str(files.log)
    assert len(document["provenance"]["logs"][0]["sha256"]) == 64
    assert document["provenance"]["command"].startswith("thermaltool calibrate ")
    for term in document["terms"]:
        n = len(term["covariance_names"])
        assert np.array(term["covariance"]).shape == (n, n)
        assert set(term["covariance_names"]) <= set(term["parameters"])


@pytest.mark.slow
def test_stdin_to_stdout_and_again_the_same(thermaltool, files):
    arguments = ("calibrate", "-", *SENSOR, *ONE_KIND)
    result = thermaltool(*arguments, stdin=files.log.read_text())
    assert result.code == 0
    document = json.loads(result.out)
    assert document["provenance"]["logs"][0]["name"] == "<stdin>"
    assert json.dumps(document, sort_keys=True, indent=1) + "\n" == result.out
    assert thermaltool(*arguments, stdin=files.log.read_text()).out == result.out
    quiet = thermaltool(*arguments, "-q", stdin=files.log.read_text())
    assert quiet.err == ""


@pytest.mark.slow
def test_json(thermaltool, files):
    target = files.folder / "new.json"
    result = thermaltool("calibrate", files.log, *SENSOR, *QUICK, "--json", "-o", target)
    assert set(result.json) == {"outputs", "terms", "responses"}
    (response,) = result.json["responses"]
    assert response["gain"][1] < response["gain"][0] < response["gain"][2]
    assert response["gain_unit"] == "K"
    assert result.json["outputs"][0]["fit"]["candidates"]
    fit = result.json["outputs"][0]["fit"]
    assert {"rmse", "max_error", "fit_percent", "rows", "offsets", "unidentified"} <= set(fit)
    assert fit["rows"] == 240
    clash = thermaltool("calibrate", files.log, *SENSOR, "--json")
    assert (clash.code, clash.out) == (2, "")
    assert "-o" in clash.err


@pytest.mark.slow
def test_max_rmse(thermaltool, files):
    target = files.folder / "new.json"
    arguments = ("calibrate", files.log, *SENSOR, *ONE_KIND, "-o", target)
    assert thermaltool(*arguments, "--max-rmse", 0.05).code == 0
    target.unlink()
    assert thermaltool(*arguments, "--max-rmse", 0.001).code == 3
    assert target.exists()  # ran, but the check did not pass


@pytest.mark.slow
def test_several_logs_and_a_stretch(thermaltool, files):
    result = thermaltool("calibrate", files.log, files.log, *SENSOR, *QUICK, "--stop", 1200)
    document = json.loads(result.out)
    assert document["outputs"][0]["fit"]["rows"] == 2 * 121
    assert len(document["provenance"]["logs"]) == 2
    assert f"{files.log}: the same log again counts twice" in result.err


@pytest.mark.slow
def test_kind_and_fixed_radius(thermaltool, files):
    kind = ("--response", "dT_pair1_K=deflection")
    document = json.loads(thermaltool("calibrate", files.log, *SENSOR, *QUICK, *kind).out)
    assert document["terms"][0]["kind"] == "deflection"
    document = json.loads(
        thermaltool("calibrate", files.log, *SENSOR, *QUICK, "--fix", "r0=0.2").out
    )
    assert document["terms"][0]["parameters"]["r0"] == 0.2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--fix", "r1=0.2"), "cannot fix r1: only delay, r0 can be fixed"),
        (("--fix", "r0=-1"), "cannot fix r0 = -1"),
        (("--response", "dT_pair1_K=radiation"), "unknown response 'radiation'; known: conduction"),
        (("--response", "d_y_um=deflection"), "d_y_um, which is no output of the fit"),
        (("--deflection", "Q_main_1"), "Q_main_1 is named twice: a channel has one role"),
        (("--deflection", "d_xx_um"), "no column d_xx_um (near: d_x_um"),
        (("--start", 5000), "no row from"),
        (("--start", 500, "--stop", 505), "1 row"),
        (("--stop", 90), "Q_main_1 never leaves its reference"),
        (("--start", 200, "--stop", 230), "dT_pair1_K: 4 rows for 5 parameters: too few"),
    ],
)
def test_refusals(thermaltool, files, options, message):
    target = files.folder / "old.json"
    target.write_text("old")
    result = thermaltool("calibrate", files.log, *SENSOR, *QUICK, *options, "-o", target)
    assert (result.code, result.out) == (1, "")
    assert result.err.startswith("thermaltool calibrate: ")
    assert result.err.count("\n") == 1
    assert message in result.err
    assert target.read_text() == "old"


@pytest.mark.parametrize(
    "options",
    [("--fix", "r0"), ("--fix", "r0=x"), ("--response", "deflection"), ("--reference", "x")],
)
def test_usage(thermaltool, files, options):
    assert thermaltool("calibrate", files.log, *SENSOR, *options).code == 2
    assert thermaltool("calibrate", files.log, "--sensor", "dT_pair1_K").code == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "<stdin>: the file is empty"),
        ("time_s,Q_main_1,dT_pair1_K\n", "<stdin>: 0 rows"),
        ("time_s,Q_main_1,dT_pair1_K\n0,1,0\n", "<stdin>: 1 row"),
    ],
)
def test_logs_without_content(thermaltool, text, message):
    result = thermaltool("calibrate", "-", *SENSOR, *QUICK, stdin=text)
    assert (result.code, result.out) == (1, "")
    assert message in result.err
    assert result.err.count("\n") == 1


def holed(text):
    lines = text.splitlines()
    for k in (30, 31, 77):
        cells = lines[k].split(",")
        cells[2] = ""
        lines[k] = ",".join(cells)
    return "\n".join(lines) + "\n"


@pytest.mark.slow
def test_missing_values(thermaltool, files):
    text = holed(files.log.read_text())
    arguments = ("calibrate", "-", *SENSOR, *ONE_KIND)
    result = thermaltool(*arguments, stdin=text)
    assert result.code == 1
    assert "<stdin>:31: dT_pair1_K: missing value (3 in all): see --nan-policy" in result.err
    rows = {
        policy: json.loads(thermaltool(*arguments, "--nan-policy", policy, stdin=text).out)[
            "outputs"
        ][0]["fit"]["rows"]
        for policy in ("omit", "hold")
    }
    assert rows == {"omit": 237, "hold": 240}


@pytest.mark.slow
def test_a_pause_is_told(thermaltool, files):
    lines = files.log.read_text().splitlines()
    text = "\n".join(lines[:100] + lines[140:]) + "\n"
    result = thermaltool("calibrate", "-", *SENSOR, *QUICK, stdin=text)
    assert result.code == 0
    assert "<stdin>:101: a pause of " in result.err


def test_a_missing_folder(thermaltool, files):
    target = files.folder / "absent" / "model.json"
    result = thermaltool("calibrate", files.log, *SENSOR, *QUICK, "-o", target)
    assert result.code == 1
    assert result.err.splitlines()[-1].endswith(f"{target}: No such file or directory")


@pytest.mark.parametrize("value", ["nan", "inf", "abc"])
def test_numbers_that_are_none_are_usage_errors(thermaltool, files, value):
    for option in (("--reference", value), ("--fix", f"r0={value}")):
        result = thermaltool("calibrate", files.log, *SENSOR, *QUICK, *option)
        assert result.code == 2
        assert f"not a {'number' if value == 'abc' else 'finite number'}: '{value}'" in result.err


def test_the_log_is_not_replaced_by_what_is_made_of_it(thermaltool, files):
    before = files.log.read_text()
    result = thermaltool("calibrate", files.log, *SENSOR, *QUICK, "-o", files.log)
    assert result.code == 2
    assert "would replace the input" in result.err
    assert files.log.read_text() == before
