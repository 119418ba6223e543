"""A measured drive that acts late, on a clock that has gaps and jitter."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.estimation.estimator import load_estimator
from thermaltool.estimation.known_inputs import Feedforward, KnownInput, KnownInputEstimator
from thermaltool.responses.delay import DelayedModes


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("delay", [45.0, 53.2])
def test_what_acts_late_is_followed_over_lost_rows_and_jitter(hold, delay):
    generator = np.random.default_rng(4)
    time = 15.0 * np.arange(600)
    jitter = np.where(np.arange(600) > 300, generator.choice([-0.5, 0.0, 0.5], 600), 0.0)
    kept = np.ones(600, bool)
    kept[[50, 120, 121, 130]], kept[200:240] = False, False
    time = (time + jitter)[kept]
    level = np.repeat(generator.uniform(0.0, 10.0, 30), 20)
    level = (level if hold == "zero" else np.convolve(level, np.ones(40) / 40, "same"))[kept]
    poles, weights = np.array([-1 / 300, -1 / 2000]), np.array([0.01, 0.002])
    late = DelayedModes(poles.astype(complex), weights.astype(complex), delay=delay, period=15.0)
    known = (KnownInput("T_coolant_degC", hold, "drive"),)
    estimator = KnownInputEstimator(Feedforward(("d_x_um",)), known, (), ((0, 0, late),))
    level = level - level[0]
    found = estimator.run(time, level[:, None])[:, 0]
    exact = late.run(time, level, hold)
    # Lost rows cost nothing; a clock that jitters by 3 % of a period moves what is on its way.
    even = time < 4000
    assert found[even] == pytest.approx(exact[even], abs=1e-9)
    assert found == pytest.approx(exact, abs=1e-2 * np.ptp(exact))
    # Any longer pause, of no whole number of periods.
    assert len(estimator.recursion(1237.0).F) == len(estimator.recursion(15.0).F)
    again = load_estimator(estimator.document())
    assert again.run(time, level[:, None])[:, 0] == pytest.approx(found, abs=1e-12)
