"""From a record to its time-constant spectrum, with intervals and networks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from thermaltool.fitting.data import Array
from thermaltool.fitting.spectrum.bounds import SpectrumBounds
from thermaltool.fitting.spectrum.compressed import compress
from thermaltool.fitting.spectrum.density import smooth_spectrum
from thermaltool.fitting.spectrum.ladder import ThermalLadder, cauer_ladder, foster_capacities
from thermaltool.fitting.spectrum.lines import LineFit, candidates, choose
from thermaltool.fitting.spectrum.transient import Transient, transient_of
from thermaltool.record import Record
from thermaltool.signals.intervals import Estimate, log_normal_estimate, normal_estimate
from thermaltool.signals.whiteness import PortmanteauTest, ljung_box

# Times in a decade at which the cumulative resistance has its interval.
CUTS_PER_DECADE = 3
# Of the end of a grid [ln s].
ROUNDING = 1e-9
# Places of the smooth spectrum below this part of its total are empty: no part of a ladder.
MIN_PART = 1e-9
# Lags of the test of the residuals, and no more than this part of the rows.
TEST_LAGS, TEST_PART = 20, 5


@dataclass(frozen=True)
class SpectralLine:
    """One time constant of a spectrum, or what a log cannot tell from one.

    Attributes
    ----------
    time_constant : Estimate [s]
        Of all that lies in the stretch: the mean of ln τ by resistance. Its interval holds
        whatever the spectrum is.
    resistance : Estimate [K/W]
        Of all that lies in the stretch, with such an interval.
    stretch : (float, float) [s]
        From half way to the line before to half way to the next one.
    time_constant_alone, resistance_alone : Estimate
        The same with intervals for a spectrum of these lines and nothing else.
    """

    time_constant: Estimate
    resistance: Estimate
    stretch: tuple[float, float]
    time_constant_alone: Estimate
    resistance_alone: Estimate


@dataclass(frozen=True)
class CumulativeResistance:
    """Resistance of all time constants up to some, with its 95 % interval.

    Attributes
    ----------
    time_constants : ndarray, shape (m,) [s]
    value, low, high : ndarray, shape (m,) [K/W]
        Of the smooth spectrum, and what all spectra that fit have in common.
    """

    time_constants: Array
    value: Array
    low: Array
    high: Array


@dataclass(frozen=True)
class ThermalSpectrum:
    """Time-constant spectrum of one transient.

    Attributes
    ----------
    transient : Transient
    fit : LineFit
        The lines, fastest first.
    fits : tuple of LineFit
        All that were compared, fewest lines first.
    lines : tuple of SpectralLine
    fitted : ndarray, shape (n,) [K]
        The output by the lines.
    whiteness : PortmanteauTest
        Of what they leave.
    grid, density : ndarray, shape (M,) [s], [K/W for a decade]
        The smooth spectrum.
    ladder : ThermalLadder
        Of the lines.
    structure : ThermalLadder
        Of the smooth spectrum: its sums are the structure function.
    bounds : SpectrumBounds
    """

    transient: Transient
    fit: LineFit
    fits: tuple[LineFit, ...]
    lines: tuple[SpectralLine, ...]
    fitted: Array
    whiteness: PortmanteauTest
    grid: Array
    density: Array
    ladder: ThermalLadder
    structure: ThermalLadder
    bounds: SpectrumBounds

    @property
    def time_constants(self) -> Array:
        """Of the lines, shape (N,) [s]."""
        return np.exp(self.fit.logs)

    @property
    def capacities(self) -> Array:
        """Of the Foster cells, shape (N,) [J/K]."""
        return foster_capacities(self.time_constants, self.fit.resistances)

    @cached_property
    def cumulative(self) -> CumulativeResistance:
        """Cumulative resistance at some places of each decade."""
        grid = np.log(self.grid)
        decades = (grid[-1] - grid[0]) / np.log(10.0)
        cuts = np.linspace(grid[0], grid[-1], int(np.ceil(CUTS_PER_DECADE * decades)) + 1)[1:]
        ends = [self.bounds.resistance(-np.inf, cut) for cut in cuts.tolist()]
        sums = np.cumsum(self.density) * float(np.log10(self.grid[1] / self.grid[0]))
        low, high = np.array(ends).T
        return CumulativeResistance(np.exp(cuts), np.interp(cuts, grid, sums), low, high)


def thermal_spectrum(
    record: Record,
    drive: str,
    output: str,
    lines: int | None = None,
    before: float | None = None,
    step_at: float | None = None,
) -> ThermalSpectrum:
    """Time-constant spectrum R(τ) of T = ∫ R(τ)/(τs + 1) dτ · P, and its networks.

    Parameters
    ----------
    record : Record
        Without missing values in either channel.
    drive, output : str
    lines : int, optional
        Number of lines. Default: that of the least BIC.
    before, step_at : float, optional
        See `transient_of`.

    Raises
    ------
    LogError
        As `transient_of`.
    FitError
        The output falls where the power rises; the log carries fewer lines.
    """
    transient = transient_of(record, drive, output, before, step_at)
    problem = compress(transient)
    fits = candidates(problem)
    fit = choose(fits, lines)
    bounds = SpectrumBounds(fit)
    total = float(np.sum(fit.resistances))
    grid = problem.grid[problem.grid <= problem.usual_end(fit.logs) + ROUNDING]
    smooth = smooth_spectrum(problem, grid, fit.variance, total)
    found = np.flatnonzero(smooth > MIN_PART * total)
    taus = np.exp(fit.logs)
    fitted = np.full(len(transient.time), fit.offset)
    for rows, responses in transient.responses(taus):
        fitted[rows] += responses @ fit.resistances
    residual = transient.rise - fitted
    lags = min(TEST_LAGS, len(residual) // TEST_PART)
    decade = float(grid[1] - grid[0]) / np.log(10.0)
    return ThermalSpectrum(
        transient,
        fit,
        tuple(fits),
        _lines(fit, bounds),
        fitted,
        ljung_box([residual - residual.mean()], lags, 0),
        np.exp(grid),
        smooth / decade,
        cauer_ladder(taus, fit.resistances),
        cauer_ladder(np.exp(grid[found]), smooth[found]),
        bounds,
    )


def _lines(fit: LineFit, bounds: SpectrumBounds) -> tuple[SpectralLine, ...]:
    n, errors = len(fit.logs), np.sqrt(np.maximum(np.diag(fit.covariance()), 0.0))
    edges = np.concatenate([[-np.inf], (fit.logs[1:] + fit.logs[:-1]) / 2, [np.inf]])
    found = []
    for k, (log, resistance) in enumerate(
        zip(fit.logs.tolist(), fit.resistances.tolist(), strict=True)
    ):
        low, high = float(edges[k]), float(edges[k + 1])
        tau = float(np.exp(log))
        first, last = np.exp(bounds.mean_log(low, high)).tolist()
        least, most = bounds.resistance(low, high)
        found.append(
            SpectralLine(
                Estimate(tau, min(first, tau), max(last, tau), "s"),
                Estimate(resistance, min(least, resistance), max(most, resistance), "K/W"),
                (float(np.exp(low)), float(np.exp(high))),
                log_normal_estimate(tau, float(errors[k]), "s"),
                normal_estimate(resistance, float(errors[n + k]), "K/W"),
            )
        )
    return tuple(found)
