"""Modes whose loss changes: against an integrator, however far the loss goes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.modes import Modes
from thermaltool.responses.varying_loss import run_with_loss

TIME = np.arange(0.0, 400.0, 0.5)


@pytest.mark.parametrize("hold", ["zero", "first"])
def test_it_is_the_bilinear_equation(hold):
    rate, u = 0.02 + 0.02 * np.sin(TIME / 15), np.cos(TIME / 20)
    cooling = np.append(0.0, np.cumsum(rate[:-1] * np.diff(TIME)))
    modes = Modes(np.array([-0.05 + 0j]), np.array([0.05 + 0j]))

    def slope(t, x):
        k = min(int(t / 0.5), len(TIME) - 1)
        acting = u[k] if hold == "zero" else np.interp(t, TIME, u)
        return 0.05 * acting - (0.05 + rate[k]) * x

    expected = solve_ivp(slope, (0, TIME[-1]), [0.0], t_eval=TIME, max_step=0.1, rtol=1e-8).y[0]
    got = run_with_loss(modes, TIME, u, hold, cooling)
    np.testing.assert_allclose(got, expected, atol=1e-3 if hold == "zero" else 1e-2)


def test_a_double_pole_and_a_pair_decay_by_the_same_factor():
    modes = Modes(np.array([-0.05 + 0j, -0.02 + 0.3j]), np.array([0.1 + 0j, 0.2 - 0.1j]),
                  np.array([0.03, 0.0]))  # fmt: skip
    u = np.where(TIME < 50, 1.0, 0.0)
    cooling = np.where(TIME > 60, 0.03 * (TIME - 60), 0.0)
    got, plain = run_with_loss(modes, TIME, u, "zero", cooling), modes.run(TIME, u, "zero")
    np.testing.assert_allclose(got, plain * np.exp(-cooling), atol=1e-12)


def test_the_integral_may_be_of_any_size():
    modes = Modes(np.array([-0.05 + 0j]), np.array([0.05 + 0j]))
    cooling = 5.0 * TIME  # 2000 in all: e^2000 is no number
    got = run_with_loss(modes, TIME, np.ones(len(TIME)), "zero", cooling)
    assert np.isfinite(got).all()
    assert np.ptp(got[100:]) < 1e-12


@pytest.mark.parametrize("late", [0.0, 3.0])
@pytest.mark.parametrize("hold", ["zero", "first"])
def test_what_entered_last_before_a_loss_ends_is_followed(late, hold):
    """Γ rises to a little over `MAX_SPAN`; the last inputs before have not lost all."""
    poles, weights = np.array([-0.05 + 0j]), np.array([0.05 + 0j])
    modes = DelayedModes(poles, weights, delay=late) if late else Modes(poles, weights)
    rate = np.where(TIME < 40, 2.45, np.where(TIME < 41, 3.0, 0.0))
    cooling = np.append(0.0, np.cumsum(rate[:-1] * np.diff(TIME)))
    got = run_with_loss(modes, TIME, np.where((TIME >= 35) & (TIME < 40), 1.0, 0.0), hold, cooling)
    # From 44 on nothing enters and nothing more is lost.
    start, at = (int(np.flatnonzero(t == TIME)[0]) for t in (45, 60))
    assert got[start] > 1e-4
    assert got[at] == pytest.approx(got[start] * np.exp(-0.05 * (60 - 45)), rel=1e-9)
