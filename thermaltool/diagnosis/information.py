"""Information: what logs, and inputs that nobody has run yet, can show of a cause.

Every log gives, for each output, the normal matrix of [signatures, what logs share] under the noise
of that output; what belongs to one log alone (its offset, its start) is eliminated from it. Normal
matrices of several logs add up; eliminating what they share leaves the information matrix of the
signatures with everything projected out that the model may say for itself. Angles between
signatures under it say what logs can tell apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from thermaltool.diagnosis.assumptions import Assumptions
from thermaltool.diagnosis.evidence import DECISIVE_EVIDENCE, FLAT_GROUPS, NoiseLevel, NullFit
from thermaltool.diagnosis.fit import products_of, profile
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.simulation import Changes
from thermaltool.diagnosis.starts import begins_away, level_responses
from thermaltool.diagnosis.whitening import SINGULAR
from thermaltool.effects.effect import Effect, Float
from thermaltool.signals.likelihood import Factor
from thermaltool.signals.symmetric import eigh
from thermaltool.units import is_displacement

# A signature of which the model's own parameters leave less than this share of the power is theirs.
MIN_POWER_LEFT = 1e-4
# The search for a detectable size begins this far below the size of white noise alone, goes up in
# such steps and ends at such a precision, all of its logarithm.
FIRST_BELOW, STEP_UP, PRECISION = 3.0, 2.0, 1e-3


@dataclass(frozen=True)
class ReadingNoise:
    """Noise of an output: its level, and the white variance of an independent reading."""

    level: NoiseLevel
    variance: float


@dataclass(frozen=True)
class NormalMatrix:
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

    def only(self, kept: NDArray[np.bool_]) -> NormalMatrix:
        """Without those signatures that are not `kept`, ndarray of shape (k,)."""
        mask = np.append(kept, np.ones(len(self.matrix) - len(kept), bool)).astype(float)
        return NormalMatrix(self.matrix * np.outer(mask, mask), self.whole * kept)


LogInformation = dict[str, NormalMatrix]  # of one log, by output


def noise_before(hypothesis: Hypothesis, assumptions: Assumptions) -> dict[str, ReadingNoise]:
    """Noise of every output with no further cause.

    Parameters
    ----------
    hypothesis : Hypothesis
    assumptions : frozenset of str
    """
    nulls = {o: evidence.null(assumptions) for o, evidence in hypothesis.evidence.items()}
    return {
        o: ReadingNoise(
            evidence.levels[nulls[o].level], nulls[o].white ** 2 / evidence.independence
        )
        for o, evidence in hypothesis.evidence.items()
    }


def noise_after(
    hypothesis: Hypothesis, assumptions: Assumptions, caused: Changes
) -> dict[str, ReadingNoise]:
    """Noise of every output once a cause has taken its part away.

    Parameters
    ----------
    hypothesis : Hypothesis
    assumptions : frozenset of str
    caused : mapping of output to list of ndarray
        What the cause does.
    """
    found = noise_before(hypothesis, assumptions)
    products = products_of(hypothesis, {"": caused}, assumptions)
    if not products:
        return found
    after = profile(list(products.values()), 1, np.ones(1))
    for (output, each), g in zip(products.items(), after.levels, strict=True):
        evidence = hypothesis.evidence[output]
        variance = each.variance(np.ones(1), g) / evidence.independence
        found[output] = ReadingNoise(evidence.levels[g], variance)
    return found


class InformationMatrix:
    """Information of a hypothesis's logs on signatures, and of experiments beside them.

    Parameters
    ----------
    hypothesis : Hypothesis
    assumptions : frozenset of str
        Nuisance in use. Where the model's own parameters are released they are quite free.
    noise : mapping of output to ReadingNoise, optional
        That with no further cause by default.
    """

    def __init__(
        self,
        hypothesis: Hypothesis,
        assumptions: Assumptions,
        noise: Mapping[str, ReadingNoise] | None = None,
    ) -> None:
        self.hypothesis, self.assumptions = hypothesis, assumptions
        self.noise = noise or noise_before(hypothesis, assumptions)
        self.group = "released" if "released" in assumptions else "tight"
        simulation = hypothesis.simulation
        starts = level_responses(simulation) if begins_away(simulation) else []
        self._private, self._shared, self._prior = {}, {}, {}
        for output, evidence in hypothesis.evidence.items():
            names = np.array(evidence.names)
            columns = evidence.columns[:, 1:]
            own = [n for n in names if n in assumptions and n != self.group]
            begun = [evidence.groups.means(s[output]) for s in starts]
            block = columns[:, np.isin(names, list(assumptions - {self.group}))]
            self._private[output] = (
                np.column_stack([block, *begun]),
                np.array([*(float(n not in FLAT_GROUPS) for n in own), *(0.0 for _ in begun)]),
            )
            self._shared[output] = columns[:, names == self.group]
            prior = np.ones(self._shared[output].shape[1])
            if self.group == "released":
                prior[: len(hypothesis.nuisance[output].own)] = 0.0
            self._prior[output] = prior

    def of_logs(self, signatures: Sequence[Changes]) -> LogInformation:
        """What the logs show of signatures.

        Parameters
        ----------
        signatures : sequence of mapping of output to list of ndarray
        """
        result = {}
        for output, evidence in self.hypothesis.evidence.items():
            noise = self.noise[output]
            blank = np.zeros(evidence.groups.size)
            columns = [
                evidence.groups.means(s[output]) if output in s else blank for s in signatures
            ]
            private, prior = self._private[output]
            result[output] = normal_matrix(
                columns, self._shared[output], private, prior, noise.level.factor, noise.variance
            )
        return result

    def of_signatures(self, logs: Sequence[LogInformation], count: int) -> dict[str, Float]:
        """Information matrix of the first `count` signatures in each output, (count, count).

        Parameters
        ----------
        logs : sequence of mapping of output to NormalMatrix
        count : int
        """
        result = {}
        for output, prior in self._prior.items():
            total = np.sum([log[output].matrix for log in logs if output in log], axis=0)
            total = total + np.diag(np.append(np.zeros(count), prior))
            result[output] = eliminated(total, count)
        return result

    def joint(self, logs: Sequence[LogInformation], count: int) -> Float:
        """Information matrix of the first `count` signatures, all outputs together."""
        return np.asarray(np.sum(list(self.of_signatures(logs, count).values()), axis=0))

    def angle(self, logs: Sequence[LogInformation], count: int) -> float:
        """Angle between the first of `count` signatures and the others, all outputs [deg]."""
        return angle(self.joint(logs, count))

    def angle_to_model(self, logs: LogInformation, more: LogInformation | None = None) -> float:
        """Angle between one signature and what the model may say for itself [deg].

        Parameters
        ----------
        logs : mapping of output to NormalMatrix
        more : mapping of output to NormalMatrix, optional
            An experiment: the angle that it shows beside the logs.
        """
        together = [logs] if more is None else [logs, more]
        left, before = (
            sum(float(v[0, 0]) for v in self.of_signatures(each, 1).values())
            for each in (together, [logs])
        )
        whole = sum(float(block.whole[0]) for block in together[-1].values())
        left -= 0.0 if more is None else before
        return _arcsine(left / whole) if whole else 0.0

    def shows(self, changes: Changes) -> bool:
        """Whether the model's own parameters leave anything of a signature, given by output."""
        present = self.of_logs([changes])
        left = self.of_signatures([present], 1)
        return any(left[o][0, 0] > MIN_POWER_LEFT * present[o].whole[0] for o in changes)


