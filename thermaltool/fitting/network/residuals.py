"""Residual tests of every output of a network."""

from __future__ import annotations

import numpy as np

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.network.model import Network
from thermaltool.fitting.transfer.colour import runs_of
from thermaltool.fitting.transfer.residuals import ResidualTests, tested


def network_tests(network: Network, data: TrainingData) -> list[ResidualTests]:
    """Are the errors of each output white, and independent of the inputs.

    Parameters
    ----------
    network : Network
    data : TrainingData
        Training or validation data.
    """
    computed = [network.simulate(s) for s in data.records]
    return [_tested(network, data, computed, k) for k in range(len(network.outputs))]


def _tested(network: Network, data: TrainingData, computed: list[Array], k: int) -> ResidualTests:
    runs = []
    for u, y, own in zip(data.u, data.y, computed, strict=True):
        error = y[k] - own[k]
        for run in runs_of(np.where(np.isfinite(error), np.arange(len(error)), np.nan)):
            place = run.astype(np.intp)
            runs.append((error[place], u[:, place]))
    output = network.outputs[k]
    delays = {
        name: round(delay / data.period) + (hold == "zero")
        for name, delay, hold in zip(data.inputs, output.delays, data.holds, strict=True)
    }
    return tested(runs, delays, 0)
