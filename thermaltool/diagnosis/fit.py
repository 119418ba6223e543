"""One cause: from its signature to the evidence for it.

The best amplitudes follow from inner products alone, of signatures with the residual and with each
other under every noise level, nuisance projected out; the noise of each output is estimated anew
for every candidate (profile likelihood).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.diagnosis.assumptions import Assumptions
from thermaltool.diagnosis.evidence import DECISIVE_EVIDENCE, NullFit, ProjectedProducts
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.simulation import Changes
from thermaltool.effects.effect import Effect, Float, reference_of
from thermaltool.errors import ModelError
from thermaltool.signals.row_groups import Index
from thermaltool.signals.symmetric import pseudo_inverse

Signatures = Mapping[str, Changes]  # of one trial, by amplitude

# Steps between amplitudes and noise levels, and the relative change at which they agree.
MAX_PROFILE_STEPS, PROFILE_TOLERANCE = 8, 1e-3
# Singular values of the scaled products of amplitudes that count, relative to the largest.
RELATIVE_RANK = 1e-10


@dataclass(frozen=True)
class CauseCandidate:
    """A cause at one place, with its amplitudes fitted.

    Attributes
    ----------
    effect : Effect
    evidence : float
        Fall of BIC.
    gain : float
        Rise of the log likelihood.
    assumptions : frozenset of str
        Under which it was fitted.
    amplitudes : mapping of str to float
        Departures from neutral of the linear parameters; of ``""``, the share of a displacement.
    prior : float
        Part of the evidence that is how common such a cause is, whatever the logs say.
    """

    effect: Effect
    evidence: float
    gain: float
    assumptions: Assumptions
    amplitudes: Mapping[str, float]
    prior: float = 0.0

    @staticmethod
    def unfitted(effect: Effect, assumptions: Assumptions) -> CauseCandidate:
        """An effect as it stands, from which `fit_candidate` may start."""
        return CauseCandidate(effect, 0.0, 0.0, assumptions, {})

    @property
    def evidence_of_logs(self) -> float:
        """Evidence of the logs alone, however common the cause may be."""
        return self.evidence - self.prior

    @property
    def place(self) -> tuple[str, str, str | None]:
        """Name, channel, and the only log in which it acts."""
        return self.effect.name, self.effect.channel, self.effect.log

    @property
    def form(self) -> tuple[str, str, str | None, frozenset[str]]:
        """The place, and which of its parameters the cause uses there, but for where it acts."""
        own = self.effect
        names = (reference_of(n)[0] for n in own.parameters if not own.parameter(n).place)
        return *self.place, frozenset(names)

    def has_other_form(self, other: CauseCandidate) -> bool:
        """Whether another candidate is this cause in another form, and has evidence."""
        return other.place == self.place and other.form != self.form and other.evidence > 0


def evaluate(hypothesis: Hypothesis, effect: Effect, assumptions: Assumptions) -> CauseCandidate:
    """Evidence of a cause whose searched parameters stand, from its signature.

    Parameters
    ----------
    hypothesis : Hypothesis
    effect : Effect
    assumptions : frozenset of str
    """
    signatures = signatures_of(hypothesis, effect)
    products = products_of(hypothesis, signatures, assumptions)
    if not products:
        return CauseCandidate(effect, -np.inf, -np.inf, assumptions, {})
    return score(hypothesis, effect, list(signatures), products, assumptions, fixed=True)


def score(
    hypothesis: Hypothesis,
    effect: Effect,
    amplitudes: Sequence[str],
    products: Mapping[str, CandidateProducts],
    assumptions: Assumptions,
    fixed: bool = False,
) -> CauseCandidate:
    """Best amplitudes of a cause and their evidence; outputs that it does not reach are left out.

    Parameters
    ----------
    hypothesis : Hypothesis
    effect : Effect
    amplitudes : sequence of str
        Names of its linear parameters, or ``""`` for the displacement as a whole.
    products : mapping of output to CandidateProducts
    assumptions : frozenset of str
    fixed : bool
        A displacement counts as it stands, not by an amplitude of its own.
    """
    amplitudes, products = list(amplitudes), dict(products)
    while True:
        outputs = list(products)
        given = np.array([1.0 if fixed and not name else np.nan for name in amplitudes])
        result = profile(list(products.values()), len(amplitudes), given)
        separate = [reference_of(name)[1] for name in amplitudes]
        # An output with amplitudes of its own has to pay for them.
        over = {
            o: 2 * gain - separate.count(o) * float(np.log(hypothesis.groups[o].count))
            for o, gain in zip(outputs, result.gains.tolist(), strict=True)
        }
        idle = [o for o in outputs if o in separate and len(products) > 1 and over[o] < 0]
        if not idle or effect.stands:
            break
        worst = min(idle, key=lambda o: result.gains[outputs.index(o)])
        gone = [n for n in amplitudes if reference_of(n)[1] == worst]
        kept = [n for n in amplitudes if n not in gone]
        effect = effect.without(tuple(gone))
        products = {
            o: replace(p, amplitudes=np.array([kept.index(amplitudes[a]) for a in p.amplitudes]))
            for o, p in products.items()
            if o != worst
        }
        amplitudes = kept
    # Assumptions differ in what the model may say for itself, of all outputs: they are compared
    # with the present ones.
    gain = 0.5 * hypothesis.evidence_of(assumptions)
    for output, own in zip(outputs, result.gains.tolist(), strict=True):
        gain += own * hypothesis.evidence[output].independence
    rows = sum(hypothesis.groups[o].count * hypothesis.evidence[o].independence for o in outputs)
    count = len(effect.linear()) + len(effect.searched())
    found = {n: float(v) for n, v in zip(amplitudes, result.amplitudes, strict=True)}
    effect = effect.changed({n: effect.parameter(n).neutral + v for n, v in found.items() if n})
    # Heat and air reach more than one place: what moves one output is mostly that output's.
    sure = [o for o in outputs if over[o] >= DECISIVE_EVIDENCE or o not in separate]
    odds = effect.odds
    if len(sure) < 2 <= len(_read_in(hypothesis, effect)):
        odds *= effect.odds_alone(sure[0] if sure else None)
    prior = 2 * float(np.log(odds)) if odds else -np.inf
    fall = 2 * gain - count * float(np.log(rows)) + prior
    if not odds or not effect.plausible(hypothesis.scene):
        fall = gain = -np.inf
    return CauseCandidate(effect, fall, gain, assumptions, found, prior)


def _read_in(hypothesis: Hypothesis, effect: Effect) -> list[str]:
    """Outputs with readings in the logs in which a cause may act."""
    logs = [log for log in hypothesis.logs if effect.log in (None, log.digest)]
    return [o for o in hypothesis.groups if any(o in log.columns for log in logs)]


def signatures_of(hypothesis: Hypothesis, trial: Effect) -> dict[str, Changes]:
    """Signatures by amplitude and output; none where the effect is too strong to be followed.

    Parameters
    ----------
    hypothesis : Hypothesis
    trial : Effect
    """
    try:
        found = hypothesis.simulation.signatures(trial)
    except ModelError:
        return {}
    return {name: outputs for name, outputs in found.items() if outputs}


# ---------------------------------------------------------------- amplitudes by inner products


@dataclass(frozen=True)
class CandidateProducts:
    """Products of a candidate's signatures in one output.

    Attributes
    ----------
    b : ndarray, shape (levels, m)
    C : ndarray, shape (levels, m, m)
    amplitudes : ndarray of int, shape (m,)
        Which of the candidate's amplitudes each signature has.
    null : NullFit
    """

    b: Float
    C: Float
    amplitudes: Index
    null: NullFit

    @staticmethod
    def of(
        projected: ProjectedProducts, index: Sequence[int], amplitudes: Sequence[int]
    ) -> CandidateProducts:
        """Products of the signatures `index` of an output, with these amplitudes."""
        C = np.empty((len(projected.b), len(index), len(index)))
        for i, p in enumerate(index):
            for j, q in enumerate(index):
                pair = min(p, q), max(p, q)
                C[:, i, j] = projected.own[:, p] if p == q else projected.pairs[pair]
        b = projected.b[:, list(index)]
        return CandidateProducts(b, C, np.array(amplitudes, int), projected.null)

    def variance(self, amplitudes: Float, level: int) -> float:
        """White variance that is left with a candidate's amplitudes at one noise level."""
        a = amplitudes[self.amplitudes]
        square = float(self.null.square[level] - (2 * self.b[level] - self.C[level] @ a) @ a)
        return max(square, self.null.least) / self.null.dof

    def best_level(self) -> int:
        """Noise level at which the candidate would explain this output best by itself."""
        if self.b.shape[1] == 1:
            own = self.C[:, 0, 0]
            removed = np.where(own > 0, self.b[:, 0] ** 2 / np.where(own > 0, own, 1.0), 0.0)
        else:
            size = np.sqrt(np.maximum(np.einsum("gii->gi", self.C), 1e-300))
            scaled = self.C / (size[:, :, None] * size[:, None, :])
            inverse = pseudo_inverse(scaled, RELATIVE_RANK)
            b = self.b / size
            removed = np.einsum("gi,gij,gj->g", b, inverse, b)
        return int(np.argmin(self.null.negative_log(self.null.square - removed)))


