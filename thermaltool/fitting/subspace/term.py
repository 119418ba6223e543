"""Sections and their weights as the parameters of a rational response, and how sure these are."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from thermaltool.fitting.data import Array
from thermaltool.fitting.subspace.sections import PoleSection
from thermaltool.responses.rational import oscillation_names, rational_kind

# Half the step by which parameters of the response are differentiated, as a share of each.
DIFFERENCE = 1e-6


def kind_of(sections: Sequence[PoleSection], direct: bool) -> type:
    """The class of response that has these poles.

    Parameters
    ----------
    sections : sequence of PoleSection
    direct : bool

    Raises
    ------
    ModelError
        More poles than a response has.
    """
    pairs = sum(section.is_pair for section in sections)
    lags = sum(section.states for section in sections) - 2 * pairs
    found: type = rational_kind(lags, pairs, direct)
    return found


def searched_names(sections: Sequence[PoleSection]) -> tuple[str, ...]:
    """Names of the parameters that poles have, as the response has them."""
    return tuple(kind_of(sections, False).searched)  # type: ignore[attr-defined]


def response_values(
    sections: Sequence[PoleSection], weights: Array, direct: float | None, dt: float
) -> dict[str, float]:
    """Parameters of the response to one input, by name.

    Parameters
    ----------
    sections : sequence of PoleSection
    weights : ndarray, shape (N,)
        Of both states, section by section.
    direct : float or None
        Feedthrough, where there is any.
    dt : float [s]
        Sample period.
    """
    values: dict[str, float] = {}
    lags: list[tuple[float, float]] = []
    at = pairs = 0
    for section in sections:
        own = weights[at : at + section.states]
        at += section.states
        if section.is_pair:
            pairs += 1
            omega, zeta = np.exp(section.theta)
            found = (float(own[0]), float(own[1]), float(omega / dt), float(min(zeta, 1 - 1e-12)))
            values |= dict(zip(oscillation_names(pairs), found, strict=True))
            continue
        p = section.poles.real
        if section.states == 1:
            lags.append((-dt / float(p[0]), float(own[0])))
            continue
        omega = np.exp(section.theta[0])
        for here, other in ((p[0], p[1]), (p[1], p[0])):
            gain = -(own[0] * omega**2 + own[1] * omega * here) / ((here - other) * here)
            lags.append((-dt / float(here), float(gain)))
    for k, (tau, gain) in enumerate(sorted(lags, reverse=True), start=1):
        values |= {f"tau{k}": tau, f"K{k}": gain}
    return values if direct is None else {**values, "K0": float(direct)}


def _off_double(section: PoleSection) -> tuple[float, ...]:
    """Logarithms so far from ζ = 1 that a step turns no two real poles into a pair."""
    if section.states == 1:
        return section.theta
    omega, zeta = section.theta
    least = 2 * DIFFERENCE
    return omega, min(zeta, -least) if section.is_pair else max(zeta, least)


def response_slopes(
    sections: Sequence[PoleSection], weights: Array, direct: float | None, dt: float,
    names: Sequence[str],
) -> Array:  # fmt: skip
    """Derivatives of the named parameters of the response, shape (len(names), N + N + 1 or + 0).

    By the logarithms of the sections, by the weights, and by the feedthrough where there is any.

    Parameters
    ----------
    sections, weights, direct, dt
        As `response_values`.
    names : sequence of str
    """
    theta = np.concatenate([_off_double(section) for section in sections])
    edges = np.cumsum([0, *(section.states for section in sections)])
    n = len(theta)
    given = np.concatenate([theta, weights, [] if direct is None else [direct]])

    def at(values: Array) -> Array:
        own = [PoleSection(tuple(values[a:b].tolist())) for a, b in pairwise(edges.tolist())]
        last = None if direct is None else float(values[-1])
        found = response_values(own, values[n : 2 * n], last, dt)
        return np.array([found[name] for name in names])

    columns = []
    size = max(float(np.max(np.abs(weights), initial=0.0)), 1e-300)
    for k in range(len(given)):
        step = np.zeros(len(given))
        step[k] = DIFFERENCE if k < n else DIFFERENCE * size
        columns.append((at(given + step) - at(given - step)) / (2 * step[k]))
    return np.array(columns).T
