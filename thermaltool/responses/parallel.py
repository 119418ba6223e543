"""Responses side by side, as one recursion of several inputs and outputs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermaltool.responses.modes import Float, Hold, Modes
from thermaltool.responses.recursion import Recursion

# From an input to an output, by their places: (output, input, response, or a gain that acts at
# once).
InputPath = tuple[int, int, Modes | float]


def parallel(
    paths: Sequence[InputPath], holds: Sequence[Hold], outputs: int, dt: float
) -> Recursion:
    """The recursion over one sample of paths that add up in their outputs.

    Parameters
    ----------
    paths : sequence of (output, input, Modes or float)
    holds : sequence of "zero" or "first", one for each input
    outputs : int
    dt : float [s]

    Returns
    -------
    Recursion
        F is block diagonal, in the order of the paths; G0 and G1 have a column for each input, C a
        row for each output.
    """
    parts = [_one(response, dt, holds[source]) for _, source, response in paths]
    states, inputs = sum(len(part.F) for part in parts), len(holds)
    F, C = np.zeros((states, states)), np.zeros((outputs, states))
    G0, G1 = np.zeros((states, inputs)), np.zeros((states, inputs))
    at = 0
    for (target, source, _), part in zip(paths, parts, strict=True):
        to = slice(at, at + len(part.F))
        F[to, to], C[target, to] = part.F, part.C[0]
        G0[to, source], G1[to, source] = part.G0[:, 0], part.G1[:, 0]
        at = to.stop
    return Recursion(F, G0, G1, C)


def settled_state(paths: Sequence[InputPath], holds: Sequence[Hold], u: Float, dt: float) -> Float:
    """The state in which inputs that have stood for ever leave paths, shape (n,).

    Parameters
    ----------
    paths, holds, dt
        As for `parallel`, in whose order the state is.
    u : ndarray, shape (n_inputs,)
        NaN leaves the paths of an input at rest, as does a path that does not decay.
    """
    found = [np.zeros(0)]
    for _, source, response in paths:
        part = _one(response, dt, holds[source])
        stays = np.max(np.abs(np.linalg.eigvals(part.F)), initial=0.0) >= 1.0
        still = stays or np.isnan(u[source])
        found.append(np.zeros(len(part.F)) if still else part.settled(u[source : source + 1]))
    return np.concatenate(found)


def _one(response: Modes | float, dt: float, hold: Hold) -> Recursion:
    if isinstance(response, Modes):
        return response.discretize(dt, hold)
    one: Float = np.ones((1, 1))
    return Recursion(0 * one, 0 * one, one, response * one)
