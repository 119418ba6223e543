"""Kinds of response that differ from drive to drive, and lags that all drives share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermaltool.fitting.kind_candidate import LEFT_OUT
from thermaltool.fitting.response_search import FittedKinds, KindSearch
from thermaltool.fitting.sound_kinds import best_of, without_delays

# Kinds whose delays are searched.
DELAYED = ("rational1", "rational2", "rational3")
# What is tried for one drive where there are several.
KINDS_FOR_ONE = ("rational1", "rational2", "deflection")
# Those whose time constants all drives may share.
COMMON = ("rational1", "rational2", "rational3", "rational4")


def mixed_kinds(task: KindSearch, found: Sequence[FittedKinds], rows: float) -> list[FittedKinds]:
    """From the best, and from the best without a delay, where that is another.

    Parameters
    ----------
    task : KindSearch
    found : sequence of FittedKinds
        Those that are alike for all drives among them.
    rows : float
        Independent ones.
    """
    plain = without_delays(found)
    starts = _starts(found, rows)
    return [each for start in starts for each in _replaced(task, start, plain, rows)]


def _starts(found: Sequence[FittedKinds], rows: float) -> list[FittedKinds]:
    """The best, and the best without a delay, where that is another."""
    best, plain = best_of(found, rows), best_of(without_delays(found), rows)
    return [best] if plain is best else [best, plain]


def _replaced(
    task: KindSearch, best: FittedKinds, plain: Sequence[FittedKinds], rows: float
) -> list[FittedKinds]:
    """Without each of the drives, and with another kind for one after the other."""
    alike = {each.kinds[0]: each for each in plain}
    tried: list[FittedKinds] = []
    for d in range(len(best.kinds)):
        others = [_left_out(task, best, d)]
        for kind in KINDS_FOR_ONE:
            if (
                kind == best.kinds[d]
                or kind not in alike
                or (best.delays[d] and kind not in DELAYED)
            ):
                continue
            rates = [best.rates(k) for k in range(len(best.kinds))]
            rates[d] = alike[kind].rates(d)
            kinds = (*best.kinds[:d], kind, *best.kinds[d + 1 :])
            others.append(task.fit(kinds, best.delays, np.concatenate(rates)))
        tried += [each for each in others if each is not None]
        best = best_of([best, *(each for each in tried if LEFT_OUT not in each.kinds)], rows)
    return tried


def _left_out(task: KindSearch, best: FittedKinds, d: int) -> FittedKinds | None:
    if any(best.delays):
        return None
    kinds = (*best.kinds[:d], *best.kinds[d + 1 :])
    rates = [best.rates(k) for k in range(len(best.kinds)) if k != d]
    fit = task.without(d).fit(kinds, (0.0,) * len(kinds), np.concatenate(rates))
    return None if fit is None else _beside_left_out(fit, best, [d])


def _beside_left_out(fit: FittedKinds, best: FittedKinds, without: Sequence[int]) -> FittedKinds:
    """A fit to the other drives, with kinds and delays for all of them."""
    own = iter(fit.kinds)
    kinds = tuple(LEFT_OUT if d in without else next(own) for d in range(len(best.kinds)))
    return replace(fit, kinds=kinds, delays=best.delays)


def common_lags(task: KindSearch, found: Sequence[FittedKinds], rows: float) -> list[FittedKinds]:
    """Lags that all drives share, and those that act in the best, with its delays and without.

    Parts of one body have its time constants, whatever moves it: those of its thermal modes.

    Parameters
    ----------
    task : KindSearch
    found : sequence of FittedKinds
    rows : float
        Independent ones.
    """
    return [each for best in _starts(found, rows) for each in _shared(task, best)]


def _shared(task: KindSearch, best: FittedKinds) -> list[FittedKinds]:
    """Every common kind of all drives, and of those that act in the best."""
    idle = [d for d, kind in enumerate(best.kinds) if kind == LEFT_OUT]
    fits: list[FittedKinds] = []
    for without in [[], idle] if idle else [[]]:
        acting = [d for d in range(len(best.kinds)) if d not in without]
        if len(acting) < 2:
            continue
        own = task.driven_by([task.drives[d] for d in acting]) if without else task
        delays = tuple(best.delays[d] for d in acting)
        for kind in COMMON:
            fit = own.fit((kind,) * len(acting), delays, common=True)
            fits += [] if fit is None else [_beside_left_out(fit, best, without)]
    return fits
