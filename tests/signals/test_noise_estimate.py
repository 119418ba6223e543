"""The whole estimate: simulated records, awkward ones, and measured logs."""

import numpy as np
import pytest
from reference.measured import whole_log

from thermaltool.signals.noise import MIN_SAMPLES, estimate_noise


def test_white_sigma_beside_a_warm_up_and_a_step(warm_up):
    t = 0.5 * np.arange(8000)
    for k in range(5):
        y = 0.02 * np.random.default_rng([1, k]).standard_normal(t.size) + warm_up(t, 100.0)
        y[6000:] += 1.0
        estimate = estimate_noise(t, y)
        assert estimate.drift.white_sigma == pytest.approx(0.02, rel=0.03)
        assert estimate.outlier_time.size == 0


def test_idle_start_of_a_warm_up_tells_the_drift(drifting, warm_up):
    t = 0.5 * np.arange(12000)
    y = drifting(np.random.default_rng(2), t, 0.02, 0.03, 60.0) + warm_up(t, 3000.0)
    estimate = estimate_noise(t, y)
    assert not estimate.upper_bound
    assert estimate.stretch[0] == 0.0
    assert 2000.0 < estimate.stretch[1] < 3005.0
    assert estimate.drift.white_sigma == pytest.approx(0.02, rel=0.03)
    low, high = estimate.drift.sigma_interval
    assert low < 0.03 < high


@pytest.mark.parametrize(
    ("size", "means"), [(0.0, "a slow drift would pass for it"), (0.1, "is an upper bound")]
)
def test_signal_throughout_makes_drift_an_upper_bound(drifting, size, means):
    t = 0.5 * np.arange(4000)
    y = 0.02 * np.random.default_rng(3).standard_normal(t.size) + 10.0 * np.sin(t / 150.0)
    if size:
        y = y + drifting(np.random.default_rng(4), t, 0.0, size, 20.0)
    estimate = estimate_noise(t, y)
    assert estimate.upper_bound
    assert estimate.separation_cutoff is not None
    assert estimate.drift.white_sigma == pytest.approx(0.02, rel=0.03)
    assert any(note.endswith(means) for note in estimate.notes)


def test_large_drift_is_drift_when_the_caller_says_idle(drifting):
    t = np.arange(6000.0)
    y = drifting(np.random.default_rng(4), t, 0.01, 0.5, 60.0)
    assert estimate_noise(t, y).upper_bound
    idle = estimate_noise(t, y, idle=True)
    assert not idle.upper_bound
    assert idle.drift.sigma_interval[0] < 0.5 < idle.drift.sigma_interval[1]


def test_level_dependence(warm_up):
    t = 0.5 * np.arange(8000)
    rng = np.random.default_rng(5)
    signal = warm_up(t, 200.0)
    same = estimate_noise(t, signal + 0.02 * rng.standard_normal(t.size)).level_dependence
    grows = estimate_noise(t, signal + 0.02 * (1 + signal / 8) * rng.standard_normal(t.size))
    assert same.p_value > 0.001
    assert grows.level_dependence.significant
    assert grows.level_dependence.slope == pytest.approx(0.02 / 8, rel=0.3)


def test_outliers_do_not_reach_sigma():
    t = np.arange(3000.0)
    y = 0.02 * np.random.default_rng(6).standard_normal(3000)
    y[[500, 1500, 2500]] += [3.0, -2.0, 1.0]
    estimate = estimate_noise(t, y)
    assert estimate.outlier_time.tolist() == [500.0, 1500.0, 2500.0]
    assert estimate.drift.white_sigma == pytest.approx(0.02, rel=0.05)


def test_flicker_of_one_step_is_resolution_limited():
    y = np.where(np.random.default_rng(7).random(2000) < 0.02, 25.1, 25.0)
    estimate = estimate_noise(np.arange(2000.0), y)
    assert estimate.resolution == pytest.approx(0.1)
    assert estimate.drift.white_sigma == pytest.approx(0.1 / np.sqrt(12.0))
    assert any("resolution-limited" in note for note in estimate.notes)


