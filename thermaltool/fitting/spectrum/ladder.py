"""Foster and Cauer networks of one thermal impedance, and its structure function.

Z(s) = Σ R_i/(τ_i s + 1) is a row of cells R_i ‖ C_i (Foster). The ladder from the node to ambient
(Cauer) is its continued fraction 1/(C_1 s + 1/(R_1 + 1/(C_2 s + ...))), whose parts are those of
the heat path; their sums are the cumulative structure function (V. Székely and Tran Van Bien,
Solid-State Electron. 31 (1988) 1363; JESD51-14). The fraction loses digits with every part: it is
taken in decimal numbers whose digits are doubled until nothing changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Context, Decimal, Inexact, Rounded, localcontext

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array

# Decimal digits at first, and at most; parts that agree to this share are exact in a float.
FIRST_DIGITS, MAX_DIGITS, AGREED = 50, 6400, 1e-15


@dataclass(frozen=True)
class ThermalLadder:
    """A Cauer network: C_1 at the node, R_1 to C_2, ..., the last resistance to ambient.

    Attributes
    ----------
    resistances : ndarray, shape (N,) [K/W]
    capacities : ndarray, shape (N,) [J/K]
    """

    resistances: Array
    capacities: Array

    def cumulative(self) -> tuple[Array, Array]:
        """Structure function: capacity of the path up to a resistance, (N + 1,) each.

        It rises where a resistance is passed; the last one is that to ambient.
        """
        resistance = np.append(0.0, np.cumsum(self.resistances))
        capacity = np.cumsum(self.capacities)
        return resistance, np.append(capacity, capacity[-1])


def foster_capacities(taus: Array, resistances: Array) -> Array:
    """Capacities C_i = τ_i/R_i of the cells, shape (N,) [J/K].

    Parameters
    ----------
    taus : ndarray, shape (N,) [s]
    resistances : ndarray, shape (N,) [K/W]
    """
    return taus / resistances


def cauer_ladder(taus: Array, resistances: Array) -> ThermalLadder:
    """The ladder of the same impedance as the Foster cells.

    Parameters
    ----------
    taus : ndarray, shape (N,) [s]
        Different from each other, above zero.
    resistances : ndarray, shape (N,) [K/W]
        Above zero.

    Raises
    ------
    FitError
        No ladder to the digits of a float.
    """
    digits, before = FIRST_DIGITS, None
    while digits <= MAX_DIGITS:
        found = _fraction(taus.tolist(), resistances.tolist(), digits)
        if found is not None and before is not None and np.allclose(found, before, AGREED, 0.0):
            return ThermalLadder(found[1], found[0])
        digits, before = 2 * digits, found
    raise FitError("no Cauer network: two time constants are too near to each other")


def _fraction(taus: list[float], resistances: list[float], digits: int) -> Array | None:
    """Capacities and resistances of the ladder, shape (2, N); None where digits do not suffice."""
    with localcontext(Context(prec=digits, Emin=-999999999, Emax=999999999)) as context:
        context.traps[Inexact] = context.traps[Rounded] = False
        # Coefficients of s, the highest power first.
        above, below = [Decimal(0)], [Decimal(1)]
        for tau, resistance in zip(map(Decimal, taus), map(Decimal, resistances), strict=True):
            grown = [a + b for a, b in zip([tau * a for a in above] + [Decimal(0)],
                                           [Decimal(0), *above], strict=True)]  # fmt: skip
            added = [resistance * b for b in below]
            above = [a + b for a, b in zip(grown, [Decimal(0), *added], strict=True)]
            below = [a + b for a, b in zip([tau * b for b in below] + [Decimal(0)],
                                           [Decimal(0), *below], strict=True)]  # fmt: skip
        above = above[len(above) - len(taus) :]
        parts: list[tuple[float, float]] = []
        for _ in taus:
            capacity = below[0] / above[0]
            left = [b - capacity * a for b, a in zip(below[1:], [*above[1:], Decimal(0)],
                                                     strict=True)]  # fmt: skip
            if not left[0] > 0:
                return None
            resistance = above[0] / left[0]
            rest = [a - resistance * b for a, b in zip(above[1:], left[1:], strict=True)]
            parts.append((float(capacity), float(resistance)))
            above, below = rest, left
            if above and not above[0] > 0:
                return None
    return np.array(parts).T
