"""Noise levels under which the residual of an output is judged: a coarse grid, then a fine one."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from thermaltool.diagnosis.assumptions import Assumptions
from thermaltool.diagnosis.evidence import OutputEvidence
from thermaltool.effects.effect import Float
from thermaltool.signals.row_groups import RowGroups

# Variance of the discrepancy over that of white noise, and number of time constants, at first; then
# factors around the best of them.
COARSE_RATIOS, COARSE_TAUS = 10.0 ** np.arange(-2, 7), 7
# Where nothing is expected of the noise its likelihood is broad: every second of these, then those
# beside the best few.
SECOND, BEST_COARSE = 2, 3
FINE_RATIOS = (0.003, 0.02, 0.1, 0.35, 1.0, 3.0)
FINE_TAUS = (0.1, 0.33, 1.0, 3.0)
# Ratio from which the fine levels start where white noise alone is best.
START_RATIO = 0.1


def weigh(
    groups: RowGroups,
    residual: Float,
    nuisance: Mapping[str, Float],
    centre: Mapping[str, Float],
    white: float,
    assumptions: Assumptions,
    expected: Callable[[float], float] | None = None,
    near: OutputEvidence | None = None,
) -> OutputEvidence:
    """Evidence of one output at the noise levels that its residual asks for.

    Parameters
    ----------
    groups : RowGroups
    residual : ndarray, shape (n,)
    nuisance : mapping of group to ndarray, shape (n, c)
        ``offset`` and ``accepted`` are free; other groups count in units of their prior.
    centre : mapping of group to ndarray, shape (c,)
        Where a group stands already, in units of its prior.
    white : float
        White noise of a reading, from the differences of neighbours.
    assumptions : frozenset of str
        Under which the noise levels are found.
    expected : callable, optional
        Discrepancy of a clean log by its time constant [s]: a larger one has the odds of
        `DISCREPANCY_SPREAD` against it; with it the white noise, too, is held near `white` (by as
        many rows as there are). Without it both are free.
    near : OutputEvidence, optional
        Of much the same residual: the fine levels are around the best of its levels, or its own
        where white noise alone is best. Other nuisance than that of the assumptions is left out.
    """
    start = OutputEvidence(
        groups,
        tuple(name for name, block in nuisance.items() for _ in range(block.shape[1])),
        np.column_stack([residual, *nuisance.values()]),
        np.concatenate(
            [centre.get(name, np.zeros(block.shape[1])) for name, block in nuisance.items()]
        ),
        white,
        expected,
    )
    if "white" in assumptions:
        alone = start.at([])
        alone = replace(alone, white=alone.null(assumptions).white)
        return replace(alone, independence=alone.correlated_rows(assumptions))
    if near is not None:
        best = near.levels[near.null(assumptions).level]
        same = [(level.ratio, level.tau) for level in near.levels if level.ratio]
        around = _fine(best.ratio, best.tau) if best.ratio else same
        return replace(start, white=near.white).only(assumptions).at(around)
    noise = groups.noise
    longest = max(noise.span / 2, 6 * noise.period)
    taus = np.geomspace(3 * noise.period, longest, COARSE_TAUS).tolist()
    coarse = start.only(assumptions)
    if expected is not None:
        coarse = coarse.at([(r, t) for r in COARSE_RATIOS for t in taus])
    else:
        coarse = coarse.at([(r, t) for r in COARSE_RATIOS[::SECOND] for t in taus[::SECOND]])
        coarse = coarse.at(_beside_best(coarse, assumptions, taus))
        for _ in range(2):
            coarse = replace(coarse, white=coarse.null(assumptions).white)
    best = coarse.levels[coarse.null(assumptions).level]
    tau = best.tau if best.ratio else float(np.sqrt(taus[0] * taus[-1]))
    fine = _fine(best.ratio or START_RATIO, tau)
    return replace(start, white=coarse.white).at(fine)


def _beside_best(
    coarse: OutputEvidence, assumptions: Assumptions, taus: Sequence[float]
) -> list[tuple[float, float]]:
    """The coarse levels on and beside the best few of every second one."""
    null, found = coarse.null(assumptions), set()
    for k in np.argsort(null.negative_log(null.square))[:BEST_COARSE].tolist():
        if not coarse.levels[k].ratio:
            continue
        i = int(np.argmin(np.abs(np.log(COARSE_RATIOS / coarse.levels[k].ratio))))
        j = int(np.argmin(np.abs(np.log(np.array(taus) / coarse.levels[k].tau))))
        around = (range(max(at - 1, 0), at + 2) for at in (i, j))
        found |= set(itertools.product(*around))
    known = ((i, j) for i, j in sorted(found) if i < len(COARSE_RATIOS) and j < len(taus))
    return [(float(COARSE_RATIOS[i]), taus[j]) for i, j in known]


def _fine(ratio: float, tau: float) -> list[tuple[float, float]]:
    """Levels around one."""
    return [(r * ratio, t * tau) for r in FINE_RATIOS for t in FINE_TAUS]
