"""The closed forms against the source's integrals, and against its numbers."""

from __future__ import annotations

import numpy as np
import pytest
from machines.heated_rod import HeatedRod
from reference import fraser1997 as fraser
from reference.ring import ring_step, ring_transfer
from scipy.linalg import expm

from thermaltool.responses.conduction import Conduction
from thermaltool.responses.deflection import Deflection, JointDeflection
from thermaltool.responses.modes import Modes
from thermaltool.responses.rod import Rod
from thermaltool.responses.slab import Slab

SOURCES = [fraser.PAIR, fraser.MAIN, *fraser.JOINT]


@pytest.mark.parametrize("source", SOURCES)
def test_closed_form_is_the_printed_integral(source):
    response = Conduction(**source)
    slow, delay = response.slowest(), (source["r"] - source["r0"]) ** 2 / source["alpha"]
    for size in (0.0, 0.1 / slow, 1 / slow, 1 / delay, 4 / delay):
        for s in size * np.array([1, np.exp(1j), 1j, -1j, np.exp(2j)]):
            expected = ring_transfer(s, **source)
            got = response.transfer(np.array([s]))[0]
            assert abs(got - expected) < 1e-12 * response.dc_gain()
            assert abs(got - expected) < 1e-11 * abs(expected)


@pytest.mark.parametrize("source", SOURCES)
def test_step_is_the_printed_integral(source):
    response = Conduction(**source)
    t = np.geomspace(0.05, 20, 60) * response.slowest()
    np.testing.assert_allclose(
        response.step(t), ring_step(t, **source), atol=1e-10 * response.dc_gain()
    )


@pytest.mark.parametrize("source", SOURCES)
def test_far_from_the_origin_nothing_overflows(source):
    s = np.array([1e6, 1e9j, 1e12 + 1e12j, 1e15])
    assert np.all(np.abs(Conduction(**source).transfer(s)) < 1e-3)


def test_a_probe_on_the_ring():
    response = Conduction(2.0, 0.02, 0.1, 0.12, 0.12)
    t = 0.5 * np.arange(1, 400)
    error = np.max(np.abs(response.modes(0.5).step(t) - response.step(t)))
    assert error < 3e-5 * response.dc_gain()


@pytest.mark.parametrize("depth", [0.1, 0.5, 0.9])
def test_a_slab_is_what_cells_of_it_do(depth):
    """Finite volumes of half a percent of the thickness, by their eigenvectors."""
    cells, tau, biot, far = 200, 700.0, 0.8, 2.5
    # Half a cell lies between its middle and a face: in series with the film.
    film = np.zeros(cells)
    film[[0, -1]] = [b / (1 + b / (2 * cells)) for b in (biot, far)]
    links = cells * (2 * np.eye(cells) - np.eye(cells, k=1) - np.eye(cells, k=-1))
    links[[0, -1], [0, -1]] = cells
    rates, shapes = np.linalg.eigh((links + np.diag(film)) * cells / tau)
    # Heat that goes into the face, part of which the film takes before it reaches the cell.
    heat = np.zeros(cells)
    heat[0] = cells / tau / (1 + biot / (2 * cells))
    t = np.geomspace(1e-3, 10, 40) * tau
    rise = shapes @ (
        (1 - np.exp(-np.outer(rates, t))) / rates[:, None] * (shapes.T @ heat)[:, None]
    )
    at = depth * cells - 0.5
    expected = (1 - at % 1) * rise[int(at)] + at % 1 * rise[int(at) + 1]
    slab = Slab(K=expected[-1], tau=tau, biot=biot, biot_far=far, depth=depth)
    assert slab.slowest() == pytest.approx(1 / rates[0], rel=1e-4)
    np.testing.assert_allclose(slab.step(t), expected, atol=2e-4 * expected[-1])
    # The steady state per unit of heat, by the resistances in series.
    inner = (1 + far * (1 - depth)) / (biot + far + biot * far)
    assert expected[-1] == pytest.approx(inner, rel=1e-4)


def test_printed_steady_deflections():
    for axis, values in (("x", fraser.LINEAR_X), ("y", fraser.LINEAR_Y)):
        assert Deflection(**values).dc_gain() == pytest.approx(fraser.LINEAR_STEADY[axis], abs=0.05)