@dataclass(frozen=True)
class ProfileFit:
    """The best amplitudes of a candidate.

    Attributes
    ----------
    amplitudes : ndarray, shape (p,)
    gains : ndarray, shape (outputs,)
        Rise of the log likelihood of each output.
    levels : list of int
        Noise level of each output.
    """

    amplitudes: Float
    gains: Float
    levels: list[int]


def profile(outputs: Sequence[CandidateProducts], size: int, given: Float) -> ProfileFit:
    """Maximum of the likelihood over amplitudes and, for each output, its noise.

    Parameters
    ----------
    outputs : sequence of CandidateProducts
    size : int
        Number of amplitudes.
    given : ndarray, shape (size,)
        Amplitudes that are given; NaN for those that are sought.
    """
    b, C = _padded(outputs, size)
    square, logdet = (np.array([getattr(x.null, n) for x in outputs]) for n in ("square", "logdet"))
    dof, least = (np.array([[getattr(x.null, n)] for x in outputs]) for n in ("dof", "least"))
    at = np.arange(len(outputs))
    levels = np.array([each.best_level() for each in outputs])
    free = np.flatnonzero(np.isnan(given))
    amplitudes = np.nan_to_num(given)
    for _ in range(MAX_PROFILE_STEPS):
        # White variance that is left of each output at its level.
        left = square[at, levels] - (2 * b[at, levels] - C[at, levels] @ amplitudes) @ amplitudes
        precision = dof[:, 0] / np.maximum(left, least[:, 0])
        before = amplitudes
        if len(free):
            H = np.einsum("o,oij->ij", precision, C[at, levels])
            slope = precision @ b[at, levels] - H @ np.nan_to_num(given)
            amplitudes = np.nan_to_num(given)
            amplitudes[free] = _inverse(H[np.ix_(free, free)]) @ slope[free]
        squares = square - (2 * b - C @ amplitudes) @ amplitudes
        negative = 0.5 * (dof * np.log(np.maximum(squares, least) / dof) + logdet)
        new = np.argmin(negative, axis=1)
        moved = np.abs(amplitudes - before) > PROFILE_TOLERANCE * np.abs(amplitudes)
        agreed = not moved.any() and np.array_equal(new, levels)
        levels = new
        if agreed:
            break
    gains = np.array([each.null.best for each in outputs]) - negative[at, levels]
    return ProfileFit(amplitudes, gains, levels.tolist())


