"""What a diagnosis finds, as data: causes, what they are worth, and what is left open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from thermaltool.diagnosis.gain import Gain
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.lasting import Recurrence
from thermaltool.diagnosis.residual import ResidualReport
from thermaltool.diagnosis.ruled_out import ruled_out
from thermaltool.diagnosis.severity import Severity
from thermaltool.diagnosis.written import WrittenStep
from thermaltool.documents import DIAGNOSIS, jsonable
from thermaltool.effects.effect import Effect
from thermaltool.fitting.averaging import Averages
from thermaltool.model import Model
from thermaltool.record import Record
from thermaltool.units import printed

Float = NDArray[np.float64]
Interval = tuple[float, float]

Verdict = Literal["adequate", "not adequate", "cannot judge"]
# Values that a sentence on an unsure cause holds; more of them name no size.
MAX_VALUES_TOLD = 4


@dataclass(frozen=True)
class Location:
    """Where something is in the logs.

    Attributes
    ----------
    log : str
        Digest.
    output : str
    start, stop : float [s]
        From the first row, of the stretch that has most of it for its length.
    condition : str or None
        What the machine does, or the level of a channel, in which most of it is; None for no one.
    shortest, longest : float or None [s]
        Periods that it mostly has.
    rms : float [unit of the output]
    """

    log: str
    output: str
    start: float
    stop: float
    condition: str | None
    shortest: float | None
    longest: float | None
    rms: float


@dataclass(frozen=True)
class Cause:
    """An accepted cause, or what no cause explains (`unknown`).

    Attributes
    ----------
    effect : Effect
    evidence : float
        Fall of BIC under white noise and a slow discrepancy, corrected for the number of causes
        that were tried; above 10 is decisive.
    intervals : mapping of parameter to (low, high)
        95 %.
    gain : mapping of channel to Gain
        By the written models without it and with it, the zero of every log free; on unseen logs
        where there are some, else on the diagnosed ones. Of outliers, which are no part of a
        model: by leaving them out, and all other gains are those without them.
    held_out : mapping of channel to Gain
        Of rows that the fit has not seen, each predicted from the others: by these it was judged.
    forms : tuple of (Effect, float)
        Other forms of the same cause at the same place, with their evidence.
    explained : float
        Share of the misfit (residual power above noise, all channels) that the written model
        would have without this cause, and does not have with it.
    location : Location or None
        Of an unknown cause.
    severity : mapping of output to Severity
        How much it moves each output over the diagnosed logs.
    action : str
        What a technician can do about it.
    elsewhere : tuple of Recurrence
        Other logs that show it, of one that changed something in its log.
    """

    effect: Effect
    evidence: float
    intervals: Mapping[str, Interval]
    gain: Mapping[str, Gain]
    explained: float
    held_out: Mapping[str, Gain] = field(default_factory=dict)
    forms: tuple[tuple[Effect, float], ...] = ()
    location: Location | None = None
    severity: Mapping[str, Severity] = field(default_factory=dict)
    action: str = ""
    elsewhere: tuple[Recurrence, ...] = ()

    def document(self, tolerance: Mapping[str, float]) -> dict[str, Any]:
        """As JSON; an effect confined to one log says to which.

        Parameters
        ----------
        tolerance : mapping of output to float [unit of the output]
        """
        effect = self.effect
        return {
            "name": effect.name,
            "channel": effect.channel,
            "partner": effect.partner,
            "log": effect.log,
            "elsewhere": [asdict(each) for each in self.elsewhere],
            "explanation": effect.explanation,
            "action": self.action,
            "severity": {
                name: each.document(tolerance.get(name)) for name, each in self.severity.items()
            },
            "source": effect.source,
            "evidence": self.evidence,
            "explained": self.explained,
            "parameters": {
                name: {
                    "value": value,
                    "interval": self.intervals.get(name),
                    "unit": effect.unit(name),
                }
                for name, value in effect.parameters.items()
            },
            "other_forms": [
                {"parameters": dict(form.parameters), "evidence": evidence}
                for form, evidence in self.forms
            ],
            "gain": _gains(self.gain),
            "held_out": _gains(self.held_out),
            "location": None if self.location is None else asdict(self.location),
        }


def _gains(gains: Mapping[str, Gain]) -> dict[str, Any]:
    return {name: {**asdict(gain), "claimed": gain.claimed} for name, gain in gains.items()}


@dataclass(frozen=True)
class Alternative:
    """Causes that this log cannot tell apart.

    Attributes
    ----------
    names, channels : tuple of str
        The accepted cause first.
    angle : float [deg]
        Between their signatures, the model's own parameters projected out.
    separating_experiment : str
        The input that opens the angle most, in words.
    opened : float [deg]
        The angle that it is predicted to open; NaN where advice is in words alone.
    kind : str
        ``indistinguishable``; ``invisible``: these logs show none of the names (one or more), which
        look like the model's own response; ``suspected``: no cause is sure, and the first name is
        the likeliest one.
    """

    names: tuple[str, ...]
    channels: tuple[str, ...]
    angle: float
    separating_experiment: str
    opened: float
    kind: str = "indistinguishable"


@dataclass(frozen=True)
class Tried:
    """A cause of the catalogue and how it fared at the first step.

    Attributes
    ----------
    name, channel : str
    evidence : float
    detectable : float or None
        RMS change of an output that this log would show (evidence 10), before looking at the
        residual; None where the log cannot show it at all.
    verdict : str
        accepted, explained by another, approximation error, no evidence, cannot be seen.
    output : str or None
        Whose change `detectable` is.
    """

    name: str
    channel: str
    evidence: float
    detectable: float | None
    verdict: str
    output: str | None = None


@dataclass(frozen=True)
class Diagnosis:
    """The whole answer.

    Attributes
    ----------
    verdict : str
        ``adequate``, ``not adequate``, or ``cannot judge``: the calibration leaves open what would
        decide.
    noise_share : float
        Share of the residual's power that noise and what the calibration has shown account for, at
        the worst output (1: nothing but noise).
    residuals : mapping of output to ResidualReport
    causes : tuple of Cause, in the order of acceptance
    alternatives : tuple of Alternative
    tried : tuple of Tried, the strongest first
    notes : tuple of str
    model : Model
        With the accepted effects; the model that came in where there are no causes.
    extends : bool
        Whether it is another than the one that came in.
    written : tuple of WrittenStep
        What the model that came in, and the written one cause after cause, make of every log.
    spoiled : str or None
        Log and output of which the extended model is worse than the one that came in: it is not
        to be written.
    undecided : tuple of str
        Why the logs cannot judge the model, and what would help.
    curves : tuple of (output, Record)
        Of every output in every log what was ``measured``, ``simulated`` and, where there are
        causes, ``extended`` by them, relative to rest.
    sound : tuple of str
        Digests of unseen logs that the model as it came fits: no cause acts there.
    rests : bool
        No output moves in the logs, so that they show nothing.
    not_judged : tuple of str
        Outputs of the model that no diagnosed log has.
    """

    verdict: Verdict
    noise_share: float
    residuals: Mapping[str, ResidualReport]
    causes: tuple[Cause, ...]
    alternatives: tuple[Alternative, ...]
    tried: tuple[Tried, ...]
    notes: tuple[str, ...]
    model: Model
    extends: bool = True
    written: tuple[WrittenStep, ...] = ()
    spoiled: str | None = None
    undecided: tuple[str, ...] = ()
    curves: tuple[tuple[str, Record], ...] = field(default=(), compare=False)
    sound: tuple[str, ...] = ()
    rests: bool = False
    not_judged: tuple[str, ...] = ()

    @property
    def adequate(self) -> bool:
        """Whether noise and the calibration's own error account for what is left."""
        return self.verdict == "adequate"

    def _named(self) -> set[tuple[str, str]]:
        """Causes that are accepted, and what may be behind a misfit instead."""
        accepted = {(cause.effect.name, cause.effect.channel) for cause in self.causes}
        rivals = {
            pair
            for each in self.alternatives
            for pair in zip(each.names, each.channels, strict=True)
        }
        return accepted | rivals

    def document(self, tolerance: Mapping[str, float] | None = None) -> dict[str, Any]:
        """As JSON: without the curves and the model, null for what is not finite.

        Parameters
        ----------
        tolerance : mapping of output to float [unit of the output], optional
            Against which the severity of each cause is told.
        """
        tolerance = tolerance or {}
        document = {
            "verdict": self.verdict,
            "adequate": self.adequate,
            "noise_share": self.noise_share,
            "drives": [drive.channel for drive in self.model.drives],
            "residuals": {name: report.document() for name, report in self.residuals.items()},
            "causes": [cause.document(tolerance) for cause in self.causes],
            "tolerance": dict(tolerance),
            "alternatives": [
                {
                    "names": each.names,
                    "channels": each.channels,
                    "angle_deg": each.angle,
                    "separating_experiment": each.separating_experiment,
                    "opened_deg": each.opened,
                    "kind": each.kind,
                }
                for each in self.alternatives
            ],
            "tried": [asdict(each) for each in self.tried],
            "ruled_out": [
                asdict(each)
                for each in ruled_out(self.tried, self.residuals, self._named(), tolerance)
                if not self.rests
            ],
            "notes": self.notes,
            "written": [each.document() for each in self.written],
            "spoiled": self.spoiled,
            "undecided": self.undecided,
            "rests": self.rests,
            "not_judged": self.not_judged,
        }
        return DIAGNOSIS.wrap(jsonable(document))


