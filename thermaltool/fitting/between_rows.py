"""Inputs that switch between the rows of a log, and whether any of them acts at once.

A command that a logger of its own clock reads has changed at some instant since the row before. The
output of the same row has moved by then, which a feedthrough explains as well: of one lag the mean
over the instants is the same course. What tells them apart is the scatter of the instants, of which
a feedthrough has none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg import block_diag

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.error_regression import (
    MIN_DIRECTION,
    error_regression,
    input_response,
    instants_of,
)
from thermaltool.fitting.instants import DECISIVE, MAX_SHARE, Instants, pulses
from thermaltool.fitting.projection import orthonormal_rows
from thermaltool.fitting.selection import MIN_DIRECT_EVIDENCE
from thermaltool.fitting.subspace.identify import identify_subspace
from thermaltool.fitting.subspace.model import SubspaceOutput
from thermaltool.fitting.subspace.problem import SubspaceProblem
from thermaltool.fitting.subspace.sections import PoleSection, all_poles
from thermaltool.record import Record
from thermaltool.responses.switching import switches

# Rows that are looked at, and poles of the models that are compared, at most.
MAX_ROWS, MAX_POLES = 4000, 3
# A lag below so many rows stands for feedthrough.
MIN_LAG = 1.0
# Step of the logarithm of a pole, by which its slope is a difference.
POLE_STEP = 0.1


@dataclass(frozen=True)
class BetweenRows:
    """Held inputs whose switches lie between the rows.

    Attributes
    ----------
    lines : tuple of str
        These inputs: on the average they act as straight lines from row to row do.
    lagging : tuple of str
        Those of them that act on no output of the same row, but through what they do before it.
    """

    lines: tuple[str, ...] = ()
    lagging: tuple[str, ...] = ()


def find_between_rows(data: TrainingData) -> BetweenRows:
    """Held inputs that switch between the rows, as far as evidence goes.

    Parameters
    ----------
    data : TrainingData
        On an even clock.
    """
    held = tuple(n for n, hold in zip(data.inputs, data.holds, strict=True) if hold == "zero")
    data = data if data.rows <= MAX_ROWS else data.excerpt(MAX_ROWS)
    if not held or not _switches(data):
        return BetweenRows()
    try:
        found = _Compared(data, held)
        if not found.between:
            return BetweenRows()
        lines = tuple(n for n in held if len(held) == 1 or not found.holds(n))
        lagging = () if found.acts_at_once(lines) else lines
    except FitError:
        return BetweenRows()
    return BetweenRows(lines, lagging)


def _switches(data: TrainingData) -> bool:
    """Whether some held input is a command, which stands still for most rows."""
    for u in data.u:
        for level, hold in zip(u, data.holds, strict=True):
            if hold == "zero" and switches(level, np.ones(len(level) - 1), 1, MAX_SHARE):
                return True
    return False


class _Compared:
    """Models with inputs held from row to row, and along straight lines."""

    def __init__(self, data: TrainingData, held: Sequence[str]) -> None:
        self.data, self.names = data, held
        self.held, self.direct = (_best(data, direct) for direct in (False, True))
        self.lines = _best(data.along_lines(held), False)

    @property
    def between(self) -> bool:
        """Whether lines are decisively better, and instants explain what is left beside them."""
        if not self.lines.level > self.held.level + DECISIVE:
            return False
        evidence = sum(
            _instants(output, self.data.only(k)) for k, output in enumerate(self.direct.outputs)
        )
        if evidence > DECISIVE or evidence <= 0:
            return evidence > 0
        # A feedthrough that explains no more than lines do has a number too many.
        try:
            slow = _best(self.data.along_lines(self.names), False, MIN_LAG)
        except FitError:
            return False
        size = len(self.names) * len(self.data.outputs)
        return slow.level >= self.direct.level - 0.5 * size * np.log(self.data.rows)

    def holds(self, name: str) -> bool:
        """Whether one of the inputs is better held from row to row."""
        others = [n for n in self.names if n != name]
        other = _best(self.data.along_lines(others), False)
        return other.level > self.lines.level + DECISIVE

    def acts_at_once(self, lines: Sequence[str]) -> bool:
        """Whether feedthrough beside straight lines has evidence that the instants do not explain.

        Parameters
        ----------
        lines : sequence of str
        """
        data = self.data.along_lines(lines)
        try:
            slow = _best(data, False, MIN_LAG / 2)
        except FitError:
            return True
        return any(
            _acts_at_once(output, data.only(k), lines) for k, output in enumerate(slow.outputs)
        )


@dataclass(frozen=True)
class _Candidate:
    """A model of few poles.

    Attributes
    ----------
    outputs : sequence of SubspaceOutput
    level : float
        Logarithm of the likelihood of all outputs.
    fastest : float
        The smallest time constant [rows].
    """

    outputs: Sequence[SubspaceOutput]
    level: float
    fastest: float


def _best(data: TrainingData, direct: bool, least: float = 0.0) -> _Candidate:
    """Of one to three poles, none faster than `least` rows, those of least BIC."""
    found: list[tuple[float, _Candidate]] = []
    problem: FitError | None = None
    for order in range(1, MAX_POLES + 1):
        try:
            model = identify_subspace(data, order, direct, judged=False)
        except FitError as error:
            problem = problem or error
            continue
        errors = [_errors(output, data) for output in model.outputs]
        level = sum(-0.5 * len(e) * np.log(max(float(np.mean(e**2)), 1e-300)) for e in errors)
        fastest = float(np.min(-1 / all_poles(model.outputs[0].sections).real))
        if fastest >= least:
            cost = 0.5 * model.criteria.parameters * np.log(data.rows)
            found.append((cost - level, _Candidate(model.outputs, float(level), fastest)))
    if not found:
        raise problem or FitError("no pole fits")
    return min(found, key=lambda pair: pair[0])[1]


def _errors(output: SubspaceOutput, data: TrainingData) -> Array:
    return np.concatenate([r.column(output.target) - output.simulate(r) for r in data.records])


def _acts_at_once(output: SubspaceOutput, data: TrainingData, lines: Sequence[str]) -> bool:
    """Whether feedthrough of one of these inputs is more than what its instants can explain.

    By the likelihood ratio with the instants integrated out, everything else fitted anew beside it
    (weights, offsets, starts, and poles by their slopes); and larger than what half a row changes,
    for no switch lies beyond its rows.
    """
    problem = SubspaceProblem(data, direct=True)
    moved = [PoleSection(tuple(value + POLE_STEP for value in s.theta)) for s in output.sections]
    shared, free, late = [], [], []
    for j, (u, record) in enumerate(zip(data.u, data.records, strict=True)):
        shared.append(problem.shared(j, (*output.sections, *moved)))
        free.append(problem.free(j, output.sections))
        of_input = partial(input_response, output, record)
        own = list(pulses(u, of_input, ["zero"] * len(u), len(data.records)))
        late.append(np.array(own).reshape(len(own), len(record)))
    rows, edge, places = np.hstack(shared), -data.experiments, map(data.inputs.index, lines)
    at = edge - len(data.inputs)
    other, direct = np.vstack([rows[:at], rows[edge:], block_diag(*free)]), rows[at:edge]
    direct = direct[list(places)]
    error, instants = _errors(output, data), block_diag(*late)
    left = _beside(np.vstack([other, direct]), np.vstack([instants, error]))
    noise = replace(Instants.of(left[:-1].T, left[-1]), columns=instants.T)
    error, other, direct = (noise.whitened(own.T).T for own in (error, other, direct))
    left = _beside(other, np.vstack([direct, error]))
    gains, *_ = np.linalg.lstsq(left[:-1].T, left[-1])
    losses = [float(np.sum(own**2)) for own in (left[-1], left[-1] - gains @ left[:-1])]
    evidence = len(error) * np.log(losses[0] / max(losses[1], 1e-300))
    if evidence < MIN_DIRECT_EVIDENCE * len(lines) * np.log(data.rows):
        return False
    step = np.append(0.0, np.ones(2))
    clock = Record(data.period * np.arange(3.0), {})
    half_row = [input_response(output, clock, data.inputs.index(n), step)[1] for n in lines]
    return bool(np.any(np.abs(gains) > np.abs(half_row)))


def _beside(columns: Array, rows: Array) -> Array:
    """What columns, shape (p, n), leave of rows, shape (q, n)."""
    basis = orthonormal_rows(columns, MIN_DIRECTION)
    return np.asarray(rows - (rows @ basis.T) @ basis)


def _instants(output: SubspaceOutput, data: TrainingData) -> float:
    """Evidence for instants in what an output leaves, beside all that a linear plant may do."""
    found = error_regression(output, data)
    if found is None:
        return 0.0
    own = instants_of(replace(found, other=found.other[:0], names=()))
    return 0.0 if own is None else own[1].evidence
