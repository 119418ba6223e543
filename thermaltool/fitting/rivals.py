"""Structures side by side: which one predicts blocks held out decisively better.

Each is fitted anew to the rows beside every block, with the orders that were chosen, and runs into
the block with the state that the rows before it leave (`TrainingData.folds`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, Split, TrainingData
from thermaltool.fitting.fit import Fit
from thermaltool.fitting.selection import BLOCKS, FITTED_SHARE, Ranked, excites
from thermaltool.signals.agreement import agreement

# Another structure is taken where it lowers the logarithm of the error variance of blocks held
# out, in the mean of the outputs, by so much; no output may lose more of its fit by that [points].
MIN_GAIN, MAX_LOST = 0.1, 2.0
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
    """

    level: float
    fit_percent: tuple[float, ...]

    def beats(self, other: HeldFit) -> bool:
        """Whether this one is decisively better, and no output is given up for others.

        Parameters
        ----------
        other : HeldFit
        """
        kept = all(
            own > before - MAX_LOST
            for own, before in zip(self.fit_percent, other.fit_percent, strict=True)
        )
        return kept and other.level - self.level > MIN_GAIN


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
    errors = np.maximum([own.rmse for own in each], 1e-150)
    return HeldFit(float(2 * np.log(errors).mean()), tuple(own.fit_percent for own in each))


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
