from __future__ import annotations

import json
import time as clock

import numpy as np
import pytest
from scipy.signal import lfilter

from thermaltool.diagnosis.residual import residual_report
from thermaltool.diagnosis.residual_parts import ResidualParts
from thermaltool.errors import FitError

N, DT = 4000, 10.0
TIME = DT * np.arange(N)
# Twenty levels of equal length.
DRIVE = np.array([0, 1, 1, 0, 1, 0, 0, 1, 0, 1, 1, 1, 0, 0, 1, 0, 1, 0, 0, 0.0]).repeat(N // 20)
OUTPUT = lfilter([1 - np.exp(-DT / 900)], [1, -np.exp(-DT / 900)], 50 * DRIVE)


def drift(rng, sigma, tau, n=N):
    """Ornstein-Uhlenbeck."""
    a = np.exp(-DT / tau)
    start = sigma * rng.standard_normal()
    return lfilter(
        [1.0], [1.0, -a], sigma * np.sqrt(1 - a * a) * rng.standard_normal(n), zi=[start]
    )[0]


def report(
    residual, *, time=TIME, measured=OUTPUT, drives=None, others=None, white=0.5, warm=False
):
    drives = {"Q_main_1": DRIVE} if drives is None else drives
    return residual_report(time, residual, measured, drives, others or {}, white, warm=warm)


def test_noise_and_discrepancy_are_told_apart():
    rng = np.random.default_rng(1)
    found = report(0.5 * rng.standard_normal(N) + drift(rng, 1.5, 600.0))
    assert found.noise.white == 0.5
    assert found.noise.discrepancy == pytest.approx(1.5, rel=0.3)
    assert found.noise.time_constant == pytest.approx(600, rel=0.5)
    assert found.above_noise == pytest.approx(1 - 0.25 / (0.25 + 2.25), abs=0.05)
    # Two time constants for each independent row, the white part on top.
    assert found.effective_rows == pytest.approx(N * DT / 1200, rel=0.6)


def test_noise_alone():
    rng = np.random.default_rng(2)
    found = report(0.5 * rng.standard_normal(N))
    assert found.noise.discrepancy == 0.0
    assert found.noise.time_constant is None
    assert found.above_noise < 0.1
    assert found.effective_rows == N


def test_the_parts_of_a_residual_add_up():
    rng = np.random.default_rng(3)
    found = report(0.5 * rng.standard_normal(N) + drift(rng, 1.5, 600.0))
    white = report(0.5 * rng.standard_normal(N), white=2.0).parts
    assert (white.noise, white.rest) == (white.rms, 0.0)
    assert found.parts.calibration == 0.0
    assert found.parts.rest**2 / found.parts.rms**2 == pytest.approx(found.above_noise)
    shown = ResidualParts.of(found.parts.rms, 0.5, 0.7)
    assert shown.rest**2 == pytest.approx(0.3 * shown.rms**2)
    assert shown.calibration**2 == pytest.approx(0.7 * shown.rms**2 - 0.25)


@pytest.mark.slow
def test_tests_hold_their_level_on_coloured_noise():
    # 200 tests at 1 %: more than 8 rejections have a chance of 3e-4.
    rejected = {"Q_main_1": 0, "T_room_degC": 0, "white": 0}
    for seed in range(200):
        rng = np.random.default_rng(seed)
        residual = 0.5 * rng.standard_normal(1000) + drift(rng, 1.0, 900.0, 1000)
        others = {"T_room_degC": drift(rng, 1.0, 3000.0, 1000)}
        found = report(residual, time=TIME[:1000], measured=OUTPUT[:1000],
                       drives={"Q_main_1": DRIVE[:1000]}, others=others)  # fmt: skip
        for each in found.dependences:
            rejected[each.channel] += each.p_value < 0.01
        rejected["white"] += found.white_p < 0.01
    assert max(rejected.values()) <= 8
    # The textbook's test of the same residual rejects nearly always.
    assert abs(np.corrcoef(residual[1:], residual[:-1])[0, 1]) > 5 * 2.58 / np.sqrt(1000)


def test_a_missed_part_of_the_response_is_seen():
    rng = np.random.default_rng(5)
    found = report(0.5 * rng.standard_normal(N) + 0.05 * OUTPUT,
                   others={"T_room_degC": drift(rng, 1.0, 3000.0)})  # fmt: skip
    first, second = found.dependences
    assert (first.channel, second.channel) == ("Q_main_1", "T_room_degC")
    assert first.correlation > first.bound
    assert first.p_value < 1e-6
    assert second.p_value > 0.01


def test_the_lag_of_a_dependence():
    rng = np.random.default_rng(6)
    pulses = np.zeros(N)
    pulses[::250] = 1.0
    late = np.roll(pulses, 24)  # 240 s
    late[:24] = 0.0
    found = report(0.1 * rng.standard_normal(N) + 2 * late, drives={"U_V": pulses}, white=0.1)
    low, high = found.dependences[0].lag
    assert low <= 240 <= high


def test_what_the_description_does_not_cover_is_not_white():
    rng = np.random.default_rng(7)
    wave = 0.5 * np.sin(2 * np.pi * TIME / 60)
    assert report(0.5 * rng.standard_normal(N) + wave).white_p < 1e-6


@pytest.mark.parametrize(("period", "band"), [(20000, 0), (40, -1)])
def test_bands(period, band):
    rng = np.random.default_rng(8)
    found = report(0.5 * rng.standard_normal(N) + np.sin(2 * np.pi * TIME / period + 1))
    shares = [each.power for each in found.bands]
    assert sum(shares) == pytest.approx(1)
    assert shares[band] > 0.85
    assert found.bands[0].longest is None
    assert found.bands[-1].shortest is None
    for slow, fast in zip(found.bands[:-1], found.bands[1:], strict=True):
        assert slow.shortest == fast.longest


def test_a_trend_leaks_into_no_fast_band():
    rng = np.random.default_rng(9)
    found = report(0.01 * rng.standard_normal(N) + TIME / 1e4, white=0.01)
    assert found.bands[-1].power < 1e-3


def test_worst_stretch():
    rng = np.random.default_rng(10)
    residual = 0.5 * rng.standard_normal(N)
    residual[1000:1400] += 3.0
    worst = report(residual).worst
    assert worst.record == 0
    assert worst.start == pytest.approx(10000, abs=1000)
    assert worst.stop == pytest.approx(14000, abs=1000)
    assert worst.rms == pytest.approx(3.04, rel=0.15)
    assert worst.power > 0.7
    assert worst.time == pytest.approx(0.1, abs=0.03)


def test_conditions():
    rng = np.random.default_rng(11)
    slope = np.gradient(OUTPUT)
    cooling = slope < -0.1 * np.quantile(np.abs(slope), 0.9)
    speed = np.where(TIME < 20000, 500.0, 3000.0)
    room = 20 + TIME / 1e4
    residual = 0.5 * rng.standard_normal(N) + 2.0 * cooling
    found = {
        (c.channel, c.name): c
        for c in report(residual, others={"n_rpm": speed, "T_room_degC": room}).conditions
    }
    assert found[None, "cooling"].mean > 1.5
    assert abs(found[None, "heating"].mean) < 0.5
    assert sum(found[None, name].rows for name in ("heating", "cooling", "idle")) == N
    assert sum(found[None, name].power for name in ("heating", "cooling", "idle")) == pytest.approx(
        1
    )
    assert found["Q_main_1", "at 0"].rms > 2 * found["Q_main_1", "at 1"].rms
    assert found["n_rpm", "at 500"].rows == 2000
    thirds = [c for (channel, _), c in found.items() if channel == "T_room_degC"]
    assert [c.rows for c in thirds] == pytest.approx([N / 3] * 3, abs=2)
    assert thirds[0].high == thirds[1].low


def test_a_residual_that_comes_for_good_is_worst_from_there_on():
    """The model is right for two fifths of the log, so that its median lies amid what is wrong."""
    rng = np.random.default_rng(13)
    begin = 0.4 * TIME[-1]
    rise = 20.0 * -np.expm1(-np.clip(TIME - begin, 0, None) / 8000.0)
    found = report(7.0 + rise + 0.5 * rng.standard_normal(N), drives={"n_rpm": TIME // 1000})
    assert begin < found.worst.start < begin + 0.3 * TIME[-1]
    assert found.worst.stop == TIME[-1]
    (early, *_) = (c for c in found.conditions if c.channel == "n_rpm")
    assert abs(early.mean) < 0.1


def test_a_residual_that_is_soon_there_and_stays_is_worst_while_it_stays():
    rng = np.random.default_rng(14)
    residual = 20.0 * -np.expm1(-TIME / 800.0) + 0.5 * rng.standard_normal(N)
    found = report(residual)
    assert found.worst.start < 0.1 * TIME[-1]
    assert found.worst.stop == TIME[-1]
    assert found.worst.rms == pytest.approx(20.0, rel=0.05)
    # Where the first rows tell no zero, the level that most rows share is taken for right.
    begun = report(residual, warm=True).worst
    assert begun.start == 0.0
    assert begun.stop < 0.2 * TIME[-1]


def test_an_arbitrary_zero_is_no_misfit():
    rng = np.random.default_rng(12)
    residual = 0.5 * rng.standard_normal(N)
    found = report(residual + 40.0)
    assert found.above_noise < 0.1
    assert found.mean == pytest.approx(40, abs=0.1)
    assert found.spread == pytest.approx(0.5, rel=0.1)
    assert found.dependences[0].p_value == pytest.approx(report(residual).dependences[0].p_value)


def test_records_one_after_the_other():
    rng = np.random.default_rng(13)
    half = N // 2
    time = np.concatenate([TIME[:half], TIME[:half]])
    residual = 0.5 * rng.standard_normal(N) + np.repeat([0.0, 30.0], half)
    residual[half + 500 : half + 700] += 4.0
    found = report(residual, time=time)
    assert found.worst.record == 1
    assert found.worst.start == pytest.approx(5000, abs=600)
    assert found.spread < 1.5


def test_missing_rows_are_left_out():
    rng = np.random.default_rng(14)
    residual, bed = 0.5 * rng.standard_normal(N), drift(rng, 1.0, 3000.0)
    residual[100:1100:2] = np.nan
    bed[:50] = np.nan
    found = report(residual, others={"T_bed_degC": bed, "T_dead_degC": np.full(N, np.nan)})
    assert found.rows == N - 500
    assert [d.channel for d in found.dependences if d.p_value < 1e-4] == []
    assert "T_dead_degC" not in {d.channel for d in found.dependences}
    json.dumps(found.document(), allow_nan=False)


def test_an_exact_model():
    found = report(np.zeros(N), white=0.0)
    assert (found.rms, found.above_noise, found.white_p) == (0.0, 0.0, 1.0)
    json.dumps(found.document(), allow_nan=False)


def test_too_few_rows():
    with pytest.raises(FitError, match="3 rows"):
        report(np.r_[np.zeros(3), np.full(N - 3, np.nan)])


def test_the_time_taken_grows_with_the_rows():
    rng = np.random.default_rng(15)

    def taken(n: int) -> float:
        time = DT * np.arange(n)
        columns = {name: drift(rng, 1.0, 3000.0, n) for name in ("T_a_degC", "T_b_degC")}
        residual = drift(rng, 1.0, 600.0, n) + rng.standard_normal(n)
        once = []
        for _ in range(5):
            start = clock.thread_time()
            residual_report(time, residual, residual, columns, {}, 1.0, 0.0)
            once.append(clock.thread_time() - start)
        return min(once)

    assert taken(40_000) < 8 * taken(10_000)  # 16 were it by their square
