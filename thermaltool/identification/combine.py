"""Several models as one: added up, or scheduled by level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from thermaltool.effects.band import Band
from thermaltool.effects.effect import Effect
from thermaltool.errors import ModelError
from thermaltool.model import Drive, Model, Output


def superposed(models: Sequence[Model]) -> Model:
    """The sum of models: δ = Σ u_i ε_i (Mareš et al., (7)).

    A drive or an output that several models have is there once; outputs are the sums of all terms.

    Raises
    ------
    ModelError
        A drive or an output with another hold, role or zero; one drive on one output in two
        models; sample periods that differ; an effect that is not on a drive.
    """
    _examine(models)
    owners: dict[tuple[str, str], Model] = {}
    for model in models:
        for term in model.terms:
            if owners.setdefault((term.drive, term.output), model) is not model:
                raise ModelError(f"{term.drive} → {term.output} is in two models: it counts twice")
    effects: list[Effect] = []
    for effect in (e for m in models for e in m.effects):
        if effect.side != "drive":
            raise ModelError(f"{effect.name} of {effect.channel}: superpose first, correct then")
        if effect not in effects:
            effects.append(effect)
    terms = tuple(t for m in models for t in m.terms)
    return _joined(models, terms=terms, effects=tuple(effects))


def scheduled(models: Sequence[Model], by: str, levels: Sequence[float] | None = None) -> Model:
    """Models by level of a channel, switched without a bump (`thermaltool.effects.band`).

    Parameters
    ----------
    models : sequence of Model
        Of the same drives and outputs, without effects.
    by : str
        What chooses: a drive, or another channel of the log.
    levels : sequence of float, optional
        At which each model was found; default the largest level of `by` in its logs.

    Raises
    ------
    ModelError
        Models that do not go together, a level that is not known, or two of one level.
    """
    _examine(models)
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
    if len(set(at)) < len(at):
        raise ModelError(f"two models of one level of {by}: {', '.join(f'{x:g}' for x in at)}")
    order = sorted(range(len(at)), key=at.__getitem__)
    ladder = tuple(at[k] for k in order)
    terms = tuple(
        replace(term, band=Band(by, ladder, place))
        for place, k in enumerate(order)
        for term in models[k].terms
    )
    return _joined([models[k] for k in order], terms=terms)


def _level(model: Model, by: str) -> float:
    for drive in model.drives:
        if drive.channel == by:
            return max(abs(drive.range[0]), abs(drive.range[1]))
    raise ModelError(f"{by} is no drive of the models: give the levels with --levels")


def _examine(models: Sequence[Model]) -> None:
    drives: dict[str, Drive] = {}
    outputs: dict[str, Output] = {}
    for model in models:
        if model.sample_period != models[0].sample_period:
            raise ModelError(
                f"sampled every {model.sample_period:g} s, the first model every "
                f"{models[0].sample_period:g} s"
            )
        for drive in model.drives:
            known = drives.setdefault(drive.channel, drive)
            if (known.hold, known.reference) != (drive.hold, drive.reference):
                raise ModelError(f"{drive.channel}: the models differ in its hold or reference")
        for output in model.outputs:
            seen = outputs.setdefault(output.channel, output)
            if (seen.role, seen.offset) != (output.role, output.offset):
                raise ModelError(f"{output.channel}: the models differ in its role or zero")


def _joined(models: Sequence[Model], **parts: object) -> Model:
    """Drives and outputs of all models with their widest ranges; fits are those of the parts."""
    drives: dict[str, Drive] = {}
    outputs: dict[str, Output] = {}
    for model in models:
        for drive in model.drives:
            known = drives.get(drive.channel, drive)
            drives[drive.channel] = replace(drive, range=_wider(known.range, drive.range))
        for output in model.outputs:
            seen = outputs.get(output.channel, output)
            outputs[output.channel] = replace(
                output, range=_wider(seen.range, output.range), fit={}
            )
    logs = [log for model in models for log in model.provenance.get("logs", ())]
    joined = Model(tuple(drives.values()), tuple(outputs.values()), (), models[0].sample_period,
                   {"logs": logs})  # fmt: skip
    return replace(joined, **parts)  # type: ignore[arg-type]


def _wider(one: tuple[float, float], other: tuple[float, float]) -> tuple[float, float]:
    return min(one[0], other[0]), max(one[1], other[1])
