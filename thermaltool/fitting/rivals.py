"""Structures side by side: which one predicts blocks held out decisively better.

Each is fitted anew to the rows beside every block, with the orders that were chosen, and runs into
the block with the state that the rows before it leave (`TrainingData.folds`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as t_distribution

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, Split, TrainingData
from thermaltool.fitting.fit import Fit
from thermaltool.fitting.selection import BLOCKS, FITTED_SHARE, Ranked, excites
from thermaltool.signals.agreement import Agreement, agreement

# Another structure is taken where it lowers the logarithm of the error variance of blocks held
# out, in the mean of the outputs, by so much; no output may lose more of its fit by that [points].
MIN_GAIN, MAX_LOST = 0.1, 2.0
# Where blocks have to agree: the p-value of their mean gain, and the gain where there is one alone,
# half of the error.
MAX_P_PAIRS, MIN_SINGLE_GAIN = 0.05, float(np.log(4))
# Residuals follow an input below this p-value: something of the dynamics is left to find.
MAX_P_VALUE = 0.01
# Rows by which structures are compared, at most.
MAX_COMPARED_ROWS = 4000

Refit = Callable[[TrainingData], Ranked]


@dataclass(frozen=True)
class HeldFit:
    """How a structure does on blocks held out.

    Attributes
    ----------
    level : float
        Mean over the outputs of the logarithm of the error variance.
    fit_percent : tuple of float, one for each output
    blocks : tuple of float
        As `level`, of every block.
    """

    level: float
    fit_percent: tuple[float, ...]
    blocks: tuple[float, ...]

    def beats(self, other: HeldFit, everywhere: bool = False) -> bool:
        """Whether this one is decisively better, and no output is given up for others.

        Parameters
        ----------
        other : HeldFit
        everywhere : bool
            Whether the blocks have to agree on that.
        """
        if everywhere and not self._agree(other):
            return False
        kept = all(
            own > before - MAX_LOST
            for own, before in zip(self.fit_percent, other.fit_percent, strict=True)
        )
        return kept and other.level - self.level > MIN_GAIN

    def _agree(self, other: HeldFit) -> bool:
        """Whether every block gains, or the mean of them by Student's t."""
        gains = np.array([other.level - self.level])
        if self.blocks and len(self.blocks) == len(other.blocks):
            gains = np.subtract(other.blocks, self.blocks)
        if len(gains) == 1:
            return bool(gains[0] > MIN_SINGLE_GAIN)
        least = float(t_distribution.isf(MAX_P_PAIRS, len(gains) - 1))
        sure = gains.mean() > least * gains.std(ddof=1) / np.sqrt(len(gains))
        return bool(sure or gains.min() > MIN_GAIN)


def held_fit(data: TrainingData, refit: Refit) -> HeldFit:
    """How a structure does on blocks of the data, each held out in turn.

    Parameters
    ----------
    data : TrainingData
    refit : callable
        The structure with its orders, fitted to given data.

    Raises
    ------
    FitError
        Data that do not carry it without a block.
    """
    short = data if data.rows <= MAX_COMPARED_ROWS else data.excerpt(MAX_COMPARED_ROWS)
    splits: list[Split] = [fold for fold in short.folds(BLOCKS) if excites(fold.fitted)]
    splits = splits or [short.split(FITTED_SHARE)]
    runs = [np.atleast_2d(refit(split.fitted).carried_on(split)) for split in splits]
    measured: list[Array] = [
        np.concatenate([split.held.output(k) for split in splits]) for k in range(len(data.outputs))
    ]
    each = [agreement(y, run) for y, run in zip(measured, np.hstack(runs), strict=True)]
    if not all(np.isfinite(own.rmse) for own in each):
        raise FitError("no run over the rows held out")
    blocks = []
    for split, run in zip(splits, runs, strict=True):
        own = [agreement(split.held.output(k), y) for k, y in enumerate(run)]
        blocks.append(_level(own))
    fits = tuple(own.fit_percent for own in each)
    return HeldFit(_level(each), fits, tuple(blocks) if np.all(np.isfinite(blocks)) else ())


def joined_fits(each: Sequence[HeldFit]) -> HeldFit:
    """All outputs of several data sets.

    Parameters
    ----------
    each : sequence of HeldFit
    """
    counts = [len(own.fit_percent) for own in each]
    blocks: list[float] = []
    if len({len(own.blocks) for own in each}) == 1:
        blocks = np.average([own.blocks for own in each], axis=0, weights=counts).tolist()
    level = float(np.average([own.level for own in each], weights=counts))
    return HeldFit(level, tuple(v for own in each for v in own.fit_percent), tuple(blocks))


def _level(each: Sequence[Agreement]) -> float:
    errors = np.maximum([own.rmse for own in each], 1e-150)
    return float(2 * np.log(errors).mean())


def leaves_dynamics(fits: Sequence[Fit]) -> bool:
    """Whether the residuals of some output follow an input, or cannot be tested.

    Parameters
    ----------
    fits : sequence of Fit
    """
    tests = [fit.tests for fit in fits]
    return any(
        test is None or any(p < MAX_P_VALUE for p in test.independent_p.values()) for test in tests
    )


@dataclass(frozen=True)
class Separate:
    """Models of single outputs, run side by side.

    Attributes
    ----------
    models : tuple
        One for each output.
    """

    models: tuple[Ranked, ...]

    @property
    def parameters(self) -> float:
        """Of all outputs."""
        return sum(model.parameters for model in self.models)

    def carried_on(self, split: Split) -> Array:
        """As `OutputModel.carried_on`, shape (p, n)."""
        each = enumerate(self.models)
        return np.array([model.carried_on(split.only(k)) for k, model in each])
