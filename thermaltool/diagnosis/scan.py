"""The whole catalogue against one residual in one linear-algebra pass, and the best ones refined.

At a trial size every cause has a signature; its inner products with the residual and with itself,
prewhitened and with the model's own parameters projected out, give the evidence that a fit of its
amplitude would have (score test). Only what survives is refitted.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from thermaltool.diagnosis.evidence import DECISIVE, State
from thermaltool.diagnosis.profile import Part, Profile, profile
from thermaltool.diagnosis.workbench import Progress, Series, Workbench
from thermaltool.effects import CATALOGUE, effect_class
from thermaltool.effects.effect import Effect, Float, reference_of
from thermaltool.errors import ModelError

# Trials that promise less evidence than this are not fitted.
LEAST = -10.0
# Of a search: a value for what no machine has, that can be subtracted.
IMPLAUSIBLE = 1e300
# First step of a search, of a logarithm.
STEP = 0.3


@dataclass(frozen=True)
class Candidate:
    """A cause at one place, with amplitudes fitted by the score.

    Attributes
    ----------
    effect : Effect
    evidence : float
        Fall of BIC.
    gain : float
        Rise of the log likelihood.
    state : frozenset of str
        Nuisance that was in use.
    amplitudes : mapping of str to float
        Departures from neutral of the linear parameters; of ``""``, the share of a displacement.
    """

    effect: Effect
    evidence: float
    gain: float
    state: State
    amplitudes: Mapping[str, float]

    @property
    def said(self) -> float:
        """Evidence of the logs alone, however common the cause may be."""
        return self.evidence - 2 * float(np.log(self.effect.odds))

    @property
    def place(self) -> tuple[str, str, str | None]:
        return self.effect.name, self.effect.channel, self.effect.log

    @property
    def form(self) -> tuple[str, str, str | None, frozenset[str]]:
        """The place, and which of its parameters the cause uses there."""
        names = (reference_of(name)[0] for name in self.effect.parameters)
        return *self.place, frozenset(names)


def every_probe(bench: Workbench, names: Iterable[str] = CATALOGUE) -> Iterator[Effect]:
    """All trials of the catalogue on this workbench."""
    scene = bench.scene()
    present = {(e.name, e.channel, e.log) for e in bench.model.effects if not e.event}
    for name in names:
        for probe in effect_class(name).probes(scene):
            if (probe.name, probe.channel, probe.log) not in present:
                yield probe


@dataclass(frozen=True)
class Signature:
    """A trial with its signatures, by amplitude and output."""

    probe: Effect
    found: Mapping[str, Mapping[str, Series]]


def scan(
    bench: Workbench, states: Sequence[State], progress: Progress = lambda message: None
) -> list[Candidate]:
    """Evidence of every trial of the catalogue, each at its best state, the strongest first."""
    signatures = []
    for probe in every_probe(bench):
        progress(f"signatures, {probe.name}")
        found = _signatures(bench, probe)
        if found:
            signatures.append(Signature(probe, found))
    progress("scores")
    prepared = _Prepared(bench, signatures, states)
    candidates = []
    for k in range(len(signatures)):
        trials = [prepared.candidate(k, s) for s in states if prepared.promises(k, s)]
        if trials:
            # The present state, unless another one is decisively better.
            candidates.append(
                max(trials, key=lambda c: c.evidence - DECISIVE * (c.state != bench.state))
            )
    return sorted(candidates, key=lambda c: -c.evidence)


def _signatures(bench: Workbench, probe: Effect) -> dict[str, dict[str, Series]]:
    """Signatures by amplitude and output; none where the effect is too strong to be followed."""
    try:
        found = bench.signatures(probe)
    except ModelError:
        return {}
    return {name: outputs for name, outputs in found.items() if outputs}


class _Prepared:
    """Products of all signatures with all outputs, computed at once for each output."""

    def __init__(
        self, bench: Workbench, signatures: Sequence[Signature], states: Sequence[State]
    ) -> None:
        self.bench, self.signatures = bench, signatures
        self.index: list[dict[str, list[int]]] = [{} for _ in signatures]
        self.names: list[dict[str, list[str]]] = [{} for _ in signatures]
        self.reduced = {}
        for output, evidence in bench.evidence.items():
            columns: list[Float] = []
            groups: list[list[int]] = []
            for k, signature in enumerate(signatures):
                here = [n for n, reached in signature.found.items() if output in reached]
                if not here:
                    continue
                self.index[k][output] = list(range(len(columns), len(columns) + len(here)))
                self.names[k][output] = here
                groups.append(self.index[k][output])
                columns += [evidence.observed.gather(signature.found[n][output]) for n in here]
            if columns:
                products = evidence.products(np.column_stack(columns), groups)
                for state in states:
                    self.reduced[output, state] = evidence.reduced(state, products)

    def promises(self, k: int, state: State) -> bool:
        """Whether a trial could have evidence at all, every output explained on its own."""
        probe, gain = self.signatures[k].probe, 0.0
        for output, index in self.index[k].items():
            if len(index) > 1:
                return True
            evidence = self.bench.evidence[output]
            gain += max(float(self.reduced[output, state].most[index[0]]), 0.0)
            gain -= evidence.base(state).best - evidence.base(self.bench.state).best
        rows = min((_size(self.bench, o) for o in self.index[k]), default=1)
        price = (len(probe.searched()) + 1) * float(np.log(rows))
        return 2 * gain - price > LEAST

    def candidate(self, k: int, state: State) -> Candidate:
        probe = self.signatures[k].probe
        amplitudes = list(self.signatures[k].found)
        parts = {
            output: self.reduced[output, state].part(
                index, [amplitudes.index(n) for n in self.names[k][output]]
            )
            for output, index in self.index[k].items()
        }
        return judge(self.bench, probe, amplitudes, parts, state)


def judge(
    bench: Workbench,
    probe: Effect,
    amplitudes: list[str],
    parts: Mapping[str, Part],
    state: State,
    fixed: bool = False,
) -> Candidate:
    """Evidence of a cause from its parts; outputs that it does not reach are left out.

    `fixed`: a displacement counts as it stands, not by an amplitude of its own.
    """
    parts = dict(parts)
    while True:
        outputs = list(parts)
        given = np.ones(len(amplitudes)) if fixed and amplitudes == [""] else None
        result = profile(list(parts.values()), len(amplitudes), given)
        separate = [reference_of(name)[1] for name in amplitudes]
        rows = {o: len(p.amplitudes) for o, p in parts.items()}
        # An output with amplitudes of its own has to pay for them.
        idle = [
            o
            for o, gain in zip(outputs, result.gains, strict=True)
            if o in separate and len(parts) > 1 and 2 * gain < rows[o] * np.log(_size(bench, o))
        ]
        if not idle:
            break
        worst = min(idle, key=lambda o: result.gains[outputs.index(o)])
        gone = [n for n in amplitudes if reference_of(n)[1] == worst]
        probe, kept = probe.without(tuple(gone)), [n for n in amplitudes if n not in gone]
        parts = {
            o: Part(p.b, p.C, np.array([kept.index(amplitudes[a]) for a in p.amplitudes]), p.base)
            for o, p in parts.items()
            if o != worst
        }
        amplitudes = kept
    found = _candidate(bench, probe, amplitudes, list(parts), result, state)
    # Heat and air reach more than one place: what moves one output alone is that output's.
    alone = probe.everywhere and len(parts) < min(2, len(bench.observed))
    if alone or not found.effect.plausible(bench.scene()):
        return replace(found, evidence=-np.inf, gain=-np.inf)
    return found


def _size(bench: Workbench, output: str) -> int:
    return sum(len(rows) for rows in bench.observed[output].rows)


def _candidate(
    bench: Workbench,
    probe: Effect,
    amplitudes: list[str],
    outputs: list[str],
    result: Profile,
    state: State,
) -> Candidate:
    count = len(probe.linear()) + len(probe.searched())
    rows = sum(_size(bench, o) * bench.evidence[o].share for o in outputs)
    # States differ in what the model may say for itself: they are compared with the present one.
    gain = 0.0
    for output, own in zip(outputs, result.gains.tolist(), strict=True):
        evidence = bench.evidence[output]
        own += evidence.base(bench.state).best - evidence.base(state).best
        gain += own * evidence.share
    found = {n: float(v) for n, v in zip(amplitudes, result.amplitudes, strict=True)}
    named = {n: probe.parameter(n).neutral + v for n, v in found.items() if n}
    return Candidate(
        probe.changed(named),
        2 * gain - count * float(np.log(rows)) + 2 * float(np.log(probe.odds)),
        gain,
        state,
        found,
    )


def refine(bench: Workbench, candidate: Candidate) -> Candidate:
    """Search what is not linear in a cause from where the score left it."""
    effect, state = candidate.effect, candidate.state
    names = effect.searched()

    def at(point: Float) -> Effect:
        values = {}
        for name, x in zip(names, point.tolist(), strict=True):
            known = effect.parameter(name)
            value = float(np.exp(x)) if known.log else x
            if known.log and known.unit == "s":
                # Faster than the samples is as fast as can be.
                value = max(value, 0.05 * bench.logs[0].period)
            values[name] = float(np.clip(value, known.low, known.high))
        return effect.changed(values)

    def evaluate(trial: Effect) -> Candidate:
        found = _signatures(bench, trial)
        parts, amplitudes, outputs = bench.reduce(found, state)
        if not parts:
            return replace(candidate, effect=trial, gain=-np.inf, evidence=-np.inf)
        by_output = dict(zip(outputs, parts, strict=True))
        return judge(bench, trial, amplitudes, by_output, state, fixed=True)

    if not names:
        return evaluate(effect)
    start = effect
    if "" in candidate.amplitudes:
        # A displacement at a trial size, scaled by its amplitude: that much of the way.
        start = _scaled(effect, candidate.amplitudes[""])
    x0, sizes = [], []
    for name in names:
        known, value = effect.parameter(name), start.parameters[name]
        value = float(np.clip(value, known.low, known.high))
        x0.append(np.log(value) if known.log else value)
        sizes.append(STEP if known.log else _span(bench, effect, name))
    simplex = np.vstack([x0, np.array(x0) + np.diag(sizes)])
    seen: dict[tuple[float, ...], Candidate] = {}

    def objective(point: Float) -> float:
        trial = at(point)
        key = tuple(trial.parameters[n] for n in names)
        if key not in seen:
            seen[key] = evaluate(trial)
        return min(-seen[key].gain, IMPLAUSIBLE)

    minimize(
        objective,
        np.array(x0),
        method="Nelder-Mead",
        options={
            "initial_simplex": simplex,
            "xatol": 1e-3 * min(abs(s) for s in sizes),
            "fatol": 0.05,
            "maxfev": 30 * len(names),
        },
    )
    return max(seen.values(), key=lambda c: c.gain)


def _scaled(effect: Effect, amplitude: float) -> Effect:
    """A purely searched effect moved from neutral by `amplitude` of its trial size."""
    values = {}
    share = float(np.clip(amplitude, 0.1, 5.0))
    for name in effect.searched():
        known = effect.parameter(name)
        value = effect.parameters[name]
        if known.log and known.neutral > 0:
            values[name] = float(known.neutral * (value / known.neutral) ** share)
        else:
            values[name] = known.neutral + share * (value - known.neutral)
    return effect.changed(values)


def _span(bench: Workbench, effect: Effect, name: str) -> float:
    """First step of a search: of a time, what lies between two trials; else a fifth."""
    known, value = effect.parameter(name), effect.parameters[name]
    if known.unit == "s" and effect.log is not None:
        return max(log.duration for log in bench.logs) / 96
    return 0.2 * (abs(value - known.neutral) or 1.0)
