"""Responses of a machine that has come to lose heat at another rate, beside the machine itself."""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from thermaltool.errors import ModelError
from thermaltool.model import Drive, Model, Output, Term, characteristics, dumps, loads
from thermaltool.responses import response_class
from thermaltool.responses.deflection import Deflection
from thermaltool.responses.losing import losing
from thermaltool.responses.modes import Modes
from thermaltool.responses.rational import Rational1, Rational2, rational_kind

HEAT, BASE = "P_heater_W", "T_base_degC"
TIME = np.arange(0.0, 9000.0, 10.0)


def test_a_lag_that_loses_twice_as_fast_has_half_the_gain_and_the_time_constant():
    found = losing(Rational1(K1=0.8, tau1=600.0), (1 / 600, 1 / 600), 600.0)
    np.testing.assert_allclose(found.step(TIME), 0.4 * -np.expm1(-TIME / 300.0), atol=1e-12)
    assert found.slowest() == pytest.approx(300.0)


def test_all_modes_of_any_response_decay_faster_by_one_rate():
    """h(t) exp(−rt): the impulse response of x' = A x + B u − r x, also with a delay."""
    pair = rational_kind(1, 1)(0.5, 2.0, 0.02, 0.3, 0.4, 300.0, delay=40.0)
    double = Deflection(1 / 300, 1 / 100, 1 / 500, 1.0, 1.0, 1.0)
    for response in (Rational2(3.0, 700.0, -1.2, 150.0), pair, double):
        rate = 0.5 / 700.0
        found = losing(response, (rate, rate), 700.0)
        s = 1j * np.geomspace(1e-5, 1e-1, 30)
        # What enters late enters as large.
        late = np.exp(getattr(response, "delay", 0.0) * rate)
        np.testing.assert_allclose(found.transfer(s), late * response.transfer(s + rate), rtol=1e-8)


def test_bodies_follow_a_room_that_heat_is_lost_to_at_any_rate():
    """x' = A x − A 1 u and x' = (A − r) x − (A − r) 1 u, of two lumps, by their eigenvalues."""
    A = np.array([[-5.75e-3, 3.75e-3], [1.67e-3, -2.33e-3]])

    def lumps(A):
        rates, vectors = np.linalg.eigh(A) if np.allclose(A, A.T) else np.linalg.eig(A)
        gains = vectors * np.linalg.solve(vectors, np.ones(2))
        return [(float(k), float(-1 / r)) for k, r in zip(gains[0], rates, strict=True)]

    rate = 1e-3
    (k1, t1), (k2, t2) = lumps(A)
    found = losing(Rational2(k1, t1, k2, t2), (rate, rate), max(t1, t2), (0.1, 0.2), to_drive=True)
    expected = sum(k * -np.expm1(-TIME / t) for k, t in lumps(A - rate * np.eye(2)))
    np.testing.assert_allclose(found.step(TIME), expected, atol=1e-9)


@pytest.mark.parametrize("to_drive", [False, True])
def test_two_modes_that_are_near_each_other_are_a_double_one(to_drive):
    apart, rate = 1e-5, 1 / 200
    double = Modes(np.array([-rate + 0j]), np.array([0.3 + 0j]), np.array([2e-3]))
    low, high = -rate * (1 - apart), -rate * (1 + apart)
    step = 2e-3 / (low - high)
    near = Modes(np.array([low, high], complex), np.array([0.15 + step, 0.15 - step], complex))
    change = (-2e-4, -6e-4), 700.0, (0.1, 0.3), to_drive
    one, two = (losing(Bank(modes), *change).modes(1.0) for modes in (double, near))
    np.testing.assert_allclose(one.step(TIME), two.step(TIME), rtol=1e-4)


@dataclass(frozen=True)
class Bank:
    """Modes as a response."""

    own: Modes
    kind = "bank"
    searched = gains = ()
    fixed: ClassVar = {}

    def modes(self, dt):
        return self.own


@pytest.mark.parametrize("rate", [-0.9 / 700, -0.3 / 700, 0.5 / 700, 9 / 700])
def test_it_stays_stable_and_modes_weigh_what_is_said(rate):
    found = losing(Rational2(3.0, 700.0, 1.0, 7e4), (rate, 3 * rate), 700.0, (0.1, -0.2))
    before, after = found.before_loss.modes(1.0), found.modes(1.0)
    assert np.all(after.poles.real < 0)
    np.testing.assert_allclose(after.weights / before.weights, 1.1)
    fast = losing(Rational1(1.0, 0.7), (rate, rate), 700.0, (0.1, -0.2))
    ratio = fast.modes(1.0).weights / fast.before_loss.modes(1.0).weights
    np.testing.assert_allclose(ratio, 0.8, rtol=1e-3)


def test_no_mode_comes_to_be_slower_than_one_that_was():
    times = np.geomspace(1.0, 600.0, 40)
    found = losing(Rational1(1.0, 600.0), (-0.5 / 600, -4 / 600), 600.0)
    changed = [found.changed(float(each)) for each in times]
    assert np.all(np.diff(changed) > 0)
    assert found.slowest() == pytest.approx(changed[-1])
    assert found.changed(0.0) == 0.0


def test_one_change_after_the_other_is_both():
    first = losing(Rational2(3.0, 700.0, -1.2, 150.0), (7e-4, 1e-3), 700.0, (0.1, -0.1))
    back = losing(first, (-7e-4, -1e-3), 466.0, (1 / 1.1 - 1, 1 / 0.9 - 1))
    assert type(back) is type(first)
    np.testing.assert_allclose(back.step(TIME), back.before_loss.step(TIME), rtol=1e-9, atol=1e-12)


def test_damping_and_period_are_those_of_the_changed_pair():
    pair = rational_kind(0, 1)(0.5, 2.0, 0.01, 0.3)
    term = Term(HEAT, BASE, losing(pair, (2 / 300, 2 / 300), 300.0))
    (found,) = characteristics(term).oscillations
    pole = term.response.modes(1.0).poles[0]
    assert found.damping.value == pytest.approx(-pole.real / abs(pole))
    assert found.period.value == pytest.approx(2 * np.pi / abs(pole))


def test_it_travels_in_the_model_file_and_to_other_processes():
    changed = losing(Rational2(3.0, 700.0, -1.2, 150.0), (7e-4, 1e-3), 700.0, (0.1, -0.1))
    kept = Model(
        (Drive(HEAT, "zero", 0.0, (0.0, 1.0)),),
        (Output(BASE, "sensor", 20.0, (0.0, 3.0)),),
        (Term(HEAT, BASE, changed),),
        10.0,
    )
    assert loads(dumps(kept)).terms == kept.terms
    assert pickle.loads(pickle.dumps(changed)) == changed


@pytest.mark.parametrize("kind", ["_loss", "rational3_loss_loss", "lag_bank_loss"])
def test_kinds_that_are_none(kind):
    with pytest.raises(ModelError, match="unknown response"):
        response_class(kind)
