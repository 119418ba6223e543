"""How long an estimate needs to come right from a wrong start."""

from __future__ import annotations

import math

import numpy as np

from thermaltool.responses.modes import Float
from thermaltool.responses.recursion import Recursion

# What is left of an error that counts as nothing: three time constants of a first-order lag.
REMAINDER = 0.05
# Longest time that is looked at, 2⁴⁰ samples: what lasts longer never ends.
DOUBLINGS = 40


def settling_time(recursion: Recursion, dt: float, rows: slice = slice(None)) -> float:
    """Time until `REMAINDER` of a wrong start is left in every estimate.

    The start is wrong by the state that a steady reading leads to, one sensor at a time: the
    machine is warm, and the estimate begins at rest.

    Parameters
    ----------
    recursion : Recursion
        Of an estimator, over a sample of `dt` [s].
    dt : float [s]
    rows : slice
        The estimates that count.

    Returns
    -------
    float [s]
        inf where the error does not decay.
    """
    F, C = recursion.F, recursion.C[rows]
    if not len(F):
        return 0.0
    try:
        state = recursion.settled(np.eye(recursion.G0.shape[1]))
    except np.linalg.LinAlgError:
        return math.inf
    with np.errstate(over="ignore", invalid="ignore"):
        powers = [F]
        for _ in range(DOUBLINGS):
            powers.append(powers[-1] @ powers[-1])
        errors = np.array([_largest(C @ state), *(_largest(C @ power @ state) for power in powers)])
    allowed = REMAINDER * np.max(errors, axis=0)
    if not np.all(np.isfinite(errors)) or np.any(errors[-1] > allowed):
        return math.inf
    samples = 1
    for k in range(DOUBLINGS, -1, -1):
        later = powers[k] @ state
        if np.any(_largest(C @ later) > allowed):
            state, samples = later, samples + 2**k
    return samples * dt


def _largest(errors: Float) -> Float:
    """Of each estimate the largest over the sensors."""
    return np.asarray(np.max(np.abs(errors), axis=1))
