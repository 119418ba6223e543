"""Information criteria of a fitted model."""

from __future__ import annotations

import math
from dataclasses import dataclass

# In place of a loss of zero, which has no logarithm [unit²].
MIN_LOSS = 1e-300


@dataclass(frozen=True)
class Criteria:
    """What a fit is worth beside the parameters that it takes.

    Attributes
    ----------
    deviance : float
        −2 log L, up to a constant that candidates on the same data share.
    parameters : int
        Everything that was fitted.
    rows : int
        Samples.
    """

    deviance: float
    parameters: int
    rows: int

    @staticmethod
    def of_squares(loss: float, rows: int, parameters: int) -> Criteria:
        """Of least squares with Gaussian errors: deviance N ln(loss/N).

        Parameters
        ----------
        loss : float [unit²]
            Sum of squared errors.
        """
        # An exact fit leaves nothing: the least number above zero stands for its loss.
        return Criteria(rows * math.log(max(loss, MIN_LOSS) / rows), parameters, rows)

    @property
    def aic(self) -> float:
        """Akaike 1974."""
        return self.deviance + 2.0 * self.parameters

    @property
    def aicc(self) -> float:
        """Hurvich and Tsai, Biometrika 76 (1989) 297."""
        k, n = self.parameters, self.rows
        return self.aic + 2.0 * k * (k + 1.0) / max(n - k - 1.0, 0.5)

    @property
    def bic(self) -> float:
        """Schwarz 1978."""
        return self.deviance + math.log(self.rows) * self.parameters
