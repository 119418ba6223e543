"""What a technician can do about a cause: its action with the fitted numbers filled in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from thermaltool.diagnosis.inputs import duration_text
from thermaltool.effects.effect import Effect, reference_of
from thermaltool.effects.instant import INSTANTS
from thermaltool.units import is_temperature, parse_channel, printed

if TYPE_CHECKING:
    from thermaltool.diagnosis.result import Location
    from thermaltool.diagnosis.severity import Severity

# What else to look at where one output alone shows a cause.
ALONE = ". No other output shows it: see whether the sensor of {output} sits as it did"


def action_of(
    effect: Effect,
    severity: Mapping[str, Severity],
    noise: Mapping[str, float],
    location: Location | None = None,
    begins: float = 0.0,
) -> str:
    """A sentence that says what to look at and what to do.

    Parameters
    ----------
    effect : Effect
    severity : mapping of output to Severity
    noise : mapping of output to float [unit of the output]
        Of a reading: the output that is moved most is told.
    location : Location, optional
        Of an unknown cause.
    begins : float [s]
        First row of the log of an accident: instants are told from there on.
    """
    named = [own for name in effect.parameters if (own := reference_of(name)[1])]
    output = max(
        severity,
        key=lambda o: severity[o].largest / noise.get(o, 1.0),
        default=next(iter(named), effect.channel),
    )
    values = {"channel": effect.channel, "partner": effect.partner or "", "output": output}
    moved = {own for name in effect.linear() if (own := reference_of(name)[1])}
    alone = len(moved) == 1 < len(noise)
    values["alone"] = ALONE.format(output=output) if alone else ""
    largest = severity[output].largest if output in severity else 0.0
    values["moves"] = _text(largest, parse_channel(output).unit) if output else ""
    fitted = []
    for name, value in effect.parameters.items():
        base, own = reference_of(name)
        if own in (None, output):
            since = begins if base in INSTANTS and effect.log is not None else 0.0
            values[base] = _text(value - since, effect.unit(name))
            values[f"{base}_percent"] = f"{100 * value:.3g} %"
            if not effect.parameter(name).fixed:
                fitted.append(f"{base.replace('_', ' ')} {values[base]}")
    values["fitted"] = ", ".join(fitted)
    if location is not None:
        values["start"], values["stop"] = (_text(t, "s") for t in (location.start, location.stop))
        values["condition"] = f", mostly while {location.condition}" if location.condition else ""
    form = effect.action if effect.channel else effect.action_unlogged or effect.action
    if effect.channel and is_temperature(effect.channel):
        form = effect.action_measured or form
    if effect.partner is None:
        form = effect.action_alone or form
    return form.format_map(values)


def _text(value: float, unit: str) -> str:
    """A value as a person says it: times in a handy unit."""
    if unit == "s":
        return f"{'-' if value < 0 else ''}{duration_text(abs(value), 3)}"
    # A factor is told beside 1.
    digits = 4 if unit == "1" else 3
    return f"{value:.{digits}g} {printed(unit)}".rstrip()
