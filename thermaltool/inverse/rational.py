"""Inverse transfer functions as a model document: what was an output drives what was a drive."""

from __future__ import annotations

from dataclasses import dataclass

from thermaltool.effects.dynamics import hold_of
from thermaltool.errors import ModelError
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.responses.inverse_rational import Inverse, inverted
from thermaltool.responses.rational import Rational


@dataclass(frozen=True)
class InverseModel:
    """The model document, and what its response is made of."""

    model: Model
    inverse: Inverse


def inverse_model(
    model: Model, filter_time: float, output: str | None = None, drive: str | None = None
) -> InverseModel:
    """The inverse of one transfer function of a model.

    Parameters
    ----------
    model : Model
    filter_time : float [s]
        As `inverted`.
    output, drive : str or None
        Which; None where there is one way only.

    Raises
    ------
    ModelError
        None or several ways to choose from, effects or schedules, a response that is not rational,
        and as `inverted`.
    """
    found = [t for t in model.terms if output in (None, t.output) and drive in (None, t.drive)]
    ways = list(dict.fromkeys(f"{t.drive} → {t.output}" for t in found or model.terms))
    if not found or len(ways) > 1:
        problem = "several ways" if found else "no such way"
        raise ModelError(f"{problem}: {', '.join(ways)}: choose with --drive and --sensor")
    term, (place,) = found[0], ways
    if term.band is not None or model.effects:
        what = "a schedule" if term.band is not None else f"the effect {model.effects[0].name}"
        raise ModelError(f"{place}: {what} has no inverse transfer function; compensate --heater "
                         "follows it")  # fmt: skip
    if len(found) > 1:
        raise ModelError(f"{place}: {len(found)} responses in sum, of which there is no inverse")
    if not isinstance(term.response, Rational):
        raise ModelError(
            f"{place}: {term.response.kind} is not rational: it has a kernel, --window"
        )
    source = next(o for o in model.outputs if o.channel == term.output)
    given = next(d for d in model.drives if d.channel == term.drive)
    try:
        inverse = inverted(term.response, filter_time)
    except ModelError as error:
        raise ModelError(f"{place}: {error}") from error
    inner = Model(
        (Drive(source.channel, hold_of(source.channel), source.offset, source.range),),
        (Output(given.channel, "sensor", given.reference, given.range),),
        (Term(source.channel, given.channel, inverse.response),),
        model.sample_period,
        {"inverse_of": dict(model.provenance), "filter_s": list(inverse.filter_lags)},
    )
    return InverseModel(inner, inverse)
