"""Several models as one: added up, or scheduled by level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermaltool.effects.band import ScheduleBand
from thermaltool.effects.effect import Effect
from thermaltool.errors import ModelError
from thermaltool.model import Drive, Model, Output
from thermaltool.record import MAX_UNEVENNESS
from thermaltool.signals.changes import larger_changes
from thermaltool.units import Reference

CORRECT_LATER = "superpose first, correct then (calibrate --linear looks for no curve)"


def superposed(models: Sequence[Model], names: Sequence[str] = ()) -> Model:
    """The sum of models: δ = Σ u_i ε_i (Mareš et al., (7)).

    A drive or an output that several models have is there once; outputs are the sums of all terms.
    What adds up is what outputs do above rest. Rest itself is one state of the machine, of which
    every model has its own estimate: where it is a number, the mean of them is kept.

    Parameters
    ----------
    models : sequence of Model
    names : sequence of str, optional
        What errors call them; "model 1", ... where it is left out.

    Raises
    ------
    ModelError
        A drive or an output with another hold, role or kind of zero; one drive on one output in
        two models; sample periods that differ; an effect that is not on a drive, or on a drive
        that another model has without it.
    """
    names = _examine(models, names)
    owners: dict[tuple[str, str], Model] = {}
    for model in models:
        for term in model.terms:
            if owners.setdefault((term.drive, term.output), model) is not model:
                raise ModelError(f"{term.drive} → {term.output} is in two models: it counts twice")
    terms = tuple(t for m in models for t in m.terms)
    return _joined(models, terms=terms, effects=_at_drives(models, names))


def _at_drives(models: Sequence[Model], names: Sequence[str]) -> tuple[Effect, ...]:
    """Effects at the drives: in the sum each of them acts on the terms of all models."""
    for effect in (e for m in models for e in m.effects):
        if effect.side != "drive":
            raise ModelError(f"{effect.name} of {effect.channel}: {CORRECT_LATER}")
    effects: list[Effect] = []
    for channel in dict.fromkeys(t.drive for m in models for t in m.terms):
        own = {
            name: [e for e in model.effects if e.channel == channel]
            for name, model in zip(names, models, strict=True)
            if any(t.drive == channel for t in model.terms)
        }
        first, *others = own.values()
        if any(other != first for other in others):
            told = ", ".join(
                f"{name} ({', '.join(e.name for e in each) or 'straight'})"
                for name, each in own.items()
            )
            raise ModelError(f"{channel} acts differently in the models {told}: {CORRECT_LATER}")
        effects += first
    return tuple(effects)


def scheduled(
    models: Sequence[Model],
    by: str,
    levels: Sequence[float] | None = None,
    names: Sequence[str] = (),
) -> Model:
    """Models by level of a channel, switched without a bump (`thermaltool.effects.band`).

    Parameters
    ----------
    models : sequence of Model
        Of the same drives and outputs, without effects.
    by : str
        What chooses: a drive, or another channel of the log.
    levels : sequence of float, optional
        At which each model was found; default the largest level of `by` in its logs.
    names : sequence of str, optional
        As in `superposed`; zeros that are numbers are averaged as there.

    Raises
    ------
    ModelError
        Models that do not go together, a level that is not known, or two of one level.
    """
    _examine(models, names)
    if len(models) < 2:
        raise ModelError("a schedule takes two models or more")
    first = models[0]
    for model in models:
        ends = ([d.channel for d in model.drives], [o.channel for o in model.outputs])
        if ends != ([d.channel for d in first.drives], [o.channel for o in first.outputs]):
            raise ModelError("the models of a schedule have the same drives and outputs")
        if model.effects:
            raise ModelError(
                f"a model with {model.effects[0].name}: correct the schedule, not its members"
            )
        if any(t.band is not None for t in model.terms):
            raise ModelError("a schedule of schedules")
    at = [_level(model, by) for model in models] if levels is None else list(map(float, levels))
    if len(at) != len(models):
        raise ModelError(f"{len(models)} models, {len(at)} levels")
    if min(at) < 0:
        raise ModelError("the levels of a schedule are sizes, without sign: from 0 on")
    if len(set(at)) < len(at):
        raise ModelError(f"two models of one level of {by}: {', '.join(f'{x:g}' for x in at)}")
    order = sorted(range(len(at)), key=at.__getitem__)
    ladder = tuple(at[k] for k in order)
    terms = tuple(
        replace(term, band=ScheduleBand(by, ladder, place))
        for place, k in enumerate(order)
        for term in models[k].terms
    )
    return _joined([models[k] for k in order], terms=terms)


def _level(model: Model, by: str) -> float:
    for drive in model.drives:
        if drive.channel == by:
            return max(abs(drive.range[0]), abs(drive.range[1]))
    raise ModelError(f"{by} is no drive of the models: give the levels with --levels")


def _examine(models: Sequence[Model], names: Sequence[str]) -> Sequence[str]:
    """That models go together; their names, or numbers where they have none."""
    names = names or [f"model {k + 1}" for k in range(len(models))]
    first = models[0].sample_period
    drives: dict[str, Drive] = {}
    outputs: dict[str, Output] = {}
    for name, model in zip(names, models, strict=True):
        if abs(model.sample_period - first) > MAX_UNEVENNESS * first:
            raise ModelError(
                f"{name}: sampled every {model.sample_period:g} s, {names[0]} every {first:g} s"
            )
        for drive in model.drives:
            known = drives.setdefault(drive.channel, drive)
            if (known.hold, known.reference) != (drive.hold, drive.reference):
                raise ModelError(f"{drive.channel}: the models differ in its hold or reference")
        for output in model.outputs:
            seen = outputs.setdefault(output.channel, output)
            if seen.role != output.role:
                raise ModelError(f"{output.channel}: the models differ in its role")
            if (seen.offset == "first") != (output.offset == "first"):
                raise ModelError(
                    f"{output.channel}: the models differ in its zero: a number, or the first value"
                )
    return names


def _joined(models: Sequence[Model], **parts: object) -> Model:
    """Drives and outputs of all models with their widest ranges; fits are those of the parts."""
    drives: dict[str, Drive] = {}
    outputs: dict[str, Output] = {}
    for model in models:
        for drive in model.drives:
            known = drives.get(drive.channel, drive)
            drives[drive.channel] = replace(
                drive,
                range=_wider(known.range, drive.range),
                changes=larger_changes(known.changes, drive.changes),
            )
        for output in model.outputs:
            seen = outputs.get(output.channel, output)
            outputs[output.channel] = replace(
                output,
                offset=_zero(models, output.channel),
                range=_wider(seen.range, output.range),
                fit={},
                changes=larger_changes(seen.changes, output.changes),
            )
    logs = [log for model in models for log in model.provenance.get("logs", ())]
    joined = Model(tuple(drives.values()), tuple(outputs.values()), (), models[0].sample_period,
                   {"logs": logs})  # fmt: skip
    return replace(joined, **parts)  # type: ignore[arg-type]


def _zero(models: Sequence[Model], channel: str) -> Reference:
    """Where an output rests: numbers are estimates of one state, of which the mean is taken."""
    zeros = [o.offset for m in models for o in m.outputs if o.channel == channel]
    numbers = [zero for zero in zeros if zero != "first"]
    return float(np.mean(numbers)) if numbers else "first"


def _wider(one: tuple[float, float], other: tuple[float, float]) -> tuple[float, float]:
    return min(one[0], other[0]), max(one[1], other[1])
