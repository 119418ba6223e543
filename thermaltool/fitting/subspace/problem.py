"""The problem of all outputs: Σ over sections and inputs, direct feedthrough, offsets, start.

For given poles all else is linear, and its columns are the same for every output: two weights for
each input and section, the feedthrough, one offset for each experiment, and what an unknown state
at the start of each piece leaves behind. The last are taken off piece by piece, the others by one
set of normal equations (variable projection, Golub and Pereyra 1973).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.joint import MIN_LOSS, ProjectedOutput, criterion
from thermaltool.fitting.subspace.sections import PoleSection, combined, moved, responses
from thermaltool.signals.gauss_newton import solve

# Half the step of a logarithm by which a response is differentiated.
LOG_DIFFERENCE = 1e-5


@dataclass(frozen=True)
class SubspacePoint:
    """Poles with everything that is linear for them.

    Attributes
    ----------
    sections : tuple of PoleSection
    linear : ndarray, shape (p, S)
        Weights section by section and in each input by input, feedthrough of each input where there
        is any, offsets about the `centres` of the problem.
    starts : tuple of ndarray, shape (p, N)
        What each piece begins with; (p, 0) at rest.
    losses : ndarray, shape (p,) [unit²]
        Sums of the squared errors.
    gram : ndarray, shape (S, S)
    columns, errors : tuple of ndarray, shape (S, rows), (p, rows)
        Of each piece: the shared columns without what the start explains of them; errors.
    """

    sections: tuple[PoleSection, ...]
    linear: Array
    starts: tuple[Array, ...]
    losses: Array
    gram: Array
    columns: tuple[Array, ...]
    errors: tuple[Array, ...]

    @property
    def rows(self) -> int:
        """Rows that count."""
        return sum(each.shape[1] for each in self.errors)

    @cached_property
    def criterion(self) -> float:
        """½ Σ n ln(loss/n) over the outputs."""
        return criterion([(float(loss), self.rows) for loss in self.losses])


@dataclass(frozen=True)
class SubspaceProblem:
    """Least squares of all outputs for given poles.

    Attributes
    ----------
    data : TrainingData
        On an even clock. A row counts where no output is missing.
    direct : bool
        Whether the outputs follow the inputs of the same row.
    stride : int
        Every so many rows count; the sections are followed over all.
    real : bool
        Whether the search keeps to real poles.
    """

    data: TrainingData
    direct: bool = False
    stride: int = 1
    real: bool = False

    @cached_property
    def known(self) -> tuple[NDArray[np.bool_], ...]:
        """Which rows of each piece count, of every `stride`-th."""
        every = (np.isfinite(y[:, :: self.stride]) for y in self.data.y)
        return tuple(np.logical_and.reduce(each, axis=0) for each in every)

    def counted(self, j: int, rows: Array) -> Array:
        """Rows of piece j that count, shape (..., rows).

        Parameters
        ----------
        j : int
        rows : ndarray, shape (..., n)
        """
        thin = rows[..., :: self.stride]
        return thin if self.known[j].all() else thin[..., self.known[j]]

    def spread(self, j: int, counted: Array, missing: float = 0.0) -> Array:
        """Values of the rows of piece j that count, on its clock.

        Parameters
        ----------
        j : int
        counted : ndarray, shape (..., rows)
        missing : float
            What stands for the other rows.
        """
        known = self.known[j]
        if known.all():
            return counted
        found = np.full((*counted.shape[:-1], len(known)), missing)
        found[..., known] = counted
        return found

    @cached_property
    def centres(self) -> Array:
        """Mean of every output in every experiment, shape (p, experiments)."""
        found = np.zeros((len(self.data.outputs), self.data.experiments))
        for origin in range(self.data.experiments):
            own = np.hstack([y for r, y in zip(self.data.records, self.data.y, strict=True)
                             if r.origin == origin])  # fmt: skip
            own = own[:, np.isfinite(own).all(axis=0)]
            if own.size:
                found[:, origin] = own.mean(axis=1)
        return found

    def measured(self, j: int) -> Array:
        """Outputs of piece j about the centres, shape (p, rows)."""
        y = self.data.y[j] - self.centres[:, [self.data.records[j].origin]]
        return self.counted(j, y)

    @cached_property
    def powers(self) -> Array:
        """Squares of all outputs about the centres, shape (p,)."""
        whole = np.hstack([self.measured(j) for j in range(len(self.data.records))])
        return np.maximum(np.sum(whole**2, axis=1), 1e-300)

    @cached_property
    def driven(self) -> tuple[Array, ...]:
        """Inputs of each piece relative to its first row, which has stood before."""
        return tuple(u - u[:, :1] for u in self.data.u)

    def linear_count(self, order: int) -> int:
        """Columns of each output beside those of the start, S."""
        return len(self.data.inputs) * (order + self.direct) + self.data.experiments

    def places(self, sections: tuple[PoleSection, ...]) -> list[slice]:
        """Weights of each section among the linear parameters."""
        m = len(self.data.inputs)
        edges = np.cumsum([0, *(m * section.states for section in sections)]).tolist()
        return [slice(a, b) for a, b in pairwise(edges)]

    def shared(self, j: int, sections: tuple[PoleSection, ...]) -> Array:
        """Columns of piece j that all pieces share, shape (S, rows)."""
        data, record = self.data, self.data.records[j]
        stood = data.u[j][:, 0] - data.levels[record.origin]
        m, kept = len(stood), int(self.known[j].sum())
        found = np.zeros((self.linear_count(sum(s.states for s in sections)), kept))
        for section, place in zip(sections, self.places(sections), strict=True):
            each = self.counted(j, responses(section, self.driven[j], data.holds))
            # The first state of each section has a steady state of one, the second none.
            each[:: section.states] += stood[:, None]
            found[place] = each
        if self.direct:
            at = -data.experiments - m
            found[at : -data.experiments] = self.counted(j, self.driven[j] + stood[:, None])
        found[record.origin - data.experiments] = 1.0
        return found

    def free(self, j: int, sections: tuple[PoleSection, ...]) -> Array:
        """What any state at the start of piece j leaves behind, shape (N, rows); (0, rows)."""
        record = self.data.records[j]
        if record.at_rest or not sections:
            return np.zeros((0, int(self.known[j].sum())))
        return self.counted(j, np.vstack([s.free(len(record)) for s in sections]))

    def project(self, sections: tuple[PoleSection, ...]) -> SubspacePoint:
        """All that is linear for these poles.

        Parameters
        ----------
        sections : tuple of PoleSection
        """
        size = self.linear_count(sum(s.states for s in sections))
        gram, cross = np.zeros((size, size)), np.zeros((size, len(self.data.outputs)))
        shared, measured, taken = [], [], []
        for j in range(len(self.data.records)):
            columns, free, y = self.shared(j, sections), self.free(j, sections), self.measured(j)
            if len(free):
                both = np.vstack([columns, y])
                off = solve(free @ free.T, free @ both.T).T
                both -= off @ free
                columns, y = both[:size], both[size:]
                taken.append((off[:size], off[size:]))
            else:
                taken.append((np.zeros((size, 0)), np.zeros((len(y), 0))))
            gram += columns @ columns.T
            cross += columns @ y.T
            shared.append(columns)
            measured.append(y)
        linear = solve(gram, cross).T
        errors = tuple(y - linear @ own for y, own in zip(measured, shared, strict=True))
        losses = np.sum([np.sum(e**2, axis=1) for e in errors], axis=0)
        starts = tuple(of_y - linear @ of_columns for of_columns, of_y in taken)
        return SubspacePoint(
            sections, linear, starts, np.maximum(losses, MIN_LOSS * self.powers), gram,
            tuple(shared), errors,
        )  # fmt: skip

    def errors_on_clock(self, point: SubspacePoint) -> list[list[Array]]:
        """Errors of every output in each piece; NaN in rows that do not count."""
        each = [self.spread(j, own, np.nan) for j, own in enumerate(point.errors)]
        return [[own[k] for own in each] for k in range(len(self.data.outputs))]

    def slopes(self, j: int, point: SubspacePoint) -> Array:
        """How piece j of each output follows the logarithms, shape (p, N, rows).

        Parameters
        ----------
        j : int
        point : SubspacePoint
        """
        p, (rows,) = len(self.data.outputs), {each.shape[1] for each in (point.errors[j],)}
        found, at = np.zeros((p, sum(s.states for s in point.sections), rows)), 0
        begun = point.starts[j].shape[1] > 0
        for section, place in zip(point.sections, self.places(point.sections), strict=True):
            n = section.states
            for k in range(n):
                beside = []
                for sign in (1, -1):
                    step = sign * LOG_DIFFERENCE * np.eye(n)[k]
                    (other,) = moved((section,), step)
                    signal = combined(
                        other, self.driven[j], self.data.holds, point.linear[:, place]
                    )  # fmt: skip
                    if begun:
                        free = other.free(len(self.data.records[j]))
                        signal = signal + point.starts[j][:, at : at + n] @ free
                    beside.append(self.counted(j, signal))
                found[:, at + k] = (beside[0] - beside[1]) / (2 * LOG_DIFFERENCE)
            at += n
        if begun:
            free = self.free(j, point.sections)
            flat = found.reshape(-1, rows)
            found = (flat - solve(free @ free.T, free @ flat.T).T @ free).reshape(found.shape)
        return found

    def linearized(self, point: SubspacePoint) -> list[ProjectedOutput]:
        """Every output with its slopes by the logarithms, the linear parameters projected out.

        Parameters
        ----------
        point : SubspacePoint
        """
        outputs = range(len(self.data.outputs))
        order = sum(s.states for s in point.sections)
        inner = np.zeros((len(outputs), order, order))
        across, pull = (
            np.zeros((len(outputs), order, len(point.gram))),
            np.zeros((len(outputs), order)),
        )
        for j, (columns, errors) in enumerate(zip(point.columns, point.errors, strict=True)):
            slopes = self.slopes(j, point)
            inner += slopes @ slopes.transpose(0, 2, 1)
            across += slopes @ columns.T
            pull += np.einsum("pnr,pr->pn", slopes, errors)
        by_logarithms = solve(point.gram, across.reshape(-1, len(point.gram)).T)
        by_logarithms = by_logarithms.T.reshape(across.shape).transpose(0, 2, 1)
        return [
            ProjectedOutput(point.linear[k], float(point.losses[k]), point.rows, by_logarithms[k],
                            point.gram, inner[k] - across[k] @ by_logarithms[k], pull[k])
            for k in outputs
        ]  # fmt: skip
