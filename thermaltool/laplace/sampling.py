"""Evaluating a transfer function with care: shifted, counted, checked."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import FitError

ComplexArray = NDArray[np.complex128]
RealArray = NDArray[np.float64]
Transfer = Callable[[ComplexArray], ComplexArray]

# Rounding of a term, as a part of it: F itself is right to a few last digits.
ROUNDING = 4 * float(np.finfo(float).eps)


class Sampler:
    """F(s + abscissa) as an array function that counts its evaluations.

    With the shift every method may assume singularities in Re s ≤ 0; the factor e^(abscissa·t)
    goes onto the result.
    """

    def __init__(self, transfer: Transfer, abscissa: float) -> None:
        self.transfer, self.abscissa = transfer, abscissa
        self.evaluations = 0

    def lenient(self, s: ComplexArray) -> ComplexArray:
        """F(s + abscissa), non-finite values as they come; `s` has shape (n,)."""
        shifted = s + self.abscissa
        with np.errstate(all="ignore"):
            values = np.asarray(self.transfer(shifted), dtype=np.complex128)
        if values.shape != s.shape:
            if values.ndim:
                raise ValueError(
                    f"the transfer function returned shape {values.shape} for s of shape {s.shape}"
                )
            values = np.full(s.shape, values)
        self.evaluations += s.size
        return values

    def __call__(self, s: ComplexArray) -> ComplexArray:
        """F(s + abscissa) of shape (n,); `FitError` names the s where it is not finite."""
        values = self.lenient(s)
        bad = ~np.isfinite(values)
        if bad.any():
            where = (s + self.abscissa)[bad][0]
            raise FitError(
                f"the transfer function is not finite at s = {where:.6g} "
                f"({bad.sum()} of {s.size} places): a pole right of the abscissa, or an overflow "
                "that a scaled form (exponential instead of cosh, i0e instead of i0) avoids"
            )
        return values
