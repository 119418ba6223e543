"""Directions in which many inputs move together: principal components, partial least squares.

Inputs of one unit have one scale, so that a ridge holds their weights down alike. Of principal
components the first k carry the most of their variance (Jolliffe 2002); of partial least squares
the most of their covariance with the output (Wold, Sjöström, Eriksson 2001).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.excitation import MIN_MOVEMENT

Method = Literal["pca", "pls", "none"]

# Columns whose correlation is above this say the same, and nearly the same.
SAME_CORRELATION, NEARLY_SAME_CORRELATION = 0.999, 0.99
# So many inputs at least are many, and few components carry so much of their variance.
MANY_INPUTS, CARRIED_VARIANCE = 6, 0.99


@dataclass(frozen=True)
class Reduction:
    """How inputs are reduced.

    Attributes
    ----------
    method : {"pca", "pls", "none"}
    components : int or None
        None: all, and the ridge alone holds their weights down.
    """

    method: Method = "pca"
    components: int | None = None

    def kept(self, inputs: int) -> int:
        """How many components there are of so many inputs.

        Parameters
        ----------
        inputs : int

        Raises
        ------
        FitError
            More components than inputs.
        """
        if self.components is None:
            return inputs
        if self.components > inputs:
            raise FitError(
                f"{self.method}:{self.components}: more components than the {inputs} inputs that "
                "move"
            )
        return self.components

    def loadings(self, columns: Array, output: Array, units: Sequence[str] = ()) -> Array:
        """All components by inputs: ``loadings.T @ columns`` are the scores, the first first.

        A sensor that hardly moves would have a large weight if it were scaled by itself, and errs
        by it where it moves more than in the fit.

        Parameters
        ----------
        columns : ndarray, shape (m, n)
            About their means.
        output : ndarray, shape (n,)
        units : sequence of str, one for each input
            Those of one unit are scaled together; without any each by itself.

        Returns
        -------
        ndarray, shape (m, m)
        """
        power = np.mean(columns**2, axis=1)
        if units:
            places = np.unique(np.array(units), return_inverse=True)[1]
            power = (np.bincount(places, power) / np.bincount(places))[places]
        scale = np.sqrt(power)
        scale = np.where(scale > 0, scale, 1.0)
        unit = columns / scale[:, None]
        own = METHODS[self.method](unit, output)
        return np.asarray(own / scale[:, None])


def _principal(unit: Array, output: Array) -> Array:
    return np.asarray(np.linalg.eigh(unit @ unit.T)[1][:, ::-1])


def _partial(unit: Array, output: Array) -> Array:
    """Orthonormal directions w ∝ X y of what the ones before leave of X; the last by variance."""
    left, found = unit.copy(), np.zeros((len(unit), 0))
    start = np.linalg.norm(unit @ output)
    for _ in range(len(unit)):
        direction = left @ output
        # Orthogonal to those before: what rounding leaves of them grows else.
        direction = direction - found @ (found.T @ direction)
        size = np.linalg.norm(direction)
        if not size > MIN_MOVEMENT * start:
            break
        direction = direction / size
        scores = direction @ left
        left = left - np.outer(left @ scores, scores) / (scores @ scores)
        found = np.column_stack([found, direction])
    rest = np.eye(len(unit)) - found @ found.T
    more = np.linalg.eigh(rest @ (unit @ unit.T) @ rest + rest)[1][:, ::-1]
    return np.column_stack([found, more[:, : len(unit) - found.shape[1]]])


METHODS: dict[Method, Callable[[Array, Array], Array]] = {
    "pca": _principal,
    "pls": _partial,
    "none": _principal,
}


def parse_reduction(text: str) -> Reduction:
    """A reduction as the command line has it: ``pca``, ``pls:3``, ``none``.

    Parameters
    ----------
    text : str

    Raises
    ------
    ValueError
    """
    method, colon, count = text.partition(":")
    if method not in get_args(Method):
        raise ValueError(f"{text!r} is none of pca, pls, none, pca:k, pls:k")
    if not colon:
        return Reduction(method)  # type: ignore[arg-type]
    if method == "none":
        raise ValueError("none has no number: it keeps all inputs")
    if not count.isdecimal() or int(count) < 1:
        raise ValueError(f"{text!r}: the number of components is 1 or more")
    return Reduction(method, int(count))  # type: ignore[arg-type]


def moving_inputs(data: TrainingData) -> tuple[str, ...]:
    """Inputs that move within the records.

    Parameters
    ----------
    data : TrainingData

    Raises
    ------
    FitError
        None does.
    """
    columns = np.hstack(data.u)
    span = np.ptp(columns, axis=1) > MIN_MOVEMENT * np.max(np.abs(columns), axis=1)
    found = tuple(name for name, moves in zip(data.inputs, span, strict=True) if moves)
    if not found:
        raise FitError("no input excites: none moves within the rows that are fitted")
    return found


def correlation(data: TrainingData) -> Array:
    """Correlation of the inputs, each experiment about its mean, shape (m, m).

    Parameters
    ----------
    data : TrainingData
        All of whose inputs move.
    """
    parts = []
    for e in range(data.experiments):
        own = np.hstack([
            u for r, u in zip(data.records, data.u, strict=True) if r.origin == e
        ])  # fmt: skip
        parts.append(own - own.mean(axis=1, keepdims=True))
    return np.atleast_2d(np.corrcoef(np.hstack(parts)))


def same_inputs(data: TrainingData, least: float = SAME_CORRELATION) -> tuple[tuple[str, ...], ...]:
    """Groups of inputs that are nearly equal but for zero and scale.

    Parameters
    ----------
    data : TrainingData
        All of whose inputs move.
    least : float
        Correlation from which on they are.
    """
    near = np.abs(correlation(data)) >= least
    groups: list[tuple[str, ...]] = []
    left = list(range(len(data.inputs)))
    while left:
        group, left = [left[0]], left[1:]
        for k in list(left):
            if near[group[0], k]:
                group.append(k)
                left.remove(k)
        if len(group) > 1:
            groups.append(tuple(data.inputs[k] for k in group))
    return tuple(groups)


def carrying(data: TrainingData) -> int:
    """How many principal components carry nearly all variance of the scaled inputs that move.

    Parameters
    ----------
    data : TrainingData
    """
    moving = data.driven_by(moving_inputs(data))
    values = np.sort(np.linalg.eigvalsh(correlation(moving)))[::-1]
    carried = np.cumsum(values) / values.sum()
    return int(np.argmax(carried >= CARRIED_VARIANCE)) + 1


def is_reducible(data: TrainingData) -> bool:
    """Whether many inputs say much the same: half as many components carry nearly all of them.

    Parameters
    ----------
    data : TrainingData
    """
    moving = moving_inputs(data)
    return len(moving) >= MANY_INPUTS and 2 * carrying(data) <= len(moving)
