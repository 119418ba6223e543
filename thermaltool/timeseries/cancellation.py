"""Whether a nearly cancelling pair of roots describes the series or a line of its noise.

Without the pair its angle means nothing, so that twice the logarithm of the likelihood ratio is the
largest of as many χ² numbers as there are lines to tell apart, half the samples (R. B. Davies,
Biometrika 64 (1977) 247; here with Bonferroni's bound).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from thermaltool.timeseries.likelihood import ArmaLikelihood
from thermaltool.timeseries.maximum import climb, start
from thermaltool.timeseries.polynomials import cancelling, without_root

Array = NDArray[np.float64]

MAX_P_VALUE = 0.05  # of a record of noise: what reaches it is a line of the noise
MAX_STEPS = 20  # of the climb of the smaller model
TOLERANCE = 1e-2  # [deviance], a hundredth of what tells two models apart


@dataclass(frozen=True)
class NeedlessPair:
    """A pair of roots that the series does not ask for.

    Attributes
    ----------
    ar_root, ma_root : complex
    rise : float
        Of the deviance without it.
    usual : float
        That a line of white noise reaches in one of 20 records.
    """

    ar_root: complex
    ma_root: complex
    rise: float
    usual: float


def needless_pairs(
    likelihood: ArmaLikelihood, ar: Array, ma: Array, deviance: float
) -> list[NeedlessPair]:
    """The nearly cancelling roots of a model that explain no more than noise would.

    Parameters
    ----------
    likelihood : ArmaLikelihood
    ar, ma : ndarray
        At their maximum likelihood.
    deviance : float
    """
    found = []
    for root, other in cancelling(ar, ma):
        smaller = start(likelihood, without_root(ar, root), -without_root(-ma, other))
        rise = climb(likelihood, smaller, MAX_STEPS, TOLERANCE)[0].deviance - deviance
        coefficients = 2 if root.imag == 0.0 else 4
        lines = 1.0 if root.imag == 0.0 else max(0.5 * likelihood.size, 1.0)
        usual = float(chdtri(coefficients, MAX_P_VALUE / lines))
        if rise < usual:
            found.append(NeedlessPair(root, other, float(rise), usual))
    return found
