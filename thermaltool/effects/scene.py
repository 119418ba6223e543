"""What a model and its logs offer to a cause that looks for a place to act."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermaltool.record import Record
from thermaltool.units import is_displacement

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """What a model and its logs offer to a cause that looks for a place to act.

    Attributes
    ----------
    logs : tuple of Record
    drives, outputs, extra : tuple of str
        Channels that drive the model, that it computes, and that are in every log beside it.
    unanswered : mapping of drive to outputs in which the model has no response to it
    spans : mapping of output to float
        How far the drives can move every output of the model (`model.span`).
    acting_drives : tuple of mapping, one for each log
        Each drive relative to its reference, ndarray (n,).
    simulated, residual : tuple of mapping, one for each log
        Each output relative to rest, and measured minus simulated (NaN where not measured).
    noise : mapping of output to float
        White noise of a reading.
    slowest : mapping of output to float
        Slowest time constant [s].
    bodies : mapping of output to float
        The slowest time constant that matters of the response to heat, where there is one [s].
    """

    logs: tuple[Record, ...]
    drives: tuple[str, ...]
    outputs: tuple[str, ...]
    extra: tuple[str, ...]
    unanswered: Mapping[str, tuple[str, ...]]
    spans: Mapping[str, float]
    acting_drives: tuple[Mapping[str, Float], ...]
    simulated: tuple[Mapping[str, Float], ...]
    residual: tuple[Mapping[str, Float], ...]
    noise: Mapping[str, float]
    slowest: Mapping[str, float]
    bodies: Mapping[str, float]

    @property
    def period(self) -> float:
        """Shortest sample period of the logs [s]."""
        return min(log.period for log in self.logs)

    @property
    def duration(self) -> float:
        """Longest duration of the logs [s]."""
        return max(log.duration for log in self.logs)

    def sensors(self) -> tuple[str, ...]:
        """Outputs that are no displacement."""
        return tuple(o for o in self.outputs if not is_displacement(o))

    def displacements(self) -> tuple[str, ...]:
        """Outputs that are a displacement."""
        return tuple(o for o in self.outputs if is_displacement(o))

    def level(self, drive: str) -> float:
        """Largest absolute value of a drive in any log."""
        return max(float(np.max(np.abs(drives[drive]))) for drives in self.acting_drives)

    def levels(self) -> dict[str, float]:
        """Levels of the drives that act in some log."""
        return {drive: level for drive in self.drives if (level := self.level(drive))}

    def reach(self, output: str) -> float:
        """Largest absolute simulated value of an output in any log."""
        return max(float(np.max(np.abs(each[output]))) for each in self.simulated)

    def within_one(self) -> tuple[str | None, ...]:
        """Logs that a fault may be confined to; None alone where there is one log."""
        return (None,) if len(self.logs) == 1 else (None, *(log.digest for log in self.logs))

    def instants(self, log: Record, count: int = 48) -> list[float]:
        """Times at which something may have happened, none within 2 % of the ends [s]."""
        margin = 0.02 * log.duration
        return np.linspace(log.time[0] + margin, log.time[-1] - margin, count).tolist()
