"""Probes that hardly any heat reaches: what is calibrated can be run."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.errors import ThermalToolWarning
from thermaltool.fitting.output_fit import fit_output
from thermaltool.model import Drive
from thermaltool.record import Record
from thermaltool.responses.conduction import MAX_LOSS_LENGTHS, Conduction

TIME = 5.0 * np.arange(400)


def far(lengths, r=5.0, slowest=900.0):
    """A probe so many lengths away over which the heat is lost."""
    a = (lengths / r) ** 2
    return Conduction(1.0, a, 1 / (a * slowest), r)


@pytest.mark.parametrize("lengths", [5.0, 7.0, 8.5, MAX_LOSS_LENGTHS])
@pytest.mark.parametrize("r", [0.3, 5.0, 30.0])
def test_followed_to_the_tolerance_wherever_a_fit_may_go(lengths, r):
    response = far(lengths, r)
    times = np.geomspace(5.0, 2e4, 200)
    wanted = response.step(times)
    found = response.modes(5.0).step(times)
    assert np.max(np.abs(found - wanted)) < 4e-5 * np.max(np.abs(wanted))


def test_beyond_that_it_runs_and_says_how_well():
    with pytest.warns(ThermalToolWarning, match="follow it to"):
        modes = far(25.0).modes(5.0)
    assert np.isfinite(modes.step(TIME)).all()


@pytest.mark.slow
def test_a_fit_of_a_front_that_comes_late_can_be_run():
    """A dead time of 200 s looks like a probe that no heat reaches."""
    heat = np.where((TIME // 400) % 2 == 1, 1.0, 0.0)
    late = np.interp(TIME - 200.0, TIME, heat, left=0.0)
    noise = 0.01 * np.random.default_rng(5).standard_normal(len(TIME))
    record = Record(TIME, {"Q_main_1": heat, "dT_far_K": 3.0 * late + noise})
    drive = Drive("Q_main_1", "zero", 0.0, (0.0, 1.0))
    found = fit_output([record], [drive], "dT_far_K", ["conduction"]).responses[0]
    assert np.sqrt(found.a) * found.r < 1.2 * MAX_LOSS_LENGTHS
    found.modes(5.0)
