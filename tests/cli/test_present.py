"""``thermaltool present`` and ``compare`` from outside."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reference.diagnosed import diagnosed, measured

from thermaltool.documents import DIAGNOSIS
from thermaltool.effects.band import ScheduleBand
from thermaltool.effects.sensor_gain import SensorGain
from thermaltool.model import Drive, Model, Output, Term, dumps
from thermaltool.record import Record
from thermaltool.responses.rational import rational_kind

LAG = rational_kind(1, 0)


def lag_model(tau: float = 300.0, channel: str = "d_tool holder front_um") -> Model:
    response = LAG(K1=0.2, tau1=tau)
    covariance = np.diag([0.001**2, 5.0**2])
    return Model(
        drives=(Drive("Q_main_W", "zero", 0.0, (0.0, 100.0)),),
        outputs=(Output(channel, "deflection", "first", (-1.0, 20.0),
                        {"rmse": 0.123, "fit_percent": 98.7, "rows": 400}),),
        terms=(Term("Q_main_W", channel, response, covariance, ("K1", "tau1")),),
        sample_period=10.0,
        provenance={"logs": [{"name": "in/run.csv", "sha256": "0"}]},
    )  # fmt: skip


@pytest.fixture
def files(tmp_path: Path) -> dict[str, Path]:
    """Two models of one output, and a log: noise on the first one's output."""
    rng = np.random.default_rng(7)
    model = lag_model()
    time = 10.0 * np.arange(400)
    heat = np.where((time > 300) & (time < 2500), 100.0, 0.0)
    name = model.outputs[0].channel
    bent = model.simulate(Record(time, {"Q_main_W": heat}))[name]
    lines = ["time_s,Q_main_W," + name]
    lines += [f"{t:g},{q:g},{y:.4f}" for t, q, y in
              zip(time, heat, bent + 50 + 0.1 * rng.standard_normal(400), strict=True)]  # fmt: skip
    found = {key: tmp_path / f"{key}.{end}" for key, end in
             (("good", "json"), ("slow", "json"), ("log", "csv"))}  # fmt: skip
    found["good"].write_text(dumps(model))
    found["slow"].write_text(dumps(lag_model(600.0)))
    found["log"].write_text("\n".join(lines) + "\n")
    return found


def test_a_table_that_a_person_would_ask_for(thermaltool, files) -> None:
    result = thermaltool("present", files["good"])
    assert (result.code, result.err) == (0, "")
    assert "driven by Q_main_W (seen 0 to 100 W)\none row every 10 s\nfrom run.csv" in result.out
    assert "d_tool holder front_um  deflection  0.123  98.70  400   -1 to 20 µm" in result.out
    # 0.2 ± 1.96 · 0.001; a time constant is normal in its logarithm: 300 exp(± 1.96 · 5 / 300).
    assert "rational1  0.2 µm/W     (0.198 to 0.202)  5 min (4.84 min to 5.17 min)" in result.out


def test_json_below_one_screen_and_without_covariance(thermaltool, files) -> None:
    result = thermaltool("present", files["good"], files["slow"], "--json")
    assert "covariance" not in result.out
    assert len(result.out.splitlines()) <= 24
    assert max(map(len, result.out.splitlines())) <= 250
    first, second = result.json[str(files["good"])], result.json[str(files["slow"])]
    (response,) = first["responses"]
    assert response["gain"] == pytest.approx([0.2, 0.19804, 0.20196])
    assert response["time_constants_s"][0] == pytest.approx([300, 290.357, 309.963], rel=1e-5)
    assert second["responses"][0]["time_constants_s"][0][0] == 600


