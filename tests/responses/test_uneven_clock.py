"""Responses on an uneven clock, against the closed form of a step."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from thermaltool.responses import modes
from thermaltool.responses.modes import Modes
from thermaltool.responses.sample_clock import clock_step
from thermaltool.responses.uneven import uneven_clock

RATES = np.array([0.002, 0.02, 0.4, 1.5])
WEIGHTS = np.array([0.01, -0.03, 0.5, 0.2])
POLE, WEIGHT, DOUBLE = -0.05 + 0.2j, 0.1 - 0.02j, 0.004


def response(kind: str) -> Modes:
    """Four real modes; one of them double, or a complex pair beside them."""
    poles, weights, double = -RATES.astype(complex), WEIGHTS.astype(complex), np.zeros(4)
    if kind == "double":
        double[1] = DOUBLE
    if kind == "complex":  # one pole stands for the pair
        poles, weights = np.append(poles, POLE), np.append(weights, WEIGHT)
        double = np.zeros(5)
    return Modes(poles, weights, double)


def step(kind: str, time: np.ndarray) -> np.ndarray:
    """What a unit step at time 0 does, by hand."""
    y = (WEIGHTS / RATES * -np.expm1(-np.outer(time, RATES))).sum(axis=1)
    if kind == "double":  # of 1 / (s + p)²
        p = RATES[1]
        y += DOUBLE / p**2 * (1 - (1 + p * time) * np.exp(-p * time))
    if kind == "complex":
        y += 2 * (WEIGHT / POLE * (np.exp(POLE * time) - 1)).real
    return y


@pytest.mark.parametrize("kind", ["real", "double", "complex"])
@pytest.mark.parametrize("most", [2**20, 1500, 1])
def test_a_step_is_its_closed_form(kind: str, most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """All modes at once, two at a time, and one by one."""
    monkeypatch.setattr(modes, "MAX_STATES", most)
    lengths = np.random.default_rng(7).uniform(0.3, 4.0, 700).round(3)
    time = np.concatenate([[0.0], np.cumsum(lengths)])
    held, made = np.ones(len(time)), response(kind)
    assert made.run(time, held, "zero") == pytest.approx(step(kind, time), abs=1e-9)
    moments = np.array([0.0, 3.3, 500.0, time[-1] + 20.0])
    assert made.at(time, held, "zero", moments) == pytest.approx(step(kind, moments), abs=1e-9)
    assert made.at(time, held, "zero", np.array([-1.0])) == [0.0]


@pytest.mark.parametrize("kind", ["real", "double", "complex"])
@pytest.mark.parametrize("hold", ["zero", "first"])
def test_stretches_go_on_from_the_state(
    kind: str, hold: modes.Hold, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(8)
    time, u = np.cumsum(rng.uniform(0.3, 4.0, 700)), rng.standard_normal(700)
    made, late = response(kind), rng.uniform(time[0] - 5, time[-1] + 5, 900)
    whole = made.run(time, u, hold), made.at(time, u, hold, late)
    monkeypatch.setattr(modes, "MAX_STRETCH", 60)
    parts = made.run(time, u, hold), made.at(time, u, hold, late)
    for one, other in zip(whole, parts, strict=True):
        assert other == pytest.approx(one, abs=1e-9 * np.max(np.abs(one)))


def test_a_long_record_takes_no_more_for_its_modes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(modes, "MAX_STRETCH", 2000)
    rates = np.geomspace(1e-4, 1.0, 60)
    made = Modes(-rates.astype(complex), rates.astype(complex), np.zeros(60))
    time = np.cumsum(np.random.default_rng(9).uniform(0.5, 1.5, 40_000))
    tracemalloc.start()
    made.run(time, np.ones(len(time)), "zero")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # All modes in all rows would take 480 bytes a row for each of five arrays.
    assert peak < 400 * len(time)


@pytest.mark.parametrize("kind", ["real", "complex"])
@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("pause", [0.0, 100.0, 1e5])
def test_a_clock_that_comes_again_gives_the_same(kind, hold, pause):
    """From the second time on sums of blocks, but for what decays too fast."""
    generator = np.random.default_rng(11)
    time = np.append(0.0, np.cumsum(generator.uniform(0.3, 4.0, 3000)))
    time[1500:] += pause
    made = response(kind)
    for _ in range(3):
        u = np.cumsum(generator.standard_normal(len(time)))
        again = made.run(time, u, hold)
        here = made._stepped(np.diff(time), clock_step(time), u, hold)
        np.testing.assert_allclose(again, here, rtol=0, atol=1e-12 * np.max(np.abs(here)))
    kept = uneven_clock(made.poles.tobytes(), np.diff(time).tobytes(), hold)
    # After a long pause what is slow enough for a block.
    assert sum(len(each.own) for each in kept.sums) >= (2 if pause < 1e5 else 0)
    assert len(kept.fast) + sum(len(each.own) for each in kept.sums) == len(made.poles)
