"""A log whose values are not in the units of its names, found by the course of the others."""

import numpy as np
import pytest

from thermaltool.diagnosis.course_units import course_suspects
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.rational import Rational1

TIME = np.arange(0.0, 3600.0, 10.0)
HEAT = np.where((TIME > 300) & (TIME < 2000), 40.0, 0.0)  # far less than at the calibration
MODEL = Model(
    drives=(Drive("Q_a_W", "zero", 0.0, (0.0, 1500.0)),),
    outputs=(
        Output("T_a_degC", "sensor", 20.0, (0.0, 40.0)),
        Output("d_x_um", "deflection", "first", (0.0, 200.0)),
    ),
    terms=(
        Term("Q_a_W", "T_a_degC", Rational1(0.03, 900.0)),
        Term("Q_a_W", "d_x_um", Rational1(0.15, 600.0)),
    ),
    sample_period=10.0,
)


def log(heat=1.0, temperature=1.0, displacement=1.0, noise=0.02):
    draw = np.random.default_rng(5)

    def warmed(gain, tau):
        y = np.zeros(len(TIME))
        for k in range(1, len(TIME)):
            kept = np.exp(-10.0 / tau)
            y[k] = kept * y[k - 1] + (1 - kept) * gain * HEAT[k - 1]
        return y + noise * draw.standard_normal(len(TIME))

    columns = {
        "Q_a_W": heat * HEAT,
        "T_a_degC": 20.0 + temperature * warmed(0.03, 900.0),
        "d_x_um": 7.0 + displacement * warmed(0.15, 600.0),
    }
    return Record(TIME, columns)


@pytest.mark.parametrize(
    ("scales", "found"),
    [
        ({"displacement": 1e-3}, [("d_x_um", "mm")]),
        ({"displacement": 1e3}, [("d_x_um", "nm")]),
        ({"heat": 1e3}, [("Q_a_W", "mW")]),
        ({"heat": 1e-3}, [("Q_a_W", "kW")]),
        ({}, []),
        ({"displacement": 10.0}, []),  # a wrong gain, and no unit
        ({"displacement": -1e-3}, []),
        ({"displacement": 1e-3, "noise": 20.0}, []),  # no course is seen
    ],
)
def test_what_follows_the_course_at_another_size_is_in_another_unit(scales, found):
    suspects = course_suspects(MODEL, log(**scales))
    assert [(each.channel, each.unit) for each in suspects] == found
    assert all(each.by_model for each in suspects)


def test_a_dead_reading_is_in_no_unit():
    still = log()
    still.columns["d_x_um"][:] = 7.0
    assert course_suspects(MODEL, still) == ()
