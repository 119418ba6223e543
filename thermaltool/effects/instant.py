"""What causes have in common that change something from an instant on."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from thermaltool.effects.effect import Effect
from thermaltool.effects.scene import Scene

# Parameters that are a time of the clock of one log, of these causes and others.
INSTANTS = ("time", "start", "stop")
# Readings of the channel before and after the instant.
MIN_READINGS_BESIDE = 3


class Instant(Effect):
    """Something is another from `time` on, in one log."""

    event: ClassVar[bool] = True

    def plausible(self, scene: Scene) -> bool:
        # What fewer readings show is an outlier, or how the log begins or ends.
        for log in scene.logs:
            if log.digest == self.log:
                values = log.columns.get(self.channel, log.time)
                before = (log.time < self.parameters["time"])[np.isfinite(values)]
                if min(np.sum(before), np.sum(~before)) < MIN_READINGS_BESIDE:
                    return False
        return super().plausible(scene)
