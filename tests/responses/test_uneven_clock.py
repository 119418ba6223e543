"""Responses on an uneven clock, against the closed form of a step."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from thermaltool.responses import modes
from thermaltool.responses.modes import Modes
from thermaltool.responses.sample_clock import clock_step

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
    """In blocks of rows; two modes at a time, and one by one."""
    monkeypatch.setattr(modes, "MAX_STATES", most)
    if most < 2**20:
        monkeypatch.setattr(modes, "MAX_CLOCK_STATES", 0)
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
    monkeypatch.setattr(modes, "MAX_CLOCK_STATES", 0)
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
@pytest.mark.parametrize("rows", [3, 8, 3000])
def test_sums_of_blocks_are_steps_of_rows(kind, hold, pause, rows):
    generator = np.random.default_rng(11)
    time = np.append(0.0, np.cumsum(generator.uniform(0.3, 4.0, rows - 1)))
    time[rows // 2 :] += pause
    u, made = np.cumsum(generator.standard_normal(rows)), response(kind)
    steps = np.diff(time)
    here = made._stepped(steps, clock_step(time), u, hold)
    atol = 1e-12 * np.max(np.abs(here))
    np.testing.assert_allclose(made.run(time, u, hold), here, rtol=0, atol=atol)
    clock = modes._uneven_clock(made.poles.tobytes(), steps.tobytes(), clock_step(time), hold)
    counted = sorted([*clock.fast, *(k for each in clock.sums for k in each.own)])
    assert counted == list(range(len(made.poles)))
    # With a pause of a day none is slow enough for a block.
    assert bool(clock.sums) == (pause < 1e5)


def test_a_row_that_is_no_clock_and_a_mode_that_keeps_what_it_gets():
    made = Modes(np.array([0.0, -0.1], complex), np.ones(2, complex))
    for _ in range(2):
        assert made.run(np.zeros(1), np.ones(1), "zero") == [0.0]
    time = np.array([0.0, 1.0, 3.0, 7.0, 8.0])
    expected = time - np.expm1(-0.1 * time) / 0.1
    np.testing.assert_allclose(made.run(time, np.ones(5), "zero"), expected, rtol=1e-12)
