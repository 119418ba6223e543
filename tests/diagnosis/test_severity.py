"""How much a cause moves an output, and tolerances as they are typed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference.diagnosed import BED, MODEL, OUTPUT, SOURCE, measured

from thermaltool.diagnosis.severity import severity_of, severity_of_outliers, tolerances_of
from thermaltool.errors import UnitError

OUTPUTS = ["T_near_degC", "d_x_um", "d_y_mm"]


def test_what_a_cause_moves_is_what_it_adds() -> None:
    """By hand: the first-order lag of the bed, times its gain."""
    log = measured()
    bed, warm = log.columns[BED] - log.columns[BED][0], np.zeros(len(log.time))
    for k in range(1, len(warm)):
        # A line between samples, through a lag: fine steps of Euler.
        value = warm[k - 1]
        for part in np.linspace(0.025, 0.975, 20):
            level = bed[k - 1] + part * (bed[k] - bed[k - 1])
            value += 10.0 / 20 * (level - value) / 840.0
        warm[k] = value
    found = severity_of(replace(MODEL, effects=(SOURCE,)), SOURCE, [log])
    assert set(found) == {OUTPUT}
    assert found[OUTPUT].largest == pytest.approx(0.6 * warm.max(), rel=1e-3)
    assert found[OUTPUT].rms == pytest.approx(0.6 * np.sqrt(np.mean(warm**2)), rel=1e-3)


def test_a_cause_that_the_model_does_not_hold_moves_nothing() -> None:
    assert severity_of(MODEL, SOURCE, [measured()]) == {}


def test_outliers_are_as_large_as_they_are_off() -> None:
    log = measured(bed=20.0)
    rows = np.zeros(len(log.time), bool)
    rows[[100, 900, 1500]] = True
    log.columns[OUTPUT][rows] += np.array([30.0, -80.0, 55.0])
    found = severity_of_outliers(MODEL, [log], {(log.digest, OUTPUT): rows})
    assert found[OUTPUT].largest == pytest.approx(80.0, abs=3.0)
    assert found[OUTPUT].rms == pytest.approx(
        np.sqrt((30**2 + 80**2 + 55**2) / len(rows)), rel=0.03
    )


@pytest.mark.parametrize(
    ("given", "found"),
    [
        (["5um"], {"d_x_um": 5.0, "d_y_mm": 0.005}),
        (["5 µm", "d_x_um=2"], {"d_x_um": 2.0, "d_y_mm": 0.005}),
        (["d_y_mm=5e-3"], {"d_y_mm": 0.005}),
        (["T_near_degC=0.5K", "d_x_um=3000nm"], {"T_near_degC": 0.5, "d_x_um": 3.0}),
        (["0.5°C"], {"T_near_degC": 0.5}),
        ([], {}),
    ],
)
def test_tolerances(given: list[str], found: dict[str, float]) -> None:
    assert tolerances_of(given, OUTPUTS) == pytest.approx(found)


def test_a_number_alone_is_in_the_unit_of_the_outputs() -> None:
    assert tolerances_of(["5"], ["d_x_um", "d_y_um"]) == {"d_x_um": 5.0, "d_y_um": 5.0}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("5", "outputs are in degC, um, mm: give a unit"),
        ("d_q_um=5", "no output 'd_q_um'"),
        ("5W", "no output is in W"),
        ("d_x_um=5K", "no output is in K"),
        ("5furlong", "unknown unit 'furlong'"),
        ("small", "not a number with a unit"),
        ("0um", "above zero"),
        ("-5um", "above zero"),
        ("nan", "not a number"),
        ("1e999um", "above zero"),
    ],
)
def test_tolerances_that_cannot_be(given: str, message: str) -> None:
    with pytest.raises(UnitError, match=message):
        tolerances_of([given], OUTPUTS)
