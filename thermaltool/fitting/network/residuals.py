"""Residual tests of every output of a network."""

from __future__ import annotations

import numpy as np

from thermaltool.fitting.network.data import Records
from thermaltool.fitting.network.identify import runs_of
from thermaltool.fitting.network.model import Network
from thermaltool.fitting.transfer.data import Array
from thermaltool.fitting.transfer.residuals import ResidualTests, tested


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
    runs = []
    for s, y in zip(data.spans, computed, strict=True):
        error = s.outputs[k] - y[k]
        for run in runs_of(np.where(np.isfinite(error), np.arange(len(s)), np.nan)):
            place = run.astype(np.intp)
            runs.append((error[place], s.inputs[:, place]))
    share = network.shares[k]
    delays = {
        name: round(delay / data.dt) + (hold == "zero")
        for name, delay, hold in zip(data.names, share.delays, data.holds, strict=True)
    }
    return tested(runs, delays, 0)