# ---------------------------------------------------------------- linear algebra


def angle(products: Float) -> float:
    """Angle between the first of some vectors and the span of the others [deg].

    Parameters
    ----------
    products : ndarray, shape (k, k)
        Their inner products.
    """
    if not products[0, 0] > 0:
        return 0.0
    return _arcsine(eliminated(products, 1)[0, 0] / products[0, 0])


def _arcsine(power: float) -> float:
    """Angle whose sine has this square [deg]."""
    return float(np.degrees(np.arcsin(np.sqrt(np.clip(power, 0.0, 1.0)))))


def eliminated(matrix: Float, keep: int) -> Float:
    """A normal matrix with all but the first `keep` unknowns eliminated (Schur complement).

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
    keep : int
    """
    head, cross, tail = matrix[:keep, :keep], matrix[:keep, keep:], matrix[keep:, keep:]
    size = np.sqrt(np.maximum(np.diag(tail), 0.0))
    used = size > 0
    if not used.any():
        return head
    scaled = tail[np.ix_(used, used)] / np.outer(size[used], size[used])
    values, vectors = eigh(scaled)
    kept = values > SINGULAR * len(values)
    through = (cross[:, used] / size[used]) @ vectors[:, kept] / np.sqrt(values[kept])
    return np.asarray(head - through @ through.T)


