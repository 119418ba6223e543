"""Candidates on a body: duty cycles against a simulation, sites, the rod of the source."""

import numpy as np
import pytest

import thermaltool as tt
from thermaltool.errors import FitError, ModelError
from thermaltool.placement.body_candidates import CORRELATION_TIMES, duty_cycles_of, sites_of


def test_moments_are_those_of_a_heat_that_switches_at_random(rod):
    """Against implicit steps of the equations of the mesh, row by row."""
    source = tt.thermal_modes(rod)
    equations, modes = source.modes.equations, source.modes
    sites = sites_of(modes, source.body, ("T_1_degC", "T_5_degC"))
    cycle = duty_cycles_of(modes, sites, 1e6 * equations.deflections, np.array([1000.0]))[1]
    told = np.vstack([cycle.readings, cycle.deflections])
    told = told @ told.T
    correlation = CORRELATION_TIMES[1] * modes.time_constants[0]
    dt, count, machines = correlation / 20, 4000, 200
    inverse = np.linalg.inv(equations.capacity.toarray() / dt + equations.conduction.toarray())
    step = inverse @ equations.capacity.toarray() / dt
    rng = np.random.default_rng(5)
    on = rng.random(machines) < 0.5
    state = np.zeros((len(step), machines))
    rows = np.vstack([sites.shapes @ np.linalg.pinv(modes.shapes), 1e6 * equations.deflections])
    total = np.zeros((3, 3))
    for k in range(count):
        on ^= rng.random(machines) < 0.5 * dt / correlation  # a switch draws a level anew
        state = step @ state + inverse @ equations.loads * (1000.0 * on)
        if k >= count // 4:
            seen = rows @ state
            total += seen @ seen.T
    found = total / (machines * (count - count // 4))
    assert found == pytest.approx(told, rel=0.05)


def test_two_sensors_of_the_rod_are_those_of_the_source(rod):
    """Zhu, Ni, Shih 2008: of nine candidates 0.1 m and 0.5 m; the design misses no more."""
    points = tuple(rod["points"])
    rule = tt.place_on_body(rod, candidates=points, criterion="modes").sets[0]
    assert rule.sensors == ("T_1_degC", "T_5_degC")
    design = tt.place_on_body(rod, candidates=points, sensors=2).sets[-1]
    assert design.errors[0] <= rule.errors[0]


@pytest.mark.slow
def test_more_sensors_leave_less_unknown_and_the_design_is_no_worse_than_the_rule(block):
    found = tt.place_on_body(block, sensors=4, forbid=["right"])
    errors = np.array([each.errors for each in found.sets])[:, 0]
    assert np.all(np.diff(errors) < 0)
    assert all(at[0] < 0.2 for at in found.places.values())
    rule = tt.place_on_body(block, criterion="modes", forbid=["right"]).sets[0]
    same = found.sets[len(rule.sensors) - 1]
    assert same.errors[0] <= rule.errors[0] * (1 + 1e-9)
    assert found.frame["rmse"].tolist() == errors.tolist()


def test_a_dear_boundary_is_left(block):
    sides = {"left": (0, 0.0), "right": (0, 0.2), "front": (1, 0.0), "back": (1, 0.1),
             "bottom": (2, 0.0), "top": (2, 0.08)}  # fmt: skip
    free = tt.place_on_body(block, sensors=1)
    (at,) = free.places.values()
    boundary, (axis, end) = next(
        (name, side) for name, side in sides.items() if at[side[0]] == pytest.approx(side[1])
    )
    dear = tt.place_on_body(block, sensors=1, costs={boundary: 5.0})
    ((*other,),) = dear.places.values()
    assert other[axis] != pytest.approx(end)
    # Of two places that mirror each other the other one may be as good.
    assert dear.sets[0].errors[0] >= free.sets[0].errors[0] * (1 - 1e-6)


@pytest.mark.parametrize(
    ("changes", "options", "words"),
    [
        ({}, {"outputs": "d_z_um"}, "no deflection is called d_z_um"),
        ({}, {"candidates": "T_10_degC"}, "no point is called T_10_degC"),
        ({}, {"forbid": ["rigth"]}, "no point or boundary is called rigth .near: right"),
        ({}, {"forbid": ["side"]}, "all are forbidden"),
        ({}, {"sensors": 40}, "40 sensors of 23 candidates"),
        ({}, {"reading_noise": 1e-7}, "the least that is computed with"),
        ({}, {"costs": {"left": 2.0}, "criterion": "modes"}, "knows no costs"),
        ({}, {"costs": {"left": -2.0}}, "above zero"),
        ({}, {"candidates": ["T_5_degC"], "criterion": "modes"}, "no candidate is near Q_motor_W"),
        ({"deflections": {}}, {}, "no .deflections."),
    ],
)
def test_bad_input_is_one_clear_line(rod, changes, options, words):
    with pytest.raises((ModelError, FitError), match=words):
        tt.place_on_body(rod | changes, **options)


def test_far_candidates_and_fewer_sensors_than_modes_are_told(rod):
    far, few = tt.place_on_body(rod, candidates=["T_5_degC"]).notes[:2]
    assert "the nearest, T_5_degC, is 0.5 m away" in far
    assert few.startswith("1 sensor for 3 modes that carry 80 % of the weights")
    assert not tt.place_on_body(rod, sensors=3).notes


def test_a_criterion_of_logs_is_refused(rod):
    with pytest.raises(ValueError, match="of logs"):
        tt.place_on_body(rod, criterion="held-out")


def test_a_name_that_is_given_twice_is_refused(rod):
    with pytest.raises(ValueError, match="T_1_degC is given twice among the sensors"):
        tt.place_on_body(rod, candidates=["T_1_degC", "T_1_degC"])


def test_a_point_may_be_forbidden_among_the_nodes(rod):
    free = tt.place_on_body(rod, sensors=1).places
    rod["points"]["T_best_degC"] = {"at": next(iter(free.values()))[0]}
    other = tt.place_on_body(rod, sensors=1, forbid=["T_best_degC"]).places
    assert not set(free) & set(other)