def test_constant_and_command_channels_are_silent():
    t = np.arange(500.0)
    constant = estimate_noise(t, np.full(500, 21.5))
    assert constant.drift.white_sigma == 0.0
    assert constant.notes[0].startswith("constant")
    for command in (np.where(t < 100, 0.0, 280.0), np.repeat([0.0, 1250.0, 0.0, 3750.0, 0.0], 100)):
        silent = estimate_noise(t, command)
        assert silent.drift.white_sigma == 0.0
        assert "command" in silent.notes[0]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.full(200, np.nan), "missing"),
        (np.arange(MIN_SAMPLES - 1.0), "too few"),
        (np.empty(0), "too few"),
    ],
)
def test_records_without_an_answer(values, message):
    with pytest.raises(ValueError, match=message):
        estimate_noise(np.arange(float(values.size)), values)


def test_clock_must_increase():
    with pytest.raises(ValueError, match="increase"):
        estimate_noise(np.zeros(100), np.arange(100.0))


def test_missing_readings_and_gaps():
    rng = np.random.default_rng(8)
    t = np.concatenate((np.arange(3000.0), 10000.0 + np.arange(3000.0)))
    y = 0.02 * rng.standard_normal(t.size)
    y[rng.random(t.size) < 0.05] = np.nan
    estimate = estimate_noise(t, y)
    assert estimate.drift.white_sigma == pytest.approx(0.02, rel=0.05)
    assert estimate.spectrum is not None


def test_time_shift_and_scale(drifting):
    t = 0.5 * np.arange(3000)
    y = drifting(np.random.default_rng(9), t, 0.02, 0.03, 20.0)
    a, b = estimate_noise(t, y), estimate_noise(t + 1e6, 100.0 + 2.0 * y)
    assert b.drift.white_sigma == pytest.approx(2.0 * a.drift.white_sigma, rel=1e-3)
    assert b.drift.sigma == pytest.approx(2.0 * a.drift.sigma, rel=1e-2)


class TestMeasured:
    def test_spindle(self):
        path = whole_log("cnc_spindle/spindle_first_28h.csv")
        names = path.read_text().partition("\n")[0].split(",")
        table = np.loadtxt(path, delimiter=",", skiprows=1)
        speed = estimate_noise(table[:, 0], table[:, 1])
        assert "command" in speed.notes[0]
        probe = estimate_noise(table[:, 0], table[:, names.index("ch2_um")])
        assert probe.upper_bound
        # A cycle of 311 s runs through the probes: harmonics of 3.2 mHz stand out.
        nearest = [line.frequency / 3.21e-3 for line in probe.lines[:5]]
        assert np.abs(np.array(nearest) - np.round(nearest)).max() < 0.2
        temperature = estimate_noise(table[:, 0], table[:, names.index("t10_C")])
        assert temperature.resolution == pytest.approx(1e-4)
        assert 0.005 < temperature.drift.sigma < 0.1

    def test_lamp(self):
        table = np.loadtxt(whole_log("daisy/heating_system.csv"), delimiter=",", skiprows=1)
        estimate = estimate_noise(table[:, 0], table[:, 2])
        assert estimate.resolution == pytest.approx(0.244)
        assert estimate.drift.white_sigma == pytest.approx(0.244 / np.sqrt(12.0))

    def test_bursts(self):
        rows = [
            line.split(",")
            for line in whole_log("gantry/run_2021-06-13_morning.csv").read_text().splitlines()
            if line[:1].isdigit()
        ]
        clock = np.array([r[1].replace("/", "-").replace("-", "-", 2) for r in rows], dtype=object)
        stamps = np.array([f"{c[:10]}T{c[11:]}" for c in clock], dtype="datetime64[s]")
        time = (stamps - stamps[0]).astype(float)
        frame = estimate_noise(time, np.array([float(r[3]) for r in rows]))
        assert frame.allan is None
        assert frame.spectrum is None
        assert any("uneven" in note for note in frame.notes)
        assert 0.01 < frame.drift.white_sigma < 0.05
