"""How sure the continuous form of a discrete transfer function is: its parameters' covariance.

To first order, J C Jᵀ, J by central differences in the parameters of the model's own search: a
small change of those moves the poles, and the gains follow by the same least squares on the step.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.fitting.data import Array
from thermaltool.fitting.output_model import ContinuousTerm
from thermaltool.fitting.transfer.continuous_term import (
    named_poles,
    rates,
    response_of_step,
    unit_step,
)
from thermaltool.responses.modes import Complex

if TYPE_CHECKING:
    from thermaltool.fitting.transfer.model import TransferModel

# Step of a derivative, in standard errors of the parameter.
STEP = 1e-3


def with_covariance(model: TransferModel, k: int, term: ContinuousTerm) -> ContinuousTerm:
    """A term with the covariance of its time constants and gains; unchanged where it has none.

    Parameters
    ----------
    model : TransferModel
    k : int
        The input whose term it is.
    term : ContinuousTerm
    """
    response: Any = term.response
    names = (*response.searched, *response.gains)
    variances = np.diag(model.covariance)
    own = [j for j in model.acting_on(k) if variances[j] > 0]
    slopes = []
    try:
        for j in own:
            step = STEP * float(np.sqrt(variances[j]))
            ahead, behind = (
                _parameters(model.moved(j, by), k, response, rates(model, k))
                for by in (step, -step)
            )
            slopes.append((ahead - behind) / (2 * step))
    except ModelError:
        return term
    slope = np.array(slopes).T.reshape(len(names), len(own))
    covariance = slope @ model.covariance[np.ix_(own, own)] @ slope.T
    if not own or not np.isfinite(covariance).all():
        return term
    return replace(term, covariance=(covariance + covariance.T) / 2, names=names)


def _parameters(model: TransferModel, k: int, response: Any, before: Complex) -> Array:
    """Time constants and gains of a model whose poles have moved a little, in their order."""
    left, moved = rates(model, k), []
    for pole in before:
        nearest = int(np.argmin(np.abs(left - pole)))
        found = left[nearest]
        # Two real poles that meet become a pair: there is no slope.
        if (found.imag == 0) != (pole.imag == 0):
            raise ModelError("a pole has no slope")
        moved.append(found)
        left = np.delete(left, nearest)
    known = named_poles(np.array(moved))
    if "delay" in response.fixed:
        known["delay"] = response.delay
    time, u = unit_step(model, before)
    found_response, _ = response_of_step(type(response), known, time, u, model, k)
    after: Any = found_response.response
    return np.array([getattr(after, name) for name in (*after.searched, *after.gains)])
