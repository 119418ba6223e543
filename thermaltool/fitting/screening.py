"""Which of many inputs an output follows, by the evidence.

y = offset + decays + Σ_i [w_i0 u_i + Σ_j w_ij u_i/(τ_j s + 1)] + v

with the time constants on a grid, whitened by an AR model of what all inputs together leave. The
weights of an input are normal with one variance, of which the evidence decides, the likelihood of
the output with them integrated out (MacKay 1992; automatic relevance determination, Neal 1996).
Inputs are taken one by one, the one of most evidence first, and left out again where the others
say what it says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from thermaltool.errors import FitError
from thermaltool.fitting.components.choose import averaged
from thermaltool.fitting.components.problem import ComponentProblem
from thermaltool.fitting.components.reduction import (
    NEARLY_SAME_CORRELATION,
    Reduction,
    correlation,
    is_reducible,
    moving_inputs,
)
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.error_model import ar_error_model, effective_share, known_runs
from thermaltool.signals.gauss_newton import solve

# Twice the logarithm of the likelihood ratio that an input takes.
MIN_EVIDENCE = 10.0
# Rows are averaged in groups to so many at most.
MAX_ROWS = 4000
# Lags of every input, from one row to this share of the longest record.
LAGS, SLOWEST_SHARE = (2, 8), 0.25
# Rows for each column of the regression; rows that the errors are worth for each column left out:
# slow errors tell little, and what many inputs that say much the same explain of them is not sure.
ROWS_PER_COLUMN, ERRORS_PER_COLUMN = 6, 4
# A shorter run without a hole says nothing.
MIN_RUN = 40
# Variance of the errors over that of the weights of inputs that vary by 1, about the rows.
RIDGES = 10.0 ** np.arange(-10, 3.1, 0.5)
# Components of the inputs kept have to leave less than this of the squared error held out.
MAX_SQUARE_RATIO = 0.9


@dataclass(frozen=True)
class LeftOut:
    """An input that an output does not follow, as far as the data show.

    Attributes
    ----------
    name : str
    evidence : float or None
        Twice the logarithm of the likelihood ratio beside the inputs kept; None: it never moves.
    same_as : str
        The input kept that says nearly the same; empty where there is none.
    """

    name: str
    evidence: float | None = None
    same_as: str = ""


@dataclass(frozen=True)
class _Rows:
    """Rows that count: of the output, of what each input becomes, of offsets and decays.

    Attributes
    ----------
    output : ndarray, shape (n,)
    beside : ndarray, shape (b, n)
    inputs : ndarray, shape (m, k, n)
    ends : tuple of int
        Behind each run without a hole.
    """

    output: Array
    beside: Array
    inputs: Array
    ends: tuple[int, ...]

    @cached_property
    def columns(self) -> Array:
        """Those beside the inputs first, then input by input, shape (b + m k, n)."""
        return np.vstack([self.beside, self.inputs.reshape(-1, len(self.output))])

    @cached_property
    def gram(self) -> Array:
        """Of the columns and, last, the output."""
        whole = np.vstack([self.columns, self.output])
        return np.asarray(whole @ whole.T)

    def place(self, inputs: Sequence[int]) -> NDArray[np.intp]:
        """Columns of these inputs."""
        first, k = len(self.beside), self.inputs.shape[1]
        return (first + k * np.array(inputs, dtype=np.intp)[:, None] + np.arange(k)).ravel()

    def errors(self, inputs: Sequence[int]) -> list[Array]:
        """What these inputs leave of the output, run by run."""
        own = np.concatenate([np.arange(len(self.beside)), self.place(inputs)])
        weights = solve(self.gram[np.ix_(own, own)], self.gram[own, -1])
        return np.split(self.output - weights @ self.columns[own], self.ends[:-1])

    def whitened(self, ar: Array) -> _Rows:
        """Through an AR polynomial, run by run, without the rows that it needs to begin."""
        cut = len(ar) - 1

        def through(rows: Array) -> Array:
            runs = np.split(rows, self.ends[:-1], axis=-1)
            return np.concatenate([lfilter(ar, [1.0], run)[..., cut:] for run in runs], axis=-1)

        starts = (0, *self.ends[:-1])
        lengths = [end - start - cut for start, end in zip(starts, self.ends, strict=True)]
        return _Rows(through(self.output), through(self.beside), through(self.inputs),
                     tuple(np.cumsum(lengths).tolist()))  # fmt: skip

    def evidences(self, kept: Sequence[int], asked: Sequence[int]) -> dict[int, float]:
        """Evidence of inputs beside those kept: twice the logarithm of the likelihood ratio."""
        n, gram = len(self.output), self.gram
        own = np.concatenate([np.arange(len(self.beside)), self.place(kept)])
        taken = solve(gram[np.ix_(own, own)], gram[own])
        found = {}
        for i in asked:
            place = self.place([i])
            both = np.append(place, len(gram) - 1)
            rest = gram[np.ix_(both, both)] - gram[np.ix_(both, own)] @ taken[:, both]
            values, vectors = np.linalg.eigh(rest[:-1, :-1])
            values, pull = np.maximum(values, 0.0)[:, None], (vectors.T @ rest[:-1, -1])[:, None]
            power = max(float(rest[-1, -1]), 1e-300)
            # Of an input that varies by 1.
            ridges = RIDGES * n
            left = power - np.sum(pull**2 / (values + ridges), axis=0)
            spread = np.sum(np.log1p(values / ridges), axis=0)
            each = n * np.log(power / np.maximum(left, 1e-12 * power)) - spread
            found[i] = float(each.max())
        return found


def screen_all(sets: Sequence[TrainingData]) -> tuple[tuple[str, ...], tuple[LeftOut, ...]]:
    """Inputs that some output follows, and those that none does with the most evidence of each.

    Parameters
    ----------
    sets : sequence of TrainingData
        Of one output each, with the same inputs.

    Raises
    ------
    FitError
        No input moves.
    """
    found = [screen(data) for data in sets]
    kept = tuple(n for n in sets[0].inputs if any(n in own for own, _ in found))
    names = moving_inputs(sets[0])
    # Of inputs that say much the same a mean over all may know more than those of most evidence.
    alike = len(kept) < len(names) and is_reducible(sets[0])
    if alike and not all(_predicts_better(data.driven_by(names), kept) for data in sets):
        return names, tuple(LeftOut(name) for name in sets[0].inputs if name not in names)
    left_out: dict[str, LeftOut] = {}
    for each in (each for _, own in found for each in own if each.name not in kept):
        known = left_out.get(each.name)
        if known is None or (each.evidence or 0.0) > (known.evidence or 0.0):
            left_out[each.name] = each
    return kept, tuple(left_out[name] for name in sets[0].inputs if name in left_out)


def _predicts_better(data: TrainingData, kept: Sequence[str]) -> bool:
    """Whether components of these inputs predict blocks held out clearly better than of all."""
    errors = []
    for names in (data.inputs, kept):
        try:
            _, choices = averaged(ComponentProblem(data.driven_by(names), Reduction()))
        except FitError:
            return False
        errors.append(min(each.error for each in choices))
    return errors[1] ** 2 < MAX_SQUARE_RATIO * errors[0] ** 2


def screen(data: TrainingData) -> tuple[tuple[str, ...], tuple[LeftOut, ...]]:
    """Inputs that an output follows, and those that it does not.

    Parameters
    ----------
    data : TrainingData
        Of one output.

    Returns
    -------
    kept : tuple of str
        At least one; all that move where the data are too few to say.
    left_out : tuple of LeftOut

    Raises
    ------
    FitError
        No input moves.
    """
    names = moving_inputs(data)
    idle = tuple(LeftOut(name) for name in data.inputs if name not in names)
    data = data.driven_by(names)
    rows = _rows(data)
    if rows is None:
        return names, idle
    everything = range(len(names))
    model = ar_error_model(rows.errors(everything))
    white = rows if model is None else rows.whitened(model[0])
    kept = _kept(white, len(names))
    dropped = [i for i in everything if i not in kept]
    if not kept or not dropped or not _known(rows, kept, len(dropped)):
        return names, idle
    evidences, near = white.evidences(kept, dropped), np.abs(correlation(data))
    left_out = []
    for i in dropped:
        same = max(kept, key=lambda k: near[i, k])
        found = names[same] if near[i, same] >= NEARLY_SAME_CORRELATION else ""
        left_out.append(LeftOut(names[i], evidences[i], found))
    return tuple(names[i] for i in kept), (*idle, *left_out)


def _kept(white: _Rows, count: int) -> list[int]:
    """Inputs of enough evidence, one after the other, and each beside all others at the end."""
    kept: list[int] = []
    while len(kept) < count:
        found = white.evidences(kept, [i for i in range(count) if i not in kept])
        best = max(found, key=lambda i: found[i])
        if found[best] < MIN_EVIDENCE:
            break
        kept.append(best)
    while len(kept) > 1:
        beside = {i: white.evidences([k for k in kept if k != i], [i])[i] for i in kept}
        least = min(beside, key=lambda i: beside[i])
        if beside[least] >= MIN_EVIDENCE:
            break
        kept.remove(least)
    return sorted(kept)


def _known(rows: _Rows, kept: Sequence[int], dropped: int) -> bool:
    """Whether what the kept inputs leave is worth enough rows to say that the others do nothing."""
    worth = effective_share(rows.errors(kept)) * len(rows.output)
    return worth >= ERRORS_PER_COLUMN * dropped * rows.inputs.shape[1]


def _rows(data: TrainingData) -> _Rows | None:
    """All rows, in groups where they are many; None: too few."""
    m, group = len(data.inputs), -(-data.rows // MAX_ROWS)
    lags = min(LAGS[1], data.rows // group // ROWS_PER_COLUMN // m - 1)
    if lags < LAGS[0]:
        return None
    taus = np.geomspace(1.0, max(SLOWEST_SHARE * data.longest, 4.0), lags)
    sizes = np.std(np.hstack(data.u), axis=1)
    # Decays of the first piece of each log alone: those behind a hole are shorter than a lag.
    free = [k for k in data.begins.values() if not data.records[k].at_rest]
    parts = []
    for k, (record, u, y) in enumerate(zip(data.records, data.u, data.y, strict=True)):
        offsets = np.zeros((data.experiments, len(record)))
        offsets[record.origin] = 1.0
        decays = np.zeros((len(free), lags, len(record)))
        if k in free:
            decays[free.index(k)] = np.exp(-np.arange(len(record)) / taus[:, None])
        beside = np.vstack([offsets, decays.reshape(-1, len(record))])
        about = (u - data.levels[record.origin][:, None]) / sizes[:, None]
        through = [about, *(lfilter([1 - a], [1, -a], about) for a in np.exp(-1 / taus))]
        whole = _group_means(np.vstack([y[:1], beside, *through]), group)
        parts += [whole[:, run] for run in known_runs(whole[0])]
    parts = [part for part in parts if part.shape[1] >= MIN_RUN]
    if not parts:
        return None
    rows = np.hstack(parts)
    edge, n = len(rows) - m * (lags + 1), rows.shape[1]
    if n < ROWS_PER_COLUMN * len(rows):
        return None
    inputs = rows[edge:].reshape(lags + 1, m, n).transpose(1, 0, 2)
    ends = np.cumsum([part.shape[1] for part in parts]).tolist()
    return _Rows(rows[0], rows[1:edge], inputs, tuple(ends))


def _group_means(rows: Array, group: int) -> Array:
    """Means of so many values of each row, shape (p, n // group)."""
    count = rows.shape[1] // group
    return np.asarray(rows[:, : count * group].reshape(len(rows), count, group).mean(axis=2))
