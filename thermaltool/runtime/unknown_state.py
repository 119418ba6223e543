"""How much of the machine's state the estimate may not know."""

from __future__ import annotations

import math

from thermaltool.estimation.settling_time import REMAINDER


class UnknownState:
    """The share of the state that the estimate may not know, as of a first-order lag.

    It grows while nothing is read and falls while readings come.

    Parameters
    ----------
    settling_time : float [s]
        Until `REMAINDER` of a wrong start is left.

    Attributes
    ----------
    unknown : float
        0 (all is known) to 1 (nothing is).
    """

    def __init__(self, settling_time: float) -> None:
        self.settling_time = settling_time
        self.unknown = 0.0

    @property
    def lasts(self) -> bool:
        """Whether the estimate is still on its way."""
        return self.unknown > REMAINDER

    @property
    def left(self) -> float:
        """How long readings have to come until it is there [s]; inf where it never is."""
        if math.isinf(self.settling_time):
            return math.inf if self.lasts else 0.0
        return self.settling_time * max(1 - math.log(self.unknown) / math.log(REMAINDER), 0.0)

    def blind(self, seconds: float) -> None:
        """Nothing was read for so long [s]."""
        if math.isinf(self.settling_time):
            # What never decays stays, however short the time in which it came.
            self.unknown = 1.0 if seconds > 0 else self.unknown
            return
        self.unknown = 1 - (1 - self.unknown) * self._kept(seconds)

    def reads(self, seconds: float) -> None:
        """Readings have come for so long [s]."""
        if self.unknown:
            self.unknown *= self._kept(seconds)

    def _kept(self, seconds: float) -> float:
        if not seconds:
            return 1.0
        return math.exp(math.log(REMAINDER) * seconds / max(self.settling_time, 1e-9))
