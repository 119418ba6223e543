"""How far a computed signal is from a measured one."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# Share of the spread that stands for no error.
TINY = 1e-12


@dataclass(frozen=True)
class Agreement:
    """Error = measured − computed, in the unit of the signal.

    Attributes
    ----------
    rmse, max_error, mean : float
    band : float
        Largest minus smallest error.
    steady : float
        Mean error over the last tenth of the rows.
    fit_percent : float
        (1 − ‖y − ŷ‖/‖y − ȳ‖)·100; NaN for a constant signal.
    rows : int
        Rows with both.
    """

    rmse: float
    max_error: float
    mean: float
    band: float
    steady: float
    fit_percent: float
    rows: int

    @property
    def rmse_zero_free(self) -> float:
        """RMS error about its mean: what is left where the zero of a displacement is free."""
        return float(np.sqrt(np.maximum(self.rmse**2 - self.mean**2, 0.0)))

    def with_noise(self, sigma: float) -> Agreement:
        """The agreement with readings of which these rows are averages.

        Parameters
        ----------
        sigma : float [unit of the signal]
            Noise of a reading that an average does not show; in the RMSE and the fit.
        """
        if not sigma:
            return self
        rmse = float(np.hypot(self.rmse, sigma))
        # RMS about the mean, of which the fit is told.
        spread = self.rmse / max(1 - self.fit_percent / 100, TINY)
        fit = 100 * (1 - rmse / float(np.hypot(spread, sigma)))
        return replace(self, rmse=rmse, fit_percent=fit)

    def document(self) -> dict[str, float | int | None]:
        """JSON-ready: null for what is not there."""
        values = {**asdict(self), "rmse_zero_free": self.rmse_zero_free}
        return {k: v if np.isfinite(v) else None for k, v in values.items()}


def agreement(measured: Array, computed: Array) -> Agreement:
    """Compare two signals, leaving out rows where either is NaN.

    Parameters
    ----------
    measured, computed : ndarray, shape (n,)
    """
    there = np.isfinite(measured) & np.isfinite(computed)
    y, error = measured[there], (measured - computed)[there]
    if not len(y):
        nan = float("nan")
        return Agreement(nan, nan, nan, nan, nan, nan, 0)
    # Of a constant rounding alone is left.
    spread = float(np.linalg.norm(y - np.mean(y))) if np.ptp(y) else 0.0
    return Agreement(
        rmse=float(np.sqrt(np.mean(error**2))),
        max_error=float(np.max(np.abs(error))),
        mean=float(np.mean(error)),
        band=float(np.ptp(error)),
        steady=float(np.mean(error[-max(1, len(error) // 10) :])),
        fit_percent=100 * (1 - float(np.linalg.norm(error)) / spread) if spread else float("nan"),
        rows=len(y),
    )


def improvement(uncompensated: Array, computed: Array) -> float:
    """imp = 100 − 100·|compensated|/|uncompensated| in means (Mareš et al., (3)) [%].

    Parameters
    ----------
    uncompensated, computed : ndarray, shape (n,)
        The deviation as measured, and what a model would take off it; rows with NaN are left out.
    """
    there = np.isfinite(uncompensated) & np.isfinite(computed)
    before = float(np.mean(np.abs(uncompensated[there]))) if there.any() else 0.0
    if not before:
        return float("nan")
    return 100 - 100 * float(np.mean(np.abs((uncompensated - computed)[there]))) / before
