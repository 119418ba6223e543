"""Residual tests of every output of a network."""

from __future__ import annotations

import numpy as np

from thermaltool.identification.network.data import Records
from thermaltool.identification.network.identify import SHORTEST_RUN, runs_of
from thermaltool.identification.network.model import Network
from thermaltool.identification.transfer.data import Array
from thermaltool.identification.transfer.residuals import Cause, ResidualTests, tested


def network_tests(network: Network, data: Records) -> list[ResidualTests]:
    """Are the errors of each output white, and independent of the inputs.

    Parameters
    ----------
    network : Network
    data : Records
        Training or validation data.
    """
    computed = [network.simulate(s) for s in data.spans]
    return [_tested(network, data, computed, k) for k in range(len(network.shares))]


def _tested(network: Network, data: Records, computed: list[Array], k: int) -> ResidualTests:
    errors: list[Array] = []
    inputs: list[Array] = []
    for s, y in zip(data.spans, computed, strict=True):
        error = s.outputs[k] - y[k]
        rows = runs_of(np.where(np.isfinite(error), np.arange(len(s)), np.nan))
        for run in rows:
            place = run.astype(np.intp)
            if len(place) >= min(SHORTEST_RUN, len(s)):
                errors.append(error[place])
                inputs.append(s.inputs[:, place])
    share, causes = network.shares[k], {}
    for i, (name, hold) in enumerate(zip(data.names, data.holds, strict=True)):
        delay = round(share.delays[i] / data.dt) + (hold == "zero")
        runs = [u[i] - np.mean(u[i]) for u in inputs]
        causes[name] = Cause(runs, delay, 2 * share.modes)
    return tested(errors, causes, share.modes)
