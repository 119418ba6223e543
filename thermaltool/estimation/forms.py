"""Which form an estimator has, behind what is read beside its sensors."""

from __future__ import annotations

from thermaltool.errors import ModelError
from thermaltool.estimation.estimator import Estimator, KalmanEstimator, KernelEstimator
from thermaltool.estimation.known_inputs import KnownInputEstimator
from thermaltool.estimation.variable_cooling import VariableCoolingEstimator


def linear_kalman(estimator: Estimator) -> KalmanEstimator:
    """The Kalman form in an estimator.

    Raises
    ------
    ModelError
        Another form, or a loss of heat that changes.
    """
    if isinstance(estimator, VariableCoolingEstimator):
        raise ModelError(
            f"{estimator.losses[0].name}: a loss of heat that changes has neither smoother nor "
            "standard errors"
        )
    inner = estimator.inner if isinstance(estimator, KnownInputEstimator) else estimator
    if isinstance(inner, KernelEstimator):
        raise ModelError(
            "smoothing and standard errors take the Kalman form: run thermaltool regularize "
            "--form kalman"
        )
    if not isinstance(inner, KalmanEstimator):
        raise ModelError("every drive is measured: no heat is estimated, nothing to smooth")
    return inner
