"""Recursive least squares with forgetting, in a form whose covariance stays positive.

The covariance is kept as P = U D Uᵀ with U unit upper triangular and D diagonal (Bierman,
Factorization Methods for Discrete Sequential Estimation, 1977, ch. V). Its update multiplies and
divides entries of D by positive numbers only, so P stays positive whatever rounding does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from thermaltool.timeseries.recursive.straight import update_function


@dataclass
class RecursiveLeastSquares:
    """Parameters of y = θ·φ + noise, one sample at a time; O(n²) work and memory.

    Minimizes Σ λ^(t−k) (y_k − θ·φ_k)² + θᵀθ/β as the source does (Gao 2000, eq. 4-17 to 4-20).
    There P is divided by λ without a bound and grows in directions that are not excited (a
    constant input excites one) until it overflows; here no entry of D passes `beta`: no direction
    becomes less known than it was at the start.

    Attributes
    ----------
    size : int
        n.
    beta : float
        P(0) = beta·I [unit of θ² per unit of noise variance].
    forgetting : float
        λ, in (0, 1].
    theta : list of n float

    Raises
    ------
    ValueError
        λ or β out of range.
    """

    size: int
    beta: float
    forgetting: float = 1.0
    theta: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        if not 0 < self.forgetting <= 1:
            raise ValueError(f"forgetting factor {self.forgetting:g} is not above 0 and at most 1")
        if not 0 < self.beta < math.inf:
            raise ValueError(f"beta {self.beta:g} is not above 0 and finite")
        self.theta = self.theta or [0.0] * self.size
        self._update = update_function(self.size)
        self._D = [self.beta] * self.size
        self._U = [0.0] * (self.size * (self.size - 1) // 2)

    def update(self, phi: Sequence[float], error: float) -> float:
        """Take a sample: its regressors, and the error y − θ·φ of θ before it.

        Returns the error of θ after it.
        """
        self.theta, self._D, self._U, after = self._update(
            phi, error, self.forgetting, self.beta, self.theta, self._D, self._U
        )
        return after
