"""A fit knows no unit of time: the same log on a clock of nanoseconds and of days."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt

ROWS, TAUS, GAINS = 400, (5.0, 40.0), (0.1, 0.3)


def log(period: float, even: bool) -> pd.DataFrame:
    """Two lags [periods] behind a held power that switches, and noise; the recursion by hand."""
    rng = np.random.default_rng([5, even])
    steps = np.ones(ROWS - 1) if even else rng.integers(5, 16, ROWS - 1) / 10
    power = rng.integers(0, 2, ROWS // 20).repeat(20) * 100.0
    power[:20], rise = 0.0, np.zeros(ROWS)
    for tau, gain in zip(TAUS, GAINS, strict=True):
        x = 0.0
        for k, step in enumerate(steps):
            x += -np.expm1(-step / tau) * (power[k] - x)
            rise[k + 1] += gain * x
    rise += rng.normal(0.0, 0.02, ROWS)
    time = period * np.append(0.0, np.cumsum(steps))
    return pd.DataFrame({"time_s": time, "P_heater_W": power, "dT_heater_K": rise})


def found(frame: pd.DataFrame, command: str) -> list[float]:
    """Time constants [s]."""
    if command == "calibrate":
        fit = tt.calibrate(frame, ["P_heater_W"], sensors=["dT_heater_K"],
                           kinds={"dT_heater_K": "rational2"})  # fmt: skip
        response = fit.model.terms[0].response
    else:
        plan = {"modes": 2} if command == "network" else {"orders": [(2, 2, 1)]}
        fit = tt.identify(frame, ["P_heater_W"], ["dT_heater_K"], structure=command, **plan)
        response = fit.model.terms[0].response
    return sorted((-1 / response.modes(1.0).poles.real).tolist())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "even"),
    [
        ("oe", True),
        ("network", True),
        ("network", False),
        ("calibrate", True),
        ("calibrate", False),
    ],
)
def test_time_constants_scale_with_the_clock(command: str, even: bool) -> None:
    expected = np.array(found(log(1.0, even), command))
    np.testing.assert_allclose(expected, TAUS, rtol=0.03)
    for period in (1e-9, 20e-6, 86400.0):
        np.testing.assert_allclose(np.array(found(log(period, even), command)) / period,
                                   expected, rtol=1e-4)  # fmt: skip


@pytest.mark.parametrize("period", [1e-9, 20e-6, 86400.0])
def test_check_finds_nothing_wrong_with_a_quick_clock_or_a_slow_one(period: float) -> None:
    report = tt.check(log(period, True))
    assert "nothing wrong" in report.table()
    assert f"period {period:g} s" in report.table()
