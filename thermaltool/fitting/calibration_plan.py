"""What a calibration fits: channels by role, and what is known or chosen beforehand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from thermaltool.errors import ModelError
from thermaltool.fitting.output_fit import Loss
from thermaltool.fitting.response_choice import KINDS
from thermaltool.fitting.start_state import Initial
from thermaltool.model import Drive, Role
from thermaltool.responses import response_class
from thermaltool.units import Hold, Reference, drive_reference, hold_of


@dataclass(frozen=True)
class CalibrationPlan:
    """What to fit.

    Attributes
    ----------
    drives, sensors, deflections : tuple of str
        Channels by role.
    kinds : mapping of output channel to kind of response
        Default: conduction for a sensor, deflection for a deflection; with `choose` the one that
        evidence and held-out rows speak for.
    reference : "first", float or None
        What counts as no drive; None is "first" for an absolute temperature and 0 otherwise.
    hold : "zero", "first" or None
        Of the drives between samples; None chooses by quantity and, with `choose`, takes lines for
        what switches between the rows.
    fixed : mapping of parameter name to value
    loss, starts
        See `fit_output`.
    initial : {"rest", "free", "auto"}
        State at the first rows: at rest, free, or, with `choose`, free where the machine is clearly
        still on its way to rest.
    choose : bool
        Compare all kinds for every output whose kind is not given, and ways of the drives between
        samples, and laws of the drives and of the material.
    linear : bool
        No law is looked for.
    at_rows : bool
        What is held switches at the rows.
    """

    drives: tuple[str, ...]
    sensors: tuple[str, ...] = ()
    deflections: tuple[str, ...] = ()
    kinds: Mapping[str, str] = field(default_factory=dict)
    reference: Reference | None = None
    hold: Hold | None = None
    fixed: Mapping[str, float] = field(default_factory=dict)
    loss: Loss = "huber"
    starts: int = 6
    initial: Initial = "rest"
    choose: bool = False
    linear: bool = False
    at_rows: bool = False

    @property
    def free_start(self) -> bool:
        """Whether the state at the first rows is fitted; see `fit_output`."""
        return self.initial == "free"

    def chosen(self, channel: str) -> bool:
        """Whether the kind of an output is to be found."""
        return self.choose and channel not in self.kinds

    def drive(self, channel: str) -> Drive:
        """A drive of the model; its range is that of the records (`calibrate`)."""
        reference = drive_reference(channel) if self.reference is None else self.reference
        return Drive(channel, self.hold or hold_of(channel), reference, (0.0, 0.0))

    def outputs(self) -> list[tuple[str, Role, str]]:
        """(channel, role, kind) of every output."""
        roles: list[tuple[str, Role, str]] = [(c, "sensor", "conduction") for c in self.sensors]
        roles += [(c, "deflection", "deflection") for c in self.deflections]
        return [(channel, role, self.kinds.get(channel, kind)) for channel, role, kind in roles]

    def constants(self) -> set[str]:
        """Parameters that can be fixed: those that a kind of the outputs has."""
        outputs = self.outputs()
        kinds = {kind for channel, _, kind in outputs if not self.chosen(channel)}
        if any(self.chosen(channel) for channel, _, _ in outputs):
            kinds |= set(KINDS)
        return {name for kind in kinds for name in response_class(kind).fixed}

    def check(self) -> None:
        """Refuse what is no calibration.

        Raises
        ------
        ModelError
            Nothing to fit, a channel in two roles, an unknown kind, a parameter that no kind has.
        """
        outputs = self.outputs()
        names = [*self.drives, *(channel for channel, _, _ in outputs)]
        if not self.drives or not outputs:
            raise ModelError("a calibration needs a drive and at least one sensor or deflection")
        for name in names:
            if names.count(name) > 1:
                raise ModelError(f"{name} is named twice: a channel has one role")
        for channel in self.kinds:
            if channel not in names[len(self.drives) :]:
                raise ModelError(f"a kind of response for {channel}, which is no output of the fit")
        constants = self.constants()
        for name, value in self.fixed.items():
            if name not in constants:
                known = f"only {', '.join(sorted(constants))}" if constants else "nothing here"
                raise ModelError(f"cannot fix {name}: {known} can be fixed")
            if not 0 < value < float("inf"):
                raise ModelError(f"cannot fix {name} = {value:g}: it must be above 0")
