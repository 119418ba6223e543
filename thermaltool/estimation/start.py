"""The state of a machine at the first row of a record: what is known of it before any reading."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from thermaltool.errors import FitError
from thermaltool.estimation.state_space import StateSpace, propagated
from thermaltool.responses.modes import Float

if TYPE_CHECKING:
    from thermaltool.model import Model

# Cold, settled at its heat, or in any state that heat before the record has left.
Initial = Literal["rest", "settled", "free"]
# ... or at rest unless the first readings contradict it: free then, where all is smoothed.
Start = Literal["auto", "rest", "settled", "free"]
# Samples after which what a state was no longer counts.
FORGOTTEN = 2**40


def require_decay(F: Float) -> None:
    """Raise FitError where a response does not decay: heat before may have left anything.

    Parameters
    ----------
    F : ndarray, shape (modal, modal)
        Of the modes, over one sample.
    """
    if len(F) and np.max(np.abs(np.linalg.eigvals(F))) >= 1.0:
        raise FitError("a response does not decay: the start is neither settled nor free")


def warm_covariance(
    space: StateSpace,
    settled: Float,
    modal: int,
    level: Sequence[float],
    walk: Sequence[float],
    dt: float,
) -> Float:
    """Covariance of the state of a machine that has worked for long, shape (n, n).

    Each heat q before the record is stationary, q ← a q + w with a = exp(−dt/T): its standard
    deviation is `level`, and over short times it wanders as the walk does, so T = 2 level²/walk².
    The covariance solves P = F P Fᵀ + Q with that heat (discrete Lyapunov equation).

    Parameters
    ----------
    space : StateSpace
        Modes, heats as random walks, drifts of the sensors.
    settled : ndarray, shape (n, n)
        Covariance for a heat that has stood for long.
    modal : int
        States that are modes; the heats come next.
    level : sequence of float, one for each drive [unit of the drive]
    walk : sequence of float [unit of the drive/√s]
    dt : float [s]
    """
    F, Q = space.F.copy(), space.Q.copy()
    for k, (size, rate) in enumerate(zip(level, walk, strict=True)):
        share = dt * rate**2 / (2 * size**2)
        F[modal + k, modal + k] = np.exp(-share)
        Q[modal + k, modal + k] = size**2 * -np.expm1(-2 * share)
    return propagated(F, Q, settled, FORGOTTEN)


def drive_levels(model: Model, drives: Sequence[str]) -> tuple[float, ...]:
    """The largest size of each drive in the calibration; 1 where it was none."""
    ranges = {d.channel: max(map(abs, d.range)) for d in model.drives}
    return tuple(float(ranges[name]) or 1.0 for name in drives)
