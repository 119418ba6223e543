"""``thermaltool estimate`` from outside."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

forms = pytest.mark.parametrize("form", ["kalman", "kernel"])


def agreed(result, name):
    """Figures of a channel in what --json wrote."""
    return result.json["agreement"][name]


def table(text):
    rows = list(csv.reader(text.splitlines()))
    return rows[0], np.array(rows[1:], float).reshape(len(rows) - 1, len(rows[0]))


@forms
def test_heat_and_deflection(thermaltool, files, form):
    result = thermaltool("estimate", getattr(files, form), files.log)
    assert result.code == 0
    names, values = table(result.out)
    assert names == ["time_s", "Q_main_1", "d_x_um"]
    assert np.mean(values[60:120, 1]) == pytest.approx(1.0, abs=0.05)
    assert np.mean(values[-50:, 1]) == pytest.approx(0.5, abs=0.05)
    lines = [line.split() for line in result.err.splitlines()]
    assert lines[0] == ["estimate", "band", "steady", "rmse", "max", "rows"]
    assert lines[2][0] == "d_x_um"
    assert float(lines[2][1]) < 12  # µm of 60, heat that halves at once included


def test_json_and_the_table_agree(thermaltool, files):
    target = files.folder / "out.csv"
    result = thermaltool("estimate", files.kalman, files.log, "--json", "-o", target)
    assert set(result.json) == {"agreement"}
    assert set(result.json["agreement"]) == {"Q_main_1", "d_x_um"}
    _, values = table(target.read_text())
    _, log = table(files.log.read_text())
    error = (log[:, 3] - log[0, 3]) - values[:, 2]
    assert agreed(result, "d_x_um")["band"] == pytest.approx(np.ptp(error))
    assert agreed(result, "d_x_um")["rows"] == 240


@forms
def test_temperatures_alone_through_a_pipe(thermaltool, files, form):
    rows = list(csv.DictReader(files.log.read_text().splitlines()))
    text = "time_s,dT_pair1_K\n" + "".join(f"{r['time_s']},{r['dT_pair1_K']}\n" for r in rows)
    result = thermaltool("estimate", getattr(files, form), stdin=text)
    assert result.err == ""
    assert result.out == thermaltool("estimate", getattr(files, form), files.log, "-q").out


def test_header_only_and_one_row(thermaltool, files):
    for rows in (0, 1):
        text = "time_s,dT_pair1_K\n" + "0,0.1\n" * rows
        result = thermaltool("estimate", files.kalman, stdin=text)
        assert result.code == 0
        assert len(result.out.splitlines()) == 1 + rows
    assert thermaltool("estimate", files.kalman, stdin="").code == 1


def test_missing_columns_and_values(thermaltool, files):
    text = files.log.read_text().replace("dT_pair1_K", "dT_pair2_K")
    result = thermaltool("estimate", files.kalman, stdin=text)
    assert result.code == 1
    assert "<stdin>: no column dT_pair1_K (near: dT_pair2_K)" in result.err
    lines = files.log.read_text().splitlines()
    lines[20] = ",".join([*lines[20].split(",")[:2], "", *lines[20].split(",")[3:]])
    text = "\n".join(lines) + "\n"
    result = thermaltool("estimate", files.kalman, stdin=text)
    assert "<stdin>:21: dT_pair1_K: missing value (1 in all)" in result.err
    held = thermaltool("estimate", files.kalman, "--nan-policy", "hold", stdin=text)
    left = thermaltool("estimate", files.kalman, "--nan-policy", "omit", stdin=text)
    assert (len(held.out.splitlines()), len(left.out.splitlines())) == (241, 240)


def test_outside_the_calibrated_range(thermaltool, files):
    text = files.log.read_text() + "2400,0.5,40,30,21\n"
    result = thermaltool("estimate", files.kalman, stdin=text)
    assert result.code == 0
    assert result.err.startswith("<stdin>:242: dT_pair1_K: ")
    assert "outside the calibrated range" in result.err


def test_without_or_with_a_foreign_design(thermaltool, files):
    result = thermaltool("estimate", files.model, files.log)
    assert result.code == 1
    assert "the model has no estimator yet: run thermaltool regularize" in result.err
    document = json.loads(files.kalman.read_text())
    document["terms"][0]["parameters"]["K"] *= 1.01
    files.kalman.write_text(json.dumps(document))
    result = thermaltool("estimate", files.kalman, files.log)
    assert "designed for other parameters: run thermaltool regularize again" in result.err


@forms
@pytest.mark.parametrize("key", ["sensors", "followed", "form", "outputs"])
def test_a_design_that_is_not_whole(thermaltool, files, form, key):
    path = getattr(files, form)
    document = json.loads(path.read_text())
    del document["design"][key]
    path.write_text(json.dumps(document))
    result = thermaltool("estimate", path, files.log)
    assert (result.code, result.err.count("\n")) == (1, 1)
    assert "run thermaltool regularize again" in result.err


@forms
def test_a_warm_start_is_told_and_can_be_settled(thermaltool, files, form):
    header, *rows = files.log.read_text().splitlines()
    warm = "\n".join([header, *rows[110:]]) + "\n"
    design = getattr(files, form)
    cold = thermaltool("estimate", design, "-", "--json", "-o", files.folder / "o.csv", stdin=warm)
    assert "<stdin>:2: dT_pair1_K:" in cold.err
    assert "see --initial settled" in cold.err
    settled = thermaltool(
        "estimate", design, "-", "--initial", "settled", "--json", "-o", files.folder / "o.csv",
        stdin=warm,
    )  # fmt: skip
    assert "settled" not in settled.err
    assert agreed(settled, "d_x_um")["band"] < 0.5 * agreed(cold, "d_x_um")["band"]


def test_what_a_displacement_counts_from_is_told_and_a_warm_start_is_no_zero(thermaltool, files):
    """Beside a machine that is warm at the first row the zero is that of the whole log."""
    header, *rows = files.log.read_text().splitlines()
    target = files.folder / "o.csv"
    for begin, said in ((0, "over the first"), (110, "over all rows")):
        text = "\n".join([header, *rows[begin:]]) + "\n"
        told = thermaltool("estimate", files.kalman, "-", "-o", target, stdin=text)
        assert f"d_x_um: counts from the median of measured minus estimated {said}" in told.err
        found = agreed(thermaltool("estimate", files.kalman, "-", "--json", "-o", target,
                                   stdin=text), "d_x_um")  # fmt: skip
        _, log = table(text)
        error = log[:, 3] - table(target.read_text())[1][:, 2]
        assert found["rmse"] == pytest.approx(np.sqrt(np.mean((error - found["zero"]) ** 2)))
        if begin:
            assert found["zero"] == pytest.approx(np.median(error))
            assert found["zero_rows"] == len(error)


@pytest.mark.slow
def test_a_warm_start_is_estimated_where_all_is_smoothed(thermaltool, files):
    header, *rows = files.log.read_text().splitlines()
    warm = "\n".join([header, *rows[110:]]) + "\n"
    arguments = "estimate", files.kalman, "-", "--json", "-o", files.folder / "o.csv"
    cold = thermaltool(*arguments, "--smooth", "--initial", "rest", stdin=warm)
    assert "see --initial settled or free" in cold.err
    free = thermaltool(*arguments, "--smooth", "--initial", "free", stdin=warm)
    assert "at the start" not in free.err
    found = thermaltool(*arguments, "--smooth", stdin=warm)
    assert "at the start is not rest: the state there is estimated" in found.err
    assert found.json == free.json
    assert agreed(free, "d_x_um")["band"] < 0.5 * agreed(cold, "d_x_um")["band"]
    refused = thermaltool(*arguments, "--initial", "free", stdin=warm)
    assert refused.code == 2
    assert "--initial free goes with --smooth" in refused.err


def test_a_deflection_beyond_the_calibration_is_told(thermaltool, files):
    header, *rows = files.log.read_text().splitlines()
    hot = [header]
    for row in rows:
        cells = row.split(",")
        hot.append(",".join([cells[0], cells[1], f"{2 * float(cells[2]):.4f}", *cells[3:]]))
    result = thermaltool("estimate", files.kalman, "-", stdin="\n".join(hot) + "\n")
    assert "d_x_um:" in result.err
    assert "outside the calibrated range" in result.err


@pytest.mark.slow
def test_where_no_alarm_is_possible_that_is_said(thermaltool, files):
    run = ("estimate", files.kalman, "-", "--json", "-o", files.folder / "o.csv")
    for look in ("--bands", "--smooth"):
        found = thermaltool(*run, look, stdin=files.log.read_text())
        alarm = found.json["alarm"]
        assert (alarm["word"], alarm["time_s"]) == ("not possible", None)
        assert "no more sensors than drives" in alarm["reason"]
        assert found.err.count("no alarm is possible") == 1
        assert "<stdin>: no alarm is possible where model and machine part" in found.err
    assert "alarm" not in thermaltool(*run, stdin=files.log.read_text()).json


@pytest.mark.slow
def test_steps_are_looked_for_run_by_run_between_pauses(thermaltool, files):
    header, *rows = files.log.read_text().splitlines()
    parted = "\n".join([header, *rows[:90], *rows[120:]]) + "\n"
    found = thermaltool("estimate", files.kalman, "-", "--smooth", "--bands", stdin=parted)
    assert "in each of 2 runs between pauses" in found.err
    _, values = table(found.out)
    assert len(values) == len(rows) - 30
    assert np.all(np.isfinite(values))


LOOKS = pytest.mark.parametrize("look", [("--smooth",), ("--lag", 30), ("--walk", 0.05)], ids=str)


@LOOKS
def test_looking_back_is_nearer_and_says_how_sure_it_is(thermaltool, files, look):
    plain = thermaltool("estimate", files.kalman, files.log, "--json", "-o", files.folder / "p.csv")
    target = files.folder / "late.csv"
    result = thermaltool(
        "estimate", files.kalman, files.log, *look, "--bands", "--json", "-o", target
    )
    assert result.code == 0
    names, values = table(target.read_text())
    assert names == ["time_s", "Q_main_1", "d_x_um", "sigma_Q_main_1", "sigma_d_x_um"]
    assert np.all(values[:, 3] > 0)
    if "--walk" not in look:
        assert agreed(result, "Q_main_1")["rmse"] < 0.9 * agreed(plain, "Q_main_1")["rmse"]
    assert ("as this log tells it" in result.err) == ("--lag" not in look)


@LOOKS
def test_records_of_no_and_of_one_row(thermaltool, files, look):
    for rows in (0, 1):
        text = "time_s,dT_pair1_K\n" + "0,0.1\n" * rows
        result = thermaltool("estimate", files.kalman, "-", "--bands", *look, stdin=text)
        if rows and "--smooth" in look:
            assert (result.code, result.out) == (1, "")
            assert result.err.endswith("1 row with a reading of every sensor: too few to tell how "
                                       "fast the heat changes; pin it with --walk\n")  # fmt: skip
        else:
            assert (result.code, len(result.out.splitlines())) == (0, 1 + rows)


@pytest.mark.slow
def test_a_sensor_that_is_dead_for_a_while(thermaltool, files):
    lines = files.log.read_text().splitlines()
    column = lines[0].split(",").index("dT_pair1_K")
    for k in range(100, 130):
        cells = lines[k].split(",")
        cells[column] = ""
        lines[k] = ",".join(cells)
    text = "\n".join(lines) + "\n"
    run = ("estimate", files.kalman, "-", "--smooth", "--bands")
    refused = thermaltool(*run, stdin=text)
    assert refused.code == 1
    assert "missing value (30 in all): see --nan-policy" in refused.err
    result = thermaltool(*run, "--nan-policy", "hold", stdin=text)
    _, values = table(result.out)
    assert len(values) == 240
    assert np.all(np.isfinite(values))
    # Nobody has read it: it is less sure there.
    assert np.min(values[110:120, 3]) > 1.2 * np.median(values[40:80, 3])


@pytest.mark.parametrize(
    ("form", "options", "message"),
    [
        ("kernel", ("--smooth",), "take the Kalman form: run thermaltool regularize --form kalman"),
        ("kalman", ("--lag", 1e7), "a lag of 1e+07 s is 1e+06 samples of 10 s: give 1 to"),
        ("kalman", ("--smooth", "--lag", 5), "--smooth takes all later readings"),
        ("kalman", ("--walk", "quick"), "'quick' is not likelihood|design|RATE"),
        ("kalman", ("--walk", -1), "'-1' is not likelihood|design|RATE"),
    ],
)
def test_what_cannot_be_looked_back_at(thermaltool, files, form, options, message):
    result = thermaltool("estimate", getattr(files, form), files.log, *options)
    assert (result.code in (1, 2), result.out) == (True, "")
    assert message in result.err


@forms
def test_a_design_for_another_sample_period_is_carried_over_and_told(thermaltool, files, form):
    lines = files.log.read_text().splitlines()
    thin = "\n".join([lines[0], *lines[1::5]]) + "\n"
    result = thermaltool("estimate", getattr(files, form), "-", stdin=thin)
    assert result.code == 0
    told = [line for line in result.err.splitlines() if "where the design is for" in line]
    assert len(told) == 1
    assert told[0].endswith("and its errors are others (regularize --dt)")
    whole = thermaltool("estimate", getattr(files, form), files.log)
    assert "where the design is for" not in whole.err


def test_a_sensor_that_stands_still_is_told(thermaltool, files):
    header, *rows = csv.reader(files.log.read_text().splitlines())
    at = next(k for k, name in enumerate(header) if name.startswith("dT"))

    def log(stands):
        kept = [row.copy() for row in rows]
        for row in kept[stands]:
            row[at] = kept[stands.start or 0][at]
        return "\n".join(map(",".join, [header, *kept])) + "\n"

    result = thermaltool("estimate", files.kalman, "-", "--smooth", stdin=log(slice(0, None)))
    assert result.code == 1
    assert len(result.err.splitlines()) == 1
    assert f"{header[at]} reads the same in every row: a sensor that is stuck" in result.err
    result = thermaltool("estimate", files.kalman, "-", stdin=log(slice(60, 160)))
    assert result.code == 0
    assert f"{header[at]}: " in result.err
    assert "a sensor that is stuck? These rows count" in result.err
