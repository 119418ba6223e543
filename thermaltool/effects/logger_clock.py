"""Clock of a logger: some readings carry another time than the drives."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.dynamics import HOUR, elapsed
from thermaltool.effects.effect import Effect, Float, Memory, Outputs, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.effects.sensor_lag import ODDS_BESIDE_SHAPE_ERROR
from thermaltool.errors import ModelError
from thermaltool.record import Record
from thermaltool.units import is_displacement

# Clocks that run apart by more than 2000 ppm are no clocks [s/h].
MAX_DRIFT = 7.2
# Offsets that are tried, from a sample to this share of a log.
OFFSETS, MAX_SHARE_OF_LOG = 3, 0.05


class LoggerClock(Effect):
    """Readings of one logger are the truth of `offset` earlier, and ever earlier by `drift`.

    ``logged[output]`` names what it logs. Between rows the truth is taken to run straight.
    """

    name: ClassVar[str] = "logger_clock"
    side: ClassVar[Side] = "sensor"
    explanation: ClassVar[str] = (
        "two loggers do not have the same time: temperatures are stamped late or early against "
        "displacements and drives, or their clocks run apart"
    )
    action: ClassVar[str] = (
        "set the clocks of the loggers: {channel} and what is logged with it has another time "
        "than the drives ({fitted})"
    )
    signature: ClassVar[str] = (
        "the residual of all outputs of one logger is minus their own slope, by one and the same "
        "time, and not that of the others"
    )
    source: ClassVar[str] = "Mills 2006, ch. 12 (offset and skew of two clocks)"
    causal: ClassVar[bool] = True
    known: ClassVar = {
        "offset": Parameter("s"),
        "drift": Parameter("s/h", low=-MAX_DRIFT, high=MAX_DRIFT),
        "logged": Parameter("1", neutral=1.0, fixed=True),
    }

    @property
    def odds(self) -> float:
        """What kinds of response leave out of their shapes looks like a clock of their sensors."""
        return ODDS_BESIDE_SHAPE_ERROR * super().odds

    def output(self, name: str, outputs: Outputs, record: Record, memory: Memory = None) -> Float:
        if f"logged[{name}]" not in self.parameters:
            return outputs[name]
        time, y = record.time, outputs[name]
        drift = self.parameters.get("drift", 0.0) / HOUR
        late = self.parameters.get("offset", 0.0) + drift * elapsed(time, memory)
        if memory is None:
            return np.interp(time - late, time, y)
        if np.any(late < 0):
            raise ModelError(f"{self.name}: a stream cannot read what is yet to come")
        known, truth = (np.append(memory.get(k, []), new) for k, new in (("time", time), ("y", y)))
        # What is read never goes back: clocks do not run apart so fast.
        first = max(int(np.searchsorted(known, time[-1] - late[-1], side="right")) - 1, 0)
        memory.update(time=known[first:], y=truth[first:])
        return np.interp(time - late, known, truth)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        loggers = [group for group in (scene.sensors(), scene.displacements()) if len(group) > 1]
        # A transmitter, a filter or a bus may hand one channel on late.
        groups: list[tuple[str, ...]] = []
        if len(scene.outputs) > 1:
            groups += [(output,) for output in scene.outputs]
        groups += loggers if scene.sensors() and scene.displacements() else []
        shortest, longest = scene.period, max(MAX_SHARE_OF_LOG * scene.duration, 2 * scene.period)
        apart = scene.period / scene.duration * HOUR
        for group in groups:
            logged = {f"logged[{output}]": 1.0 for output in group}
            for offset in np.geomspace(shortest, longest, OFFSETS).tolist():
                yield cls(group[0], {"offset": offset, **logged})
                yield cls(group[0], {"offset": -offset, **logged})
            # Clocks run apart by the logger; a channel of a displacement has one of its own.
            if apart < MAX_DRIFT and (len(group) > 1 or is_displacement(group[0])):
                yield cls(group[0], {"drift": apart, **logged})
                yield cls(group[0], {"drift": -apart, **logged})
