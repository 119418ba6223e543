"""Information criteria of a fitted order."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from thermaltool.signals.criteria import Criteria


@dataclass(frozen=True)
class OrderCriteria:
    """One pair of orders.

    Attributes
    ----------
    p, q : int
    deviance : float
        -2 log L; of the regressions where not `exact`.
    sigma2 : float
        Innovation variance [unit²].
    size : int
        Samples.
    regressors : int
        Mean and trend.
    exact : bool
        By exact maximum likelihood.
    """

    p: int
    q: int
    deviance: float
    sigma2: float
    size: int
    regressors: int
    exact: bool

    @property
    def criteria(self) -> Criteria:
        """Of coefficients, regressors and the variance."""
        return Criteria(self.deviance, self.p + self.q + self.regressors + 1, self.size)

    @property
    def gao(self) -> float:
        """N ln[RSS/(N - r)] + 2 r with r = n + m + 1, the mean included (Gao 2000, 4.2)."""
        r = self.criteria.parameters - 1
        return self.size * float(np.log(self.size * self.sigma2 / (self.size - r))) + 2.0 * r


CRITERIA: Mapping[str, Callable[[OrderCriteria], float]] = {
    "aic": lambda entry: entry.criteria.aic,
    "aicc": lambda entry: entry.criteria.aicc,
    "bic": lambda entry: entry.criteria.bic,
    "gao": lambda entry: entry.gao,
}


def criteria_named(names: Iterable[str]) -> tuple[str, ...]:
    """Names of criteria, checked.

    Raises
    ------
    ValueError
        An unknown one.
    """
    chosen = tuple(dict.fromkeys(name.strip() for name in names))
    for name in chosen:
        if name not in CRITERIA:
            raise ValueError(f"{name!r} is no criterion: there are {', '.join(CRITERIA)}")
    return chosen
