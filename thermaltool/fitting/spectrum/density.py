"""The smooth spectrum: non-negative, its roughness held down as far as the evidence says.

Second differences of the spectrum are taken as normal; their size is that of the largest marginal
likelihood (D. J. C. MacKay, Neural Comput. 4 (1992) 415), before non-negativity is asked for.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar

from thermaltool.fitting.data import Array
from thermaltool.fitting.spectrum.compressed import CompressedTransient, non_negative

# Second differences of the spectrum in the total resistance: from nearly none to any.
SIZES = np.log(1e-8), np.log(1e2)


def smooth_spectrum(
    problem: CompressedTransient, grid: Array, variance: float, total: float
) -> Array:
    """Resistance at each place of a grid, shape (M,) [K/W].

    Parameters
    ----------
    problem : CompressedTransient
    grid : ndarray, shape (M,) [ln s]
        Even.
    variance : float [K²]
        Of the noise of a row.
    total : float [K/W]
        Resistance of all lines, for the scale.
    """
    columns, m = problem.columns(grid), len(grid)
    y, free = problem.y, columns
    if problem.linear:
        unit = problem.offset / np.linalg.norm(problem.offset)
        y, free = y - unit * (unit @ y), columns - np.outer(unit, unit @ columns)
    # Zero beyond both ends: the differences tell the spectrum.
    rough = 2 * np.eye(m) - np.eye(m, k=1) - np.eye(m, k=-1)
    directions, sizes, _ = np.linalg.svd(np.linalg.solve(rough, free.T).T, full_matrices=False)
    power = (directions.T @ y) ** 2

    def unlikelihood(log_size: float) -> float:
        spread = (total * np.exp(log_size) * sizes) ** 2 + variance
        return float(np.sum(np.log(spread) + power / spread))

    trials = np.linspace(*SIZES, 41)
    best = float(trials[int(np.argmin([unlikelihood(t) for t in trials]))])
    width = float(trials[1] - trials[0])
    found = minimize_scalar(unlikelihood, bounds=(best - width, best + width), method="bounded")
    weight = float(np.sqrt(variance)) / (total * float(np.exp(found.x)))
    # An offset has no roughness.
    rough = np.pad(rough, ((0, 0), (0, 2 * problem.linear)))
    whole = np.vstack([problem.bounded(columns), weight * rough])
    spectrum, _ = non_negative(whole, np.append(problem.y, np.zeros(m)))
    return np.asarray(spectrum[:m])
