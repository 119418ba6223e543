"""A part of a model: some of its sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from thermaltool.effects.effect import Effect, reference_of
from thermaltool.errors import ModelError
from thermaltool.model.document import Model


def only_sensors(model: Model, sensors: Sequence[str]) -> Model:
    """The model with some of its sensors, and the effects that these see.

    Parameters
    ----------
    model : Model
    sensors : sequence of str
        Those that are kept.

    Raises
    ------
    ModelError
        A name that is no sensor of the model, or a sensor that an effect on others needs.
    """
    known = [o.channel for o in model.sensors]
    for name in sensors:
        if name not in known:
            raise ModelError(f"no sensor {name} in the model; there are: {', '.join(known)}")
    dropped = set(known) - set(sensors)
    return replace(
        model,
        outputs=tuple(o for o in model.outputs if o.channel not in dropped),
        terms=tuple(t for t in model.terms if t.output not in dropped),
        effects=tuple(e for e in (_seen(e, dropped) for e in model.effects) if e is not None),
    )


def _seen(effect: Effect, dropped: set[str]) -> Effect | None:
    """What is left of an effect without some sensors."""
    if effect.joins:
        for needed in {effect.channel, effect.partner} & dropped:
            raise ModelError(f"the effect {effect.name} needs the sensor {needed}: keep it")
    gone = tuple(n for n in effect.parameters if reference_of(n)[1] in dropped)
    if gone:
        effect = effect.without(gone)
        return effect if any(reference_of(n)[1] for n in effect.parameters) else None
    return None if effect.channel in dropped else effect
