import json

import numpy as np
import pytest
from click.testing import CliRunner

from thermaltool.cli.noise import command
from thermaltool.errors import LogError, OutputError


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "idle.csv"
    rng = np.random.default_rng(1)
    rows = ["time_s,dT_pair_K,T_room_degC,Q_main_W"]
    for i, value in enumerate(0.02 * rng.standard_normal(1000)):
        rows.append(f"{0.5 * i},{value:.17g},,{280 if i > 500 else 0}")
    path.write_text("\n".join(rows) + "\n")
    return path


def run(*args):
    return CliRunner().invoke(command, [str(a) for a in args], catch_exceptions=False)


def test_json_contract(log):
    result = run(log, "--json")
    assert result.exit_code == 0
    document = json.loads(result.stdout)
    assert result.stdout == json.dumps(document, sort_keys=True, ensure_ascii=False) + "\n"
    assert (document["format"], document["version"]) == ("thermaltool-noise", 1)
    assert document["sample_period_s"] == 0.5
    pair = document["channels"]["dT_pair_K"]
    assert pair["unit"] == "K"
    assert pair["white_sigma"] == pytest.approx(0.02, rel=0.1)
    assert pair["white_sigma_interval"][0] < pair["white_sigma"] < pair["white_sigma_interval"][1]
    assert pair["drift"]["upper_bound"] is False
    assert pair["drift"]["time_constant_s"] is None  # none detected
    allan = pair["drift"]["allan"]
    assert len(allan["tau_s"]) == len(allan["deviation"]) == len(allan["low"]) == len(allan["high"])
    assert pair["spectrum"]["density"]
    assert document["channels"]["Q_main_W"]["white_sigma"] == 0.0
    assert document["channels"]["T_room_degC"]["white_sigma"] is None
    assert "T_room_degC: every reading is missing" in result.stderr


def test_table_and_file(log, tmp_path):
    output = tmp_path / "noise.json"
    result = run(log, "-o", output)
    assert result.stdout.splitlines()[0].startswith("channel")
    assert json.loads(output.read_text()) == json.loads(run(log, "--json").stdout)


def test_channel_and_stretch(log):
    result = run(log, "--channel", "dT_pair_K", "--start", 100, "--stop", 400, "--json")
    channels = json.loads(result.stdout)["channels"]
    assert list(channels) == ["dT_pair_K"]
    assert channels["dT_pair_K"]["samples"] == 601
    with pytest.raises(LogError, match="no row from"):
        run(log, "--start", 1e6)
    with pytest.raises(LogError, match="dT_pair_K"):
        run(log, "--channel", "dT_pairs_K")


def test_a_start_that_is_counted_from_the_first_row_of_a_clock_from_1970(tmp_path):
    rows = "".join(f"{1772000000 + 2 * k},{k % 3}\n" for k in range(400))
    (tmp_path / "epoch.csv").write_text("time_s,T_a_degC\n" + rows)
    with pytest.raises(LogError, match=r"100 s into the log is a start of 1772000100 s$"):
        run(tmp_path / "epoch.csv", "--start", 100)
    result = run(tmp_path / "epoch.csv", "--start", 1772000100, "--json")
    assert json.loads(result.stdout)["channels"]["T_a_degC"]["samples"] == 350


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_figure(log, tmp_path, suffix):
    figure = tmp_path / f"noise.{suffix}"
    assert run(log, "--plot", figure).exit_code == 0
    heads = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}
    assert figure.read_bytes().startswith(heads[suffix])


def test_figure_of_unknown_kind_is_refused_before_work(log, tmp_path):
    with pytest.raises(OutputError, match=r"\.png, \.svg or \.pdf"):
        run(log, "--plot", tmp_path / "noise.bmp")


def test_header_only(tmp_path):
    path = tmp_path / "empty.csv"
    path.write_text("time_s,dT_pair_K\n")
    with pytest.raises(LogError):
        run(path)
