"""The controller document: a model with its estimator, the drives that are set, and by which law.

One sealed JSON file, which a stream runs without anything beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from thermaltool.control.methods import METHODS, Method
from thermaltool.documents import CONTROLLER, Part, above_zero, names, one_of
from thermaltool.errors import ModelError
from thermaltool.model import Model, from_document, to_document


@dataclass(frozen=True)
class ControlDrive:
    """A drive that is set.

    Attributes
    ----------
    channel : str
    maximum : float [unit of the drive]
        It is set between 0 and this.
    slew : float [unit of the drive per s]
        Largest rate of its setpoint.
    """

    channel: str
    maximum: float
    slew: float


@dataclass(frozen=True)
class HeaterController:
    """What runs in a stream.

    Attributes
    ----------
    model : Model
        With the design of its estimator, which reads the power of each control drive.
    method : str
        One of `METHODS`.
    drives : tuple of ControlDrive
    tolerance : mapping of output to float [unit of the output]
        The outputs that are held at zero, each with the deviation that counts as much as full
        power (Bryson's rule), and as one of this size of another output.
    period : float [s]
        Between two samples, as expected.
    horizon : float [s]
        How far the receding horizon plans.
    lead : float [s]
        After which the inversion is at zero.
    duration : float or None [s]
        How long the machine works: the plan ends there; None for a horizon that recedes always.
    axes : mapping of output to float [unit of the output]
        What an NC axis corrects of it, up and down; heaters hold what goes beyond.
    """

    model: Model
    method: Method
    drives: tuple[ControlDrive, ...]
    tolerance: Mapping[str, float]
    period: float
    horizon: float
    lead: float
    duration: float | None = None
    axes: Mapping[str, float] = field(default_factory=dict)

    @property
    def channels(self) -> tuple[str, ...]:
        """The drives that are set."""
        return tuple(drive.channel for drive in self.drives)

    def document(self) -> dict[str, Any]:
        """As JSON, with format, version and checksum."""
        return CONTROLLER.wrap(
            {
                "model": to_document(self.model),
                "method": self.method,
                "control": [
                    {
                        "channel": drive.channel,
                        "maximum": drive.maximum,
                        "slew_per_s": drive.slew,
                    }
                    for drive in self.drives
                ],
                "tolerance": dict(self.tolerance),
                "sample_period_s": self.period,
                "horizon_s": self.horizon,
                "lead_s": self.lead,
                **({} if self.duration is None else {"duration_s": self.duration}),
                **({"axes": dict(self.axes)} if self.axes else {}),
            }
        )


def load_controller(document: dict[str, Any], name: str) -> HeaterController:
    """The controller in a document.

    Parameters
    ----------
    document : dict
    name : str
        What messages call the file.

    Raises
    ------
    ModelError
        Another format, a newer version, a part missing or out of range; each names the file.
    """
    try:
        return _load(Part(CONTROLLER.check(document, name)))
    except ModelError as error:
        raise ModelError(f"{name}: {error}") from error


def _load(whole: Part) -> HeaterController:
    tolerances = whole.part("tolerance")
    drives = tuple(
        ControlDrive(
            part.read("channel", lambda value: names([value])[0]),
            part.read("maximum", above_zero),
            part.read("slew_per_s", above_zero),
        )
        for part in whole.parts("control")
    )
    if not drives or not tolerances.names():
        raise ModelError("no drive that is set, or no output that is held")
    axes = whole.part("axes") if "axes" in whole.names() else None
    reaches = {} if axes is None else {n: axes.read(n, above_zero) for n in axes.names()}
    for each in reaches:
        if each not in tolerances.names():
            raise ModelError(f"an axis for {each}, which is not held")
    return HeaterController(
        whole.read("model", from_document),
        whole.read("method", one_of(METHODS)),
        drives,
        {each: tolerances.read(each, above_zero) for each in tolerances.names()},
        whole.read("sample_period_s", above_zero),
        whole.read("horizon_s", above_zero),
        whole.read("lead_s", above_zero),
        whole.read("duration_s", above_zero, None),
        reaches,
    )