def test_effects_levels_and_estimator(thermaltool, tmp_path: Path) -> None:
    plain = lag_model()
    effect = SensorGain("T_a_degC", {"gain": 1.25}, covariance=np.array([[1e-4]]))
    band = ScheduleBand("Q_main_W", (50.0, 100.0), 1)
    output = Output("T_a_degC", "sensor", 20.0, (0.0, 9.0))
    model = replace(
        plain,
        outputs=(*plain.outputs, output),
        terms=(replace(plain.terms[0], band=band), Term("Q_main_W", "T_a_degC", LAG(0.1, 50.0))),
        effects=(effect,),
    ).with_design({
        "form": "kalman", "settings": {"walk_per_sqrt_s": 0.05}, "outputs": ["d_x_um"],
        "predicted": {"band": [4.01], "lag": 13.5}, "sensors": ["T_a_degC"],
    })  # fmt: skip
    (tmp_path / "m.json").write_text(dumps(model))
    result = thermaltool("present", tmp_path / "m.json")
    assert "rational1, at 100 W of Q_main_W" in result.out
    assert "sensor_gain  T_a_degC  gain       1.25   (1.23 to 1.27)" in result.out
    assert "no interval where the file holds no covariance" in result.out
    assert "estimator: kalman, walk_per_sqrt_s = 0.05" in result.out
    assert "predicted error band: d_x_um 4.01 µm, behind by 13.5 s" in result.out
    document = thermaltool("present", tmp_path / "m.json", "--json").json[str(tmp_path / "m.json")]
    assert document["responses"][0]["level"] == 100
    assert document["estimator"] == {"form": "kalman", "walk_per_sqrt_s": 0.05,
                                     "band": {"d_x_um": 4.01}}  # fmt: skip


@pytest.mark.slow
def test_a_model_of_a_series(thermaltool, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    x = [0.0, 0.0]
    for a in rng.standard_normal(400):
        x.append(1.6 * x[-1] - 0.9 * x[-2] + a)
    lines = ["time_s,d_tool_um", *(f"{0.01 * k:.2f},{v:.5f}" for k, v in enumerate(x))]
    (tmp_path / "x.csv").write_text("\n".join(lines))
    arma = tmp_path / "arma.json"
    fit = thermaltool("fit", tmp_path / "x.csv", "-C", "d_tool_um", "--order", "2,0", "-o", arma)
    # The table is that of `fit`.
    assert fit.out.strip() in thermaltool("present", arma).out
    found = thermaltool("present", arma, "--json").json[str(arma)]
    frequency, low, high = found["modes"][0]["natural_frequency_Hz"]
    assert low < frequency < high
    assert f"{frequency:.5g} (" in fit.out
    ahead, figure = tmp_path / "ahead.csv", tmp_path / "f.png"
    thermaltool("forecast", arma, tmp_path / "x.csv", "--steps", "9", "-o", ahead)
    for given in ((arma,), (ahead,), (ahead, tmp_path / "x.csv")):
        assert thermaltool("plot", *given, "-o", figure).err == ""


@pytest.mark.parametrize("name", ["good", "slow"])
def test_figures_of_compare_are_those_of_simulate(thermaltool, files, tmp_path, name) -> None:
    both = thermaltool("compare", files["good"], files["slow"], files["log"], "--json")
    alone = thermaltool("simulate", files[name], files["log"], "--json")
    (output,) = alone.json
    assert both.json[output][f"{name}.json"] == alone.json[output]


def test_files_of_one_name_are_told_apart(thermaltool, files, tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    other = tmp_path / "b" / "good.json"
    other.write_bytes(files["slow"].read_bytes())
    found = thermaltool("compare", files["good"], other, files["good"], files["log"], "--json").json
    (by_model,) = found.values()
    assert list(by_model) == sorted([str(files["good"]), str(other), f"{files['good']} (2)"])


def test_models_side_by_side(thermaltool, files, tmp_path: Path) -> None:
    figure = tmp_path / "compare.svg"
    result = thermaltool("compare", files["good"], files["slow"], "-", "--plot", figure,
                         stdin=files["log"].read_bytes())  # fmt: skip
    assert result.code == 0
    heading, first, second = result.out.splitlines()
    assert heading.split() == [
        "output",
        "model",
        "rmse",
        "zero",
        "free",
        "fit",
        "%",
        "max",
        "mean",
        "rows",
    ]
    assert first.startswith("d_tool holder front_um  good.json")
    assert first.endswith("least rmse")
    assert second.split()[0] == "slow.json"
    assert figure.read_bytes().startswith(b"<?xml")
    assert "good.json: d_tool holder front_um: counts from the median" in result.err
    # A stretch is judged, all rows drive.
    parts = ("--start", "1000", "--stop", "2000", "--initial", "rest", "-q")
    judged = thermaltool("compare", files["good"], files["log"], *parts)
    assert judged.out.splitlines()[1].split()[-1] == "101"
    assert judged.err == ""


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("present", "none.json"), "none.json: No such file or directory"),
        (("present", "empty.json"), "empty.json: terms: there is none"),
        (("present", "nan.json"), "nan.json: terms[0].covariance"),
        (("present", "size.json"), "size.json: terms[0].covariance: 2 rows for 1 covariance_names"),
        (("present", "other.json"),
         "other.json: neither a thermaltool model nor what thermaltool fit -o writes"),
        (("present", "log.csv"), "log.csv:1: not JSON"),
        (("compare", "good.json", "away.json", "log.csv"),
         "no output that all models have (good.json: d_tool holder front_um; away.json: d_q_um)"),
        (("compare", "good.json", "bare.csv"), "bare.csv: no column Q_main_W"),
        (("compare", "good.json", "slow.json", "bare.csv"), "which good.json needs"),
        (("compare", "good.json", "drives.csv"), "drives.csv: no measured output of the models"),
        (("compare", "other.json", "log.csv"), "other.json: not a thermaltool model"),
        (("plot", "good.json", "away.json", "log.csv"), "no output that all models have"),
        (("plot", "good.json", "slow.json", "bare.csv"), "Q_main_W"),
        (("plot", "other.json"), "no figure for this document"),
    ],
)  # fmt: skip
def test_bad_input_has_one_line(thermaltool, files, monkeypatch, arguments, message) -> None:
    folder = files["log"].parent
    monkeypatch.chdir(folder)
    document = json.loads(dumps(lag_model()))
    document.pop("sha256")
    term = document["terms"][0]
    for name, changed in (
        ("empty", {"terms": []}),
        ("nan", {"terms": [{**term, "covariance": [[float("nan"), 0], [0, 1]]}]}),
        ("size", {"terms": [{**term, "covariance_names": ["K1"]}]}),
    ):
        (folder / f"{name}.json").write_text(json.dumps({**document, **changed}))
    (folder / "other.json").write_text('{"format": "another", "version": 1}')
    (folder / "away.json").write_text(dumps(lag_model(channel="d_q_um")))
    (folder / "bare.csv").write_text("time_s,d_q_um\n0,1\n10,2\n20,3\n")
    (folder / "drives.csv").write_text("time_s,Q_main_W\n0,1\n10,2\n20,3\n")
    figure = ("-o", "f.png") if arguments[0] == "plot" else ()
    result = thermaltool(*arguments, *figure)
    assert result.code == 1
    assert result.err.count("\n") == 1
    assert result.err.startswith(f"thermaltool {arguments[0]}: ")
    assert message in result.err


