"""Which network is nested in which, and which is enough."""

from __future__ import annotations

import numpy as np
import pytest
from machines.lumped import Chain, declaration, inputs

from thermaltool.errors import FitError
from thermaltool.fitting.rc.compare import compare, is_nested
from thermaltool.fitting.rc.declaration import load_network
from thermaltool.fitting.rc.fit import fit_network
from thermaltool.record import Record

CHAINS = {1: Chain((800.0,), (3.0,)), 2: Chain((800.0, 4000.0), (5.0, 8.0))}


def network(document):
    return load_network(document, "test", "<test>")


def fits(chain, sizes, rng):
    time, heat, room = inputs(400, 10.0, rng)
    readings = chain.run(time, heat, room, rng)
    log = Record(time, {"Q_motor_W": heat, "T_room_degC": room, "T_motor_degC": readings})
    found = []
    for n in sizes:
        known = found[-1].values if found else {}
        at_most = min((f.deviance for f in found), default=np.inf)
        declared = network(declaration(n))
        found.append(fit_network(declared, [log], known=known, at_most=at_most))
    return found


def test_a_chain_is_nested_in_a_longer_one_and_not_the_reverse():
    one, two, three = (network(declaration(n)) for n in (1, 2, 3))
    assert is_nested(one, two)
    assert is_nested(one, three)
    assert is_nested(two, three)
    assert not is_nested(two, one)


def test_another_place_of_the_sensor_or_of_heat_is_not_nested():
    moved = declaration(2)
    moved["nodes"]["frame"]["measured"] = moved["nodes"]["motor"].pop("measured")
    assert not is_nested(network(declaration(1)), network(moved))
    elsewhere = declaration(2)
    elsewhere["heat"]["motor"]["node"] = "frame"
    assert is_nested(network(declaration(1)), network(elsewhere))
    assert not is_nested(network(declaration(2)), network(elsewhere))


def test_what_holds_in_the_larger_one_alone_is_not_nested():
    held = declaration(2)
    held["nodes"]["motor"]["capacity"] = {"fixed": 700.0}
    assert not is_nested(network(declaration(1)), network(held))


@pytest.mark.slow
def test_the_chain_that_made_the_log_is_sufficient():
    rng = np.random.default_rng(31)
    found = compare(fits(CHAINS[2], (1, 2), rng))
    assert found.sufficient.network.name == "2 nodes"
    ratio = next(t for t in found.tests if (t.smaller, t.larger) == ("1 nodes", "2 nodes"))
    assert ratio.dof == 2
    assert ratio.p_value < 1e-10


@pytest.mark.parametrize(
    ("logs", "least"),
    [
        # At a size of 5 %, three wrong ones of 6, or four of 12, have a probability of 0.002.
        pytest.param(6, 4, marks=pytest.mark.slow),
        pytest.param(12, 9, marks=pytest.mark.study),
    ],
)
def test_likelihood_ratio_chooses_the_size(logs, least):
    rng = np.random.default_rng(32)
    for truth, chain in CHAINS.items():
        sizes = [
            len(compare(fits(chain, (1, 2, 3), rng)).sufficient.network.nodes) for _ in range(logs)
        ]
        assert sizes.count(truth) >= least


@pytest.mark.slow
def test_other_readings_are_not_compared():
    rng = np.random.default_rng(33)
    (one,), (two,) = (fits(CHAINS[1], (1,), rng) for _ in range(2))
    with pytest.raises(FitError, match="two networks are called"):
        compare([one, two])
