"""Covariance of shared time constants and of each output's weights, under coloured errors."""

from __future__ import annotations

from collections.abc import Iterator

from thermaltool.fitting.data import Array
from thermaltool.fitting.joint import Sensitivities, joint_covariances
from thermaltool.fitting.network.problem import NetworkProblem
from thermaltool.fitting.network.search import NetworkSearchResult


def network_covariances(
    problem: NetworkProblem, found: NetworkSearchResult
) -> tuple[list[Array], list[float]]:
    """Covariance of ln τ and the weights of every output, and the variance of its errors.

    Parameters
    ----------
    problem : NetworkProblem
    found : NetworkSearchResult

    Returns
    -------
    covariances : list of ndarray, shape (N + m · N + d, N + m · N + d)
        Of the logarithms of the N time constants, then of the weights input by input, then of the
        d feedthroughs.
    variances : list of float [unit²]
    """
    taus, outputs = found.time_constants, range(len(found.projected))

    def records() -> Iterator[Sensitivities]:
        for j, place in enumerate(problem.places(len(taus), False)):
            rows = [problem.sensitivities(j, k, taus, found.projected[k]) for k in outputs]
            yield Sensitivities(place, [slopes for slopes, _ in rows], [own for _, own in rows])

    errors: list[list[Array]] = [[] for _ in outputs]
    for k, _, error in problem.errors(taus, found.projected):
        errors[k].append(error)
    own = len(taus) * len(problem.data.inputs) + problem.direct_count
    return joint_covariances(found.projected, errors, records, own)
