"""What records do not settle of a fitted output, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermaltool.fitting.parametrization import Parametrization
from thermaltool.fitting.projection import MAX_CANCELLATION
from thermaltool.fitting.start_search import StartSearch
from thermaltool.responses import Response
from thermaltool.responses.modes import Float
from thermaltool.signals.intervals import standard_error

# Standard errors, as a share of the value, above which a rate or shape is not identified, and a
# steady state not settled.
MAX_PARAMETER_ERROR, MAX_GAIN_ERROR = 0.5, 0.1
# A record shorter than this many of the slowest time constants does not show the steady state:
# its covariance, linear around the fit, is then too narrow to be believed.
SETTLED_TIME_CONSTANTS = 3


def unidentified(names: Sequence[str], values: Float, deviation: Float) -> list[str]:
    """Rates and shapes of large standard error, in one sentence.

    Parameters
    ----------
    names : sequence of str
    values, deviation : ndarray, shape (searched or more,)
    """
    weak = [
        f"{name} ({value:.3g} ± {error:.2g})"
        for name, value, error in zip(names, values, deviation, strict=False)
        if error > MAX_PARAMETER_ERROR * value
    ]
    return [f"not identified one by one: {', '.join(weak)}"] if weak else []


def cancelling(search: StartSearch, theta: Float, gains: Float) -> list[str]:
    """Terms that are far larger than the output, in one sentence.

    Parameters
    ----------
    search : StartSearch
    theta : ndarray, shape (searched,)
    gains : ndarray, shape (gains,)
    """
    unit = search.parametrization.unit_weights(theta, search.problem.grid)
    size = search.problem.cancellation(unit, gains)
    if size <= MAX_CANCELLATION:
        return []
    names = search.parametrization.names()[len(theta) :]
    shown = ", ".join(f"{name} {gain:.4g}" for name, gain in zip(names, gains, strict=True))
    return [
        f"gains cancel ({shown}): terms of {size:.3g} times the output, which these logs cannot "
        "tell apart, and which another input will not leave in balance; take fewer of them "
        "(--response), or move the drives one at a time"
    ]


def unsettled(
    responses: tuple[Response, ...],
    parametrization: Parametrization,
    covariance: Float,
    duration: float,
) -> list[str]:
    """Steady states that the records do not reach: the gain's error by linear propagation.

    Parameters
    ----------
    responses : tuple of Response
    parametrization : Parametrization
    covariance : ndarray
        Of the fitted parameters.
    duration : float [s]
        Of the longest record.
    """
    found = []
    at, gain_at = 0, parametrization.searched
    for cls, fixed, response in zip(
        parametrization.classes, parametrization.fixed, responses, strict=True
    ):
        names = (*cls.searched, *cls.gains)
        index = [*range(at, at + len(cls.searched)), *range(gain_at, gain_at + len(cls.gains))]
        at, gain_at = at + len(cls.searched), gain_at + len(cls.gains)
        values = {name: getattr(response, name) for name in names}
        gradient = []
        for name in names:
            step = 1e-4 * abs(values[name]) or 1e-6
            ahead = cls(**{**values, name: values[name] + step}, **fixed).dc_gain()
            behind = cls(**{**values, name: values[name] - step}, **fixed).dc_gain()
            gradient.append((ahead - behind) / (2 * step))
        error = standard_error(np.array(gradient), covariance[np.ix_(index, index)])
        gain, slowest = response.dc_gain(), response.slowest()
        steady = f"the steady state ({gain:.4g} ± {error:.2g})"
        if duration < SETTLED_TIME_CONSTANTS * slowest:
            found.append(
                f"{steady} is not settled: the record covers {duration / slowest:.2g} of the "
                f"slowest time constant, {slowest:.3g} s"
            )
        elif error > MAX_GAIN_ERROR * abs(gain):
            found.append(f"{steady} is not sure, though the record is long enough to show it")
    return found
