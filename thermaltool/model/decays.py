"""How outputs come to rest: by the modes of a model, or any way that a machine may take."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from thermaltool.responses.modes import Float

if TYPE_CHECKING:
    from thermaltool.model.document import Model

# Modes of an output above which it is taken to come from other levels of its drives, at which it
# had settled: a state of many modes is not told by a few rows.
MAX_FREE_MODES = 8
# Poles that differ by less than this part are one.
SAME_POLE = 1e-6
# Time constants of an unknown start, relative to the output's slowest: so near each other that
# their sum follows any decay to a hundredth of its height, also one slower than the model's. The
# last ones only where the clock shows them.
START_TIME_CONSTANTS = (1.5, 1.0, 0.6, 0.35, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005)


def start_decays(elapsed: Float, slowest: float, period: float) -> Float:
    """Decays whose sum follows any way to rest, shape (k, n).

    Parameters
    ----------
    elapsed : ndarray, shape (n,) [s]
        Since the first row.
    slowest : float [s]
        Slowest time constant.
    period : float [s]
        Of the rows, which show none that is faster.
    """
    own = [share * slowest for share in START_TIME_CONSTANTS if share * slowest > period]
    return np.array([np.exp(-elapsed / tau) for tau in own]).reshape(len(own), len(elapsed))


def free_decays(model: Model, channel: str, elapsed: Float, cooling: Float) -> Float:
    """How an output can come to rest with all drives at rest, shape (k, n).

    Each mode of its terms, or, where these are many, each term from a level of its drive at which
    it had settled.

    Parameters
    ----------
    model : Model
    channel : str
    elapsed : ndarray, shape (n,) [s]
        Since the first row.
    cooling : ndarray, shape (n,)
        Γ, the integral of the rate by which all decays faster.
    """
    columns = mode_decays(model, channel, elapsed)
    if not columns:
        responses = [t.response for t in model.terms if t.output == channel]
        columns = [each.dc_gain() - each.step(elapsed) for each in responses]
    return np.array(columns).reshape(len(columns), len(elapsed)) * np.exp(-cooling)


def mode_decays(model: Model, channel: str, elapsed: Float) -> list[Float]:
    """Each mode of an output's terms as it decays, shapes (n,); none where these are many.

    Parameters
    ----------
    model : Model
    channel : str
    elapsed : ndarray, shape (n,) [s]
        Since the first row.
    """
    found: list[complex] = []
    columns: list[Float] = []
    for term in model.terms:
        if term.output != channel:
            continue
        modes = term.response.modes(model.sample_period)
        for pole, double in zip(modes.poles, modes.double, strict=True):
            if not any(abs(pole - other) <= SAME_POLE * abs(pole) for other in found):
                found.append(complex(pole))
                decay = np.exp(pole * elapsed)
                columns += [decay.real, *([decay.imag] if pole.imag else [])]
                columns += [elapsed * decay.real] if double else []
                if len(columns) > MAX_FREE_MODES:
                    return []
    return columns
