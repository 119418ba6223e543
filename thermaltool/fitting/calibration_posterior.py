"""Parameters and lags of a calibration, given the sizes of all that a residual is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from thermaltool.fitting.gaussian_columns import information_of, inverse_of
from thermaltool.responses.modes import Float

# Prior standard deviation of a parameter's move: so many times what the noise leaves open of it,
# but no less than the first and no more than the second share of its size, nor more than what is
# linear to within the noise; the lags say the rest.
MOVE_ERRORS, PARAMETER_MOVES = 3.0, (0.003, 0.3)


@dataclass(frozen=True)
class CalibrationPosterior:
    """Gaussian posterior at one level.

    Attributes
    ----------
    mean, covariance : ndarray, shape (p + q,), (p + q, p + q)
        Moves of the parameters and weights of the lags.
    mean_alone, covariance_alone : ndarray, shape (f,), (f, f)
        Moves of the parameters of the fit, without lags.
    instants : ndarray, shape (m,)
        The likeliest ones.
    """

    mean: Float
    covariance: Float
    mean_alone: Float
    covariance_alone: Float
    instants: Float

    @staticmethod
    def of(
        gram: Float,
        white: float,
        fitted: Float,
        span: Float,
        linear: Float,
        sizes: tuple[tuple[int, float], ...],
    ) -> CalibrationPosterior:
        """From products of the residual, sensitivities, lags, instants, bends and free columns.

        Parameters
        ----------
        gram : ndarray, shape (1 + p + q + m + w + r,) * 2
        white : float [unit of the output]
        fitted : ndarray, shape (p, f)
            Zeros and ones: which parameter of the fit each one is.
        span, linear : ndarray, shape (p,)
            Sizes of the parameters, and moves that are linear, over those.
        sizes : tuple of (int, float)
            Numbers and prior sizes of lags, instants and bends, over the white noise.

        Returns
        -------
        CalibrationPosterior
        """
        p, f, ((q, _), *others) = *fitted.shape, sizes
        prior = information_of(len(gram) - 1, p, *sizes)
        # Beside no lags: what the noise alone leaves open of the parameters stays open beside them,
        # and what it does not show at all is open to the most.
        lagless = np.delete(np.arange(len(gram)), slice(1 + p, 1 + p + q))
        bare = gram[np.ix_(lagless, lagless)]
        prior[:p] = (white / (PARAMETER_MOVES[1] * span)) ** 2
        without = np.delete(prior, slice(p, p + q))
        alone = inverse_of(bare, without)
        tie = block_diag(np.ones((1, 1)), fitted, np.eye(len(bare) - 1 - p))
        tied = tie.T @ bare @ tie
        whole = inverse_of(tied, np.append(np.max(fitted.T * prior[:p], axis=1), without[p:]))
        errors = white * np.sqrt(np.maximum(np.diag(alone)[:p], 0.0)) / span
        least, most = PARAMETER_MOVES
        moves = np.clip(MOVE_ERRORS * errors, np.minimum(least, linear), np.minimum(most, linear))
        prior[:p] = (white / (moves * span)) ** 2
        inverse = inverse_of(gram, prior)
        keep, fit = slice(0, p + q), slice(1, 1 + p + q)
        return CalibrationPosterior(
            (inverse @ gram[1:, 0])[keep],
            white**2 * inverse[keep, keep],
            (whole @ tied[1:, 0])[:f],
            white**2 * whole[:f, :f],
            _instants(np.delete(np.delete(gram, fit, 0), fit, 1), others),
        )


def _instants(gram: Float, groups: Sequence[tuple[int, float]]) -> Float:
    """The likeliest of the first group beside the fit as it stands: no parameter, no lag moves."""
    inverse = inverse_of(gram, information_of(len(gram) - 1, 0, *groups))
    return np.asarray((inverse @ gram[1:, 0])[: groups[0][0]])
