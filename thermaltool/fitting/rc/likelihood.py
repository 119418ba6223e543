"""Likelihood of a network over logs: its value, score and information by small differences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermaltool.fitting.rc.data import FilterPiece
from thermaltool.fitting.rc.kalman import Innovations, StartPrior, innovations
from thermaltool.fitting.rc.network import RcNetwork, unit_factor
from thermaltool.fitting.rc.parameters import SearchSpace
from thermaltool.fitting.rc.state_space import thermal_modes

Array = NDArray[np.float64]

# Step of a difference [logarithm of a parameter]: its error is as small as that of rounding.
_STEP = 1e-5


@dataclass(frozen=True)
class RcLikelihood:
    """−2 log L of a network as a function of what is searched.

    Attributes
    ----------
    network : RcNetwork
    space : SearchSpace
    pieces : tuple of FilterPiece
    from_rest : bool
        Every piece begins at rest: settled without heat; else its start is unknown.
    """

    network: RcNetwork
    space: SearchSpace
    pieces: tuple[FilterPiece, ...]
    from_rest: bool = False

    @cached_property
    def priors(self) -> tuple[StartPrior | None, ...]:
        """Of the start of each piece: its first readings, and the range of all readings."""
        if self.from_rest:
            return (None,) * len(self.pieces)
        return start_priors(self.network, self.pieces)

    @property
    def readings(self) -> int:
        """Readings of all pieces."""
        return sum(int(piece.present.sum()) for piece in self.pieces)

    def innovations(self, vectors: Array) -> list[Innovations]:
        """One-step errors of every piece for a batch of vectors, shape (B, p)."""
        modes = thermal_modes(self.network, self.space.values(vectors))
        pairs = zip(self.pieces, self.priors, strict=True)
        return [innovations(modes, piece, prior) for piece, prior in pairs]

    def deviances(self, vectors: Array) -> Array:
        """−2 log L of a batch of vectors, shape (B,); infinite where it cannot be computed."""
        with np.errstate(all="ignore"):
            try:
                found = sum(each.deviance() for each in self.innovations(vectors))
            except np.linalg.LinAlgError:
                return np.full(len(vectors), np.inf)
        found = np.asarray(found) + self.readings * np.log(2 * np.pi)
        return np.where(np.isfinite(found), found, np.inf)

    def evaluated(self, vector: Array) -> tuple[float, Array, Array]:
        """−2 log L, expected information (p, p), and score, minus half the slope of −2 log L, (p,).

        Infinite and empty where it cannot be computed. The value alone costs nearly as much: most
        of the time goes into the rows of the filter, whatever the batch.
        """
        p = len(vector)
        vectors = np.vstack([vector, vector + _STEP * np.eye(p)])
        information, score = np.zeros((p, p)), np.zeros(p)
        value = self.readings * float(np.log(2 * np.pi))
        try:
            with np.errstate(all="ignore"):
                found = self.innovations(vectors)
        except np.linalg.LinAlgError:
            return np.inf, information, score
        for each in found:
            value += float(each.deviance()[0])
            inverse = each.inverses[:, 0]
            moved = (each.errors[:, 1:] - each.errors[:, :1]) / _STEP
            weighted = (inverse[each.entry] @ each.errors[:, 0, :, None])[..., 0]
            changes = (each.covariances[:, 1:] - each.covariances[:, :1]) / _STEP
            slopes = changes @ inverse[:, None]
            squares = np.zeros(inverse.shape)
            np.add.at(squares, each.entry, weighted[:, :, None] * weighted[:, None, :])
            score -= np.einsum("ka,kia->i", weighted, moved)
            score -= 0.5 * np.einsum("t,tiaa->i", each.counts, slopes)
            score += 0.5 * np.einsum("tab,tiab->i", squares, changes)
            information += np.einsum("kim,kjm->ij", moved @ inverse[each.entry], moved)
            information += 0.5 * np.einsum("t,tiab,tjba->ij", each.counts, slopes, slopes,
                                           optimize=True)  # fmt: skip
        if not (np.isfinite(value) and np.isfinite(information).all()):
            return np.inf, np.zeros((p, p)), np.zeros(p)
        return value, information, score

    def hessian(self, vector: Array, steps: Array) -> Array:
        """Half the second derivatives of −2 log L by central differences, shape (p, p).

        Parameters
        ----------
        vector, steps : ndarray, shape (p,)
        """
        p = len(vector)
        moves = np.diag(steps)
        pairs = [(i, j) for i in range(p) for j in range(i)]
        points = [np.zeros(p)]
        for i in range(p):
            points += [moves[i], -moves[i]]
        for i, j in pairs:
            points += [moves[i] + moves[j], -moves[i] - moves[j]]
        found = self.deviances(vector + np.array(points))
        middle, single, double = found[0], found[1 : 2 * p + 1], found[2 * p + 1 :]
        sums = single.reshape(p, 2).sum(axis=1)
        curved = np.diag(sums - 2 * middle)
        for (i, j), both in zip(pairs, double.reshape(-1, 2).sum(axis=1), strict=True):
            curved[i, j] = curved[j, i] = (both - sums[i] - sums[j] + 2 * middle) / 2
        return np.asarray(curved / np.outer(steps, steps) / 2)


def start_priors(network: RcNetwork, pieces: Sequence[FilterPiece]) -> tuple[StartPrior, ...]:
    """What is known of temperatures at the start of each piece before its readings.

    Parameters
    ----------
    network : RcNetwork
    pieces : sequence of FilterPiece
    """
    factor = np.array([unit_factor(channel) for channel in network.outputs])
    every = np.concatenate([piece.readings * factor for piece in pieces])
    spread = float(np.nanmax(every) - np.nanmin(every))
    priors = []
    for piece in pieces:
        there = np.flatnonzero(piece.present.any(axis=1))
        first = piece.readings[there[0]] * factor if len(there) else np.nanmean(every)
        priors.append(StartPrior(float(np.nanmean(first)), spread))
    return tuple(priors)
