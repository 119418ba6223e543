"""identify --structure subspace: poles that swing, and an output that follows its input at once."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.signal import StateSpace, lsim

CALL = ("--input", "Q_a_W", "--input", "Q_b_W", "--output", "dT_tip_K", "--output", "d_z_um",
        "--structure", "subspace")  # fmt: skip
ROWS, PERIOD = 1600, 5.0


@pytest.fixture(scope="module")
def columns():
    """A lag of 100 s and a pair of 80 s for both; both outputs follow the first input at once."""
    rng = np.random.default_rng(71)
    u = np.repeat(rng.uniform(-1, 1, (2, ROWS // 20)), 20, axis=1)
    u[:, :20] = 0.0
    A = [[-0.01, 0, 0], [0, -0.0125, 0.06], [0, -0.06, -0.0125]]
    B, C = [[0.01, 0.02], [0.05, 0.0], [0.03, 0.06]], [[2.0, 1.0, -1.0], [4.0, -2.0, 3.0]]
    system = StateSpace(A, B, C, [[0.8, 0.0], [1.5, 0.0]])
    time = PERIOD * np.arange(ROWS)
    y = lsim(system, u.T, time, interp=False)[1].T + 0.02 * rng.standard_normal((2, ROWS))
    return {"time_s": time, "Q_a_W": u[0], "Q_b_W": u[1], "dT_tip_K": y[0], "d_z_um": y[1] + 7}


def write_log(path, columns):
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", fmt="%.10g",
               header=",".join(columns), comments="")  # fmt: skip
    return path


@pytest.fixture
def log(tmp_path, columns):
    return write_log(tmp_path / "run.csv", columns)


@pytest.mark.slow
def test_json_and_model_file(thermaltool, log, tmp_path):
    model = tmp_path / "model.json"
    done = thermaltool("identify", log, *CALL, "--split", "0.6", "-o", model, "--json")
    assert done.code == 0, done.err
    first, second = done.json["models"]
    assert first["shared_with"] == ["d_z_um"]
    assert first["orders"] == {"modes": 3, "feedthrough": True}
    assert first["time_constants_s"] == second["time_constants_s"]
    assert sorted(first["time_constants_s"]) == pytest.approx([80, 80, 100], rel=0.1)
    (swing,) = first["terms"][0]["oscillations"]
    assert swing["omega_rad_s"] == pytest.approx(np.hypot(0.06, 0.0125), rel=0.02)
    assert swing["zeta"] == pytest.approx(0.0125 / np.hypot(0.06, 0.0125), rel=0.05)
    assert first["delay_s"] == [0.0, 0.0]
    for each in (first, second):
        # Noise of 0.02 leaves so much of a free run.
        assert each["validation"]["fit_percent"] > 80
        assert set(each["units"]) == set(each["parameters"])
    assert first["parameters"]["K0[Q_a_W]"]["value"] == pytest.approx(0.8, abs=0.02)
    assert second["parameters"]["K0[Q_b_W]"]["value"] == pytest.approx(0.0, abs=0.02)
    assert first["units"]["K0[Q_a_W]"] == "K/W"
    assert first["units"]["omega"] == "rad/s"
    document = json.loads(model.read_text())
    assert {term["kind"] for term in document["terms"]} == {"oscillation1_direct"}
    done = thermaltool("simulate", model, log, "-o", tmp_path / "out.csv", "--json")
    assert min(each["fit_percent"] for each in done.json.values()) > 80


@pytest.mark.slow
def test_the_table_names_pair_and_feedthrough(thermaltool, log):
    done = thermaltool("identify", log, *CALL, "--modes", "3")
    assert done.code == 0, done.err
    assert "dT_tip_K, d_z_um: 3 shared modes and feedthrough by subspace identification" in done.out
    assert "pair: period 104." in done.out
    assert "weight K0" in done.out
    # One choice of poles each, with feedthrough for one combination of inputs or for all.
    assert "of 4 candidates the best first" in done.out


@pytest.mark.slow
def test_the_stream_gives_what_the_simulation_gives(thermaltool, log, columns, tmp_path):
    """Both inputs are measured: the set point compensates what the model says, row by row."""
    model, design, noise = (tmp_path / f"{n}.json" for n in ("model", "design", "noise"))
    done = thermaltool("identify", log, *CALL, "--modes", "3", "-o", model)
    assert done.code == 0, done.err
    assert thermaltool("noise", log, "-o", noise).code == 0
    measured = ("--measured", "Q_a_W", "--measured", "Q_b_W")
    done = thermaltool("regularize", model, "--noise", noise, *measured, "-o", design)
    assert done.code == 0, done.err
    estimate = tmp_path / "estimate.csv"
    assert thermaltool("estimate", design, log, "-o", estimate).code == 0
    table = np.genfromtxt(estimate, delimiter=",", names=True)
    left = columns["d_z_um"] - 7 - table["d_z_um"]
    assert np.std(left) < 0.1 * np.std(columns["d_z_um"])
    # An unknown input with feedthrough is refused in one line.
    done = thermaltool("regularize", model, "--noise", noise, "--measured", "Q_b_W")
    assert done.code == 1
    assert "Q_a_W → dT_tip_K has direct feedthrough" in done.err
    assert done.err.count("\n") == 1


@pytest.mark.parametrize(("extra", "message"), [
    (("--modes", "13"), "--modes"),
    (("--orders", "2,2,1"), "a subspace model takes --modes"),
    (("--delay", "5"), "--structure network"),
    (("--real-poles",), "of a subspace any"),
])  # fmt: skip
def test_usage(thermaltool, log, extra, message):
    done = thermaltool("identify", log, *CALL, *extra)
    assert done.code == 2
    assert message in done.err


@pytest.mark.slow
def test_too_few_rows_are_one_line(thermaltool, columns, tmp_path):
    short = {name: values[15:75] for name, values in columns.items()}
    log = write_log(tmp_path / "short.csv", short)
    done = thermaltool("identify", log, *CALL, "--modes", "9")
    assert done.code == 1
    assert "36 rows do not carry 9 modes with 28 parameters" in done.err
    assert done.err.count("\n") == 1