def _padded(outputs: Sequence[CandidateProducts], size: int) -> tuple[Float, Float]:
    """Products (outputs, levels, size) and (outputs, levels, size, size), zero where none is."""
    levels = len(outputs[0].b)
    b = np.zeros((len(outputs), levels, size))
    C = np.zeros((len(outputs), levels, size, size))
    for k, each in enumerate(outputs):
        b[k][:, each.amplitudes] = each.b
        C[k][:, each.amplitudes[:, None], each.amplitudes] = each.C
    return b, C


def _inverse(matrix: Float) -> Float:
    """Pseudo-inverse of a matrix that is scaled to ones on its diagonal first."""
    if matrix.shape == (1, 1):
        return 1.0 / matrix if matrix[0, 0] > 0 else np.zeros((1, 1))
    size = np.sqrt(np.maximum(np.diag(matrix), 0))
    size[size == 0] = np.inf
    inverse = pseudo_inverse(matrix / np.outer(size, size), RELATIVE_RANK)
    return np.asarray(inverse / np.outer(size, size))


@dataclass(frozen=True)
class SignatureTable:
    """Products of the signatures of several trials in all outputs, nuisance projected out.

    Attributes
    ----------
    index : list of mapping of output to list of int
        Signatures of each trial among all of an output.
    amplitudes : list of mapping of output to list of int
        Which of the trial's amplitudes they have.
    projected : mapping of (output, assumptions) to ProjectedProducts
    """

    index: list[dict[str, list[int]]]
    amplitudes: list[dict[str, list[int]]]
    projected: Mapping[tuple[str, Assumptions], ProjectedProducts]

    @staticmethod
    def of(
        hypothesis: Hypothesis,
        trials: Sequence[Signatures],
        assumptions: Sequence[Assumptions],
    ) -> SignatureTable:
        """Products of all trials at once, under each of several assumptions.

        Parameters
        ----------
        hypothesis : Hypothesis
        trials : sequence of mapping of amplitude to mapping of output to list of ndarray
        assumptions : sequence of frozenset of str
        """
        index: list[dict[str, list[int]]] = [{} for _ in trials]
        amplitudes: list[dict[str, list[int]]] = [{} for _ in trials]
        projected = {}
        for output, evidence in hypothesis.evidence.items():
            columns: list[Float] = []
            for k, signatures in enumerate(trials):
                here = [j for j, s in enumerate(signatures.values()) if output in s]
                if here:
                    index[k][output] = list(range(len(columns), len(columns) + len(here)))
                    amplitudes[k][output] = here
                    reached = [s[output] for s in signatures.values() if output in s]
                    columns += [evidence.groups.means(series) for series in reached]
            if columns:
                groups = [each[output] for each in index if output in each]
                # Each signature lies in one piece of memory: they are taken one by one.
                products = evidence.products(np.array(columns).T, groups)
                for each in assumptions:
                    projected[output, each] = evidence.projected(each, products)
        return SignatureTable(index, amplitudes, projected)

    def of_trial(self, k: int, assumptions: Assumptions) -> dict[str, CandidateProducts]:
        """Products of one trial in every output that it reaches.

        Parameters
        ----------
        k : int
        assumptions : frozenset of str
        """
        return {
            output: CandidateProducts.of(
                self.projected[output, assumptions], index, self.amplitudes[k][output]
            )
            for output, index in self.index[k].items()
        }


def products_of(
    hypothesis: Hypothesis, signatures: Signatures, assumptions: Assumptions
) -> dict[str, CandidateProducts]:
    """Products of one trial in every output that it reaches.

    Parameters
    ----------
    hypothesis : Hypothesis
    signatures : mapping of amplitude to mapping of output to list of ndarray
    assumptions : frozenset of str
        Whose nuisance is projected out.
    """
    return SignatureTable.of(hypothesis, [signatures], [assumptions]).of_trial(0, assumptions)
