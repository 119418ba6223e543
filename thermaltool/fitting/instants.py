"""Instants of switches between the rows of a log, as a part of the noise of a calibration.

Each lies anywhere between two rows; straight lines are the mean of what it does, and its pulse is
what is left. With columns B, each an instant by its standard deviation, the errors of a fit have
the covariance s²·I + B Bᵀ: a generalized least-squares fit, with intervals that count the instants.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import minimize_scalar

from thermaltool.fitting.projection import CalibrationProblem
from thermaltool.model import Drive
from thermaltool.record import Record
from thermaltool.responses import Response
from thermaltool.responses.modes import Float
from thermaltool.responses.switching import SPREAD, change_by_instant, switches
from thermaltool.units import Hold

# Of more switches of all drives and logs the largest of each count; what switches in a larger share
# of the rows is no command.
MAX_SWITCHES, MAX_SHARE = 400, 1 / 3
# ... in a test of linearity, whose rows are all in memory.
MAX_PULSES = 80
# Rise of the log evidence from which the instants are a part of the fit.
DECISIVE = 10.0
# The noise beside them is looked for down to this share of the whole error.
MIN_NOISE = 1e-4


@dataclass(frozen=True)
class Instants:
    """Instants of the switches of all drives, as far as one output shows them.

    Attributes
    ----------
    columns : ndarray, shape (rows, m)
        Change of the output by each, earlier by a standard deviation [unit of the output].
    noise : float
        Standard deviation of the noise beside them [unit of the output].
    evidence : float
        Rise of the log likelihood, with the instants integrated out, over white noise alone.
    """

    columns: Float
    noise: float
    evidence: float

    @staticmethod
    def of(columns: Float, residual: Float) -> Instants:
        """With the noise of largest likelihood.

        Parameters
        ----------
        columns : ndarray, shape (rows, m)
        residual : ndarray, shape (rows,)
        """
        left, values, _ = np.linalg.svd(columns, full_matrices=False)
        along = (left.T @ residual) ** 2
        whole, rows = float(residual @ residual), len(residual)
        rest = max(whole - float(along.sum()), 0.0)

        def misfit(log_noise: float) -> float:
            square = np.exp(2 * log_noise)
            both = square + values**2
            free = (rows - len(values)) * np.log(square) + rest / square
            return float(0.5 * (free + np.sum(np.log(both) + along / both)))

        top = 0.5 * np.log(max(whole / rows, 1e-300))
        found = minimize_scalar(
            misfit, bounds=(top + np.log(MIN_NOISE), top + 1e-9), method="bounded"
        )
        alone = 0.5 * rows * (2 * top + 1)
        return Instants(columns, float(np.exp(found.x)), alone - float(found.fun))

    @cached_property
    def _directions(self) -> tuple[Float, Float]:
        """Left singular vectors of the columns, and their singular values."""
        left, values, _ = np.linalg.svd(self.columns, full_matrices=False)
        return left, values

    def left(self, residual: Float, weights: Float) -> Float:
        """Residual beside what the likeliest instants explain of it, shape (rows,)."""
        weighted = self.columns * weights[:, None]
        information = self.columns.T @ weighted + self.noise**2 * np.eye(self.columns.shape[1])
        return np.asarray(
            residual - self.columns @ np.linalg.solve(information, weighted.T @ residual)
        )

    def whitened(self, rows: Float) -> Float:
        """Rows through s·(s²·I + B Bᵀ)^(-1/2), shape as they are."""
        left, values = self._directions
        share = self.noise / np.hypot(self.noise, values) - 1
        return np.asarray(rows + (left * share) @ (left.T @ rows))


def fitted_instants(
    problem: CalibrationProblem,
    records: Sequence[Record],
    drives: Sequence[Drive],
    between: Sequence[str],
    responses: Sequence[Response],
    residual: Float,
) -> Instants | None:
    """Instants of all switches near a fit; None where the evidence does not ask for them.

    Parameters
    ----------
    problem : CalibrationProblem
    records : sequence of Record
    drives : sequence of Drive
    between : sequence of str
        Drives that switch between the rows.
    responses : sequence of Response, one for each drive
    residual : ndarray, shape (rows,)
    """
    columns = _columns(problem, records, drives, between, responses)
    if not columns.shape[1]:
        return None
    found = Instants.of(columns, residual)
    return found if found.evidence > DECISIVE else None


def _columns(
    problem: CalibrationProblem,
    records: Sequence[Record],
    drives: Sequence[Drive],
    between: Sequence[str],
    responses: Sequence[Response],
) -> Float:
    """Change of the output by the instant of each switch, shape (rows, m)."""
    most = max(MAX_SWITCHES // max(len(between) * len(records), 1), 1)
    columns = []
    for k, record in enumerate(records):
        own = problem.record == k
        for drive, response in zip(drives, responses, strict=True):
            if drive.channel not in between:
                continue
            level, time = record.column(drive.channel), record.time
            for j in switches(level, np.diff(time), most, MAX_SHARE):
                column = np.zeros(len(problem.measured))
                column[own] = change_by_instant(
                    problem.time[own], time[j], time[j + 1],
                    float(level[j + 1] - level[j]), [response],
                )  # fmt: skip
                columns.append(column)
    return np.array(columns).reshape(len(columns), len(problem.measured)).T


def pulses(
    levels: Float, response: Callable[[int, Float], Float], holds: Sequence[Hold], records: int
) -> Iterator[Float]:
    """Change of an output by the instant of each switch of a held input, each shape (n,).

    Parameters
    ----------
    levels : ndarray, shape (inputs, n)
        On an even clock.
    response : callable
        Of the number of an input and its course, shape (n,): asked of what switches alone.
    holds : sequence of Hold, one for each input
    records : int
        Over which the switches are counted.
    """
    most = max(MAX_PULSES // max(len(levels) * records, 1), 1)
    for i, (level, hold) in enumerate(zip(levels, holds, strict=True)):
        steps = np.ones(len(level) - 1)
        found = switches(level, steps, most, MAX_SHARE) if hold == "zero" else []
        if not found:
            continue
        # Half a row after the switch: of a level held between the rows `response` is the mean over
        # instants, of which the first row holds half. An input may have stood at its first value
        # before the record: the impulse is in the second row.
        once = response(i, np.eye(1, len(level), 1)[0])[1:]
        own = (once + np.append(once[1:], 0.0)) / 2
        own[0] += once[0] / 2
        for j in found:
            late = np.concatenate([np.zeros(j + 1), own])[: len(level)]
            yield SPREAD * float(level[j + 1] - level[j]) * late
