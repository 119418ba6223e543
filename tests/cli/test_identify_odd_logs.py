"""identify on odd logs: one clear line, or a model; what stands in where a structure fails."""

from __future__ import annotations

import numpy as np
import pytest

CALL = ("--input", "Q_a_W", "--input", "Q_b_W", "--output", "d_z_um")
THREE = (*CALL, "--output", "dT_x_K", "--output", "d_y_um")
ROWS, PERIOD = 300, 10.0


def lag(u, tau, gain):
    a, x, found = np.exp(-PERIOD / tau), 0.0, []
    for value in u:
        found.append(x)
        x = a * x + (1 - a) * gain * value
    return np.array(found)


@pytest.fixture
def columns():
    rng = np.random.default_rng(91)
    a, b = (np.repeat(rng.uniform(0, 100, ROWS // n), n) for n in (4, 3))
    a[:4] = b[:3] = 0.0
    outputs = (lag(a, 900, 0.2) - lag(b, 200, 0.1), lag(a, 300, 0.1) + lag(b, 500, 0.05),
               lag(a, 400, 0.15) + lag(b, 900, 0.2))  # fmt: skip
    noisy = [y + 0.02 * rng.standard_normal(ROWS) for y in outputs]
    return {"time_s": PERIOD * np.arange(ROWS), "Q_a_W": a, "Q_b_W": b,
            **dict(zip(("d_z_um", "dT_x_K", "d_y_um"), noisy, strict=True))}  # fmt: skip


def written(path, columns, rows=slice(None)):
    values = [list(map(str, each[rows])) for each in columns.values()]
    lines = [",".join(columns), *map(",".join, zip(*values, strict=True))]
    path.write_text("\n".join(lines) + "\n")
    return path


def one_line(done):
    assert done.code == 1
    assert done.err.count("\n") == 1, done.err
    return done.err


@pytest.mark.parametrize(
    ("call", "changed", "said"),
    [
        (CALL[2:], {"Q_b_W": np.full(ROWS, 50.0)}, "Q_b_W does not excite: it never moves"),
        (CALL[2:], {"Q_b_W": np.full(ROWS, 1e15)}, "Q_b_W does not excite: it never moves"),
        (
            CALL,
            {"d_z_um": np.full(ROWS, 3.0)},
            "d_z_um is constant over the rows that are fitted",
        ),
        (CALL, {"d_z_um": np.full(ROWS, np.nan)}, "d_z_um: no reading at all"),
        (THREE, {"d_z_um": np.full(ROWS, np.nan)}, "d_z_um: no reading at all"),
        (CALL, {"d_z_um": np.full(ROWS, 1e200)}, "d_z_um: too large"),
        (THREE, {"d_z_um": np.full(ROWS, 1e200)}, "d_z_um: too large"),
    ],
)
def test_a_channel_that_says_nothing_is_named(thermaltool, tmp_path, columns, call, changed, said):
    log = written(tmp_path / "run.csv", {**columns, **changed})
    assert said in one_line(thermaltool("identify", log, *call))


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (2, "d_z_um: one reading is too few to tell a transfer function by"),
        (20, "Q_a_W does not excite: it never moves within the rows that are fitted"),
    ],
)
def test_what_is_told_of_few_rows_counts_those_that_are_fitted(
    thermaltool, tmp_path, columns, rows, said
):
    """Two rows are no constant output, nor is a step behind the split no step."""
    late = np.where(np.arange(ROWS) < 15, 0.0, 50.0)
    log = written(tmp_path / "run.csv", {**columns, "Q_a_W": late}, slice(rows))
    assert said in one_line(
        thermaltool("identify", log, *CALL[:2], *CALL[4:], "--split", 0.6, "--orders", "1,1,1")
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "options", "said"),
    [
        ({"Q_a_W": np.full(ROWS, 50.0)}, ("--structure", "subspace", "--modes", "1"),
         "Q_a_W never moves within the rows that are fitted: it is left out"),
        ({"Q_a_W": np.full(ROWS, 1e15)}, ("--orders", "1,1,1", "--orders", "2,2,1"),
         "Q_a_W never moves within the rows that are fitted: it is left out"),
        ({"dT_x_K": np.full(ROWS, 3.0)}, ("--structure", "subspace", "--modes", "1"),
         "dT_x_K is constant: it is left out"),
    ],
)  # fmt: skip
def test_what_never_moves_is_left_out(thermaltool, tmp_path, columns, changed, options, said):
    log = written(tmp_path / "run.csv", {**columns, **changed})
    done = thermaltool("identify", log, *THREE, *options, "--json")
    assert done.code == 0, done.err
    assert done.err.count(said) == 1
    (name,) = changed
    assert len(done.json["models"]) == 3 - (name == "dT_x_K")
    for model in done.json["models"]:
        assert name not in [model["output"], *(term["input"] for term in model["terms"])]


