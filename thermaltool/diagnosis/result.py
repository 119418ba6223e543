"""What a diagnosis finds, as data: causes, what they are worth, and what is left open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.residual import ResidualReport, residual_report
from thermaltool.diagnosis.written import Gain, WrittenStep
from thermaltool.documents import DIAGNOSIS, jsonable
from thermaltool.effects.effect import Effect
from thermaltool.model import Model
from thermaltool.record import Record
from thermaltool.units import printed

Float = NDArray[np.float64]
Interval = tuple[float, float]

# The discrepancy of a clean log, of other inputs than the calibration's, is taken to be no larger
# than this many times its floor.
MAX_FLOORS = 2.0


@dataclass(frozen=True)
class Cause:
    """An accepted cause.

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
        Share of the misfit (residual power above noise) that it removes, all channels.
    """

    effect: Effect
    evidence: float
    intervals: Mapping[str, Interval]
    gain: Mapping[str, Gain]
    explained: float
    held_out: Mapping[str, Gain] = field(default_factory=dict)
    forms: tuple[tuple[Effect, float], ...] = ()

    def document(self) -> dict[str, Any]:
        """As JSON; an effect confined to one log says to which."""
        effect = self.effect
        return {
            "name": effect.name,
            "channel": effect.channel,
            "log": effect.log,
            "explanation": effect.explanation,
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
    adequate : bool
    noise_share : float
        Share of the residual's power that measured noise and the calibration's floor account for,
        at the worst output (1: nothing but noise).
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
    curves : tuple of (output, Record)
        Of every output in every log what was ``measured``, ``simulated`` and, where there are
        causes, ``extended`` by them, relative to rest.
    """

    adequate: bool
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
    curves: tuple[tuple[str, Record], ...] = field(default=(), compare=False)

    def document(self) -> dict[str, Any]:
        """As JSON: without the curves and the model, null for what is not finite."""
        document = {
            "adequate": self.adequate,
            "noise_share": self.noise_share,
            "residuals": {name: report.document() for name, report in self.residuals.items()},
            "causes": [cause.document() for cause in self.causes],
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
            "notes": self.notes,
            "written": [each.document() for each in self.written],
            "spoiled": self.spoiled,
        }
        return DIAGNOSIS.wrap(jsonable(document))


def reports_of(
    first: Hypothesis, last: Hypothesis, plain: Hypothesis
) -> tuple[dict[str, ResidualReport], float]:
    """Every output's residual, and the share of its power that noise and floor account for.

    Parameters
    ----------
    first, last : Hypothesis
        Before any cause, and with all of them.
    plain : Hypothesis
        The model as calibrated, as a user simulates it.

    Returns
    -------
    reports : dict of output to ResidualReport
    share : float
        Of the worst output.
    """
    reports, share = {}, 1.0
    # Where what is left was taken for white, its noise is not that of the sensor.
    judged = first if "white" in last.assumptions else last
    for output, groups in first.groups.items():
        white = judged.white(output)
        start = first.beginning(output)
        residual = [r - x for r, x in zip(plain.simulation.residual(output), start, strict=True)]
        rms = float(np.std(groups.joined(residual)))
        floor = MAX_FLOORS * first.nuisance[output].floor() if "tight" in first.assumptions else 0.0
        wrong = rms**2
        if "tight" in first.assumptions:
            wrong = float(np.mean(groups.joined(first.unexplained(output)) ** 2))
        accounted = 1 - max(wrong - white**2 - floor**2, 0.0) / rms**2 if rms else 1.0
        share = min(share, accounted)
        k = int(np.argmax([len(rows) for rows in groups.rows]))
        log = first.logs[k]
        reports[output] = residual_report(
            log.time,
            residual[k],
            first.simulation.measured[k][output],
            {d.channel: log.columns[d.channel] for d in first.model.drives},
            {c: v for c, v in log.columns.items() if c in first.scene.extra},
            white,
            floor,
        )
    return reports, share


def curves_of(
    first: Hypothesis, last: Hypothesis, plain: Hypothesis, extended: Hypothesis | None
) -> tuple[tuple[str, Record], ...]:
    """Measured, simulated and extended of every log and output, from the start that each fits.

    Parameters
    ----------
    first, last : Hypothesis
        Before any cause, and with all of them.
    plain, extended : Hypothesis
        The models as a user simulates them; None where there are no causes.
    """
    found = []
    for k, log in enumerate(first.logs):
        for output, measured in first.simulation.measured[k].items():
            if output not in first.groups:
                continue
            simulated = plain.simulation.outputs[k][output] + first.beginning(output)[k]
            columns = {"measured": measured, "simulated": simulated}
            if extended is not None:
                own = extended.simulation.outputs[k][output]
                columns["extended"] = own + last.beginning(output)[k]
            found.append((output, replace(log, columns=columns)))
    return tuple(found)


def unconfirmed(effect: Effect) -> str:
    """A sentence on the strongest cause, which unseen rows do not confirm.

    Parameters
    ----------
    effect : Effect
    """
    values = ", ".join(
        f"{name} {effect.parameters[name]:.3g} {printed(effect.unit(name))}".rstrip()
        for name in (*effect.linear(), *effect.searched())
    )
    return (
        f"what is left looks most like {effect.name} ({effect.channel or 'no channel'}: "
        f"{values}), but rows that its fit has not seen do not confirm it"
    )
