"""How far drives can move outputs, against what the responses do by formula."""

from __future__ import annotations

import pytest

from thermaltool.model import Drive, Model, Output, Term
from thermaltool.model.span import spans
from thermaltool.responses.deflection import Deflection
from thermaltool.responses.rational import Rational1

A, B, ROOM = "Q_a_W", "Q_b_W", "T_room_degC"
T, Z = "T_a_degC", "d_z_um"


def model(*terms):
    drives = (
        Drive(A, "zero", 0.0, (0.0, 200.0)),
        Drive(B, "zero", 0.0, (0.0, 50.0)),
        Drive(ROOM, "first", "first", (-2.0, 3.0)),
    )
    outputs = tuple(Output(o, "sensor", 0.0, (0.0, 1.0)) for o in (T, Z))
    return Model(drives, outputs, terms, 10.0)


def test_every_drive_moves_an_output_over_its_range():
    found = spans(model(Term(A, T, Rational1(0.1, 600.0)), Term(B, Z, Rational1(-2.0, 900.0))))
    assert found == pytest.approx({T: 20.0, Z: 100.0}, rel=1e-3)
    both = spans(model(Term(A, T, Rational1(0.1, 600.0)), Term(ROOM, T, Rational1(1.0, 900.0))))
    assert both == pytest.approx({T: 25.0, Z: 0.0}, rel=1e-3)


def test_what_bends_one_way_and_then_the_other_is_as_far_as_it_gets():
    # 1 um in the end: 100 (1 - exp(-t/300)) - 99 (1 - exp(-t/1500)).
    found = spans(model(Term(A, Z, Deflection(0.5, 1 / 300, -0.495, 1 / 1500, 0.0, 1.0))))
    assert found[Z] == pytest.approx(53.5, rel=0.01)
