"""What the tool says of a log of the exam, and what of it is right."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from machines.foreign.strangers import MAY_BE_KNOWN

UNKNOWN = "unknown"
# Names that are as good as the truth, as physics has it: a bent characteristic and one that ends
# early; play and a loop; a gain and a curve that has one; heat that nobody logged, from a source or
# from the air.
INDISTINGUISHABLE: Mapping[str, frozenset[str]] = {
    "drive_nonlinearity": frozenset({"actuator_saturation"}),
    "actuator_saturation": frozenset({"drive_nonlinearity"}),
    "backlash": frozenset({"hysteresis"}),
    "hysteresis": frozenset({"backlash"}),
    "sensor_gain": frozenset({"sensor_conversion"}),
    "sensor_conversion": frozenset({"sensor_gain"}),
    "second_source/latent": frozenset({"ambient_drift"}),
}
SURE = 10.0  # evidence from which the tool calls a cause decisive
# An instant is told right within this share of the log.
NEAR = 0.1
# A written model is worse where its RMS is up by this share, and its square by this many times the
# noise of a reading: of the reading itself where the zero is one reading's.
WORSE_SHARE, WORSE_FREE, WORSE_COUNTED = 0.02, 0.1, 4.0


@dataclass(frozen=True)
class Trial:
    """What is hidden in a log.

    Attributes
    ----------
    index : int
        Of the log in the run.
    plant : str
    machine : int
        Seed of the machine and of its calibration.
    group : str
        What the log counts for: clean, natural, unknown, or its size.
    kind : str
    size : float
        Wanted.
    seed : int
    """

    index: int
    plant: str
    machine: int
    group: str
    kind: str
    size: float
    seed: int


@dataclass(frozen=True)
class Named:
    """A cause of the answer: name, channel, evidence, and when it begins [s] where it says so."""

    name: str
    channel: str
    evidence: float
    explained: float
    begins: float | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Agreed:
    """RMS of an output in a log by the model that came in and by the written one, as simulated."""

    log: str
    output: str
    before: float
    after: float
    before_free: float
    after_free: float
    noise: float

    @property
    def worse(self) -> bool:
        """Worse beyond noise, with the zero free or as counted."""
        return _worse(self.before_free, self.after_free, WORSE_FREE * self.noise**2) or _worse(
            self.before, self.after, WORSE_COUNTED * self.noise**2
        )


def _worse(before: float, after: float, least: float) -> bool:
    return after > (1 + WORSE_SHARE) * before and after**2 - before**2 > least


@dataclass(frozen=True)
class Score:
    """What the tool said of a log, and what of it was right.

    Attributes
    ----------
    trial : Trial
    size : float
        Reached.
    left : float
        What the model leaves of a clean log over the noise of a reading, at the worst output.
    channel, begins, ends
        Where and when, where the truth has a place or a time.
    duration : float
        Of the log [s].
    causes : tuple of Named
        Without those that are true of the machine itself.
    declared : tuple of str
        Names in a group of at most three with the first cause, by the tool's own word.
    adequate : bool
    refused : bool
        The extended model is not written, since a log would be worse.
    agreed : tuple of Agreed
        Diagnosed, validation and calibration log.
    told_off : float
        Largest relative difference of an RMS that the report tells of the written or the first
        model from that of `simulate`.
    power : float
        Of a test that is told all of the effect, see `power_of_knowing_all`.
    seconds : float
        CPU time of the diagnosis.
    failure : str
    """

    trial: Trial
    size: float = 0.0
    left: float = float("nan")
    channel: str | None = None
    begins: float | None = None
    ends: float | None = None
    duration: float = 0.0
    causes: tuple[Named, ...] = ()
    declared: tuple[str, ...] = ()
    adequate: bool = True
    refused: bool = False
    agreed: tuple[Agreed, ...] = ()
    told_off: float = 0.0
    power: float = float("nan")
    seconds: float = float("nan")
    notes: tuple[str, ...] = ()
    failure: str = ""

    @property
    def truth(self) -> str:
        """Name of the cause in the catalogue."""
        return self.trial.kind.partition("/")[0]

    @property
    def first(self) -> bool:
        return bool(self.causes) and self.causes[0].name == self.truth

    @property
    def grouped(self) -> bool:
        """First, or indistinguishable from it by the tool's word or by physics."""
        if self.first or self.truth in self.declared:
            return True
        near = INDISTINGUISHABLE.get(self.trial.kind, frozenset())
        return bool(self.causes) and self.causes[0].name in near

    @property
    def silent(self) -> bool:
        return not self.causes and not self.failure

    @property
    def wrong(self) -> bool:
        """A first cause that is not it nor in its group, called decisive."""
        sure = bool(self.causes) and self.causes[0].evidence > SURE
        return sure and not self.grouped and self.causes[0].name != UNKNOWN

    @property
    def called(self) -> bool:
        """An unknown kind called so, or by the name that it has got since."""
        names = MAY_BE_KNOWN[self.trial.kind][1] if self.trial.kind in MAY_BE_KNOWN else frozenset()
        return any(cause.name in names | {UNKNOWN} for cause in self.causes)

    @property
    def located(self) -> bool:
        """The right channel or the right time is told by some cause."""
        return any(
            (self.channel is not None and cause.channel == self.channel)
            or (
                self.begins is not None
                and cause.begins is not None
                and abs(cause.begins - self.begins) < NEAR * self.duration
            )
            for cause in self.causes
        )

    @property
    def misnamed(self) -> bool:
        """Of an unknown kind: a decisive name of the catalogue, at no right place."""
        names = [c for c in self.causes if c.evidence > SURE and c.name != UNKNOWN]
        return bool(names) and not self.located and not self.called

    def worse(self, log: str) -> bool:
        return any(each.worse for each in self.agreed if each.log == log)