def realization(p):
    """(6.20), (7.19) as state space, the critically damped pairs as chains of two."""
    blocks = [np.array([[-p["a"]]]), np.array([[-p["b"]]])]
    inputs, outputs = [[1.0], [1.0]], [[p["A"] * p["a"]], [p["B"] * p["b"]]]
    for gain, rate in (("D", "d"), ("E", "e")):
        if gain in p:
            blocks.append(np.array([[-p[rate], 1.0], [0.0, -p[rate]]]))
            inputs.append([0.0, 1.0])
            outputs.append([-p[gain] * p[rate], p[gain]])
    n = sum(map(len, blocks))
    A, at = np.zeros((n, n)), 0
    for block in blocks:
        A[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return A, np.concatenate(inputs), np.concatenate(outputs)


DEFLECTIONS = [
    fraser.LINEAR_X,
    fraser.LINEAR_Y,
    fraser.MAIN_X,
    fraser.MAIN_Y,
    fraser.JOINT_1X,
    fraser.JOINT_1Y,
    fraser.JOINT_2X,
    fraser.JOINT_2Y,
]


@pytest.mark.parametrize("values", DEFLECTIONS)
@pytest.mark.parametrize("dt", [0.5, 120.0])
def test_recursion_is_the_matrix_exponential(values, dt):
    response = (JointDeflection if "E" in values else Deflection)(**values)
    A, b, c = realization(values)
    n = len(A)
    held = expm(dt * np.block([[A, b[:, None]], [np.zeros((1, n + 1))]]))
    u = np.random.default_rng(2).uniform(-1, 2, 500)
    x, expected = np.zeros(n), []
    for value in u:
        expected.append(c @ x)
        x = held[:n, :n] @ x + held[:n, n] * value
    got, _ = response.modes(dt).discretize(dt).run(u[:, None])
    scale = np.max(np.abs(expected))
    np.testing.assert_allclose(got[:, 0], expected, atol=1e-11 * scale)
    t = dt * np.arange(200)
    np.testing.assert_allclose(
        response.modes(dt).step(t), response.step(t), atol=1e-12 * np.max(np.abs(response.step(t)))
    )


def test_complex_poles_against_the_matrix_exponential():
    # 1/((s + 0.2)² + 1) has the residue 1/(2i) at −0.2 + i.
    modes = Modes(np.array([-0.2 + 1j]), np.array([-0.5j]))
    A, b, c = np.array([[0.0, 1.0], [-1.04, -0.4]]), np.array([0.0, 1.0]), np.array([1.0, 0.0])
    dt = 0.7
    held = expm(dt * np.block([[A, b[:, None]], [np.zeros((1, 3))]]))
    x, expected = np.zeros(2), []
    for _ in range(50):
        expected.append(c @ x)
        x = held[:2, :2] @ x + held[:2, 2]
    np.testing.assert_allclose(modes.discretize(dt).run(np.ones((50, 1)))[0][:, 0], expected)
    np.testing.assert_allclose(modes.step(dt * np.arange(50)), expected, atol=1e-15)
    assert Modes.from_document(modes.document()).weights[0] == modes.weights[0]


@pytest.mark.parametrize(("source", "probe"), [(0.0, 0.15), (0.0, 0.7), (0.0, 0.95)])
def test_a_rod_is_what_cells_of_it_do(source, probe):
    machine = HeatedRod(cells=400)
    expected = machine.step_responses((probe,), 20.0, 400)[:, 0, 0]
    area = np.pi * machine.radius**2
    cooled = machine.film * 2 * np.pi * machine.radius
    rod = Rod(
        K=1.0,
        tau=machine.length**2 * machine.capacity / machine.conductivity,
        loss=cooled * machine.length**2 / (machine.conductivity * area),
        probe=(int(probe * 400) + 0.5) / 400,
        source=source,
    )
    found = rod.step(20.0 * np.arange(400))
    np.testing.assert_allclose(found, expected / expected[-1] * found[-1], atol=2e-3)
    # All the heat leaves by the side: the mean rise is that of the power over all of the film.
    steady = [Rod(1.0, rod.tau, rod.loss, x) for x in np.linspace(0.0025, 0.9975, 200)]
    shape = np.array([each._shape(np.sqrt(np.array([rod.loss + 0j])))[0].real for each in steady])
    assert np.mean(shape) == pytest.approx(1 / rod.loss, rel=1e-4)


def test_heat_and_probe_of_a_rod_change_places():
    s = 1j * np.geomspace(1e-5, 1.0, 50)
    one, other = Rod(1.0, 700.0, 0.8, 0.8, 0.3), Rod(1.0, 700.0, 0.8, 0.7, 0.2)
    np.testing.assert_allclose(one.transfer(s), other.transfer(s), atol=1e-12)
