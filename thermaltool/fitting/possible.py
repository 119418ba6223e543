"""What no machine does, and what no log shows: fits that are no answer, whatever their error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermaltool.effects.channels import is_possible_gain
from thermaltool.fitting.projection import MAX_CANCELLATION
from thermaltool.model import Drive
from thermaltool.responses import Response
from thermaltool.responses.modes import Float
from thermaltool.units import is_absolute, is_overdamped

# Share of the largest rise that a temperature may go back while what warms it stays on: kinds of
# few time constants begin with so much the wrong way where heat has to pass through other parts.
MAX_REVERSAL = 0.05
# Of so many of the slowest time constants a response is as good as settled; instants in between.
SETTLED, INSTANTS = 8.0, 60
# What breaks on other inputs is no answer, unless nothing else comes within so much of its error.
CANCELLING_LOSS = 2.0
# By so much more than a machine sustains a time constant may be: there it hardly matters.
TOO_LONG = 1.05
# A time constant of so many of the longest record is a trend, and its gain a guess.
MAX_SLOWEST = 2.0


@dataclass(frozen=True)
class Soundness:
    """Whether a fit may be an answer, however close it comes.

    Attributes
    ----------
    cancellation : float
        Size of the largest term over that of the output.
    slowest : float
        Slowest time constant over the longest record.
    impossible : str
        What no machine does; empty where there is nothing of that.
    """

    cancellation: float
    slowest: float
    impossible: str

    @property
    def flaw(self) -> str:
        """Why it is no answer; empty where it is one."""
        if self.breaks:
            return self.breaks
        if self.slowest > MAX_SLOWEST:
            return f"a time constant of {self.slowest:.3g} times the record"
        return ""

    @property
    def breaks(self) -> str:
        """Why it breaks on other inputs; empty where it need not. A trend may be what is there."""
        if self.impossible:
            return self.impossible
        if self.cancellation > MAX_CANCELLATION:
            return f"terms of {self.cancellation:.3g} times the output cancel"
        return ""


def impossible(
    drives: Sequence[Drive], output: str, responses: Sequence[Response], longest: float = np.inf
) -> str:
    """Why responses are none of a machine; empty where they may be.

    Parameters
    ----------
    drives : sequence of Drive
    output : str
    responses : sequence of Response
        One for each drive.
    longest : float [s]
        See `CalibrationProblem`.
    """
    if max(response.slowest() for response in responses) > TOO_LONG * longest:
        return "where it is cold it would warm itself"
    for drive, response in zip(drives, responses, strict=True):
        slowest = response.slowest()
        step = response.step(slowest * np.geomspace(SETTLED / 1e4, SETTLED, INSTANTS))
        gain = float(step[-1])
        if not is_possible_gain(drive.channel, output, gain):
            return f"{drive.channel} would move it by {gain:.3g} °C for each °C"
        heated = is_absolute(output) and is_overdamped([drive.channel], output)
        if heated and reversal(step) > MAX_REVERSAL:
            return f"{drive.channel} would warm it and, staying on, cool it"
    return ""


def reversal(step: Float) -> float:
    """How far a step response goes back, as a share of its largest value.

    The temperature of any part of a body answers a step of heat, or of the temperature around it,
    monotonically: the maximum principle of the heat equation. A difference of two need not.

    Parameters
    ----------
    step : ndarray, shape (n,)
    """
    largest = float(np.max(np.abs(step)))
    if not largest:
        return 0.0
    rising = step * np.sign(step[int(np.argmax(np.abs(step)))])
    return float(np.max(np.maximum.accumulate(rising) - rising)) / largest
