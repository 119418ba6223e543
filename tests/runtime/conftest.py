"""Machines made by hand: no calibration, no Bessel functions."""

import numpy as np
import pytest

from thermaltool.estimation.estimator import KalmanEstimator, KernelEstimator, SensorNoise
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.responses.deflection import Deflection
from thermaltool.responses.modes import Modes
from thermaltool.runtime.compensation import offsets
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.settings import Settings

PAIR = Modes(np.array([-0.03, -0.4], complex), np.array([0.15, 0.8], complex))
FAR = Modes(np.array([-0.01, -0.2], complex), np.array([0.03, 0.1], complex))
X = Deflection(10.5, 5.9e-4, 67.1, 9.1e-4, -0.041, 0.0044)
Y = Deflection(100.4, 9.1e-4, 142.0, 1.6e-3, -0.01, 0.009)


def kalman(sensors: int = 1) -> KalmanEstimator:
    names = ("dT_pair1_K", "T_far_degC")[:sensors]
    return KalmanEstimator(
        names,
        ("Q_main_1",),
        ("d_x_um", "d_y_um"),
        tuple((k, 0, (PAIR, FAR)[k]) for k in range(sensors)),
        ((0, 0, X.modes(1.0)), (1, 0, Y.modes(1.0))),
        (0.02,),
        (SensorNoise(0.02, 0.03, 600.0),) * sensors,
    )


def kernel() -> KernelEstimator:
    inverse = Modes(np.array([-1.0 + 2.0j, -0.3]), np.array([0.2 - 0.7j, -0.1]))
    followed = ((0, 0, X.modes(1.0)), (1, 0, Y.modes(1.0)))
    return KernelEstimator("dT_pair1_K", "Q_main_1", ("d_x_um", "d_y_um"), inverse, followed, 7.0)


def machine(estimator) -> Model:
    sensors = (
        Output("dT_pair1_K", "sensor", 0.0, (0.0, 8.0)),
        Output("T_far_degC", "sensor", "first", (0.0, 5.0)),
    )
    deflections = (
        Output("d_x_um", "deflection", "first", (0.0, 80.0)),
        Output("d_y_um", "deflection", "first", (0.0, 250.0)),
    )
    return Model(
        (Drive("Q_main_1", "zero", 0.0, (0.0, 1.0)),),
        sensors[: len(estimator.sensors)] + deflections,
        (Term("Q_main_1", "d_x_um", X), Term("Q_main_1", "d_y_um", Y)),
        0.5,
    ).with_design(estimator.document())


@pytest.fixture(params=["kalman", "two sensors", "kernel"])
def estimator(request):
    return {"kalman": kalman, "two sensors": lambda: kalman(2), "kernel": kernel}[request.param]()


@pytest.fixture
def model() -> Model:
    return machine(kalman())


@pytest.fixture
def make_machine():
    return machine


@pytest.fixture
def make_kalman():
    return kalman


@pytest.fixture
def compensator(model):
    """Builds a compensator; what it reports is in `messages`."""

    def make(model=model, messages=None, sign=-1.0, **settings):
        emit = (messages if messages is not None else []).append
        return offsets(model, Settings(**settings), Messages(emit), sign)

    return make
