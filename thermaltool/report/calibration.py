"""What ``calibrate`` reports: the fit of every output, and what the records leave open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from thermaltool.effects.effect import Effect, reference_of
from thermaltool.effects.joint_contact import JointContact
from thermaltool.fitting.discrepancy import MAX_OVER_NOISE, calibration_error
from thermaltool.fitting.kind_candidate import LEFT_OUT, MORE_PARAMETERS, MORE_TIME_CONSTANTS
from thermaltool.fitting.projection import surroundings
from thermaltool.fitting.sound_kinds import DECISIVE
from thermaltool.model import Drive, Model, Output, characteristics, to_document
from thermaltool.report.presentation import duration, responses_table
from thermaltool.report.text import aligned, listed, switched_between_rows
from thermaltool.signals.intervals import normal_estimate
from thermaltool.units import ABSOLUTE_ZERO, is_absolute, parse_channel, printed

# A sum of gains to the surroundings this far from one is told.
MIN_OFF_EQUILIBRIUM = 0.03


def calibration_table(model: Model) -> str:
    """Each output with its fit, each response as a person asks for it, and the kinds compared."""
    rows = [["output", "rmse", "zero free", "fit %", "max", "rows", "responses"]]
    for output in model.outputs:
        fit = output.fit
        kinds = [t.response.kind for t in model.terms if t.output == output.channel]
        rows.append(
            [
                output.channel,
                f"{fit['rmse']:.4g}",
                f"{fit.get('rmse_zero_free', fit['rmse']):.4g}",
                f"{fit['fit_percent']:.2f}",
                f"{fit['max_error']:.3g}",
                str(fit["rows"]),
                kinds[0] if len(set(kinds)) == 1 else " + ".join(kinds),
            ]
        )
    parts = [aligned(rows), responses_table([characteristics(term) for term in model.terms])]
    if zeros := _zeros(model):
        parts.append(zeros)
    for output in model.outputs:
        candidates = output.fit.get("candidates")
        if candidates:
            parts.append(_candidates(output.channel, candidates))
    return "\n\n".join(parts)


def _zeros(model: Model) -> str:
    """What the sensors count from, and how far the zeros of several logs differ; may be empty."""
    rows = [["zeros of the logs", "unit", "counts from", "least", "largest", "apart", "most by"]]
    logs = [Path(each["name"]).name for each in model.provenance.get("logs", ())]
    for output in model.outputs:
        shown, weights = output.fit.get("zeros_shown", ()), output.fit.get("zero_weights", ())
        if not shown or output.offset == "first":
            continue
        most = max(range(len(shown)), key=lambda k: weights[k])
        told = [zero for zero, weight in zip(shown, weights, strict=True) if weight]
        name = logs[most] if len(logs) == len(shown) else f"log {most + 1}"
        rows.append(
            [
                output.channel,
                printed(parse_channel(output.channel).unit),
                *(f"{value:.4g}" for value in (output.offset, min(told), max(told))),
                f"{max(told) - min(told):.3g}",
                f"{name} ({100 * weights[most]:.0f} %)",
            ]
        )
    return aligned(rows) if rows[1:] else ""


def _candidates(channel: str, candidates: Sequence[Mapping[str, Any]]) -> str:
    """What was compared for one output, and why one kind is taken."""
    rows = [
        [f"{channel}: kinds compared", "parameters", "rmse of means", "held out", "criterion", ""]
    ]
    for each in candidates:
        rows.append(
            [
                each["label"],
                str(each["parameters"]),
                f"{each['rmse']:.3g}",
                "" if each["held_out"] is None else f"{each['held_out']:.3g}",
                f"{each['criterion']:.0f}",
                each["note"],
            ]
        )
    return aligned(rows)


def calibration_warnings(model: Model) -> list[str]:
    """What the records leave open, each a sentence."""
    found = [
        f"{o.channel}: {sentence}" for o in model.outputs for sentence in o.fit["unidentified"]
    ]
    for output in model.outputs:
        for drive in _left_out(output, model):
            found.append(
                f"{output.channel}: without {drive.channel}: {_why_left_out(output, drive)}. "
                f"To see one, change {drive.channel} alone, while the other drives rest"
            )
    found += _surroundings(model)
    found += switched_between_rows({each.channel: each.hold for each in model.drives})
    found += [sentence for output in model.outputs if (sentence := _likelier(output))]
    found += [_instants(o) for o in model.outputs if o.fit.get("instants")]
    if any(o.fit.get("free_start") for o in model.outputs):
        found.append(
            "the state at the first rows is fitted; simulate estimates it in other logs, too, "
            "where they are long enough (--initial rest takes them to begin at rest)"
        )
    joints = [effect for effect in model.effects if isinstance(effect, JointContact)]
    found += [_joint(effect) for effect in joints]
    found += [_law(effect, model) for effect in model.effects if effect not in joints]
    # What a contact temperature is beyond the linear model is read.
    judged = (output for output in model.outputs if output.judged)
    found += [sentence for output in judged if (sentence := _coarse(output))]
    found += [sentence for output in model.outputs if (sentence := _below_zero(output))]
    # Drives that say much the same share what they do: the gain of one alone is no question.
    for term in model.terms if model.redundancy is None else ():
        each = characteristics(term)
        if each.may_be_zero and term.covariance is not None:
            hold = 3 * term.response.slowest()
            found.append(
                f"{each.output}: the gain of {each.drive} may be zero ({each.gain}): change it "
                f"alone, while the other drives rest, and hold it for {duration(hold)}"
            )
    return found


def _surroundings(model: Model) -> list[str]:
    """Which temperatures are taken to become those of their surroundings, and which do not."""
    kept: dict[tuple[str, ...], list[str]] = {}
    found, drives = [], {each.channel: each for each in model.drives}
    for output in model.outputs:
        own = [t for t in model.terms if t.output == output.channel]
        around = surroundings([drives[t.drive] for t in own], output.channel)
        names = tuple(own[k].drive for k in around)
        if not names or "equilibrium" not in output.chosen:
            continue
        if output.chosen["equilibrium"]:
            kept.setdefault(names, []).append(output.channel)
            continue
        total = sum(own[k].response.dc_gain() for k in around)
        if abs(total - 1) > MIN_OFF_EQUILIBRIUM:
            found.append(
                f"{output.channel}: its gains to {listed(names)} add up to {total:.3g}, not to 1 "
                "as where all that warms and cools it is logged: other surroundings take part, "
                "they are not measured where they act, or these logs are too short to show it all"
            )
    for names, outputs in kept.items():
        found.append(
            f"without heat {listed(outputs)} will be as warm as {listed(names)}: gains that add up "
            "to 1 are taken as known, and these logs do not speak against it"
        )
    return found


def _likelier(output: Output) -> str:
    """That a less simple kind is surely truer, if hardly nearer; empty where none is."""
    tried = output.fit.get("candidates", ())
    taken = next((each for each in tried if each["chosen"]), None)
    others = [each for each in tried if each["note"] in (MORE_PARAMETERS, MORE_TIME_CONSTANTS)]
    if taken is None or not others:
        return ""
    best = min(others, key=lambda each: float(each["criterion"]))
    evidence = taken["criterion"] - best["criterion"]
    if evidence <= DECISIVE:
        return ""
    return (
        f'{output.channel}: "{best["label"]}" has decisive evidence beside "{taken["label"]}" '
        f"({evidence:.0f}), which is taken since it comes about as near with less: gains and time "
        "constants are those of the simpler kind, and the true ones may lie outside their intervals"
    )


def _instants(output: Output) -> str:
    """How many switches lie between rows, and how far the misfit falls with their instants."""
    own = output.fit["instants"]
    unit = printed(parse_channel(output.channel).unit)
    return (
        f"{output.channel}: the instants of {own['switches']} switches between rows are part of "
        f"the fit and of its intervals: beside them it leaves {own['rmse']:.3g} {unit}, "
        f"{own['rmse_without']:.3g} without"
    )


def _coarse(output: Output) -> str:
    """That a fit is far from the noise; empty where it is not."""
    left, noise = calibration_error(output.fit), output.fit.get("noise", 0.0)
    if not noise or left < MAX_OVER_NOISE * noise:
        return ""
    unit = printed(parse_channel(output.channel).unit)
    return (
        f"{output.channel}: the fit leaves {left:.3g} {unit}, {left / noise:.2g} times the noise "
        "of a reading: no response and no law that was tried describes these logs"
    )


def _below_zero(output: Output) -> str:
    """That a temperature at rest is none; empty where it is one."""
    zero = output.offset
    if zero == "first" or not is_absolute(output.channel):
        return ""
    if zero >= ABSOLUTE_ZERO:
        return ""
    return (
        f"{output.channel}: at rest the model is at {zero:.4g} °C, below absolute zero: its gains "
        "do not hold down to there. Begin a log at rest, or state what the drives count from "
        "(--reference)"
    )


def _joint(effect: JointContact) -> str:
    """What a joint adds to displacements, and what tells of it."""
    parts = []
    for output in dict.fromkeys(o for name in effect.parameters if (o := reference_of(name)[1])):
        forces, heat, contact, deviation = effect.gains(output)
        now, late = (contact, deviation) if effect.partner else (forces, heat)
        unit = effect.unit(f"{'contact' if effect.partner else 'forces'}[{output}]")
        gains = [f"{now:.3g} at once"] if now else []
        if late:
            gains.append(f"{late:.3g} through {duration(effect.parameters['time_constant'])}")
        parts.append(f"{output} {' and '.join(gains)} {printed(unit)}")
    level = f"{effect.parameters['level']:.4g} {printed(parse_channel(effect.channel).unit)}"
    by = (
        f"a joint, told by what {effect.partner} reads beyond the linear model"
        if effect.partner
        else f"a joint, told by the square of {effect.channel} with its sign, 1 at {level}"
    )
    return f"{by}: {'; '.join(parts)}"


def _law(effect: Effect, model: Model) -> str:
    """What acts in place of a drive, how the machine changes with its temperature, what is read."""
    name = next(n for n in effect.parameters if n not in ("level", "gain", "rest"))
    value, at = effect.parameters[name], list(effect.parameters).index(name)
    error = 0.0 if effect.covariance is None else float(effect.covariance[at, at]) ** 0.5
    told = normal_estimate(value, error)
    if effect.name == "sensor_conversion":
        ends = next(o.range for o in model.outputs if o.channel == effect.channel)
        reach = max(ends, key=abs)
        half, unit = -(reach**2) / 4, printed(parse_channel(effect.channel).unit)
        return (
            f"{effect.channel}: between rest and {reach:+.4g} {unit}, it is up to "
            f"{normal_estimate(half * value, -half * error)} {unit} off a straight line: the "
            "material conducts heat otherwise when it is hot, or the sensor is converted by "
            "another curve"
        )
    if effect.name == "radiation":
        return (
            f"{effect.channel}: more heat is lost for each degree where it is hot, as by "
            f"radiation (rate at rest {told} 1/s): gains and time constants hold near rest, and "
            "are smaller above"
        )
    level = f"{effect.parameters['level']:.4g} {printed(parse_channel(effect.channel).unit)}"
    if effect.name == "natural_convection":
        return (
            f"{effect.channel}: still air takes more heat for each degree where it is hot (rate "
            f"{told} 1/s at {level} above rest): gains and time constants hold there, and are "
            "larger near rest"
        )
    if name == "rise":
        return (
            f"{effect.channel}: heat capacity over conductivity is {1 + value:.4g} times as large "
            f"where it is {level} above rest (rise {told}): time constants hold near rest"
        )
    if name == "exponent":
        return (
            f"{effect.channel}: what acts is a power of it, {level} times (value / {level}) to the "
            f"power of {told}: static gains hold at {level}"
        )
    return (
        f"{effect.channel}: what acts is a parabola of it, value times (1 + c value / {level}) "
        f"with c = {told}: static gains hold near rest, and are {1 + value:.4g} times as large at "
        f"{level}"
    )


def _left_out(output: Output, model: Model) -> list[Drive]:
    """Drives that the chosen kinds leave out."""
    kinds = output.chosen.get("kinds")
    if kinds is None:
        return []
    return [drive for drive, kind in zip(model.drives, kinds, strict=True) if kind == LEFT_OUT]


def _why_left_out(output: Output, drive: Drive) -> str:
    """Whether no response was seen, or none apart from those to the other drives."""
    known = output.fit["discrepancy"]
    own = [k for k, (channel, _) in enumerate(known["lags"]) if channel == drive.channel]
    weights = np.reshape(known["spread"], (-1, len(known["lags"])))[:, own]
    gains = np.abs(weights[np.any(weights, axis=1)].sum(axis=1))
    gain = float(np.median(gains)) if len(gains) else 0.0
    if gain * np.ptp(drive.range) <= output.fit["noise"]:
        return "these logs show no response to it"
    per = f" per {unit}" if (unit := printed(parse_channel(drive.channel).unit)) else ""
    return (
        "it moves with the other drives, and these logs do not tell whose response is whose (its "
        f"gain may be {gain:.2g} {printed(parse_channel(output.channel).unit)}{per})"
    )


def calibration_document(model: Model) -> dict[str, Any]:
    """Outputs and terms as the model file has them."""
    document = to_document(model)
    own: dict[str, Any] = {k: document[k] for k in ("outputs", "terms", "effects") if k in document}
    return {**own, "responses": [characteristics(term).document() for term in model.terms]}
