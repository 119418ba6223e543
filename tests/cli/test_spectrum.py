"""spectrum: a transient in; lines, networks, a figure and a model out; bad logs in one line."""

from __future__ import annotations

import json

import numpy as np
import pytest
from machines.foster import Foster, logarithmic_clock, noisy, power_of

PLANT, STEP = Foster(np.array([0.02, 0.5, 20.0]), np.array([0.3, 0.8, 1.2])), {0.0: 4.0}
CALL = ("--input", "P_die_W", "--output", "T_die_degC")


def columns():
    time = logarithmic_clock(PLANT, 30)
    rise = noisy(np.random.default_rng(2), PLANT.rise(time, STEP))
    return {"time_s": time, "P_die_W": power_of(time, STEP), "T_die_degC": 25 + rise}


def write_log(path, table):
    np.savetxt(path, np.column_stack(list(table.values())), delimiter=",", fmt="%.12g",
               header=",".join(table), comments="")  # fmt: skip
    return path


@pytest.fixture(scope="module")
def done(tmp_path_factory, request):
    """One call with everything that it can write."""
    from click.testing import CliRunner

    from thermaltool.cli import group

    folder = tmp_path_factory.mktemp("spectrum")
    log = write_log(folder / "log.csv", columns())
    names = {name: folder / name for name in ("lines.csv", "model.json", "figure.png")}
    found = CliRunner().invoke(
        group, ["spectrum", str(log), *CALL, "-o", str(names["lines.csv"]), "--model",
                str(names["model.json"]), "--plot", str(names["figure.png"])],
        catch_exceptions=False,
    )  # fmt: skip
    return found, log, names


def test_the_table_names_lines_and_networks(done) -> None:
    found, _, _ = done
    assert found.exit_code == 0
    assert found.stderr == ""
    first, *rest = found.stdout.splitlines()
    assert first.startswith("T_die_degC by P_die_W: 3 lines, 2.")
    assert any(line.split()[:2] == ["Cauer", "C"] for line in rest)
    assert len([line for line in rest if " to " in line]) == 3


def test_the_csv_has_both_networks_in_si_units(done) -> None:
    _, _, names = done
    header, *rows = names["lines.csv"].read_text().splitlines()
    table = dict(zip(header.split(","), np.array([r.split(",") for r in rows], float).T,
                     strict=True))  # fmt: skip
    np.testing.assert_allclose(table["tau_s"], PLANT.taus, rtol=0.05)
    np.testing.assert_allclose(table["R_foster_K/W"], PLANT.resistances, rtol=0.05)
    np.testing.assert_allclose(table["C_foster_J/K"], PLANT.taus / PLANT.resistances, rtol=0.1)
    assert table["R_cauer_K/W"].sum() == pytest.approx(table["R_foster_K/W"].sum(), rel=1e-9)
    assert np.all(table["tau_low_s"] < PLANT.taus)
    assert np.all(table["tau_high_s"] > PLANT.taus)


def test_the_figure_is_one(done) -> None:
    _, _, names = done
    data = names["figure.png"].read_bytes()
    assert data.startswith(b"\x89PNG")
    assert len(data) > 20_000


def test_simulate_takes_the_model(thermaltool, done, tmp_path) -> None:
    _, log, names = done
    run = thermaltool("simulate", names["model.json"], log, "-o", tmp_path / "out.csv", "--json")
    assert run.code == 0
    assert "pause" not in run.err
    assert run.json["T_die_degC"]["rmse"] < 1.2e-3 * 4 * PLANT.resistances.sum()
    document = json.loads(names["model.json"].read_text())
    assert document["terms"][0]["kind"] == "rational3"


