"""What logs can show of a cause before anybody looks at the residual, and what they cannot show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from thermaltool.diagnosis.evidence import STRONG, State
from thermaltool.diagnosis.experiments import library
from thermaltool.diagnosis.profile import Base
from thermaltool.diagnosis.result import Alternative
from thermaltool.diagnosis.scan import every_probe
from thermaltool.diagnosis.sight import Changes, Normal, Rehearsal, Sight, displaced, noise_before
from thermaltool.diagnosis.workbench import Workbench
from thermaltool.effects import CATALOGUE, effect_class
from thermaltool.effects.effect import Effect, Float
from thermaltool.units import is_displacement

# A signature of which the model's own parameters leave less than this share of the power is theirs.
DEGENERATE = 1e-4
# Of the inputs that show what has not been seen, the first that opens this share of the best angle
# is asked for.
SIMPLE = 0.5
# An input shows what it opens to this angle [deg].
SHOWN = 5.0

# Found otherwise, or free to be whatever is slow: no vector at a place of the model.
_SHAPELESS = ("ambient_drift", "periodic", "outliers", "record_too_short")


@dataclass(frozen=True)
class Detectable:
    """What logs would show of a cause.

    Attributes
    ----------
    change : float [unit of `output`]
        RMS change of the output at which the cause would have strong evidence.
    output : str
        The output that tells it first.
    left : float
        Norm of the signature there that the model's own parameters leave, relative to the whole.
    """

    change: float
    output: str
    left: float


def detectable(
    bench: Workbench,
    effect: Effect,
    state: State,
    correction: float = 0.0,
    sight: Sight | None = None,
    found: Mapping[str, Changes] | None = None,
) -> Detectable | None:
    """How large a cause would have to be to be seen in these logs, the residual unseen.

    Parameters
    ----------
    effect : Effect
        At a trial size; its amplitudes are scaled.
    correction : float
        Evidence that the number of causes tried takes away.
    sight, found : optional
        Of the bench in this state, and `Workbench.signatures` of the effect, where they are known.

    Returns
    -------
    Detectable or None
        None where the model's own parameters can do all that the cause does.
    """
    sight = sight or Sight(bench, state, noise_before(bench, state))
    found = bench.signatures(effect) if found is None else found
    vectors = [changes for changes in found.values() if changes]
    if not vectors:
        return None
    present = sight.present(vectors)
    left = sight.reduced([present], len(vectors))
    best: tuple[float, Detectable] | None = None
    for k, changes in enumerate(vectors):
        seen = [o for o in changes if left[o][k, k] > DEGENERATE * present[o].whole[k]]
        if not seen:
            continue
        rows = sum(_rows(bench, o) for o in changes)
        unknown = 1 + len(effect.searched())
        needed = STRONG + correction + unknown * float(np.log(rows))
        needed -= 2 * float(np.log(effect.odds))
        amplitude = _reaching(bench, state, dict.fromkeys(seen, changes), needed)
        sizes = {o: amplitude * _rms(bench, o, changes) for o in seen}
        relative = {o: sizes[o] / float(np.sqrt(sight.noise[o].variance)) for o in seen}
        output = max(seen, key=lambda o: relative[o])
        if best is None or relative[output] < best[0]:
            share = float(np.sqrt(left[output][k, k] / present[output].whole[k]))
            best = relative[output], Detectable(sizes[output], output, min(share, 1.0))
    return None if best is None else best[1]


def _reaching(
    bench: Workbench, state: State, changes: Mapping[str, Changes], needed: float
) -> float:
    """The amplitude at which a cause is expected to have `needed` evidence.

    Without the cause, the slow discrepancy takes what it can of the change, at any level.
    """
    known: list[tuple[float, Base, Float]] = []
    for output, series in changes.items():
        evidence = bench.evidence[output]
        column = evidence.observed.gather(series[output])[:, None]
        reduced = evidence.reduced(state, evidence.products(column, [[0]]))
        known.append((evidence.share, reduced.base, reduced.own[:, 0]))

    def beyond(log: float) -> float:
        squares = [base.square + np.exp(2 * log) * own for _, base, own in known]
        gains = [
            share * (float(np.min(base.negative_log(square))) - base.best)
            for (share, base, _), square in zip(known, squares, strict=True)
        ]
        return 2 * sum(gains) - needed

    size = max(float(own[base.level]) / base.white**2 for _, base, own in known)
    low = 0.5 * float(np.log(needed / len(known) / size)) - 3.0
    high = low
    while beyond(high) < 0:
        high += 2.0
    return float(np.exp(brentq(beyond, min(low, high - 2.0), high, xtol=1e-3)))


def invisible(bench: Workbench, state: State) -> list[Alternative]:
    """Causes whose place is there but which these logs cannot show, and the input that would.

    Returns
    -------
    list of Alternative
        One for each channel, with the simplest input that would show all of its causes. `angle`
        and `opened` are between a signature and what the model may say for itself, the smallest of
        several.
    """
    sight = Sight(bench, state, noise_before(bench, state))
    unseen = list(_unseen(sight))
    if not unseen:
        return []
    rehearsal = Rehearsal(sight, library(bench, unseen), bench.observed)
    places: dict[str, list[tuple[str, float, list[float]]]] = {}
    for effect in unseen:
        now = sight.present([displaced(bench, effect)])
        then = rehearsal.normals([displaced(rehearsal.bench, effect)])
        opened = [_shown(sight, now, each) for each in then]
        if max(opened) >= SHOWN:
            places.setdefault(effect.channel, []).append((effect.name, _shown(sight, now), opened))
    found = []
    for channel, group in places.items():
        least = np.min([opened for _, _, opened in group], axis=0)
        k = int(np.argmax(least >= SIMPLE * least.max()))
        found.append(
            Alternative(
                tuple(name for name, _, _ in group),
                (channel,) * len(group),
                min(now for _, now, _ in group),
                rehearsal.experiments[k].sentence,
                float(least[k]),
            )
        )
    return found


def _rows(bench: Workbench, output: str) -> float:
    """Independent readings of an output."""
    return bench.evidence[output].share * sum(len(rows) for rows in bench.observed[output].rows)


def _rms(bench: Workbench, output: str, changes: Changes) -> float:
    """RMS change; of a displacement, whose zero is arbitrary, about its mean."""
    change = bench.observed[output].whole(changes[output])
    if is_displacement(output):
        change = change - np.mean(change)
    return float(np.sqrt(np.mean(change**2)))


def _shown(sight: Sight, present: Normal, more: Normal | None = None) -> float:
    """Between one signature and what the model may say for itself, in `more` where given [deg]."""
    logs = [present] if more is None else [present, more]
    left, before = (
        sum(float(v[0, 0]) for v in sight.reduced(each, 1).values()) for each in (logs, [present])
    )
    whole = sum(float(block.whole[0]) for block in logs[-1].values())
    left -= 0.0 if more is None else before
    return float(np.degrees(np.arcsin(np.sqrt(np.clip(left / whole, 0.0, 1.0))))) if whole else 0.0


def _unseen(sight: Sight) -> Iterator[Effect]:
    """A trial of every cause and channel of which these logs show no trial at all."""
    bench = sight.bench
    names = [n for n in CATALOGUE if n not in _SHAPELESS and not effect_class(n).event]
    places: dict[tuple[str, str], list[Effect]] = {}
    for probe in every_probe(bench, names):
        if probe.log is None and probe.channel:
            places.setdefault((probe.name, probe.channel), []).append(probe)
    for probes in places.values():
        middle = len(probes) // 2
        ordered = [probes[middle], *probes[:middle], *probes[middle + 1 :]]
        if not any(_visible(sight, probe) for probe in ordered):
            yield ordered[0]


def _visible(sight: Sight, probe: Effect) -> bool:
    changes = displaced(sight.bench, probe)
    if not changes:
        return False
    present = sight.present([changes])
    left = sight.reduced([present], 1)
    return any(left[o][0, 0] > DEGENERATE * present[o].whole[0] for o in changes)
