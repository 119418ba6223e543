"""The rule of Zhu, Ni, Shih (2008, 3.1 and 4) on their rod, by its modes in closed form."""

import numpy as np
import pytest
from machines.expanding_rod import PLACES, ROD

from thermaltool.errors import FitError
from thermaltool.placement.mode_rule import dominant_modes, place_by_modes

# cos(nπx) between insulated ends; rates by conduction and the film, heat at the first end.
ORDER = np.arange(200)
RATES = 2 * 20.0 / (ROD.radius * ROD.capacity) + (ORDER * np.pi) ** 2 * 60.5 / ROD.capacity
SHAPES = np.cos(np.outer(PLACES, ORDER) * np.pi)
WEIGHTS = np.where(ORDER, np.sqrt(2), 1) / RATES


def test_time_constants_and_weights_of_the_source():
    assert 1 / RATES[:4] / 60 == pytest.approx([141, 56.5, 20.1, 9.6], rel=0.02)
    assert WEIGHTS[:3].sum() / WEIGHTS[:20].sum() == pytest.approx(0.845, abs=0.02)


def test_sensors_at_a_tenth_and_at_half_of_the_rod():
    found = place_by_modes(SHAPES, WEIGHTS, np.array(PLACES))
    assert [PLACES[k] for k in found.sensors] == [0.1, 0.5]
    assert found.dominant == (0, 1, 2) == tuple(sorted(found.served))
    # The first serves modes I and II, the second mode III.
    assert found.modes == (0, 2)


def test_forbidden_places_and_a_source_at_the_other_end():
    found = place_by_modes(SHAPES, WEIGHTS, 1 - np.array(PLACES))
    assert [PLACES[k] for k in found.sensors][:1] == [0.9]
    found = place_by_modes(SHAPES, WEIGHTS, np.array(PLACES), forbidden=[0])
    assert 0 not in found.sensors


def test_bad_inputs_are_named():
    distance = np.array(PLACES)
    with pytest.raises(FitError, match=r"1 sensors do not see 3 dominant modes: mode 3"):
        place_by_modes(SHAPES, WEIGHTS, distance, sensors=1)
    with pytest.raises(FitError, match="forbidden"):
        place_by_modes(SHAPES, WEIGHTS, forbidden=range(9))


def test_dominant_modes_by_their_part_of_the_weights():
    assert dominant_modes(np.array([1.0, -5.0, 3.0, 0.1]), 0.8) == (1, 2)