def curves_of(
    first: Hypothesis, plain: Hypothesis, extended: Hypothesis | None
) -> tuple[tuple[str, Record], ...]:
    """Measured, simulated and extended of every log and output, as `simulate` has them.

    Parameters
    ----------
    first : Hypothesis
        Before any cause.
    plain, extended : Hypothesis
        The models as a user simulates them; None where there are no causes.
    """
    found = []
    for k, log in enumerate(first.logs):
        for output, measured in first.simulation.measured[k].items():
            if output not in first.groups:
                continue
            columns = {"measured": measured}
            for name, each in (("simulated", plain), ("extended", extended)):
                if each is not None:
                    columns[name] = each.simulation.as_simulated(output)[k][1]
            record = replace(log, columns=columns)
            # Averages have rows of the drives alone.
            averages = isinstance(log, Averages)
            found.append((output, record.where(np.isfinite(measured)) if averages else record))
    return tuple(found)


def unconfirmed(effect: Effect) -> str:
    """A sentence on the strongest cause, which unseen rows do not confirm.

    Parameters
    ----------
    effect : Effect
    """
    names = (*effect.linear(), *effect.searched())
    values = ", ".join(
        f"{name} {effect.parameters[name]:.3g} {printed(effect.unit(name))}".rstrip()
        for name in (names if len(names) <= MAX_VALUES_TOLD else ())
    )
    said = ": ".join(part for part in (effect.channel, values) if part)
    return (
        f"what is left looks most like {effect.name}{f' ({said})' if said else ''}, but rows that "
        "its fit has not seen do not confirm it"
    )