def test_json_holds_spectrum_intervals_and_structure_function(thermaltool, tmp_path) -> None:
    log, target = write_log(tmp_path / "log.csv", columns()), tmp_path / "all.json"
    run = thermaltool("spectrum", log, *CALL, "--json", "-o", target)
    assert run.code == 0
    assert json.loads(target.read_text()) == run.json
    assert len(run.json["lines"]) == 3
    for line, tau in zip(run.json["lines"], PLANT.taus, strict=True):
        low, high = line["time_constant_s"]["interval"]
        assert low < tau < high
    c = run.json["cumulative"]
    assert np.all(np.array(c["low"]) <= np.array(c["high"], float))
    resistance = run.json["structure_function"]["resistance_K_per_W"]
    assert resistance[-1] == pytest.approx(PLANT.resistances.sum(), rel=0.02)


@pytest.mark.slow
def test_eight_lines_are_one_term_of_a_model(thermaltool, tmp_path) -> None:
    plant = Foster(np.geomspace(1e-3, 1e4, 8), np.full(8, 0.5))
    time = logarithmic_clock(plant, 20)
    rise = noisy(np.random.default_rng(3), plant.rise(time, STEP))
    table = {"time_s": time, "P_die_W": power_of(time, STEP), "T_die_degC": rise}
    log = write_log(tmp_path / "log.csv", table)
    model = tmp_path / "model.json"
    assert thermaltool("spectrum", log, *CALL, "--model", model, "--lines", "8").code == 0
    assert json.loads(model.read_text())["terms"][0]["kind"] == "rational8"
    run = thermaltool("simulate", model, log, "-o", tmp_path / "out.csv", "--json")
    assert run.json["T_die_degC"]["rmse"] < 1.2e-3 * 4 * 4


def changed(**values):
    return {**columns(), **values}


T, N = columns()["time_s"], len(columns()["time_s"])
HALF = np.concatenate([T[: N // 2], T[N // 2 - 1 :][: N - N // 2]])
SPARSE = np.concatenate([np.linspace(-1, 0, 5), [1e-4, 2e-4, 3e-4], np.linspace(0.9, 80, 60)])


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (changed(P_die_W=np.full(N, 3.0)), "P_die_W: no step"),
        (changed(P_die_W=np.zeros(N)), "P_die_W: zero in every row"),
        (changed(T_die_degC=np.full(N, 20.0)), "T_die_degC: does not move"),
        (changed(T_die_degC=40 - columns()["T_die_degC"]), "does not rise with the power"),
        (changed(time_s=HALF), "time"),
        (changed(T_die_degC=np.where(T[9] == T, np.nan, 20.0)), "T_die_degC"),
        ({k: v[(T <= 0) | (T > 1)] for k, v in columns().items()}, "two decades"),
        ({k: v[T[27] > T] for k, v in columns().items()}, "rows behind the step"),
        ({"time_s": SPARSE, "P_die_W": power_of(SPARSE, STEP),
          "T_die_degC": PLANT.rise(SPARSE, STEP)}, "each decade takes 3 rows"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_one_line(thermaltool, tmp_path, table, message) -> None:
    log = write_log(tmp_path / "log.csv", table)
    run = thermaltool("spectrum", log, *CALL, "--model", tmp_path / "model.json")
    assert run.code == 1
    assert message in run.err
    assert len(run.err.splitlines()) == 1
    assert run.out == ""
    assert not (tmp_path / "model.json").exists()


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        (("--input", "T_die_degC", "--output", "T_die_degC"), "not a power"),
        (("--input", "P_die_W", "--output", "P_die_W"), "neither a temperature"),
        (("--input", "P_dye_W", "--output", "T_die_degC"), "near: P_die_W"),
    ],
)
def test_channels_of_another_kind(thermaltool, tmp_path, channels, message) -> None:
    run = thermaltool("spectrum", write_log(tmp_path / "log.csv", columns()), *channels)
    assert run.code == 1
    assert message in run.err


def test_a_step_before_the_first_row_is_named(thermaltool, tmp_path) -> None:
    behind = {k: v[T > 0] for k, v in columns().items()}
    log = write_log(tmp_path / "log.csv", behind)
    run = thermaltool("spectrum", log, *CALL, "--step-at", "0", "--json")
    assert run.code == 0
    assert len(run.json["lines"]) == 3
    assert run.json["resistance_K_per_W"] == pytest.approx(2.3, rel=0.01)
