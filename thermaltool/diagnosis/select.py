"""Selection of candidates: the catalogue scored in one pass of linear algebra, the best fitted.

At a trial size every cause has a signature; its inner products with the residual and with itself,
prewhitened and with the model's own parameters projected out, give the evidence that a fit of its
amplitude would have (score test). Only what survives is fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from thermaltool.diagnosis.assumptions import STARTS, Assumptions, is_plainer, released, started
from thermaltool.diagnosis.evidence import DECISIVE_EVIDENCE
from thermaltool.diagnosis.fit import (
    CauseCandidate,
    SignatureTable,
    evaluate,
    score,
    signatures_of,
)
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.shortlist import MIN_EVIDENCE, shortlist
from thermaltool.effects import CATALOGUE, effect_class
from thermaltool.effects.effect import Effect, Float

Progress = Callable[[str], None]

# Value of a search for what no machine has: it can be subtracted.
IMPLAUSIBLE = 1e300
# First step of a search: of a logarithm, and relative to the distance from neutral; the instant of
# an accident moves by this part of a log, half of what lies between two trials.
LOG_STEP, RELATIVE_STEP, PARTS_OF_A_LOG = 0.3, 0.2, 96
# Steps to either side at which a change of a drive is tried first: two trials far.
INSTANTS_BESIDE = 16
# ... and a place by no more than this share of what its channel goes through.
RANGE_STEP = 0.1
# Where a search ends: steps relative to the first one, log likelihood, trials for each parameter.
RELATIVE_TOLERANCE, GAIN_TOLERANCE, MAX_TRIALS = 1e-3, 0.05, 30
# A time constant is no shorter than this part of a sample period.
MIN_PERIODS = 0.05
# A displacement is scaled to no less and no more of its trial size.
MIN_SCALE, MAX_SCALE = 0.1, 5.0
# A cause with this part of the evidence that free parameters of the model's own have says nearly
# all that they do.
NEARLY = 0.9


@dataclass(frozen=True)
class Ranking:
    """Candidates under a hypothesis.

    Attributes
    ----------
    scanned : list of CauseCandidate
        The whole catalogue, the strongest first.
    fitted : list of CauseCandidate
        The best few of them, the strongest first.
    correction : float
        Evidence that the number of places tried takes away.
    alone : mapping of assumptions to float
        Evidence of what the model may say for itself, without a cause; the worthless left out.
    """

    scanned: list[CauseCandidate]
    fitted: list[CauseCandidate]
    correction: float
    alone: dict[Assumptions, float]

    def beyond(self, candidate: CauseCandidate) -> float:
        """Evidence of a candidate beyond that of its assumptions."""
        return candidate.evidence - self.alone[candidate.assumptions]

    def better_assumptions(self) -> Assumptions | None:
        """Those under which the model itself has decisively more to say than any cause.

        None where a cause beside a plainer start, or none, says decisively more than a start: any
        start follows what is slow. None, too, where a cause says nearly all that the model says
        whose own parameters are free: of two that explain a log alike it is the one with a name.
        """
        best = max(self.alone, key=lambda a: self.alone[a])
        named = (c.evidence for c in self.fitted if "released" not in c.assumptions)
        if "released" in best and max(named, default=0.0) > NEARLY * self.alone[best]:
            return None
        strongest = max((self.beyond(c) for c in self.fitted), default=-np.inf)
        plainer = max(
            (c.evidence for c in self.fitted if is_plainer(c.assumptions, best)), default=0
        )
        if plainer > self.alone[best] + DECISIVE_EVIDENCE:
            return None
        return best if self.alone[best] > max(DECISIVE_EVIDENCE, strongest) else None

    def own_start(self, present: Assumptions) -> Assumptions | None:
        """The present assumptions with the likeliest start, where the log asks for one decisively.

        Parameters
        ----------
        present : frozenset of str
        """
        ways = {way: self.alone.get(way, -np.inf) for way in started(present)}
        best = max(ways, key=lambda way: ways[way], default=None)
        return best if best is not None and ways[best] > DECISIVE_EVIDENCE else None

    def strong(self, least: float) -> list[CauseCandidate]:
        """Those with more evidence, the strongest first.

        Parameters
        ----------
        least : float
        """
        return [c for c in self.fitted if self.beyond(c) > least]


def ranked(
    hypothesis: Hypothesis,
    unseen: Collection[tuple[str, str]],
    progress: Progress = lambda message: None,
) -> Ranking:
    """The catalogue scored, and the best few candidates fitted.

    Parameters
    ----------
    hypothesis : Hypothesis
    unseen : collection of (name, channel)
        Causes that the logs cannot show: what they cannot show they cannot confirm either.
    progress : callable
    """
    present = hypothesis.assumptions
    ways = {w for each in hypothesis.nuisance.values() for w, there in each.starts.items() if there}
    possible = [present, *(a for a in started(present) if a & STARTS <= ways)]
    if "tight" in present:
        possible.append(released(present))
    # What the model may say for itself counts where these logs ask for it.
    alone = {a: hypothesis.evidence_of(a) for a in possible}
    alone = {a: evidence for a, evidence in alone.items() if evidence > MIN_EVIDENCE}
    scanned = scan(hypothesis, list(alone), progress)
    # Where held-out levels decide, the number of trials is no matter of the evidence.
    places = max(len({c.place for c in scanned}), 1)
    correction = 0.0 if "white" in present else 2 * float(np.log(places))
    seen = [c for c in scanned if (c.effect.name, c.effect.channel) not in unseen]
    short = shortlist(seen, alone)
    fitted = []
    for k, candidate in enumerate(short):
        progress(f"fitting {candidate.effect.name} ({k + 1} of {len(short)})")
        fitted.append(_refined(hypothesis, candidate))
        if candidate.assumptions != present:
            # Far from its trial size a cause may need no other change of the model.
            fitted.append(_refined(hypothesis, replace(candidate, assumptions=present)))
    fitted = [replace(c, evidence=c.evidence - correction) for c in fitted]
    fitted.sort(key=lambda c: -(c.evidence - DECISIVE_EVIDENCE * (c.assumptions != present)))
    return Ranking(scanned, fitted, correction, alone)


def trials(hypothesis: Hypothesis, names: Iterable[str] = CATALOGUE) -> Iterator[Effect]:
    """Trial sizes of every cause that has not been accepted; what a model comes with may change.

    Parameters
    ----------
    hypothesis : Hypothesis
    names : iterable of str
        Of the catalogue.
    """
    accepted = [e for e in hypothesis.model.effects if e not in hypothesis.calibrated.effects]
    present = {(e.name, e.channel, e.log) for e in accepted if not e.event}
    for name in names:
        for trial in effect_class(name).probes(hypothesis.scene):
            if (trial.name, trial.channel, trial.log) not in present:
                yield trial


# ---------------------------------------------------------------- the whole catalogue


def scan(
    hypothesis: Hypothesis,
    assumptions: Sequence[Assumptions],
    progress: Progress = lambda message: None,
) -> list[CauseCandidate]:
    """Evidence of every trial of the catalogue, the strongest first.

    Each trial by its best assumptions, which are the present ones unless others are decisively
    better, and then by the present ones, too: a model that is free, or a start, may explain more
    than any trial, and less than the fit beside one.

    Parameters
    ----------
    hypothesis : Hypothesis
    assumptions : sequence of frozenset of str
        The present ones among them.
    progress : callable
    """
    found = []
    every = list(trials(hypothesis))
    for k, trial in enumerate(every):
        progress(f"signatures, {trial.name} ({k + 1} of {len(every)})")
        signatures = signatures_of(hypothesis, trial)
        if signatures:
            found.append((trial, signatures))
    progress("scores")
    table = SignatureTable.of(hypothesis, [s for _, s in found], assumptions)
    candidates = []
    for k, (trial, signatures) in enumerate(found):
        scored = [
            score(hypothesis, trial, list(signatures), table.of_trial(k, s), s)
            for s in assumptions
            if _promises(hypothesis, table, k, trial, s)
        ]
        if scored:
            best = max(
                scored,
                key=lambda c: (
                    c.evidence - DECISIVE_EVIDENCE * (c.assumptions != hypothesis.assumptions)
                ),
            )
            candidates += [
                c for c in scored if c is best or c.assumptions == hypothesis.assumptions
            ]
    return sorted(candidates, key=lambda c: -c.evidence)


def _promises(
    hypothesis: Hypothesis, table: SignatureTable, k: int, trial: Effect, assumptions: Assumptions
) -> bool:
    """Whether a trial could have evidence at all, every output explained on its own."""
    if STARTS & assumptions and trial.begins_at_rest(hypothesis.scene):
        return False
    gain = 0.5 * hypothesis.evidence_of(assumptions)
    for output, index in table.index[k].items():
        if len(index) > 1:
            return True
        gain += max(float(table.projected[output, assumptions].largest_rise[index[0]]), 0.0)
    rows = min((hypothesis.groups[o].count for o in table.index[k]), default=1)
    price = (len(trial.searched()) + 1) * float(np.log(rows))
    return 2 * gain - price > MIN_EVIDENCE


# ---------------------------------------------------------------- one of them fitted


def fit_candidate(hypothesis: Hypothesis, candidate: CauseCandidate) -> CauseCandidate:
    """Search what is not linear in a cause from where the scan left it.

    Parameters
    ----------
    hypothesis : Hypothesis
    candidate : CauseCandidate
        Its assumptions are those of the fit.
    """
    effect = candidate.effect
    names = effect.searched()
    if not names:
        return evaluate(hypothesis, effect, candidate.assumptions)
    start = effect
    if "" in candidate.amplitudes:
        # A displacement at a trial size, scaled by its amplitude: that much of the way.
        start = _scaled(effect, candidate.amplitudes[""])
    start = _best_instant(hypothesis, start, candidate.assumptions)
    x0, sizes = [], []
    for name in names:
        known, value = effect.parameter(name), start.parameters[name]
        value = float(np.clip(value, known.low, known.high))
        x0.append(np.log(value) if known.log else value)
        sizes.append(LOG_STEP if known.log else _first_step(hypothesis, effect, name))
    simplex = np.vstack([x0, np.array(x0) + np.diag(sizes)])
    seen: dict[tuple[float, ...], CauseCandidate] = {}

    def at(point: Float) -> Effect:
        values = {}
        for name, x in zip(names, point.tolist(), strict=True):
            known = effect.parameter(name)
            value = float(np.exp(x)) if known.log else x
            if known.log and known.unit == "s":
                # Faster than the samples is as fast as can be.
                value = max(value, MIN_PERIODS * min(log.period for log in hypothesis.logs))
            values[name] = float(np.clip(value, known.low, known.high))
        return effect.changed(values)

    def objective(point: Float) -> float:
        trial = at(point)
        key = tuple(trial.parameters[n] for n in names)
        if key not in seen:
            seen[key] = evaluate(hypothesis, trial, candidate.assumptions)
        return min(-seen[key].gain, IMPLAUSIBLE)

    minimize(
        objective,
        np.array(x0),
        method="Nelder-Mead",
        options={
            "initial_simplex": simplex,
            "xatol": RELATIVE_TOLERANCE * min(abs(s) for s in sizes),
            "fatol": GAIN_TOLERANCE,
            "maxfev": MAX_TRIALS * len(names),
        },
    )
    return max(seen.values(), key=lambda c: c.gain)


def _refined(hypothesis: Hypothesis, candidate: CauseCandidate) -> CauseCandidate:
    """A candidate fitted; with one more parameter where that has decisively more evidence."""
    found = fit_candidate(hypothesis, candidate)
    finer = found.effect.finer()
    # Gains that are free are scaled by themselves.
    if finer is None or "released" in found.assumptions:
        return found
    again = fit_candidate(hypothesis, CauseCandidate.unfitted(finer, found.assumptions))
    return again if again.evidence > found.evidence + DECISIVE_EVIDENCE else found


def _best_instant(hypothesis: Hypothesis, start: Effect, assumptions: Assumptions) -> Effect:
    """A change of a drive at the best instant around; while the drive is off all are as good."""
    if not start.event or start.side != "drive":
        return start
    (name,) = start.searched()
    step = _first_step(hypothesis, start, name)
    around = [
        start.changed({name: start.parameters[name] + k * step})
        for k in range(-INSTANTS_BESIDE, INSTANTS_BESIDE + 1)
    ]
    return max(around, key=lambda each: evaluate(hypothesis, each, assumptions).gain)


def _scaled(effect: Effect, amplitude: float) -> Effect:
    """A purely searched effect moved from neutral by `amplitude` of its trial size."""
    values = {}
    scale = float(np.clip(amplitude, MIN_SCALE, MAX_SCALE))
    for name in effect.searched():
        known = effect.parameter(name)
        value = effect.parameters[name]
        if known.place:
            continue
        if known.log and known.neutral > 0:
            values[name] = float(known.neutral * (value / known.neutral) ** scale)
        else:
            values[name] = known.neutral + scale * (value - known.neutral)
    return effect.changed(values)


def _first_step(hypothesis: Hypothesis, effect: Effect, name: str) -> float:
    """First step of a search of a parameter that is not searched by its logarithm."""
    known, value = effect.parameter(name), effect.parameters[name]
    if known.unit == "s" and effect.log is not None:
        return hypothesis.simulation.duration_of(effect) / PARTS_OF_A_LOG
    step = RELATIVE_STEP * (abs(value - known.neutral) or 1.0)
    if not known.place:
        return step
    spans = [
        float(np.nanmax(values) - np.nanmin(values))
        for log in hypothesis.logs
        if (values := log.columns.get(effect.channel)) is not None and np.isfinite(values).any()
    ]
    return min(step, RANGE_STEP * max(spans)) if max(spans, default=0.0) > 0 else step
