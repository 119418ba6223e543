"""Loss of heat that has changed for good since the calibration: fan, filter, covers, coolant."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np

from thermaltool.effects.effect import Effect, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.responses import Response
from thermaltool.responses.losing import losing
from thermaltool.units import is_absolute

# Least noise of a reading.
TINY = 1e-12
# Factors that are worth a trial.
TRIALS = (0.6, 0.8, 1.3, 2.0)
MAX_RATIO = 8.0
# By which modes of an output come to weigh more, at most for a loss e times as large.
WEIGHTS, MOST_MIXED = ("slow", "fast"), 3.0


class LossChange(Effect):
    """Heat is lost `factor` times as fast as at the calibration, at all times.

    Modes decay faster by one rate, by which `time_constant`, the slowest one that matters, becomes
    that part of itself. Where bodies lose heat by other rates than they store it that of the fast
    ones changes `ratio` times as much, and they come to weigh `fast[output]` more, slow ones
    `slow[output]`. See `thermaltool.responses.losing.LosingHeat`.
    """

    name: ClassVar[str] = "loss_change"
    side: ClassVar[Side] = "state"
    defect: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "the machine loses heat at another rate than at the calibration: a filter has clogged, a "
        "fan has failed, a cover is open, the coolant flows otherwise"
    )
    action: ClassVar[str] = (
        "look at what cools the machine, around {channel} first (fans, filters, covers, coolant): "
        "it loses heat otherwise than at the calibration; mend it, or calibrate again"
    )
    signature: ClassVar[str] = (
        "all outputs reach less, and sooner, or more, and later, by one and the same rate"
    )
    source: ClassVar[str] = "Incropera & DeWitt, ch. 5 (lumped capacitance); Mize 1998 (coolant)"
    causal: ClassVar[bool] = True
    stands: ClassVar[bool] = True
    known: ClassVar = {
        "factor": Parameter("1", neutral=1.0, low=0.1, high=10.0, log=True),
        "time_constant": Parameter("s", fixed=True),
        "ratio": Parameter("1", neutral=1.0, low=0.0, high=MAX_RATIO),
        "slow": Parameter("1", linear=True),
        "fast": Parameter("1", linear=True),
    }

    def response(self, response: Response, drive: str, output: str) -> Response:
        own = self.parameters
        rate = (own["factor"] - 1.0) / own["time_constant"]
        slow, fast = (own.get(f"{name}[{output}]", 0.0) for name in WEIGHTS)
        rates, to_drive = (rate, own.get("ratio", 1.0) * rate), is_absolute(drive)
        return losing(response, rates, own["time_constant"], (slow, fast), to_drive)

    def finer(self) -> Self | None:
        if "ratio" in self.parameters:
            return None
        return replace(self, parameters={**self.parameters, "ratio": 1.0}, covariance=None)

    def odds_alone(self, output: str | None) -> float:
        return 0.0

    def plausible(self, scene: Scene) -> bool:
        # Modes mix as far as the loss changes: else they are gains of a drive or of sensors. In a
        # displacement, where bodies cancel, hardly any of a mode may be left.
        most = MOST_MIXED * abs(np.log(self.parameters["factor"]))
        names = [f"{name}[{output}]" for output in scene.sensors() for name in WEIGHTS]
        mixed = max((abs(self.parameters.get(name, 0.0)) for name in names), default=0.0)
        return super().plausible(scene) and mixed <= most

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        if not scene.bodies:
            return
        # The temperature that is read best tells the time constant best.
        bodies = [o for o in scene.sensors() if o in scene.bodies] or list(scene.bodies)
        place = max(bodies, key=lambda output: scene.spans[output] / max(scene.noise[output], TINY))
        weights = dict.fromkeys([f"{name}[{o}]" for o in scene.bodies for name in WEIGHTS], 0.0)
        for log in scene.within_one():
            for factor in TRIALS:
                own = {"factor": factor, "time_constant": scene.bodies[place], **weights}
                yield cls(place, own, log)
