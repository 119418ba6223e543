"""What logs and inputs that nobody has run yet show of signatures beside the model itself.

Every log gives, for each output, the normal matrix of [signatures, what logs share] under the noise
of that output; what belongs to one log alone (its offset, its start) is eliminated from it. Normal
matrices of several logs add up; eliminating what they share leaves the inner products of the
signatures with everything projected out that the model may say for itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thermaltool.diagnosis.evidence import FLAT, SINGULAR, Level, State
from thermaltool.diagnosis.experiments import Experiment, away_from_rest
from thermaltool.diagnosis.profile import profile
from thermaltool.diagnosis.workbench import Series, Workbench
from thermaltool.effects.effect import Effect, Float
from thermaltool.model import respond
from thermaltool.record import Record
from thermaltool.signals.likelihood import ColouredNoise, Factor

Changes = Mapping[str, Series]


@dataclass(frozen=True)
class Noise:
    """Of an output: its level, and the white variance of an independent reading."""

    level: Level
    variance: float


@dataclass(frozen=True)
class Block:
    """One output in one log, in units of its noise.

    Attributes
    ----------
    matrix : ndarray, shape (k + p, k + p)
        Inner products of the signatures and of what logs share.
    whole : ndarray, shape (k,)
        Squares of the signatures with nothing projected out.
    """

    matrix: Float
    whole: Float

    def only(self, kept: NDArray[np.bool_]) -> Block:
        """Without those signatures that are not `kept`, ndarray (k,)."""
        mask = np.append(kept, np.ones(len(self.matrix) - len(kept), bool)).astype(float)
        return Block(self.matrix * np.outer(mask, mask), self.whole * kept)


Normal = dict[str, Block]  # of one log


def noise_before(bench: Workbench, state: State) -> dict[str, Noise]:
    """Noise of every output with no further cause."""
    found = {}
    for output, evidence in bench.evidence.items():
        base = evidence.base(state)
        found[output] = Noise(evidence.levels[base.level], base.white**2 / evidence.share)
    return found


def noise_after(bench: Workbench, state: State, caused: Changes) -> dict[str, Noise]:
    """Noise of every output once a cause has taken its part away."""
    found = noise_before(bench, state)
    parts, _, outputs = bench.reduce({"": caused}, state)
    if not parts:
        return found
    after = profile(parts, 1, np.ones(1))
    for output, part, g in zip(outputs, parts, after.levels, strict=True):
        square = float(part.base.square[g] - 2 * part.b[g].sum() + part.C[g].sum())
        evidence = bench.evidence[output]
        variance = max(square, part.base.least) / part.base.dof / evidence.share
        found[output] = Noise(evidence.levels[g], variance)
    return found


class Sight:
    """Logs of a workbench as seen by signatures, and experiments beside them.

    Parameters
    ----------
    bench : Workbench
        With its evidence.
    state : frozenset of str
        Nuisance in use. Where the model's own parameters are released they are quite free.
    noise : mapping of output to Noise
    """

    def __init__(self, bench: Workbench, state: State, noise: Mapping[str, Noise]) -> None:
        self.bench, self.state, self.noise = bench, state, noise
        self.group = "released" if "released" in state else "tight"
        self.private, self.shared, self.prior = {}, {}, {}
        starts = _starts(bench) if away_from_rest(bench) else []
        for output, evidence in bench.evidence.items():
            names = np.array(evidence.names)
            columns = evidence.columns[:, 1:]
            own = [n for n in names if n in state and n != self.group]
            begun = [evidence.observed.gather(s[output]) for s in starts]
            block = columns[:, np.isin(names, list(state - {self.group}))]
            self.private[output] = (
                np.column_stack([block, *begun]),
                np.array([*(float(n not in FLAT) for n in own), *(0.0 for _ in begun)]),
            )
            self.shared[output] = columns[:, names == self.group]
            prior = np.ones(self.shared[output].shape[1])
            if self.group == "released":
                prior[: len(bench.own(output))] = 0.0
            self.prior[output] = prior

    def present(self, signatures: Sequence[Changes]) -> Normal:
        """The logs of the workbench."""
        result = {}
        for output, evidence in self.bench.evidence.items():
            noise = self.noise[output]
            columns = [
                evidence.observed.gather(s[output])
                if output in s
                else np.zeros(evidence.observed.size)
                for s in signatures
            ]
            result[output] = _normal(
                columns,
                self.shared[output],
                *self.private[output],
                noise.level.factor,
                noise.variance,
            )
        return result

    def reduced(self, logs: Sequence[Normal], count: int) -> dict[str, Float]:
        """Inner products of `count` signatures in each output, shape (count, count)."""
        result = {}
        for output, prior in self.prior.items():
            total = np.sum([log[output].matrix for log in logs if output in log], axis=0)
            total = total + np.diag(np.append(np.zeros(count), prior))
            result[output] = eliminated(total, count)
        return result


class Rehearsal:
    """Experiments on the model of a sight, all at once.

    Parameters
    ----------
    sight : Sight
    experiments : sequence of Experiment
    outputs : iterable of str
        Outputs that the causes in question reach.
    """

    def __init__(
        self, sight: Sight, experiments: Sequence[Experiment], outputs: Iterable[str]
    ) -> None:
        self.sight, self.experiments = sight, experiments
        old = sight.bench
        logs = [each.signals for each in experiments]
        self.bench = Workbench(old.model, logs, old.calibrated, {}, old.state)
        starts = _starts(self.bench) if away_from_rest(old) else []
        self.shared: dict[str, Series] = {}
        self.private: dict[str, Series] = {}
        self.factors: list[dict[str, Factor]] = []
        for output in outputs:
            root = old.prior(output, sight.group == "released").root
            own = self.bench.movements(output)
            free = [*self.bench.offsets(), *self.bench.accepted(output).values()]
            free += [start[output] for start in starts]
            self.shared[output] = [each.means(own[k]) @ root for k, each in enumerate(experiments)]
            self.private[output] = [
                each.means(np.column_stack([c[k] for c in free]))
                for k, each in enumerate(experiments)
            ]
        for each in experiments:
            white = 1 / (each.readings * each.counts)
            noise = ColouredNoise(each.means(each.signals.time), np.array([0]), white)
            self.factors.append(
                {o: noise.factor(n.level.ratio, n.level.tau) for o, n in sight.noise.items()}
            )

    def normals(self, signatures: Sequence[Changes]) -> list[Normal]:
        """One for each experiment."""
        result = []
        for k, each in enumerate(self.experiments):
            blank = np.zeros(len(each.counts))
            normal = {}
            for output in self.shared:
                columns = [each.means(s[output][k]) if output in s else blank for s in signatures]
                private = self.private[output][k]
                private = private[:, np.any(private, axis=0)]
                normal[output] = _normal(
                    columns,
                    self.shared[output][k],
                    private,
                    np.zeros(private.shape[1]),
                    self.factors[k][output],
                    self.sight.noise[output].variance,
                )
            result.append(normal)
        return result


def displaced(bench: Workbench, effect: Effect) -> dict[str, Series]:
    """Change of every output by a cause as it stands."""
    changed = bench.with_effects(effect)
    found = {}
    for output in bench.observed:
        series = [n[output] - o[output] for n, o in zip(changed, bench.outputs, strict=True)]
        if any(np.any(s) for s in series):
            found[output] = series
    return found


def reachable(bench: Workbench, effect: Effect) -> list[dict[str, Series]]:
    """Changes by each amplitude of a cause, and by a small move of what is not linear in it."""
    found = list(bench.signatures(effect).values())
    # An instant that was found by scanning has no slope.
    searched = () if effect.event else effect.searched()
    if (effect.linear() and searched) or len(searched) > 1:
        here = bench.with_effects(effect)
        for name in searched:
            known, value = effect.parameter(name), effect.parameters[name]
            step = 0.02 * (abs(value) if known.log else abs(value - known.neutral) or 1.0)
            step = step if value + step <= known.high else -step
            there = bench.with_effects(effect.changed({name: value + step}))
            found.append(
                {
                    o: [(t[o] - h[o]) / step for t, h in zip(there, here, strict=True)]
                    for o in bench.observed
                }
            )
    return found


def angle(products: Float) -> float:
    """Between the first of some vectors and the span of the others, from inner products [deg]."""
    if not products[0, 0] > 0:
        return 0.0
    left = eliminated(products, 1)[0, 0] / products[0, 0]
    return float(np.degrees(np.arcsin(np.sqrt(np.clip(left, 0.0, 1.0)))))


def eliminated(matrix: Float, keep: int) -> Float:
    """A normal matrix with all but the first `keep` unknowns eliminated."""
    head, cross, tail = matrix[:keep, :keep], matrix[:keep, keep:], matrix[keep:, keep:]
    size = np.sqrt(np.maximum(np.diag(tail), 0.0))
    used = size > 0
    if not used.any():
        return head
    scaled = tail[np.ix_(used, used)] / np.outer(size[used], size[used])
    values, vectors = np.linalg.eigh(scaled)
    kept = values > SINGULAR * len(values)
    through = (cross[:, used] / size[used]) @ vectors[:, kept] / np.sqrt(values[kept])
    return np.asarray(head - through @ through.T)


def _normal(
    signatures: Sequence[Float],
    shared: Float,
    private: Float,
    prior: Float,
    factor: Factor,
    variance: float,
) -> Block:
    columns = np.column_stack([*signatures, shared, private])
    matrix = columns.T @ factor.solve(columns) / variance
    keep = len(signatures) + shared.shape[1]
    whole = np.diag(matrix)[: len(signatures)].copy()
    inside = np.arange(keep, len(matrix))
    matrix[inside, inside] += prior
    return Block(eliminated(matrix, keep), whole)


def _starts(bench: Workbench) -> list[dict[str, Series]]:
    """Responses to the level of each drive with which each log begins.

    How a machine came to be where a log begins with a drive on, nobody knows: what it would do
    from rest under that level tells nothing.
    """
    found = []
    bare = replace(bench.model, effects=())
    rest = {d.channel: 0.0 if d.reference == "first" else d.reference for d in bare.drives}
    for k, log in enumerate(bench.logs):
        for channel in rest:
            if bench.inputs[k][channel][0] == 0:
                continue
            columns = {c: np.full(len(log.time), r + (c == channel)) for c, r in rest.items()}
            response = respond(bare, (), Record(log.time, columns))
            found.append(
                {
                    o: [y if j == k else np.zeros(len(g.time)) for j, g in enumerate(bench.logs)]
                    for o, y in response.items()
                }
            )
    return found
