"""Diffusive responses as sums of real exponentials on a logarithmic grid of rates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from thermaltool.errors import FitError
from thermaltool.responses.modes import Float, Hold, Modes, uniform_spans


@dataclass(frozen=True)
class RelaxationGrid:
    """Exponentials on a logarithmic grid of rates, and the map from step responses to weights.

    The relaxation spectrum of a diffusive response lies on the negative real axis (for the ring
    source below −aα, Fraser 1997 (5.8)); weights on a grid of rates by least squares follow it to
    a part in 10⁶ at eight rates per decade, and stay of the order of the gain.

    Attributes
    ----------
    rates : ndarray, shape (n,) [1/s]
    times : ndarray, shape (m,) [s]
        Where a step response has to be known.
    """

    rates: Float
    times: Float
    _inverse: Float

    @staticmethod
    @lru_cache(maxsize=64)
    def between(slow: float, fast: float, delayed: bool = False) -> RelaxationGrid:
        """For rates from `slow` to `fast` [1/s].

        `delayed`: the responses start with zero slope and curvature, as all do that reach the
        probe by diffusion. An inverse amplifies what is left of either.

        Parameters
        ----------
        slow, fast : float [1/s]
        delayed : bool
        """
        per_decade = 10 if delayed else 8
        rates = np.geomspace(slow, fast, int(np.ceil(np.log10(fast / slow) * per_decade)) + 1)
        times = np.geomspace(0.5 / fast, 40 / slow, 6 * len(rates))
        # The steady state is a row of its own, with weight: gains are judged by it.
        rows = [-np.expm1(-np.outer(times, rates)), np.full((1, len(rates)), 10.0)]
        if delayed:
            rows += [1e3 * (rates[None, :] / fast) ** k for k in (1, 2)]
        inverse = np.linalg.pinv(np.vstack(rows), rcond=1e-14)
        return RelaxationGrid(rates, times, inverse[:, : len(times) + 1])

    def weights(self, response: StepResponse) -> Float:
        """Σ w (1 − e^(−rate·t)) ≈ step response; shape (n,).

        Parameters
        ----------
        response : StepResponse
        """
        dc_gain = response.dc_gain()
        return np.asarray(self._inverse @ np.append(response.step(self.times), 10 * dc_gain))

    def states(self, time: Float, u: Float, hold: Hold) -> Float:
        """Responses of rate/(s + rate), for every rate, to one input from rest.

        Parameters
        ----------
        time, u : ndarray, shape (n_samples,)

        Returns
        -------
        ndarray, shape (n_samples, n)
        """
        x = np.zeros((len(time), len(self.rates)))
        bank = Modes((-self.rates).astype(complex), np.ones(len(self.rates), complex))
        for rows, dt in uniform_spans(time):
            one = bank.discretize(dt, hold)
            phi, g0, g1 = np.diag(one.F), one.G0[:, 0] * self.rates, one.G1[:, 0] * self.rates
            for k in range(rows.start, rows.stop - 1):
                x[k + 1] = phi * x[k] + g0 * u[k] + g1 * u[k + 1]
        return x


class StepResponse(Protocol):
    def step(self, t: Float) -> Float: ...
    def dc_gain(self) -> float: ...


def fit_relaxation(
    response: StepResponse, slow: float, fast: float, dt: float, tol: float = 3e-5
) -> Modes:
    """A response by diffusion as a sum of real exponentials.

    Parameters
    ----------
    response : has ``step(t)`` and ``dc_gain()``
    slow, fast : float [1/s]
        Ends of the spectrum: below `slow` there is nothing, above `fast` nothing is wanted.
    dt : float [s]
        Shortest sample: what the response does within half of it is not judged.
    tol : float
        Largest error of the step response, relative to its largest value.

    Raises
    ------
    FitError
        Where the tolerance is not reached.
    """
    # A probe beside the source answers within the sample: there is no delay to keep.
    for delayed in (True, False):
        grid = RelaxationGrid.between(slow, fast, delayed)
        target = response.step(grid.times)
        weights = grid.rates * grid.weights(response)
        modes = Modes((-grid.rates).astype(complex), weights.astype(complex))
        judged = np.abs(modes.step(grid.times) - target)[grid.times >= min(dt / 2, grid.times[-1])]
        error = float(np.max(judged) / np.max(np.abs(target)))
        if error <= tol:
            return modes
    raise FitError(
        f"a sum of {len(grid.rates)} exponentials is off by {error:.1e} (wanted {tol:.1e})"
    )
