"""A fault of a machine before it has a strength, and the scene in which its place is drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from machines.foreign.plant import REST, Conditions, Course, Generator, Plant
from machines.foreign.solver import Array


@dataclass(frozen=True)
class Fault:
    """What may go wrong, its place and time drawn, but not its strength.

    Parameters
    ----------
    channel : str or None
        Where a diagnosis should look; None where no logged channel is meant.
    apply : function
        Of strength and conditions; strength 0 changes nothing. Of the same strength in any log.
    typical : float
        A strength to begin with.
    most : float
        The largest that makes sense.
    begins, ends : float or None
        When it acts [s], where it does not all the time.
    recurs : bool
        Whether other logs of the machine have it too.
    """

    channel: str | None
    apply: Callable[[float, Conditions], None]
    typical: float = 0.1
    most: float = np.inf
    begins: float | None = None
    ends: float | None = None
    recurs: bool = True


@dataclass(frozen=True)
class Scene:
    """A machine, and a clean log of it by which places and scales are drawn.

    Parameters
    ----------
    plant : Plant
    clean : Conditions
    course : Course
    generator : Generator
    """

    plant: Plant
    clean: Conditions
    course: Course
    generator: Generator

    def moment(self) -> float:
        """A time in the middle half of the log [s]."""
        rows = self.clean.rows
        return float(rows[int(len(rows) * self.generator.uniform(0.25, 0.75))])

    def sign(self) -> float:
        return float(self.generator.choice([-1.0, 1.0]))

    def thermometer(self) -> str:
        return str(self.generator.choice(self.plant.thermometers))

    def deflection(self) -> str:
        return str(self.generator.choice(list(self.plant.deflections)))

    def reach(self, channel: str) -> float:
        """Largest departure from rest in the clean log."""
        values = self.course.table[channel]
        return float(np.max(np.abs(values - REST * channel.endswith("degC"))))

    def peak(self, node: int) -> float:
        """Highest temperature of a node above rest [K]."""
        return float(self.course.nodes[:, node].max())

    def hot(self) -> int:
        """One of the nodes that get warm: above the middle of all."""
        peaks = self.course.nodes.max(axis=0)
        return int(self.generator.choice(np.flatnonzero(peaks >= np.median(peaks))))


Builder = Callable[[Scene], Fault | None]


def on_drive(c: Conditions, change: Callable[[Array], Array]) -> None:
    c.act.append(lambda time, u: change(u))


def on_reading(c: Conditions, channel: str, change: Callable[[Array, Array], Array]) -> None:
    c.sensors.setdefault(channel, []).append(change)


def on_displacement(c: Conditions, channel: str, change: Callable[[Array, Array], Array]) -> None:
    c.mechanics.setdefault(channel, []).append(change)
