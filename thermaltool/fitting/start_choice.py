"""Whether records begin on a machine at rest, or on one that is still on its way there.

A machine in a room with day and night is hardly ever at rest. What it brings along decays through
the first rows, and a response from rest takes it for a slower lag, or for another gain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from thermaltool.effects.effect import Effect
from thermaltool.fitting.acting_record import acting_records
from thermaltool.fitting.averaging import row_noise
from thermaltool.fitting.discrepancy import calibration_error
from thermaltool.fitting.hold_choice import ChosenKinds
from thermaltool.fitting.projection import surroundings
from thermaltool.fitting.response_search import FittedKinds, KindSearch
from thermaltool.fitting.sound_kinds import DECISIVE, criterion
from thermaltool.fitting.start_state import stands_still
from thermaltool.model import Drive, Model, characteristics, relative
from thermaltool.record import Record

# Of the squared error beyond the noise of some output, where that is larger than the noise, a free
# start leaves at most this share: it stands in for slow lags and curves, too, which leave more.
MAX_LEFT_BY_START = 0.25
# ... or, where the surroundings are known, no more than so many times the noise in all.
MAX_LEFT_AT_NOISE = 1.2
# Kinds of which all drives may share the lags.
ONE_BODY = ("rational2", "rational3")


def begins_away_from_rest(
    records: Sequence[Record],
    drives: Sequence[Drive],
    chosen: Sequence[ChosenKinds],
    effects: Sequence[Effect],
    fixed: Mapping[str, float],
) -> bool:
    """Whether the same kinds of response with a free state at the first rows leave far less.

    Not to be asked where all `rests` at first, whatever else a free state may explain; but for
    temperatures of known `surroundings`. On its way to these a machine hardly moves at first, and
    what it brings along passes for a response to them that no body has: there the lags of one body
    are tried, too.

    Parameters
    ----------
    records : sequence of Record
    drives : sequence of Drive
    chosen : sequence of ChosenKinds
        Of every output whose kinds were found, fitted from rest.
    effects : sequence of Effect
        Laws of the drives that were found.
    fixed : mapping of parameter name to value
    """
    acting, zeroed = acting_records(records, drives, effects)
    evidence, explained = 0.0, False
    for each in chosen:
        around = surroundings(zeroed, each.output)
        own = sorted({*each.drives, *around})
        started = KindSearch(
            acting, [zeroed[d] for d in own], each.output, True, fixed, {}, bool(around)
        )
        held = started.driven_by([zeroed[d] for d in each.drives])
        held = held if each.equilibrium else held.out_of_equilibrium()
        # Of the same rows: what decays at first is no outlier.
        rest = each.fitted(held.from_rest())
        found = [each.fitted(held)] if own == [*each.drives] else []
        found += [_one_body(started, kind) for kind in ONE_BODY] if around else []
        frees = [fit for fit in found if fit is not None]
        if rest is None or not frees or not rest.size:
            continue
        rows = min(fit.independent for fit in frees)
        free = min(frees, key=lambda fit: criterion(fit, rows) + _price(fit, rows))
        noise = max(row_noise(r, each.output) for r in records) ** 2
        size, left = (float(np.mean(fit.residual**2)) - noise for fit in (rest, free))
        explained |= _explained_by_start(size, left, noise)
        explained |= bool(around) and left < (MAX_LEFT_AT_NOISE**2 - 1) * noise
        evidence += criterion(rest, rows) - criterion(free, rows) - _price(free, rows)
    return explained and evidence > DECISIVE


def _one_body(task: KindSearch, kind: str) -> FittedKinds | None:
    """A kind whose lags all drives share; None where it is none of a machine."""
    own = task.fit((kind,) * len(task.drives), (0.0,) * len(task.drives), common=True)
    return None if own is None or own.soundness.flaw else own


def _price(free: FittedKinds, rows: float) -> float:
    """What the decays of a free start cost in the criterion."""
    decays = free.data.problem.decays(free.search.parametrization.gains)
    return decays * float(np.log(rows))


def _explained_by_start(rested: float, free: float, noise: float) -> bool:
    """Whether a free start explains what a start from rest leaves: squared errors beyond noise."""
    return rested > noise and free < MAX_LEFT_BY_START * rested


def free_where_known(free: Model, rested: Model) -> Model:
    """The outputs with a free start, or from rest where that leaves fewer gains open.

    With a free start slow drives, zeros and what decays may pass for each other. A fit from rest
    that is far off knows its gains no better, sure of them as it may be. Where the models differ
    in laws, which all outputs share, all begin alike.

    Parameters
    ----------
    free, rested : Model
        Calibrations of the same channels.
    """
    channels = [output.channel for output in rested.outputs]
    explained = {c for c in channels if _far_nearer(free, rested, c)}
    if (free.drives, free.effects) != (rested.drives, rested.effects):
        return free if explained or _known_gains(free) >= _known_gains(rested) else rested
    taken = {
        c: free if c in explained or _known_gains(free, c) >= _known_gains(rested, c) else rested
        for c in channels
    }
    outputs = [o for c in channels for o in taken[c].outputs if o.channel == c]
    terms = [term for c in channels for term in taken[c].terms if term.output == c]
    return replace(rested, outputs=tuple(outputs), terms=tuple(terms))


def _far_nearer(free: Model, rested: Model, channel: str) -> bool:
    """Whether a free start explains what the fit from rest leaves of an output."""
    fits = [o.fit for m in (rested, free) for o in m.outputs if o.channel == channel]
    noise = float(fits[-1].get("noise", 0.0)) ** 2
    size, left = (calibration_error(fit) ** 2 - noise for fit in fits)
    return _explained_by_start(size, left, noise)


def _known_gains(model: Model, output: str | None = None) -> int:
    """Gains that are surely not zero, of one output or of all."""
    own = (term for term in model.terms if output in (None, term.output))
    return sum(not characteristics(term).may_be_zero for term in own)


def rests(record: Record, drives: Sequence[Drive], outputs: Sequence[str]) -> bool:
    """Whether the drives are off at first, and nothing moves before they do.

    Parameters
    ----------
    record : Record
    drives : sequence of Drive
    outputs : sequence of str
    """
    inputs = np.array([relative(record.column(d.channel), d.reference, d.hold) for d in drives])
    off = all(u[0] == 0 for u, d in zip(inputs, drives, strict=True) if d.hold == "zero")
    return off and all(
        stands_still(inputs[:, there], record.column(output)[there])
        for output in outputs
        if (there := np.isfinite(record.column(output))).any()
    )
