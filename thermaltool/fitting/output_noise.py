"""Noise of an output as a fit weighs its rows: white, with a slow drift in each record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermaltool.effects.effect import Float, needed
from thermaltool.model import Output, relative
from thermaltool.record import Record
from thermaltool.signals.drift import fit_drift
from thermaltool.signals.likelihood import ColouredNoise, Factor
from thermaltool.signals.robust import robust_std

# White noise is taken for at least this share of an output's range.
MIN_NOISE = 1e-4


def measured(output: Output, record: Record) -> Float:
    """Readings, shape (n,), NaN where missing; a zero that is free is near theirs [unit]."""
    return relative(needed(record, output.channel), output.offset)


def widest_range(series: Sequence[Float]) -> float:
    """Largest minus smallest value of the record that has most of it."""
    return max(*(float(np.nanmax(v) - np.nanmin(v)) for v in series), 1e-300)


@dataclass(frozen=True)
class OutputNoise:
    """White noise, and a drift of each record, of one output.

    Attributes
    ----------
    white : float [unit of the output]
    factors : tuple of Factor
        Covariance in each record, in units of the white variance.
    offset : bool
        The zero of each record is free.
    """

    white: float
    factors: tuple[Factor, ...]
    offset: bool

    @staticmethod
    def white_noise(output: Output, records: Sequence[Record]) -> OutputNoise:
        """White noise alone, from second differences of the readings.

        Parameters
        ----------
        output : Output
        records : sequence of Record
        """
        return OutputNoise._of(output, records, _second_differences(output, records), 0.0, 1.0)

    @staticmethod
    def of_errors(
        output: Output, records: Sequence[Record], errors: Sequence[Float]
    ) -> OutputNoise:
        """Maximum-likelihood white noise and drift of what a fit leaves in each record.

        Parameters
        ----------
        output : Output
        records : sequence of Record
        errors : sequence of ndarray
            Where there are readings, record by record [unit of the output].
        """
        clocks = _clocks(output, records)
        starts = np.cumsum([0, *map(len, clocks)])[:-1]
        try:
            found = fit_drift(np.concatenate(clocks), np.concatenate(errors), starts)
        except ValueError:  # too few, or nothing that scatters
            return OutputNoise.white_noise(output, records)
        white = max(found.white_sigma, _least_noise(output, records))
        if found.time_constant is None:
            return OutputNoise._of(output, records, white, 0.0, 1.0)
        ratio = (found.sigma / white) ** 2
        return OutputNoise._of(output, records, white, ratio, found.time_constant)

    @staticmethod
    def _of(
        output: Output, records: Sequence[Record], white: float, ratio: float, tau: float
    ) -> OutputNoise:
        first = np.zeros(1, np.int64)
        factors = (ColouredNoise(t, first).factor(ratio, tau) for t in _clocks(output, records))
        return OutputNoise(white, tuple(factors), output.offset == "first")

    def whitened(self, k: int, columns: Float) -> Float:
        """Rows of record k whose squares count: whitened, a free zero projected out.

        Parameters
        ----------
        k : int
        columns : ndarray, shape (n, c)
            Where there are readings [unit of the output].
        """
        rows = self.factors[k].whitened(columns) / self.white
        if self.offset:
            one = self.factors[k].whitened(np.ones((len(columns), 1)))
            one /= np.linalg.norm(one)
            rows = rows - one @ (one.T @ rows)
        return rows


def _clocks(output: Output, records: Sequence[Record]) -> list[Float]:
    return [r.time[np.isfinite(measured(output, r))] for r in records]


def _least_noise(output: Output, records: Sequence[Record]) -> float:
    """White noise that a sensor leaves in any case."""
    return MIN_NOISE * widest_range([measured(output, r) for r in records])


def _second_differences(output: Output, records: Sequence[Record]) -> float:
    bent = np.concatenate([np.diff(measured(output, r), 2) for r in records])
    bent = bent[np.isfinite(bent)]
    white = robust_std(bent) / float(np.sqrt(6.0)) if len(bent) else 0.0
    return max(white, _least_noise(output, records))
