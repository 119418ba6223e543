import numpy as np
import pytest

ROWS = [
    f"{t},{0 if t < 600 else 3000},{x:.3f},{1.5 * x:.3f},21.0"
    for t in range(0, 9000, 20)
    for x in [20 * -np.expm1(-max(t - 600, 0) / 900)]
]
LOG = "time_s,n_spindle_rpm,d_ch1_um,d_ch2_um,T_air_degC\n" + "\n".join(ROWS) + "\n"


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "spindle test.csv"
    path.write_text(LOG)
    return path


PLACES = ("--probe", "d_ch1_um=X:50mm", "--probe", "d_ch2_um=x:150")


def test_a_table_a_document_and_a_figure(thermaltool, log, tmp_path):
    figure = tmp_path / "test.png"
    result = thermaltool("iso230", log, *PLACES, "--plot", figure)
    assert result.code == 0
    assert "thermal distortion caused by rotating spindle" in result.out
    assert "d_ch1_um along X at 50 mm, d_ch2_um along X at 150 mm" in result.out
    assert "no drift of d_ch1_um, d_ch2_um" in result.err
    assert figure.read_bytes().startswith(b"\x89PNG")
    document = thermaltool("iso230", "-", *PLACES, "--json", "-q", stdin=LOG).json
    assert [run["speed"] for run in document["runs"]] == [0, 3000]
    figures = {each["symbol"]: each for each in document["runs"][1]["figures"]}
    assert figures["d(X1)60"]["value"] == pytest.approx(20 * -np.expm1(-4), rel=0.01)
    assert figures["d(B)60"]["value"] == pytest.approx(100 * -np.expm1(-4), rel=0.01)
    assert figures["d(B)60"]["unit"] == "urad"
    assert document["probes"][1] == {"axis": "X", "channel": "d_ch2_um", "distance_mm": 150}


def test_noise_of_an_idle_log_and_another_test(thermaltool, log, tmp_path):
    rng = np.random.default_rng(1)
    idle = tmp_path / "idle.csv"
    rows = "".join(f"{20 * k},{x:.4f}\n" for k, x in enumerate(0.1 * rng.standard_normal(2000)))
    idle.write_text("time_s,d_ch1_um\n" + rows)
    noise = tmp_path / "noise.json"
    assert thermaltool("noise", idle, "-o", noise).code == 0
    result = thermaltool("iso230", log, *PLACES, "--noise", noise, "--test", "etve")
    assert result.code == 0
    assert "ETVE(X1)" in result.out
    assert "in 1 h" in result.out
    assert "no drift of d_ch2_um:" in result.err


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        ((), 1, "say where the probes are"),
        (("--probe", "d_ch1_um"), 2, "--probe takes NAME=VALUE"),
        (("--probe", "d_ch1_um=Q"), 2, "an axis X, Y or Z"),
        (("--probe", "d_ch1_um=X:2K"), 2, "2K is no distance"),
        (("--probe", "d_ch1_um=X:2q"), 1, "2q"),
        (("--probe", "d_ch9_um=X"), 1, "no column d_ch9_um"),
        (("--probe", "T_air_degC=X"), 1, "a probe measures a displacement"),
        (("--probe", "d_ch1_um=X", "--probe", "d_ch1_um=Y"), 2, "a channel is there twice"),
        ((*PLACES, "--speed", "n_x_rpm"), 1, "no column n_x_rpm"),
        ((*PLACES, "--average", "0"), 2, "--average"),
        ((*PLACES, "--plot", "x.txt"), 1, "ends in .png"),
        ((*PLACES, "--start", "8900"), 1, "fewer than 10 readings"),
        ((*PLACES, "--start", "9900"), 1, "no row from 9900 s"),
    ],
)
def test_what_is_refused_in_one_line(thermaltool, log, options, code, message):
    result = thermaltool("iso230", log, *options)
    assert (result.code, result.out) == (code, "")
    assert message in result.err
    assert len(result.err.splitlines()) == (1 if code == 1 else 4)
