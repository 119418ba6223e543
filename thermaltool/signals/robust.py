"""Standard deviation of deviations among which are outliers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Standard deviation of a normal distribution over the median of its absolute values, 1/Φ⁻¹(3/4) as
# it is usually rounded: the reweighting of calibrations ends elsewhere with more digits of it.
MAD_TO_SIGMA = 1.4826


def robust_std(deviations: NDArray[np.float64]) -> float:
    """Standard deviation of normal noise, from the median of its absolute values [unit].

    Up to half of the values may be outliers (P. J. Rousseeuw and C. Croux, J. Am. Stat. Assoc. 88
    (1993) 1273, (1.2)).

    Parameters
    ----------
    deviations : ndarray, shape (n,)
        From zero; at least one, none of them NaN.
    """
    return MAD_TO_SIGMA * float(np.median(np.abs(deviations)))
