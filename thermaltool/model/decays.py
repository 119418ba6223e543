"""How outputs come to rest: by the modes of a model, or any way that a machine may take."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from thermaltool.responses.modes import Float
from thermaltool.units import is_absolute

if TYPE_CHECKING:
    from thermaltool.effects.effect import Effect
    from thermaltool.model.document import Model, Term

# Modes of an output above which it is taken to come from other levels of its drives, at which it
# had settled: a state of many modes is not told by a few rows.
MAX_FREE_MODES = 8
# Poles that differ by less than this part are one.
SAME_POLE = 1e-6
# Slower lags that pass on less than this part of all gains do not matter.
MATTERS = 0.1
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


def lag_decays(
    model: Model, effects: Iterable[Effect], channel: str, elapsed: Float
) -> list[Float]:
    """How an output comes to rest by lags that are no modes of its terms, shapes (n,).

    Those of sources that are no drives, and of its sensor: they, too, have a past.

    Parameters
    ----------
    model : Model
    effects : iterable of Effect
        Those that act.
    channel : str
    elapsed : ndarray, shape (n,) [s]
        Since the first row.
    """
    lags = {tau for effect in effects for tau in effect.lags(channel) if tau > 0}
    if not lags:
        return []
    own = (t.response for t in model.terms if t.output == channel)
    rates = [-complex(p) for each in own for p in each.modes(model.sample_period).poles]
    columns = []
    for tau in sorted(lags):
        if not any(abs(rate - 1 / tau) <= SAME_POLE * abs(rate) for rate in rates):
            rates.append(complex(1 / tau))
            columns.append(np.asarray(np.exp(-elapsed / tau)))
    return columns


def slow_bodies(terms: Sequence[Term], outputs: Iterable[str], period: float) -> dict[str, float]:
    """The slowest time constant that matters of outputs that heat moves [s].

    Slower lags that pass on little between them are what a fit has left over.

    Parameters
    ----------
    terms : sequence of Term
        Those of a drive that is no temperature count.
    outputs : iterable of str
    period : float [s]
        Of the samples.
    """
    wanted = set(outputs)

    def slowest(term: Term) -> float:
        modes = term.response.modes(period)
        rates = -modes.poles.real
        order = np.argsort(rates)
        gains = np.abs(modes.weights)[order] / rates[order]
        enough = np.cumsum(gains) >= MATTERS * np.sum(gains)
        return float(1.0 / rates[order][np.argmax(enough)])

    found: dict[str, float] = {}
    for term in terms:
        if term.output in wanted and not is_absolute(term.drive):
            found[term.output] = max(slowest(term), found.get(term.output, 0.0))
    return found
