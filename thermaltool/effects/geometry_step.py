"""Step change of geometry: a crash, a new clamping."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

from thermaltool.effects.dynamics import jump_times
from thermaltool.effects.effect import Effect, Float, Memory, Outputs, Parameter, Side
from thermaltool.effects.instant import Instant
from thermaltool.effects.scene import Scene
from thermaltool.record import Record


class GeometryStep(Instant):
    """Every displacement jumps by its own `step` at one `time`."""

    name: ClassVar[str] = "geometry_step"
    side: ClassVar[Side] = "structure"
    explanation: ClassVar[str] = (
        "the structure itself moved: a collision, a new clamping, a slipped wedge"
    )
    action: ClassVar[str] = (
        "look at clamping, bolts and wedges, and at what happened {time} into the log: "
        "{output} jumped by {step}; tighten and set the zero again"
    )
    signature: ClassVar[str] = (
        "several displacements jump between the same two samples and stay; no temperature does"
    )
    source: ClassVar[str] = "Mize 1998 (tool crash: a rigid rotation)"
    causal: ClassVar[bool] = True
    known: ClassVar = {"step": Parameter("{output}", linear=True), "time": Parameter("s")}

    def output(self, name: str, outputs: Outputs, record: Record, memory: Memory = None) -> Float:
        step = self.parameters.get(f"step[{name}]")
        if step is None:
            return outputs[name]
        return outputs[name] + step * (record.time >= self.parameters["time"])

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        steps = {f"step[{output}]": 1.0 for output in scene.displacements()}
        if not steps:
            return
        channel = max(scene.displacements(), key=scene.reach)
        for k, log in enumerate(scene.logs):
            for instant in jump_times(scene, k, scene.displacements()):
                yield cls(channel, {**steps, "time": instant}, log.digest)
