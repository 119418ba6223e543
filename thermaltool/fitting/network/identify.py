"""From records and a number of modes to a network, with intervals."""

from __future__ import annotations

import numpy as np

from thermaltool.errors import FitError, counted
from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.network.covariance import network_covariances
from thermaltool.fitting.network.model import Network, NetworkOutput
from thermaltool.fitting.network.problem import Delays, NetworkProblem
from thermaltool.fitting.network.search import METHOD, NetworkSearchResult, search
from thermaltool.signals.criteria import Criteria

# Time constants, as many as a kind of response holds.
MAX_MODES = 6


def identify_network(
    data: TrainingData, modes: int, delays: Delays, direct: bool = False
) -> Network:
    """Time constants that all outputs share, and the weights of each.

    Parameters
    ----------
    data : TrainingData
    modes : int
        Number of time constants.
    delays : tuple of tuple of float, for each output one for each input [s]
    direct : bool
        Whether outputs may follow the inputs of the same row; not with a delay.

    Raises
    ------
    FitError
        Data that carry no transfer function (`TrainingData.check`), a delay beyond the record, more
        modes than the data carry.
    """
    data.check()
    if not 1 <= modes <= MAX_MODES:
        raise FitError(f"{modes} modes: it takes 1 to {MAX_MODES}")
    if direct and np.any(delays):
        raise FitError("direct feedthrough and a dead time exclude each other")
    problem = NetworkProblem(data, delays, direct=direct)
    _refuse_overfit(problem, modes)
    found = search(problem, modes)
    return _network(problem, found)


def _refuse_overfit(problem: NetworkProblem, modes: int) -> None:
    data, need = problem.data, problem.linear_count(modes) + modes
    for k, (target, delays) in enumerate(zip(data.outputs, problem.delays, strict=True)):
        for name, delay in zip(data.inputs, delays, strict=True):
            if delay >= data.duration:
                raise FitError(
                    f"{name}: a delay of {delay:g} s is longer than the record "
                    f"({data.duration:g} s)"
                )
        rows = problem.rows(k)
        if rows < 2 * need:
            raise FitError(
                f"{target}: {rows} rows do not carry {counted(modes, 'mode')} with {need} "
                "parameters: take fewer or more data"
            )


def _network(problem: NetworkProblem, found: NetworkSearchResult) -> Network:
    data, n, m = problem.data, len(found.time_constants), len(problem.data.inputs)
    centres = problem.centres()
    covariances, variances = network_covariances(problem, found)
    outputs = []
    for k, f in enumerate(found.projected):
        weights = f.linear[: n * m].reshape(m, n)
        kept = n * m + problem.direct_count
        settled = f.linear[kept : kept + data.experiments] + centres[k]
        outputs.append(NetworkOutput(
            names=data.inputs,
            target=data.outputs[k],
            dt=data.period,
            time_constants=found.time_constants,
            weights=weights,
            direct=f.linear[n * m : kept],
            delays=problem.delays[k],
            holds=data.holds,
            levels=data.levels,
            zeros=tuple(settled.tolist()),
            sigma2=variances[k],
            covariance=covariances[k],
            method=METHOD,
            converged=found.converged,
            rows=f.rows,
            loss=f.loss,
        ))  # fmt: skip
    parameters = n + sum(output.parameters - n for output in outputs)
    return Network(tuple(outputs), Criteria(2 * found.criterion, parameters, data.rows))
