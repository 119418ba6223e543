"""Parts of a residual: noise, what the calibration left, and the rest; their squares add up."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ResidualParts:
    """RMS of a residual about the mean of each log, and of its parts.

    Attributes
    ----------
    rms : float [unit of the output]
        Of all logs. Its square is the sum of the squares of the parts.
    noise : float [unit of the output]
        Of a reading; no more than `rms`.
    calibration : float [unit of the output]
        What the calibration itself left, and what commands do that switch between rows.
    rest : float [unit of the output]
        Neither.
    """

    rms: float
    noise: float
    calibration: float
    rest: float

    @classmethod
    def of(cls, rms: float, white: float, accounted: float = 0.0) -> ResidualParts:
        """Parts of a residual by the share of its power that is accounted for.

        Parameters
        ----------
        rms, white : float [unit of the output]
            Of the residual, and of the noise of a reading.
        accounted : float
            Share of the power that noise and what the calibration left account for together; that
            of the noise at least.
        """
        noise = min(white, rms)
        known = max(accounted * rms**2, noise**2)
        calibration, rest = known - noise**2, max(rms**2 - known, 0.0)
        return cls(rms, noise, float(calibration**0.5), float(rest**0.5))
