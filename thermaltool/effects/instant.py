"""What causes have in common that change something from an instant on."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from thermaltool.effects.effect import Effect, Scene

# Samples of the log before and after the instant.
MIN_SAMPLES_BESIDE = 3


class Instant(Effect):
    """Something is another from `time` on, in one log."""

    event: ClassVar[bool] = True

    def plausible(self, scene: Scene) -> bool:
        # What fewer samples show is an outlier, or how the log begins or ends.
        before = [
            log.time < self.parameters["time"] for log in scene.logs if log.digest == self.log
        ]
        seen = all(min(np.sum(b), np.sum(~b)) >= MIN_SAMPLES_BESIDE for b in before)
        return super().plausible(scene) and seen
