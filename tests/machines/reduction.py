"""Reduction of the frame, a symmetric diffusive system, to a few states with its error measured.

A rational Krylov space (Galerkin, so stability is kept) gives an intermediate model that agrees
with the full one far below anything measurable; balanced truncation takes it to the order asked.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from thermaltool.plants.frame import PROBE_PAIRS, FramePlant
from thermaltool.plants.thermoelastic import galerkin_modes

Array = NDArray[np.float64]

_FREQUENCIES = np.geomspace(1e-6, 10.0, 400)  # [rad/s]


@dataclass(frozen=True)
class ReducedPlant:
    """``x' = A x + B Q``, ``y = C x``: the plant in few states, balanced and stable.

    Attributes
    ----------
    A : (order, order) ndarray
        [1/s]
    B : (order, 1) ndarray
        [1/s] per Q = 1.
    C : (outputs, order) ndarray
        In the units of `names`.
    names : tuple of str
        Output channels.
    error : (outputs,) ndarray
        Largest deviation of the frequency response over 1e-6 to 10 rad/s, per Q = 1 and in the
        unit of each output, from that of the intermediate model (150 Krylov directions).
    """

    A: Array
    B: Array
    C: Array
    names: tuple[str, ...]
    error: Array

    def transfer(self, s: NDArray[np.complexfloating]) -> NDArray[np.complexfloating]:
        """Frequency response, shape (outputs, frequencies); `s` in 1/s, shape (frequencies,)."""
        shifted = np.reshape(s, (-1, 1, 1)) * np.eye(len(self.A)) - self.A
        response: NDArray[np.complexfloating] = (self.C @ np.linalg.solve(shifted, self.B))[
            :, :, 0
        ].T
        return response


def reduce_frame(plant: FramePlant, order: int) -> ReducedPlant:
    """Continuous state space of heat Q [1] to the pair differences [K] and d_x, d_y [µm]."""
    names = (*PROBE_PAIRS, "d_x_um", "d_y_um")
    observe = np.array([plant.rows[name] for name in names])
    thermal = plant.thermal
    return reduce_symmetric(thermal.capacity, thermal.conduction, plant.heat, observe, names, order)


def reduce_symmetric(
    capacity: sparse.csc_array,
    conduction: sparse.csc_array,
    load: Array,
    observe: Array,
    names: tuple[str, ...],
    order: int,
) -> ReducedPlant:
    """Reduce ``capacity θ' + conduction θ = load Q``, ``y = observe θ`` to `order` states.

    Parameters
    ----------
    capacity, conduction : (n, n) sparse, symmetric positive definite
    load : (n,) ndarray
    observe : (outputs, n) ndarray
    names : tuple of str
        One per output.
    order : int
        Number of states.

    Raises
    ------
    ValueError
        `order` is not between 1 and that of the intermediate model.

    Notes
    -----
    Square-root balanced truncation (Antoulas 2005, section 7.3); the Gramians of a diagonal system
    are Cauchy matrices in closed form. Outputs are scaled by their steady values, so that kelvin
    and micrometre weigh alike.
    """
    rates, inputs, outputs = galerkin_modes(capacity, conduction, load[:, None], observe)
    if not 1 <= order <= rates.size:
        raise ValueError(f"order {order} is not between 1 and {rates.size}")
    scale = np.abs(outputs @ (inputs[:, 0] / rates))
    a, b, c = _balanced(rates, inputs, outputs / scale[:, None], order)
    plant = ReducedPlant(a, b, scale[:, None] * c, names, np.zeros(len(names)))
    s = 1j * _FREQUENCIES
    reference = outputs @ (inputs / (s + rates[:, None]))
    return replace(plant, error=np.abs(plant.transfer(s) - reference).max(axis=1))


def _balanced(rates: Array, b: Array, c: Array, order: int) -> tuple[Array, Array, Array]:
    """Balanced truncation of x' = -diag(rates) x + b u, y = c x."""
    sums = rates[:, None] + rates
    reach, observe = _factor(b @ b.T / sums), _factor(c.T @ c / sums)
    left, hankel, right = linalg.svd(observe.T @ reach)
    weight = 1.0 / np.sqrt(hankel[:order])
    test = observe @ left[:, :order] * weight
    trial = reach @ right[:order].T * weight
    return -(test.T * rates) @ trial, test.T @ b, c @ trial


def _factor(gramian: Array) -> Array:
    values, vectors = linalg.eigh(gramian)
    return vectors * np.sqrt(np.clip(values, 0.0, None))
