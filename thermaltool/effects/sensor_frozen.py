"""Frozen sensor: a reading keeps one value."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.record import Record

# Fewer equal readings in a row than this, or than this many times what is usual in the log, are
# chance or coarse steps.
MIN_EQUAL, MIN_TIMES_USUAL = 10, 3.0
# The machine has to move meanwhile by so many standard deviations of noise and so many of the
# smallest steps of the reading.
MIN_SIGMAS_MOVED, MIN_STEPS_MOVED = 5.0, 2.0
# The longest stretches of a channel are enough.
MAX_STRETCHES = 5


class SensorFrozen(Effect):
    """From `start` on, and until `stop` if there is one, the reading of `start` is repeated."""

    name: ClassVar[str] = "sensor_frozen"
    side: ClassVar[Side] = "sensor"
    bends: ClassVar[bool] = True
    event: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "one reading keeps its value: a hung converter, a lost bus, a probe at its stop"
    )
    action: ClassVar[str] = (
        "look at probe, converter and bus of {channel}: it read the same value from {start} "
        "into the log on; leave these rows out"
    )
    signature: ClassVar[str] = (
        "one channel repeats itself to the last digit while the machine goes on"
    )
    source: ClassVar[str] = "Isermann 2006, Fault-Diagnosis Systems (sensor faults)"
    causal: ClassVar[bool] = True
    known: ClassVar = {"start": Parameter("s", fixed=True), "stop": Parameter("s", fixed=True)}

    def reading(self, y: Float, record: Record, memory: Memory = None) -> Float:
        time = record.time
        first = int(np.searchsorted(time, self.parameters["start"]))
        if first == len(time):
            return y
        memory = {} if memory is None else memory
        frozen = memory.setdefault("reading", float(y[first]))
        stop = self.parameters.get("stop", np.inf)
        return np.where((np.arange(len(y)) >= first) & (time < stop), frozen, y)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for k, log in enumerate(scene.logs):
            for output in scene.outputs:
                if output not in log.columns:
                    continue
                there = np.flatnonzero(np.isfinite(log.columns[output]))
                values = log.columns[output][there]
                changes = np.abs(np.diff(values))
                smallest = float(np.min(changes[changes > 0], initial=np.inf))
                enough = MIN_SIGMAS_MOVED * scene.noise[output]
                enough += MIN_STEPS_MOVED * smallest if np.isfinite(smallest) else 0.0
                for first, last in _repeats(values)[:MAX_STRETCHES]:
                    during = scene.simulated[k][output][there[first] : there[last] + 1]
                    if np.ptp(during) > enough:
                        parameters = {"start": float(log.time[there[first]])}
                        if last + 1 < len(there):
                            parameters["stop"] = float(log.time[there[last + 1]])
                        yield cls(output, parameters, log.digest)


def _repeats(values: Float) -> list[tuple[int, int]]:
    """First and last row of every unusually long stretch of equal values, the longest first."""
    if not len(values):
        return []
    first = np.flatnonzero(np.append(True, np.diff(values) != 0))
    lengths = np.diff(np.append(first, len(values)))
    found = []
    for k in np.argsort(-lengths, kind="stable").tolist():
        others = np.delete(lengths, k)
        usual = float(np.quantile(others, 0.99)) if len(others) else 1.0
        if lengths[k] < max(MIN_EQUAL, MIN_TIMES_USUAL * usual):
            break
        found.append((int(first[k]), int(first[k] + lengths[k] - 1)))
    return found