def test_a_diagnosis_and_orders_have_a_figure(thermaltool, tmp_path: Path) -> None:
    log = measured()
    found = diagnosed([log]).document({})
    files = {"model": "m", "calibrated_on": [], "sound": [], "validated_on": [],
             "logs": [{"name": "run.csv", "sha256": log.digest}]}  # fmt: skip
    assert found["format"] == DIAGNOSIS.name
    (tmp_path / "why.json").write_text(json.dumps({**found, **files}))
    assert thermaltool("plot", tmp_path / "why.json", "-o", tmp_path / "why.png").err == ""
    entry = {"p": 1, "q": 0, "aic": 3.0, "bic": 4.0, "aicc": 3.1}
    orders = {"best": {"bic": {"p": 1, "q": 0, "value": 4.0}}, "series": "d_z_um, run.csv"}
    orders["table"] = [{**entry, "exact": True}, {**entry, "p": 0, "bic": 9.0, "exact": False}]
    (tmp_path / "orders.json").write_text(json.dumps(orders))
    assert thermaltool("plot", tmp_path / "orders.json", "-o", tmp_path / "o.png").err == ""
    (tmp_path / "orders.json").write_text(json.dumps({**orders, "table": []}))
    broken = thermaltool("plot", tmp_path / "orders.json", "-o", tmp_path / "o.png")
    assert (broken.code, broken.err.count("\n")) == (1, 1)
    assert "not what the command wrote" in broken.err