def normal_matrix(
    signatures: Sequence[Float],
    shared: Float,
    private: Float,
    prior: Float,
    factor: Factor,
    variance: float,
) -> NormalMatrix:
    """Normal matrix of one output in one log, what belongs to that log alone eliminated.

    Parameters
    ----------
    signatures : sequence of k ndarray, shape (n,)
    shared : ndarray, shape (n, p)
        Sensitivities to what logs share.
    private : ndarray, shape (n, q)
        Sensitivities to what belongs to this log alone.
    prior : ndarray, shape (q,)
        Precision of what is private.
    factor : Factor
        Covariance of the noise, in units of the white variance.
    variance : float [squared unit of the channel]
        White variance.
    """
    columns = np.column_stack([*signatures, shared, private])
    matrix = columns.T @ factor.solve(columns) / variance
    keep = len(signatures) + shared.shape[1]
    whole = np.diag(matrix)[: len(signatures)].copy()
    inside = np.arange(keep, len(matrix))
    matrix[inside, inside] += prior
    return NormalMatrix(eliminated(matrix, keep), whole)


# ---------------------------------------------------------------- how large a cause would be seen


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
    information: InformationMatrix, effect: Effect, correction: float = 0.0
) -> Detectable | None:
    """Size from which a cause would be seen in these logs, the residual unseen.

    Parameters
    ----------
    information : InformationMatrix
    effect : Effect
        At a trial size; its amplitudes are scaled.
    correction : float
        Evidence that the number of causes tried takes away.

    Returns
    -------
    Detectable or None
        None where the model's own parameters can do all that the cause does.
    """
    hypothesis, groups = information.hypothesis, information.hypothesis.groups
    vectors = [c for c in hypothesis.simulation.signatures(effect).values() if c]
    if not vectors:
        return None
    present = information.of_logs(vectors)
    left = information.of_signatures([present], len(vectors))
    best: tuple[float, Detectable] | None = None
    for k, changes in enumerate(vectors):
        seen = [o for o in changes if left[o][k, k] > MIN_POWER_LEFT * present[o].whole[k]]
        if not seen:
            continue
        rows = sum(hypothesis.evidence[o].independence * groups[o].count for o in changes)
        unknown = 1 + len(effect.searched())
        needed = DECISIVE_EVIDENCE + correction + unknown * float(np.log(rows))
        needed -= 2 * float(np.log(effect.odds))
        amplitude = _amplitude_for(
            hypothesis, information.assumptions, {o: changes[o] for o in seen}, needed
        )
        sizes = {o: amplitude * _rms(hypothesis, o, changes) for o in seen}
        relative = {o: sizes[o] / float(np.sqrt(information.noise[o].variance)) for o in seen}
        output = max(seen, key=lambda o: relative[o])
        if best is None or relative[output] < best[0]:
            share = float(np.sqrt(left[output][k, k] / present[output].whole[k]))
            best = relative[output], Detectable(sizes[output], output, min(share, 1.0))
    return None if best is None else best[1]


def _amplitude_for(
    hypothesis: Hypothesis, assumptions: Assumptions, changes: Changes, needed: float
) -> float:
    """The amplitude at which a cause is expected to have `needed` evidence.

    Without the cause, the slow discrepancy takes what it can of the change, at any level.
    """
    known: list[tuple[float, NullFit, Float]] = []
    for output, series in changes.items():
        evidence = hypothesis.evidence[output]
        column = evidence.groups.means(series)[:, None]
        projected = evidence.projected(assumptions, evidence.products(column, [[0]]))
        known.append((evidence.independence, projected.null, projected.own[:, 0]))

    def beyond(log: float) -> float:
        squares = [null.square + np.exp(2 * log) * own for _, null, own in known]
        gains = [
            independence * (float(np.min(null.negative_log(square))) - null.best)
            for (independence, null, _), square in zip(known, squares, strict=True)
        ]
        return 2 * sum(gains) - needed

    size = max(float(own[null.level]) / null.white**2 for _, null, own in known)
    low = 0.5 * float(np.log(needed / len(known) / size)) - FIRST_BELOW
    high = low
    while beyond(high) < 0:
        high += STEP_UP
    return float(np.exp(brentq(beyond, min(low, high - STEP_UP), high, xtol=PRECISION)))


def _rms(hypothesis: Hypothesis, output: str, changes: Changes) -> float:
    """RMS change; of a displacement, whose zero is arbitrary, about its mean."""
    change = hypothesis.groups[output].joined(changes[output])
    if is_displacement(output):
        change = change - np.mean(change)
    return float(np.sqrt(np.mean(change**2)))