def test_readings_of_inputs_and_outputs_in_turn_have_no_row(thermaltool, tmp_path, columns):
    even = np.arange(ROWS) % 2 == 0
    changed = {name: np.where(even == (name[0] == "Q"), values, np.nan)
               for name, values in columns.items() if name != "time_s"}  # fmt: skip
    log = written(tmp_path / "run.csv", {**columns, **changed})
    log.write_text(log.read_text().replace("nan", ""))
    said = one_line(thermaltool("identify", log, *CALL, "--nan-policy", "omit"))
    assert "d_z_um: no reading at all in the rows that have all inputs" in said


@pytest.mark.parametrize("call", [CALL, THREE])
def test_inputs_that_are_the_same_are_named(thermaltool, tmp_path, columns, call):
    log = written(tmp_path / "run.csv", {**columns, "Q_b_W": columns["Q_a_W"]})
    said = one_line(thermaltool("identify", log, *call))
    assert "collinear inputs: Q_a_W, Q_b_W" in said


def test_names_and_cells_that_are_wrong_have_their_place(thermaltool, tmp_path, columns):
    log = written(tmp_path / "run.csv", columns)
    text = log.read_text()
    log.write_text(text.replace("Q_b_W", "Q_a_W", 1))
    assert "run.csv:1: Q_a_W: this name is there twice" in one_line(
        thermaltool("identify", log, *CALL)
    )
    log.write_text(text.replace("Q_a_W", "Q_a_kJ/h", 1))
    done = thermaltool("identify", log, "--input", "Q_a_kJ/h", "--output", "d_z_um")
    assert "Q_a_kJ/h: unknown unit 'kJ/h'" in one_line(done)
    lines = text.splitlines()
    lines[100] = lines[100].replace(lines[100].split(",")[1], "5O.0", 1)
    log.write_text("\n".join(lines) + "\n")
    assert "run.csv:101: Q_a_W: not a number: '5O.0'" in one_line(
        thermaltool("identify", log, *CALL)
    )


@pytest.mark.parametrize("call", [CALL, THREE])
def test_twelve_rows_are_too_few_for_every_structure(thermaltool, tmp_path, columns, call):
    log = written(tmp_path / "run.csv", columns, slice(10, 22))
    said = one_line(thermaltool("identify", log, *call))
    assert "fitted to 7 of 12 rows" in said
    assert said.count("d_z_um") == 1


@pytest.mark.slow
def test_what_stands_in_for_a_structure_that_does_not_fit_is_said(thermaltool, tmp_path, columns):
    log = written(tmp_path / "run.csv", columns, slice(16, 36))
    done = thermaltool("identify", log, *CALL)
    assert done.code == 0, done.err
    first = done.err.splitlines()[0]
    assert "do not carry orders" in first
    assert first.endswith("subspace stands in for oe with real poles")
    # A structure that is asked for is not replaced.
    assert "do not carry orders" in one_line(
        thermaltool("identify", log, *CALL, "--structure", "oe")
    )


def test_numbers_beyond_a_word_of_64_bits_and_an_output_that_is_its_input(
    thermaltool, tmp_path, columns
):
    huge = [str(int(value * 1e20) * 10**5) for value in columns["Q_a_W"]]
    log = written(tmp_path / "run.csv", {**columns, "Q_a_W": huge, "d_z_um": columns["Q_b_W"]})
    done = thermaltool("identify", log, *CALL, "--orders", "1,1,0", "--json")
    assert done.code == 0, done.err
    first, second = (term["gain"]["value"] for term in done.json["models"][0]["terms"])
    assert abs(first) < 1e-30
    assert second == pytest.approx(1.0, rel=1e-6)


def test_validation_knows_what_simulate_knows_of_a_pause(thermaltool, tmp_path):
    """A command changes in a pause: the outputs before the split say when, to both commands."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(0, 100, 8), 40)[:ROWS]
    u[:10] = 0.0
    y = 20 + lag(u, 300, 0.2) + 0.05 * rng.standard_normal(ROWS)
    kept = np.ones(ROWS, bool)
    kept[158:166] = False
    columns = {"time_s": PERIOD * np.arange(ROWS), "Q_a_W": u, "T_x_degC": y}
    log = written(tmp_path / "run.csv", columns, kept)
    model = tmp_path / "model.json"
    call = ("--input", "Q_a_W", "--output", "T_x_degC", "--orders", "1,1,1", "--split", 0.6)
    printed = thermaltool("identify", log, *call, "-o", model, "--json").json
    (own,) = printed["models"]
    (judged,) = own["validation"]["logs"]
    done = thermaltool("simulate", model, log, "--initial", judged["initial"], "--start",
                       judged["start_s"], "--json")  # fmt: skip
    assert "in this pause" in done.err
    assert done.json["T_x_degC"]["fit_percent"] == pytest.approx(judged["fit_percent"], abs=0.01)
