"""identify: what its JSON, its table and its model file say, and what it refuses to say."""

from __future__ import annotations

import json
import re
import shlex

import numpy as np
import pytest
from scipy.signal import lfilter

from thermaltool.report.transfer import estimate_document, with_interval
from thermaltool.signals.intervals import Estimate

STRUCTURES = [(), ("--structure", "bj"), ("--structure", "arx"), ("--structure", "armax"),
              ("--continuous",), ("--structure", "network", "--modes", "1")]  # fmt: skip
ONE = ("--input", "Q_a_W", "--output", "d_z_um")


def write_log(path, columns):
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", fmt="%.10g",
               header=",".join(columns), comments="")  # fmt: skip
    return path


def run_of(poles, rows=1000, dt=10.0, gain=0.01):
    """A held power through Π(1 − pole/z), from rest."""
    rng = np.random.default_rng(1)
    power = np.repeat(rng.uniform(0, 2, rows // 20), 20)
    y = lfilter([0, gain], np.poly(poles).real, power) + 1e-3 * rng.standard_normal(rows)
    return {"time_s": dt * np.arange(rows), "Q_a_W": power, "d_z_um": y}


@pytest.fixture
def lag(tmp_path):
    return write_log(tmp_path / "lag.csv", run_of([np.exp(-10 / 300)]))


def orders(structure, given="1,1,1"):
    return () if "network" in structure else ("--orders", given)


@pytest.mark.parametrize(
    "structure",
    [(), pytest.param(("--structure", "network", "--modes", "1"), marks=pytest.mark.slow)],
)
def test_the_range_goes_on_over_a_gap(thermaltool, tmp_path, structure):
    """Two logs with zeros of their own, each with a pause: all counts from the first row of each.

    A power in front of the temperature moves its lag, so that the output has another course.
    """
    time = np.r_[0:100.0, 200:300.0]
    logs, warm, moved = [], [], []
    for k, rate in enumerate((1.0, 0.8)):
        every = np.arange(300.0)
        rise = rate * 19.8 * every / 299 + 0.5 * np.sin(every / 7) * (every > 0)
        y = lfilter([0.05], [1, -0.95], rise)
        kept = time.astype(int)
        logs.append(write_log(tmp_path / f"{k}.csv", {
            "time_s": time, "T_in_degC": 20 + 5 * k + rise[kept], "d_z_um": 30 * k + y[kept],
        }))  # fmt: skip
        warm.append(rise[kept])
        moved.append(y[kept])
    model = tmp_path / "model.json"
    done = thermaltool("identify", *logs, "--input", "T_in_degC", "--output", "d_z_um", *structure,
                       *orders(structure, "1,1,0"), "-o", model)  # fmt: skip
    assert done.code == 0, done.err
    document = json.loads(model.read_text())
    for place, values in (("drives", warm), ("outputs", moved)):
        (each,) = document[place]
        joined = np.concatenate(values)
        assert each["range"] == pytest.approx([joined.min(), joined.max()], abs=1e-6)


@pytest.mark.parametrize("structure", [("--structure", "arx"), ("--structure", "armax")])
def test_a_pole_that_grows_is_named(thermaltool, tmp_path, structure):
    log = write_log(tmp_path / "grows.csv", run_of([1.003]))
    call = ("identify", log, *ONE, *structure, "--orders", "1,1,1")
    done = thermaltool(*call)
    assert done.code == 0, done.err
    assert "|z| = 1.003" in done.out
    assert "pole at z = 1.003 does not settle" in done.err
    assert thermaltool(*call, "--json").json["models"][0]["terms"][0]["continuous"] is None
    model = tmp_path / "model.json"
    done = thermaltool(*call, "-o", model)
    assert done.code == 1
    assert "pole at z = 1.003" in done.err
    assert done.err.count("\n") == 1
    assert not model.exists()


@pytest.mark.parametrize("structure", STRUCTURES)
def test_an_integrator_is_told(thermaltool, tmp_path, structure):
    log = write_log(tmp_path / "sum.csv", run_of([1.0]))
    done = thermaltool("identify", log, *ONE, *structure, *orders(structure))
    assert done.code == 0, done.err
    assert done.err.count("look unstable or integrating") == 1
    assert "longer than the record" not in done.err
    assert not re.search(r"inf|e[+-]\d{3}", done.out)


def test_a_slow_lag_is_no_integrator(thermaltool, tmp_path):
    """Three times the record: it is told as that."""
    log = write_log(tmp_path / "slow.csv", run_of([np.exp(-1 / 3000)]))
    done = thermaltool("identify", log, *ONE, "--orders", "1,1,1")
    assert "longer than the record" in done.err
    assert "integrating" not in done.err


@pytest.mark.parametrize(("low", "high", "identified"), [
    (9.86e-298, np.inf, False),
    (1.0, 1.1e6, False),
    (1.0, 0.9e6, True),
    (-3.0, 9.0, True),
    (-1.8e12, 1.8e12, False),
    (-6e6, 6e6, True),
])  # fmt: skip
def test_an_interval_without_bounds_is_not_identified(low, high, identified):
    e = Estimate(7.0, low, high)
    assert estimate_document(e) == {"value": 7.0, "interval": [low, high] if identified else None}
    assert ("not identified" in with_interval(e)) != identified


def test_a_pair_is_told_as_one(thermaltool, tmp_path):
    """Envelope of 2000 s, period of 1500 s, and a lag of 200 s."""
    s = complex(-1 / 2000, 2 * np.pi / 1500)
    z = np.exp(10 * s)
    log = write_log(tmp_path / "swing.csv", run_of([z, z.conjugate(), np.exp(-10 / 200)]))
    done = thermaltool("identify", log, *ONE, "--orders", "2,3,1")
    assert done.code == 0, done.err
    (line,) = re.findall(r"pair: period (\S+) s, damping (\S+)", done.out)
    assert float(line[0]) == pytest.approx(1500, rel=0.01)
    assert float(line[1]) == pytest.approx(-s.real / abs(s), rel=0.02)
    envelope, _ = (re.findall(r"\s(\d\S*) \(\S+ to \S+\)", row)[-1:] for row in (
        row for row in done.out.splitlines() if " to " in row))  # fmt: skip
    assert float(envelope[0]) == pytest.approx(2000, rel=0.02)
    (model,) = thermaltool("identify", log, *ONE, "--orders", "2,3,1", "--json").json["models"]
    assert model["time_constants_s"] == pytest.approx([2000, 2000, 200], rel=0.05)
    (swing,) = model["terms"][0]["oscillations"]
    assert swing["omega_rad_s"] == pytest.approx(abs(s), rel=0.01)
    assert swing["zeta"] == pytest.approx(-s.real / abs(s), rel=0.02)


def test_real_poles_are_no_oscillation(thermaltool, lag):
    done = thermaltool("identify", lag, *ONE, "--orders", "1,1,1", "--json")
    assert done.json["models"][0]["terms"][0]["oscillations"] == []


@pytest.mark.slow
@pytest.mark.parametrize("structure", STRUCTURES)
def test_too_few_validation_rows_are_counted(thermaltool, lag, tmp_path, structure):
    call = ("identify", lag, *ONE, *structure, *orders(structure))
    few = write_log(tmp_path / "few.csv", {k: v[:2] for k, v in run_of([0.9]).items()})
    for extra in (("--split", "0.998"), ("--validate", few)):
        done = thermaltool(*call, *extra)
        assert done.code == 1
        assert "d_z_um: 2 validation rows are too few" in done.err
        assert done.err.count("\n") == 1
    assert "nan" not in thermaltool(*call, "--split", "0.98").out


@pytest.mark.parametrize("structure", STRUCTURES)
def test_constant_validation_data_say_nothing(thermaltool, lag, tmp_path, structure):
    still = run_of([0.9])
    still["d_z_um"] = np.full(1000, 4.0)
    done = thermaltool("identify", lag, *ONE, *structure, *orders(structure), "--validate",
                       write_log(tmp_path / "still.csv", still))  # fmt: skip
    assert done.code == 1
    assert "d_z_um is constant over the" in done.err


@pytest.fixture
def two(tmp_path):
    """A held and a running input, the first 20 s, the second 10 s before its effect."""
    columns = run_of([np.exp(-10 / 300)])
    air = 20 + np.cumsum(np.random.default_rng(2).standard_normal(1003)) / 10
    late = np.r_[np.zeros(2), columns["Q_a_W"][:-2]]
    y = lfilter([0, 0.01], [1, -np.exp(-10 / 300)], late)
    y += lfilter([0, 0.03], [1, -0.97], air[2:-1] - air[2])
    return write_log(tmp_path / "two.csv", {
        **columns, "T_air_degC": air[2:-1],
        "d_z_um": y + 1e-3 * np.random.default_rng(3).standard_normal(1000),
    })  # fmt: skip


BOTH = (*ONE, "--input", "T_air_degC")


@pytest.mark.parametrize("structure", STRUCTURES[:-1])
def test_delay_dead_time_and_units(thermaltool, two, structure):
    """Of nk periods a held input has one by its sampling."""
    call = ("identify", two, *BOTH, *structure, "--orders", "1,1,3", "--orders", "1,1,1")
    done = thermaltool(*call, "--json")
    assert done.code == 0, done.err
    (model,) = done.json["models"]
    assert model["delay_s"] == [30.0, 10.0]
    assert model["dead_time_s"] == [20.0, 10.0]
    assert [t["delay_s"] for t in model["terms"]] == [30.0, 10.0]
    assert [t["dead_time_s"] for t in model["terms"]] == [20.0, 10.0]
    assert [t["gain"]["unit"] for t in model["terms"]] == ["um/W", "um/degC"]
    assert model["units"].keys() == model["parameters"].keys()
    if "--continuous" in structure:
        assert model["units"] == {"a1[Q_a_W]": "1/s", "a1[T_air_degC]": "1/s",
                                  "b0[Q_a_W]": "um/W/s", "b0[T_air_degC]": "um/degC/s"}  # fmt: skip
        assert model["orders"]["nb"] == [1, 1]
    else:
        assert model["units"]["b3[Q_a_W]"] == "um/W"
        assert model["units"]["b1[T_air_degC]"] == "um/degC"
        assert {u for name, u in model["units"].items() if name[0] in "af"} == {"1"}
    table = thermaltool(*call).out.splitlines()
    head = next(line for line in table if line.startswith("input"))
    at = head.index("dead time s")
    shown = [line[at:].split()[0] for line in table if line.startswith(("Q_a_W", "T_air_degC"))]
    assert shown == ["20", "10"]


@pytest.mark.slow
def test_delay_dead_time_and_units_of_a_network(thermaltool, two):
    call = ("identify", two, *BOTH, "--structure", "network", "--modes", "1", "--delay", "20")
    (model,) = thermaltool(*call, "--json").json["models"]
    assert model["delay_s"] == [30.0, 20.0]
    assert model["dead_time_s"] == [20.0, 20.0]
    assert [t["delay_s"] for t in model["terms"]] == [30.0, 20.0]
    assert [t["dead_time_s"] for t in model["terms"]] == [20.0, 20.0]
    assert [t["gain"]["unit"] for t in model["terms"]] == ["um/W", "um/degC"]
    assert model["units"] == {"tau1": "s", "K1[Q_a_W]": "um/W", "K1[T_air_degC]": "um/degC"}
    table = thermaltool(*call).out.splitlines()
    head = next(line for line in table if line.startswith("output"))
    at = head.index("dead time s")
    assert [line[at:].split()[0] for line in table if line.startswith("d_z_um  ")][:2] == ["20"] * 2


@pytest.mark.parametrize(("extra", "message"), [
    (("--structure", "arx", "--initial", "rest"), "--initial"),
    (("--structure", "armax", "--initial", "free"), "--initial"),
    (("--structure", "network", "--noise-orders", "1,1"), "--noise-orders"),
    (("--structure", "network", "--real-poles"), "--real-poles"),
    (("--structure", "arx", "--noise-orders", "1,1"), "--noise-orders"),
    (("--noise-orders", "2,1"), "--noise-orders"),
    (("--structure", "bj", "--noise-orders", "²,1"), "--noise-orders"),
    (("--orders", "²,2,1"), "nb,nf,nk"),
    (("--orders", "٢,2,1"), "nb,nf,nk"),
    (("--orders", "30,30,1"), "go up to 9"),
    (("--orders", "1,10,1"), "go up to 9"),
    (("--reference", "soon"), "--reference"),
])  # fmt: skip
def test_what_would_have_no_effect_is_refused(thermaltool, lag, extra, message):
    done = thermaltool("identify", lag, *ONE, *extra)
    assert done.code == 2
    assert message in done.err


@pytest.mark.parametrize("extra", [
    ("--structure", "bj", "--noise-orders", "1,1"),
    ("--structure", "armax", "--noise-orders", "1", "--initial", "auto"),
])  # fmt: skip
def test_what_has_an_effect_is_taken(thermaltool, lag, extra):
    assert thermaltool("identify", lag, *ONE, "--orders", "1,1,1", *extra).code == 0


def test_quiet_leaves_the_table(thermaltool, tmp_path):
    log = write_log(tmp_path / "sum.csv", run_of([1.0]))
    call = ("identify", log, *ONE, "--orders", "1,1,1")
    loud, quiet = thermaltool(*call), thermaltool(*call, "-q")
    assert "time constant s" in quiet.out
    assert quiet.out == loud.out
    assert loud.err
    assert not quiet.err


def test_the_command_of_a_validation_reads_as_it_was_read(thermaltool, tmp_path):
    columns = run_of([np.exp(-10 / 300)])
    columns["d_z_um"][40] = np.nan
    log = write_log(tmp_path / "a log.csv", columns)
    done = thermaltool("identify", str(log), *ONE, "--orders", "1,1,1", "--split", "0.6",
                       "--nan-policy", "omit", "-o", str(tmp_path / "m.json"))  # fmt: skip
    assert done.code == 0, done.err
    (line,) = [each for each in done.out.splitlines() if each.startswith("validation: ")]
    words = shlex.split(line.removeprefix("validation: ").replace("MODEL", f"{tmp_path}/m.json"))
    assert words[-2:] == ["--nan-policy", "omit"]
    assert thermaltool(*words).code == 0


def test_the_table_is_there_where_no_model_file_can_be(thermaltool, tmp_path):
    log = write_log(tmp_path / "log.csv", run_of([-0.6]))
    model = tmp_path / "model.json"
    result = thermaltool("identify", str(log), *ONE, "--structure", "oe", "--orders", "1,1,1",
                         "-o", str(model))  # fmt: skip
    assert result.code == 1
    assert "Q_a_W  1,1,1" in result.out
    last = result.err.splitlines()[-1]
    assert "take --real-poles, a lower order, or leave this input out" in last
    assert not model.exists()


@pytest.mark.slow
def test_an_output_that_no_input_moves_is_told(thermaltool, tmp_path):
    columns = run_of([np.exp(-10 / 300)])
    columns["d_z_um"] = np.random.default_rng(3).standard_normal(1000)
    noise = write_log(tmp_path / "noise.csv", columns)
    said = thermaltool("identify", noise, *ONE, "--structure", "oe").err
    assert "d_z_um: the inputs say nothing of it: no candidate comes nearer" in said


def test_a_model_is_no_log_and_a_log_again_is_no_other(thermaltool, tmp_path, lag):
    model = tmp_path / "model.json"
    given = ("identify", lag, *ONE, "--orders", "1,1,1")
    thermaltool(*given, "-o", model)
    refused = thermaltool("identify", model, *ONE)
    assert refused.code
    assert refused.err == f"thermaltool identify: {model}: a thermaltool model, no log\n"
    again = thermaltool("identify", lag, lag, *ONE, "--orders", "1,1,1")
    assert "the same log again counts twice" in again.err


def test_validation_tells_what_the_input_does_over_a_pause(thermaltool, tmp_path):
    columns = {name: np.delete(v, slice(700, 740)) for name, v in run_of([0.97]).items()}
    log = write_log(tmp_path / "pause.csv", columns)
    said = thermaltool("identify", log, *ONE, "--orders", "1,1,1", "--split", "0.6").err
    assert "the fit is parted there; in simulate the drive is taken as held over it" in said
