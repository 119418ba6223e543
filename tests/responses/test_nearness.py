"""How near to each other the rates of a fit may be."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.fitting.parametrization import Parametrization
from thermaltool.responses import response_class
from thermaltool.responses.parameters import MIN_RATIO, nearness


def test_rates_that_are_apart_cost_nothing():
    assert nearness([1.0, MIN_RATIO * 1.001, 4.0]) == 0.0
    assert nearness([2.0]) == 0.0
    assert nearness([1.0, 1.0]) == pytest.approx(np.log(MIN_RATIO))
    assert nearness([1.0, 1.02, 4.0]) == pytest.approx(np.log(MIN_RATIO / 1.02))


def test_lags_and_pairs_of_a_deflection_are_apart_each_for_itself():
    one, two = response_class("deflection"), response_class("joint_deflection")
    assert one.search_excess(a=1.0, b=1.02, d=3.0) > 0
    assert one.search_excess(a=1.0, b=3.0, d=1.0) == 0
    assert two.search_excess(a=1.0, b=3.0, d=1.0, e=1.0) > 0
    assert two.search_excess(a=1.0, b=3.0, d=1.0, e=3.0) == 0


def test_rates_that_drives_share_count_once():
    kind = response_class("rational2")
    theta = np.log([100.0, 101.0])
    shared = Parametrization((kind,) * 3, ({"delay": 0.0},) * 3, common=True)
    assert shared.excess(theta) == pytest.approx(nearness([100.0, 101.0]))
    assert shared.apart.excess(np.tile(theta, 3)) == pytest.approx(3 * shared.excess(theta))
