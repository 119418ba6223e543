"""A dead time as further modes, for estimators: they have no state for what is on its way.

e^(−Ls) is replaced by its Padé approximant of degrees n − 1 and n; what it does to a response that
is slower than the dead time shows only beside its end, and less the larger n is.
"""

from __future__ import annotations

from math import factorial

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.modes import Complex, Float, Modes

# Degrees that are tried, the least first.
DEGREES = range(2, 10)
# Largest error of a step response that is taken at once, and at all [share of its largest value].
SMALL_ERROR, LARGEST_ERROR = 1e-3, 2e-2
# Times at which it is judged, up to so many of its slowest time constant behind the dead time.
TIMES, LAST_TIME = 400, 10.0


def with_lags(modes: DelayedModes) -> tuple[Modes, float]:
    """Modes without a delay whose step response is near.

    Parameters
    ----------
    modes : DelayedModes
        With single poles.

    Returns
    -------
    modes : Modes
    error : float
        Largest difference of the step responses, as a share of the largest value.

    Raises
    ------
    ModelError
        The dead time is too long beside the response.
    """
    best: tuple[float, Modes] | None = None
    if not np.any(modes.double):
        slowest = float(1 / np.min(np.abs(modes.poles.real)))
        late = modes.delay * np.linspace(0.0, 4.0, TIMES)
        t = np.concatenate([late, np.linspace(0.0, LAST_TIME, TIMES) * (slowest + modes.delay)])
        exact = modes.step(t)
        for degree in DEGREES:
            found = _approximated(modes, degree)
            error = float(np.max(np.abs(found.step(t) - exact)) / np.max(np.abs(exact)))
            if best is None or error < best[0]:
                best = error, found
            if error <= SMALL_ERROR:
                break
    if best is None or not best[0] <= LARGEST_ERROR:
        raise ModelError(f"a dead time of {modes.delay:.3g} s, too long beside the response")
    return best[1], best[0]


def _approximated(modes: DelayedModes, degree: int) -> Modes:
    numerator, denominator = _pade(degree)
    own: Complex = np.roots(denominator[::-1]).astype(np.complex128)

    def delayed(p: Complex) -> Complex:
        return np.asarray(np.polyval(numerator[::-1], p) / np.polyval(denominator[::-1], p))

    slope = np.polyder(denominator[::-1])
    residues = np.polyval(numerator[::-1], own) / np.polyval(slope, own)
    at = own / modes.delay
    weights = np.concatenate([modes.weights * delayed(modes.poles * modes.delay),
                              residues / modes.delay * modes.prompt().transfer(at)])  # fmt: skip
    upper = np.concatenate([modes.poles, at])
    kept = upper.imag >= -1e-9 * np.abs(upper)
    real = np.abs(upper.imag) <= 1e-9 * np.abs(upper)
    poles, weights = np.where(real, upper.real, upper), np.where(real, weights.real, weights)
    return Modes(poles[kept] + 0j, weights[kept] + 0j)


def _pade(n: int) -> tuple[Float, Float]:
    """Coefficients of e^(−x), of degree n − 1 over n, from x⁰ on."""
    m = n - 1
    whole = factorial(m + n)
    above = [factorial(m + n - k) * factorial(m) / (whole * factorial(k) * factorial(m - k))
             for k in range(m + 1)]  # fmt: skip
    below = [factorial(m + n - k) * factorial(n) / (whole * factorial(k) * factorial(n - k))
             for k in range(n + 1)]  # fmt: skip
    return np.array(above) * (-1.0) ** np.arange(n), np.array(below)
