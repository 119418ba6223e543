"""Joint contact: a joint that opens and closes with the heat passes on forces and heat otherwise.

A joint beside a heat source is pressed together at one place and opens at another as the parts
warm. What then crosses it departs from proportion in two ways: forces that come and go with the
load and leave no temperature behind, and heat, which acts as pairs of a source and a sink on
either side and is felt later, in temperatures and displacements alike.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar

import numpy as np

from thermaltool.effects.dynamics import from_rest, lagged, time_constants
from thermaltool.effects.effect import Effect, Float, Memory, Outputs, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.errors import ModelError
from thermaltool.record import Record
from thermaltool.units import is_temperature

# A displacement that goes less far the other way shows nothing of the other sign.
MIN_RELATIVE_REVERSE = 0.1
# Lags of heat behind the joint that are worth a trial.
LAG_TRIALS = 4


class JointContact(Effect):
    """One output bends by itself, or all do by a temperature z near the source.

    By itself (`curvature`, `asymmetry`) a displacement y becomes y + curvature·y|y| +
    asymmetry·|y|. Curvature: contact closes or opens with load, so that large displacements are
    not in proportion. Asymmetry: slopes 1 + asymmetry above rest and 1 − asymmetry below it, since
    a joint carries pressure but no tension.

    By the temperature z of the linear model at `channel`, with b = z|z|/level², an output gains
    ``forces``·b at once and, through a lag of `time_constant`, ``heat``·b. With a `partner`, a
    contact temperature that is read, displacements gain ``contact``·e at once and ``deviation``·e
    through the same lag, e what is read there minus what the linear model has: the heat that the
    joint redirects is then not foretold but told by what it does. It is Fraser's source-sink pair:
    a heat q that warms the contact as 1/(1 + T s) and bends the machine as g/(1 + τ s) is in the
    deflection as g (1 + T s)/(1 + τ s) of e.
    """

    name: ClassVar[str] = "joint_contact"
    side: ClassVar[Side] = "structure"
    bends: ClassVar[bool] = True
    causal: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "a joint closes or opens as the parts expand, and passes on heat and displacement "
        "otherwise than at rest"
    )
    action: ClassVar[str] = (
        "look at the joints near {channel} (bolts, bearings, wedges; {fitted}): "
        "clean, tighten or preload them so that they stay as they are when the parts warm"
    )
    signature: ClassVar[str] = (
        "displacements depart from proportion to the drive by level and sign, at once and "
        "together, while temperatures near the source stay in proportion and those at the joint "
        "depart later"
    )
    source: ClassVar[str] = "Fraser 1997, ch. 7 (joints of a nonlinear structure)"
    known: ClassVar = {
        "curvature": Parameter("1/{channel}", linear=True),
        # At -1 or 1 one side would stand still.
        "asymmetry": Parameter("1", low=-0.95, high=0.95, linear=True),
        "forces": Parameter("{output}", linear=True),
        "heat": Parameter("{output}", linear=True),
        "contact": Parameter("{output}/K", linear=True),
        "deviation": Parameter("{output}/K", linear=True),
        "time_constant": Parameter("s", low=0.0, high=1e6, log=True),
        "level": Parameter("{channel}", fixed=True),
    }

    @property
    def spreads(self) -> bool:
        """Whether outputs bend together, by a temperature."""
        return "level" in self.parameters

    @property
    def memoryless(self) -> bool:  # type: ignore[override]
        """An output that bends by itself looks at the value of the moment alone."""
        return not self.spreads

    def odds_alone(self, output: str | None) -> float:
        return 0.0 if self.spreads else 1.0

    @property
    def joins(self) -> bool:
        return self.spreads

    def needs(self) -> tuple[str, ...]:
        return () if self.partner is None else (self.partner,)

    def reading(self, y: Float, record: Record, memory: Memory = None) -> Float:
        size = np.abs(y)
        curvature = self.parameters.get("curvature", 0.0)
        return y + curvature * y * size + self.parameters.get("asymmetry", 0.0) * size

    def bent(self, z: Float) -> Float:
        """b, by which outputs depart from proportion; 1 at `level`.

        Parameters
        ----------
        z : ndarray
            Relative to rest.
        """
        share = z / self.parameters["level"]
        return np.asarray(share * np.abs(share))

    def gains(self, output: str) -> tuple[float, float, float, float]:
        """Its `forces`, `heat`, `contact` and `deviation` in an output, 0 for none.

        Parameters
        ----------
        output : str
        """
        get = self.parameters.get
        bases = ("forces", "heat", "contact", "deviation")
        forces, heat, contact, deviation = (get(f"{base}[{output}]", 0.0) for base in bases)
        return forces, heat, contact, deviation

    def lags(self, output: str) -> tuple[float, ...]:
        _, heat, _, deviation = self.gains(output)
        return (self.parameters["time_constant"],) if heat or deviation else ()

    def output(self, name: str, outputs: Outputs, record: Record, memory: Memory = None) -> Float:
        if not self.spreads:
            return super().output(name, outputs, record, memory)
        forces, heat, contact, deviation = self.gains(name)
        if not (forces or heat or contact or deviation):
            return outputs[name]
        b = self.bent(self._linear(outputs, self.channel))
        now, late = forces * b, heat * b
        if self.partner is not None:
            read = from_rest(record, self.partner, memory)
            e = read - self._linear(outputs, self.partner)
            now, late = now + contact * e, late + deviation * e
        if heat or deviation:
            tau = self.parameters["time_constant"]
            now = now + lagged(record.time, late, tau, "first", memory=memory)
        return np.asarray(outputs[name] + now)

    def _linear(self, outputs: Outputs, channel: str) -> Float:
        if channel not in outputs:
            raise ModelError(f"{self.name}: needs the output {channel}, which is not there")
        return outputs[channel]

    def without(self, names: tuple[str, ...]) -> Effect:
        """As `Effect.without`; outputs that bend together do so by the same temperature."""
        kept = super().without(names)
        return replace(kept, channel=self.channel) if self.spreads else kept

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for output in scene.displacements():
            yield cls(output, {"curvature": 1.0})
            lowest = min(float(np.min(each[output])) for each in scene.simulated)
            highest = max(float(np.max(each[output])) for each in scene.simulated)
            # Of one sign alone, asymmetry would be another gain.
            if min(-lowest, highest) > MIN_RELATIVE_REVERSE * max(-lowest, highest):
                yield cls(output, {"asymmetry": 0.5})
                yield cls(output, {"curvature": 1.0, "asymmetry": 0.5})
        yield from cls._together(scene)

    @classmethod
    def _together(cls, scene: Scene) -> Iterator[Effect]:
        """By every temperature of the model that moves; the contact is where most is left."""
        moved = scene.displacements()
        if not moved or len(scene.outputs) < 2:
            return
        for channel in scene.sensors():
            level, others = scene.reach(channel), [o for o in scene.sensors() if o != channel]
            if not (level and is_temperature(channel)):
                continue
            forces = {f"forces[{o}]": 1.0 for o in moved}
            heat = {f"heat[{o}]": 1.0 for o in others}
            near = [o for o in others if is_temperature(o)]
            contact = max(near, key=lambda o: _left(scene, o), default=None)
            for tau in time_constants(10 * scene.period, 3 * scene.duration, LAG_TRIALS):
                own = {"time_constant": tau, "level": level}
                felt = {f"heat[{o}]": 1.0 for o in moved}
                yield cls(channel, {**forces, **heat, **felt, **own})
                if contact is not None:
                    felt = {f"deviation[{o}]": 1.0 for o in moved}
                    yield cls(channel, {**forces, **heat, **felt, **own}, partner=contact)


def _left(scene: Scene, output: str) -> float:
    """What is left of an output beside its noise."""
    values = np.concatenate([each[output] for each in scene.residual])
    return float(np.nanstd(values)) / scene.noise[output]
