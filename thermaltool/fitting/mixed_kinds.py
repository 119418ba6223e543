"""Kinds of response that differ from drive to drive, and lags that all drives share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermaltool.fitting.kind_candidate import LEFT_OUT
from thermaltool.fitting.response_search import FittedKinds, KindSearch
from thermaltool.fitting.sound_kinds import best_of

# Kinds that may have a delay.
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
    plain = [each for each in found if not any(each.delays)]
    starts = {id(each): each for each in (best_of(found, rows), best_of(plain, rows))}
    return [each for start in starts.values() for each in _replaced(task, start, plain, rows)]


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
    if fit is None:
        return None
    return replace(fit, kinds=(*kinds[:d], LEFT_OUT, *kinds[d:]), delays=best.delays)


def common_lags(task: KindSearch, best: FittedKinds) -> list[FittedKinds]:
    """Lags that all drives share, and those which act in the best, with its delays.

    Parts of one body have its time constants, whatever moves it: those of its thermal modes.

    Parameters
    ----------
    task : KindSearch
    best : FittedKinds
    """
    every = tuple(range(len(best.kinds)))
    acting = tuple(d for d in every if best.kinds[d] != LEFT_OUT)
    return [
        each
        for drives in dict.fromkeys((every, acting))
        if len(drives) > 1
        for kind in COMMON
        for each in _shared(task, best, drives, kind)
    ]


def _shared(
    task: KindSearch, best: FittedKinds, drives: tuple[int, ...], kind: str
) -> list[FittedKinds]:
    """One kind whose rates these drives share, the others left out; none where it cannot be."""
    own = task.driven_by([task.drives[d] for d in drives])
    delays = tuple(best.delays[d] for d in drives)
    fit = own.fit((kind,) * len(drives), delays, common=True)
    if fit is None:
        return []
    kinds = tuple(kind if d in drives else LEFT_OUT for d in range(len(best.kinds)))
    return [replace(fit, kinds=kinds, delays=best.delays)]
