"""The state space of networks in thermal modes, for a batch of parameter vectors at once.

With capacities C and the conductance matrix L, C^(-1/2) L C^(-1/2) = U Λ Uᵀ is symmetric: every
network's modes decay with real rates Λ, and z = Uᵀ C^(1/2) T are its coordinates. In them the
discretisation over any step is exact and elementwise: decays e^(−λ dt), process noise
D_ij (1 − e^(−(λi+λj) dt))/(λi + λj) (C. F. Van Loan, IEEE Trans. Autom. Control 23 (1978) 395, in
closed form).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermaltool.fitting.rc.network import RcNetwork, is_power, unit_factor

Array = NDArray[np.float64]

# Below this, differences of exponentials are taken by their series.
_SMALL = 1e-4


@dataclass(frozen=True)
class ThermalModes:
    """A batch of B networks of n nodes, q inputs (a constant last) and m outputs.

    Attributes
    ----------
    rates : ndarray, shape (B, n) [1/s]
        Ascending.
    gains : ndarray, shape (B, n, q)
        What each input puts into each mode per second.
    diffusion : ndarray, shape (B, n, n)
        Intensity of the process noise.
    outputs : ndarray, shape (B, m, n)
        Readings of the modes, in the units of the channels.
    variances : ndarray, shape (B, m)
        Of a reading [unit²].
    offsets : ndarray, shape (B, m)
    states : ndarray, shape (B, n, n)
        Node temperatures from modes.
    """

    rates: Array
    gains: Array
    diffusion: Array
    outputs: Array
    variances: Array
    offsets: Array
    states: Array

    def discretized(self, steps: Array) -> Discretization:
        """Exact over steps, shape (S,) [s]."""
        x = self.rates[:, :, None] * steps
        first, second = _ramps(x)
        pairs = self.rates[:, :, None] + self.rates[:, None, :]
        noise = self.diffusion[..., None] * steps * _ramps(pairs[..., None] * steps)[0]
        held = self.gains[..., None] * (first * steps)[:, :, None]
        ramp = self.gains[..., None] * (second * steps)[:, :, None]
        return Discretization(*(np.moveaxis(a, -1, 0) for a in (np.exp(-x), noise, held, ramp)))

    def settled(self, inputs: Array) -> Array:
        """Modes that stand still under constant inputs (q,), shape (B, n)."""
        return np.asarray((self.gains @ inputs) / self.rates)


@dataclass(frozen=True)
class Discretization:
    """Steps of S lengths.

    Attributes
    ----------
    decay : ndarray, shape (S, B, n)
    noise : ndarray, shape (S, B, n, n)
        Covariance that the process noise adds.
    held, ramp : ndarray, shape (S, B, n, q)
        What an input adds that is constant, and what its change over the step adds.
    """

    decay: Array
    noise: Array
    held: Array
    ramp: Array


def _ramps(x: Array) -> tuple[Array, Array]:
    """(1 − e^(−x))/x and (x − 1 + e^(−x))/x², of x ≥ 0."""
    safe = np.maximum(x, _SMALL)
    first = np.where(x < _SMALL, 1 - x / 2 + x**2 / 6, -np.expm1(-safe) / safe)
    return first, np.where(x < _SMALL, 0.5 - x / 6 + x**2 / 24, (1 - first) / safe)


def thermal_modes(network: RcNetwork, values: Array) -> ThermalModes:
    """Modes of a network for a batch of its parameters.

    Parameters
    ----------
    network : RcNetwork
    values : ndarray, shape (B, P)
        All parameters in the network's order; W/K, J/K, W √s and K.
    """
    at = {p.name: values[:, k] for k, p in enumerate(network.parameters)}
    capacity = np.stack([at[node.capacity.name] for node in network.nodes], axis=1)
    intensity = np.stack([at[node.diffusion.name] for node in network.nodes], axis=1)
    conductance, inputs = _heat_balance(network, at, len(values))

    root = np.sqrt(capacity)
    rates, vectors = np.linalg.eigh(conductance / (root[:, :, None] * root[:, None, :]))
    # What stays of rounding below the slowest rate is no growth.
    rates = np.maximum(rates, 1e-12 * rates[:, -1:])
    states = vectors / root[:, :, None]
    gains = np.swapaxes(states, 1, 2) @ inputs
    diffusion = np.einsum("bki,bk,bkj->bij", states, intensity**2, states)

    rows = [k for k, node in enumerate(network.nodes) if node.measured is not None]
    factor = np.array([unit_factor(channel) for channel in network.outputs])
    noise, offset = (
        np.stack([at[each.name] for each in found], axis=1) / factor
        for found in (
            [node.noise for node in network.measured if node.noise is not None],
            [node.offset for node in network.measured if node.offset is not None],
        )
    )
    outputs = states[:, rows] / factor[:, None]
    return ThermalModes(rates, gains, diffusion, outputs, noise**2, offset, states)


def _heat_balance(network: RcNetwork, at: Mapping[str, Array], batch: int) -> tuple[Array, Array]:
    """Conductance matrix [W/K], shape (B, n, n), and watts per unit of each input, (B, n, q)."""
    n, columns = len(network.nodes), network.inputs
    conductance = np.zeros((batch, n, n))
    inputs = np.zeros((batch, n, len(columns) + 1))
    for link in network.links:
        G = at[link.conductance.name]
        ends = [network.index(end) for end in link.ends]
        for own, other, name in zip(ends, ends[::-1], link.ends[::-1], strict=True):
            if own is None:
                continue
            conductance[:, own, own] += G
            if other is not None:
                conductance[:, own, other] -= G
                continue
            boundary = network.boundary(name)
            if boundary.channel is not None:
                column = columns.index(boundary.channel)
                inputs[:, own, column] += G * unit_factor(boundary.channel)
            elif boundary.temperature is not None:
                inputs[:, own, -1] += G * at[boundary.temperature.name]
    for each in network.heat:
        taken = [h.weight for h in network.heat if h.channel == each.channel and h.weight]
        weight = at[each.weight.name] if each.weight else 1.0 - at[taken[0].name]
        row = network.index(each.node)
        factor = unit_factor(each.channel) if is_power(each.channel) else 1.0
        inputs[:, row, columns.index(each.channel)] += weight * factor
    return conductance, inputs
