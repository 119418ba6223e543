"""A small model, a log of it, and what the commands write about them."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.logs import Log
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.conduction import Conduction
from thermaltool.responses.deflection import Deflection

CONDUCTION = Conduction(K=3.5, a=0.3, alpha=0.004, r=0.7)
DEFLECTION = Deflection(A=50.0, a=0.005, B=20.0, b=0.002, D=-0.02, d=0.004)


def make_log(name: str, time: np.ndarray, **columns: np.ndarray) -> Log:
    return Log(time, dict(columns), name=name)


@pytest.fixture
def model() -> Model:
    names = ("A", "B")
    covariance = np.array([[0.5, -0.2], [-0.2, 0.3]])
    return Model(
        drives=(Drive("Q_main_W", "zero", 0.0, (0.0, 1.0)),),
        outputs=(
            Output("dT_pair1_K", "sensor", 0.0, (0.0, 5.0)),
            Output("d_y_um", "deflection", "first", (0.0, 70.0)),
        ),
        terms=(
            Term("Q_main_W", "dT_pair1_K", CONDUCTION),
            Term("Q_main_W", "d_y_um", DEFLECTION, covariance, names),
        ),
        sample_period=2.0,
    )


@pytest.fixture
def log(model: Model) -> Log:
    """The model's own outputs, the deflection with an offset, and one error of 3 µm."""
    time = 2.0 * np.arange(400)
    heat = np.where(time > 60, 1.0, 0.0)
    outputs = model.simulate(Record(time, {"Q_main_W": heat}))
    outputs["d_y_um"] = outputs["d_y_um"] + 1000.0
    outputs["d_y_um"][200] += 3.0
    return make_log("measured.csv", time, Q_main_W=heat, **outputs)
