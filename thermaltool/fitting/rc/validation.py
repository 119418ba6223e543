"""How a fitted network predicts: from row to row, and carried on without a correction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from thermaltool.fitting.rc.data import FilterPiece, filter_pieces
from thermaltool.fitting.rc.fit import RcFit
from thermaltool.fitting.rc.kalman import Innovations, innovations
from thermaltool.fitting.rc.likelihood import start_priors
from thermaltool.fitting.rc.state_space import thermal_modes
from thermaltool.record import Record
from thermaltool.signals.agreement import Agreement, agreement
from thermaltool.signals.whiteness import PeriodogramTest, cumulated_periodogram, ljung_box

Array = NDArray[np.float64]

# Lags of the test of whiteness, and rows that each of them takes.
MAX_LAGS, ROWS_PER_LAG = 25, 5


@dataclass(frozen=True)
class InnovationTests:
    """p-values of the one-step errors of one reading being white; small ones speak against it.

    Attributes
    ----------
    lags : int
    white_p : float
        Ljung-Box; NaN below ten rows.
    periodogram : PeriodogramTest
        Of the longest piece.
    """

    lags: int
    white_p: float
    periodogram: PeriodogramTest


@dataclass(frozen=True)
class RcAgreement:
    """How a network agrees with one reading over rows of one log.

    Attributes
    ----------
    network, log, output : str
    rows : {"fitted", "held out"}
    simulated : Agreement
        Of the model document from rest, as ``simulate`` gives it.
    one_step : Agreement
        Of predictions from row to row.
    carried_on : Agreement or None
        Of the state at the last fitted row carried on without a correction; of held-out rows of
        a fitted log.
    """

    network: str
    log: str
    output: str
    rows: Literal["fitted", "held out"]
    simulated: Agreement
    one_step: Agreement
    carried_on: Agreement | None = None


def innovation_tests(fit: RcFit) -> dict[str, InnovationTests]:
    """Tests of the one-step errors of the fitted rows, by channel.

    Parameters
    ----------
    fit : RcFit
    """
    runs = fit.likelihood.innovations(fit.vector[None])
    tests = {}
    for k, channel in enumerate(fit.network.outputs):
        errors = [
            run.standardized(k)[piece.present[:, k]]
            for run, piece in zip(runs, fit.likelihood.pieces, strict=True)
        ]
        errors = [e - np.mean(e) for e in errors if len(e) > 1]
        longest = max(errors, key=len)
        lags = min(MAX_LAGS, len(longest) // ROWS_PER_LAG)
        white = ljung_box(errors, lags).p_value if lags > 1 else float("nan")
        tests[channel] = InnovationTests(lags, white, cumulated_periodogram(longest))
    return tests


def one_step(fit: RcFit, logs: Sequence[Record]) -> dict[str, Agreement]:
    """Agreement of predictions from row to row with all readings of logs, by channel.

    Parameters
    ----------
    fit : RcFit
    logs : sequence of Record
    """
    pieces = filter_pieces(fit.network, logs)
    return _agreements(fit, pieces, [run.predictions for run in _runs(fit, pieces)])


def carried_on(
    fit: RcFit, logs: Sequence[Record], rows: Sequence[int]
) -> tuple[dict[str, Agreement], dict[str, Agreement]]:
    """Agreement with the rows behind the fitted ones: without a correction, and from row to row.

    The state goes on from where the filter left it at the last fitted row. What begins behind a
    pause there begins at rest where nothing corrects it.

    Parameters
    ----------
    fit : RcFit
    logs : sequence of Record
    rows : sequence of int
        Fitted rows of each piece.
    """
    pieces = filter_pieces(fit.network, logs)
    late = [np.arange(len(piece)) >= count for piece, count in zip(pieces, rows, strict=True)]
    blind = [piece.without_readings(where) for piece, where in zip(pieces, late, strict=True)]
    free = _runs(fit, blind, [count == 0 for count in rows])
    judged = [piece.without_readings(~where) for piece, where in zip(pieces, late, strict=True)]
    corrected = _runs(fit, pieces)
    return (
        _agreements(fit, judged, [run.predictions for run in free]),
        _agreements(fit, judged, [run.predictions for run in corrected]),
    )


def _runs(
    fit: RcFit, pieces: Sequence[FilterPiece], settled: Sequence[bool] | None = None
) -> list[Innovations]:
    modes = thermal_modes(fit.network, fit.likelihood.space.values(fit.vector[None]))
    priors = start_priors(fit.network, pieces)
    at_rest = settled or [False] * len(pieces)
    return [
        innovations(modes, piece, None if rest or fit.likelihood.from_rest else prior)
        for piece, prior, rest in zip(pieces, priors, at_rest, strict=True)
    ]


def _agreements(
    fit: RcFit, pieces: Sequence[FilterPiece], predictions: Sequence[Array]
) -> dict[str, Agreement]:
    return {
        channel: agreement(
            np.concatenate([piece.readings[:, k] for piece in pieces]),
            np.concatenate([predicted[:, 0, k] for predicted in predictions]),
        )
        for k, channel in enumerate(fit.network.outputs)
    }
