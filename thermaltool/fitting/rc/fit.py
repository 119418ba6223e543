"""Maximum likelihood of a network: a search from many starts, and what it found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import FitError
from thermaltool.fitting.rc.data import FilterPiece, filter_pieces, thinned
from thermaltool.fitting.rc.likelihood import RcLikelihood
from thermaltool.fitting.rc.network import RcNetwork
from thermaltool.fitting.rc.parameters import SearchSpace, estimates, is_identified
from thermaltool.fitting.rc.start import data_scale, starts
from thermaltool.record import Record
from thermaltool.signals.criteria import Criteria
from thermaltool.signals.gauss_newton import inverse_of, minimize, solve
from thermaltool.signals.intervals import Estimate

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Rows of the first search, starts that it goes on from, and how many of its ends are followed.
_FIRST_ROWS, _FIRST_STARTS, _ENDS = 800, 4, 3
# Starts where a nested network has been found more likely.
_MORE_STARTS = 16
# Steps of a search over few rows, and over all.
_FIRST_ITERATIONS, _ITERATIONS = 40, 20
# A step that gains no more of −2 log L is not taken: a thirtieth of a standard error. Along a
# valley in which parameters trade off a search ends with its last step, and has converged where
# another one would gain less than the second number.
_TOLERANCE, _CONVERGED = 1e-3, 0.1
# The same where a search only looks for the valley.
_COARSE = 0.5
# Ends whose −2 log L differ by no more are the same.
_SAME = 0.2
# One that is so far behind the best on few rows is not gone on from.
_BEHIND = 10.0
# By how much less process noise there is at first, in logarithms.
_QUIET = 4.0
# Logarithms of the process noise that is tried in addition, relative to its scale.
_ADDED = tuple(np.arange(-4.0, 2.1, 0.5).tolist())
# What the data say nothing of has a larger standard error of its logarithm.
_UNKNOWN = 5.0


@dataclass(frozen=True)
class RcFit:
    """A network with the parameters that are most likely.

    Attributes
    ----------
    likelihood : RcLikelihood
        Of the fitted rows.
    vector : ndarray, shape (p,)
        What was searched: the maximum of the likelihood, its process noise freed from bias.
    deviance : float
        −2 log L at its minimum.
    covariance : ndarray, shape (p, p)
        Of what was searched, from the second derivatives of log L.
    converged : bool
    """

    likelihood: RcLikelihood
    vector: Array
    deviance: float
    covariance: Array
    converged: bool

    @property
    def network(self) -> RcNetwork:
        """What was fitted."""
        return self.likelihood.network

    @property
    def parameters(self) -> int:
        """Number of parameters that were estimated."""
        return len(self.vector)

    @property
    def log_likelihood(self) -> float:
        """Logarithm of the likelihood of the readings."""
        return -0.5 * self.deviance

    @property
    def criteria(self) -> Criteria:
        """AIC and BIC."""
        return Criteria(self.deviance, self.parameters, self.likelihood.readings)

    @cached_property
    def estimates(self) -> dict[str, Estimate]:
        """Free parameters with 95 % intervals, by name."""
        errors = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return estimates(self.network.free, self.vector, errors)

    @property
    def unidentified(self) -> tuple[str, ...]:
        """Parameters of which the data say nothing, by name."""
        return tuple(p.name for p in self.network.free
                     if not is_identified(p, self.estimates[p.name]))  # fmt: skip

    @property
    def vanished(self) -> tuple[str, ...]:
        """Process noise and noise of readings that went to zero, by name."""
        zero = self.likelihood.space.at_zero(self.vector)
        return tuple(p.name for p, at in zip(self.network.free, zero, strict=True) if at)

    @property
    def values(self) -> dict[str, float]:
        """All parameters, fixed ones among them, by name."""
        found = self.likelihood.space.values(self.vector).tolist()
        return {p.name: v for p, v in zip(self.network.parameters, found, strict=True)}

    def unrest(self) -> float:
        """By how much −2 log L is larger where every piece begins at rest."""
        rest = replace(self.likelihood, from_rest=True)
        return float(rest.deviances(self.vector[None])[0]) - self.deviance


def fit_network(
    network: RcNetwork,
    logs: Sequence[Record],
    *,
    from_rest: bool = False,
    known: Mapping[str, float] | None = None,
    rows: Sequence[int] | None = None,
    at_most: float = np.inf,
) -> RcFit:
    """The most likely parameters of a network.

    Parameters
    ----------
    network : RcNetwork
    logs : sequence of Record
    from_rest : bool
        Logs begin at rest, settled without heat; else their starts are unknown.
    known : mapping of name to value, optional
        Estimates of a smaller network, to begin at.
    rows : sequence of int, optional
        How many rows of each piece are fitted. Default: all.
    at_most : float
        −2 log L of a network that is nested in this one: a search that ends above it is repeated
        from more starts.

    Raises
    ------
    FitError
        Nothing to fit, or no start from which the likelihood can be computed.
    """
    pieces = filter_pieces(network, logs)
    if rows is not None:
        pairs = zip(pieces, rows, strict=True)
        pieces = tuple(piece.until(count) for piece, count in pairs if count > 1)
    return fit_pieces(network, pieces, from_rest=from_rest, known=known, at_most=at_most)


def fit_pieces(
    network: RcNetwork,
    pieces: Sequence[FilterPiece],
    *,
    from_rest: bool = False,
    known: Mapping[str, float] | None = None,
    at_most: float = np.inf,
) -> RcFit:
    """As `fit_network`, of pieces."""
    begin = starts(network, data_scale(network, pieces), known or {})
    begin = begin[np.sort(np.unique(begin, axis=0, return_index=True)[1])]
    space = SearchSpace.around(network, begin[0])
    whole = RcLikelihood(network, space, tuple(pieces), from_rest)
    noise = _named(network, ".diffusion", ".noise")
    vector, deviance = _best_end(whole, begin, noise, _FIRST_STARTS)
    if deviance > at_most + _COARSE:
        vector, deviance = min((vector, deviance), _best_end(whole, begin, noise, _MORE_STARTS),
                               key=lambda end: end[1])  # fmt: skip
    expected, score = _held(whole, vector, whole.evaluated(vector)[1:])
    converged = float(score @ solve(expected, score)) < _CONVERGED
    unbiased = _unbiased(whole, vector, begin[0])
    covariance = _covariance(whole, unbiased, whole.evaluated(unbiased)[1])
    return RcFit(whole, unbiased, deviance, covariance, converged)


def _named(network: RcNetwork, *ends: str) -> Flags:
    """Which free parameters have such names, shape (p,)."""
    return np.array([p.name.endswith(ends) for p in network.free], dtype=bool)


def _best_end(whole: RcLikelihood, begin: Array, noise: Flags, count: int) -> tuple[Array, float]:
    """The most likely end of searches from `count` starts: the vector, and −2 log L there."""
    network = whole.network
    few = replace(whole, pieces=thinned(whole.pieces, _FIRST_ROWS))
    quiet = _named(network, ".diffusion")
    # Free from the first step, process noise would explain what wrong parameters leave.
    first = np.where(quiet, begin - _QUIET, begin)
    levels = few.deviances(first)
    order = [k for k in np.argsort(levels, kind="stable").tolist() if np.isfinite(levels[k])]
    if not order:
        raise FitError(f"{network.name}: the likelihood cannot be computed at any start: give "
                       "other start values")  # fmt: skip
    near: list[tuple[Array, float]] = []
    # What is known or declared is always among the starts, as is the limit of a smaller network.
    for vector in np.unique(first[[*order[:count], *range(min(2, len(first)))]], axis=0):
        _add(near, _search(few, vector, _FIRST_ITERATIONS, _COARSE, quiet))
    near = sorted(near, key=lambda end: end[1])[:_ENDS]
    ends = [_search(few, np.where(noise, begin[0], vector), _FIRST_ITERATIONS, _TOLERANCE)
            for vector, _ in near]  # fmt: skip
    ends.sort(key=lambda end: end[1])
    kept: list[tuple[Array, float]] = []
    for end in ends:
        if end[1] < ends[0][1] + _BEHIND:
            _add(kept, end)
    if few.readings < whole.readings:
        kept = [_search(whole, end[0], _ITERATIONS, _TOLERANCE) for end in kept]
    best = min(kept, key=lambda end: end[1])
    if not np.isfinite(best[1]):
        raise FitError(f"{network.name}: the likelihood cannot be computed: give start values")
    return best


def _unbiased(likelihood: RcLikelihood, vector: Array, scale: Array) -> Array:
    """The same parameters with the process noise that does not suffer from their number.

    Maximum likelihood takes for signal what the parameters follow of the noise, and intervals
    beside too small a process noise are too narrow. The likelihood adjusted for the parameters
    that are no noise, −2 log L + log det I (D. R. Cox, N. Reid, J. R. Stat. Soc. B 49 (1987) 1),
    is compared at the process noise of the fit and at larger ones.
    """
    process = _named(likelihood.network, ".diffusion")
    physical = ~_named(likelihood.network, ".diffusion", ".noise")
    others = np.ix_(physical, physical)
    best, lowest = vector, np.inf
    for added in [-np.inf, *_ADDED] if process.any() else ():
        moved = vector.copy()
        powers = np.exp(2 * vector[process]) + np.exp(2 * (scale[process] + added))
        moved[process] = 0.5 * np.log(powers)
        deviance, information, _ = likelihood.evaluated(moved)
        sign, volume = np.linalg.slogdet(information[others])
        if sign > 0 and deviance + volume < lowest:
            best, lowest = moved, deviance + float(volume)
    return best


def _add(ends: list[tuple[Array, float]], end: tuple[Array, float]) -> None:
    """Take an end that is none of those that are there."""
    if all(abs(end[1] - other[1]) > _SAME for other in ends):
        ends.append(end)


def _held(
    likelihood: RcLikelihood,
    vector: Array,
    equations: tuple[Array, Array],
    held: Flags | None = None,
) -> tuple[Array, Array]:
    """Information and score; what is held, or drawn beyond a bound, stays where it is."""
    space, (information, score) = likelihood.space, equations
    out = ((vector <= space.low) & (score < 0)) | ((vector >= space.high) & (score > 0))
    out = out if held is None else out | held
    information = np.where(out[:, None] | out, 0.0, information) + np.diag(out.astype(float))
    return information, np.where(out, 0.0, score)


def _search(
    likelihood: RcLikelihood,
    start: Array,
    iterations: int,
    tolerance: float,
    held: Flags | None = None,
) -> tuple[Array, float]:
    """Where damped scoring ends: the vector, and −2 log L there."""
    space = likelihood.space
    seen: dict[bytes, tuple[float, Array, Array]] = {}

    def evaluated(vector: Array) -> tuple[float, Array, Array]:
        key = vector.tobytes()
        if key not in seen:
            seen[key] = likelihood.evaluated(vector)
        return seen[key]

    found = minimize(
        start,
        lambda vector: evaluated(vector)[0],
        lambda vector: _held(likelihood, vector, evaluated(vector)[1:], held),
        lambda vector, step: space.clipped(vector + np.clip(step, -2.0, 2.0)),
        lambda vector: tolerance,
        iterations,
    )
    return found.point, found.value


def _covariance(likelihood: RcLikelihood, vector: Array, expected: Array) -> Array:
    """Inverse of half the second derivatives of −2 log L; of the expected ones where these fail.

    What the data say nothing of is left out, and has an endless standard error.
    """
    alone = 1.0 / np.sqrt(np.maximum(np.diag(expected), 1e-300))
    linear = np.array([p.scale == "linear" for p in likelihood.network.free])
    known = (alone < _UNKNOWN) | linear
    known &= ~likelihood.space.at_zero(vector)
    result = np.diag(np.where(known, 0.0, np.inf))
    if not known.any():
        return result
    inside = np.ix_(known, known)
    steps = np.where(linear, 0.3 * alone, np.minimum(0.3 * alone, 0.3))
    found = expected[inside]
    observed = likelihood.hessian(vector, steps)[inside]
    size = np.sqrt(np.diag(found))
    if np.isfinite(observed).all() and np.linalg.eigvalsh(observed / np.outer(size, size))[0] > 0:
        found = observed
    result[inside] = inverse_of(found)
    return np.asarray(result)
