"""Open peers of `identify`, each as a user would run it who knows orders and delays.

Every function takes inputs (m, n), output (n,) and delays nk, and returns how the model that it
found answers other inputs from rest. The true system has two poles and two numerator coefficients
for each input. What has one denominator for all inputs gets their product: two poles for each, and
as many coefficients of each numerator. Methods without delays get inputs moved by the dead time.
"""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.signal import dlsim, lfilter

Array = NDArray[np.float64]
Delays = tuple[int, ...]
Simulation = Callable[[Array], Array]
Peer = Callable[[Array, Array, Delays], Simulation]

# Block rows of the subspace methods: default of the one, and what the other can afford.
BLOCK_ROWS = 20
# Markov parameters of all inputs together.
MARKOV = 300


def loaded() -> None:
    """Import what is installed, so that no fit is charged for it."""
    for name in ("sippy_unipi", "sysidentpy.model_structure_selection",
                 "nfoursid.nfoursid", "control"):  # fmt: skip
        with contextlib.suppress(ImportError):
            importlib.import_module(name)


def moved(u: Array, nk: Delays) -> Array:
    """Inputs delayed by their dead time; the records begin idle."""
    return np.array([np.r_[np.zeros(k - 1), row[: len(row) - k + 1]]
                     for row, k in zip(u, nk, strict=True)])  # fmt: skip


def state_space(A: Array, B: Array, C: Array, D: Array, nk: Delays) -> Simulation:
    system = tuple(np.asarray(each, float) for each in (A, B, C, D))

    def simulate(u: Array) -> Array:
        return np.ravel(dlsim((*system, 1.0), moved(u, nk).T)[1])

    return simulate


def rational(pairs: list[tuple[Array, Array]]) -> Simulation:
    """Numerator and denominator in descending powers of z for each input."""

    def simulate(u: Array) -> Array:
        total = np.zeros(u.shape[1])
        for row, (B, F) in zip(u, pairs, strict=True):
            total += lfilter(np.r_[np.zeros(len(F) - len(B)), B], F, row)
        return total

    return simulate


def sippy(method: str, u: Array, y: Array, nk: Delays) -> Simulation:
    from sippy_unipi import system_identification

    poles = 2 * len(u)
    if method in ("N4SID", "CVA"):
        found = system_identification(y[None], moved(u, nk), method, SS_fixed_order=poles,
                                      SS_f=BLOCK_ROWS, SS_p=BLOCK_ROWS)  # fmt: skip
        return state_space(found.A, found.B, found.C, found.D, nk)
    # Its delay counts on top of the one sample that every model has.
    numerators, delays = [[poles] * len(u)], [[k - 1 for k in nk]]
    orders = {"OE": [numerators, [poles], delays], "ARX": [[poles], numerators, delays],
              "ARMAX": [[poles], numerators, [poles], delays]}[method]  # fmt: skip
    if len(u) == 1:
        orders = [int(np.ravel(each)[0]) for each in orders]
    found = system_identification(y[None], u.copy(), method, **{f"{method}_orders": orders})
    G = found.G
    return rational([(np.ravel(G.num[0][i]), np.ravel(G.den[0][i])) for i in range(len(u))])


def sysidentpy(u: Array, y: Array, nk: Delays) -> Simulation:
    """Linear NARX with all true lags, the noise taken out of the estimate by residuals."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    poles = 2 * len(u)
    lags = [list(range(k, k + poles)) for k in nk]
    found = FROLS(order_selection=False, n_terms=poles * (len(u) + 1),
                  ylag=list(range(1, poles + 1)), xlag=lags if len(u) > 1 else lags[0],
                  elag=list(range(1, poles + 1)), estimator=LeastSquares(unbiased=True, uiter=30),
                  basis_function=Polynomial(degree=1))  # fmt: skip
    found.fit(X=u.T, y=y[:, None])

    def simulate(fresh: Array) -> Array:
        # Its free run starts from given values of the output: at rest they are zero.
        return np.ravel(found.predict(X=fresh.T, y=np.zeros((found.max_lag, 1))))

    return simulate


def nfoursid(u: Array, y: Array, nk: Delays) -> Simulation:
    import pandas as pd
    from nfoursid.nfoursid import NFourSID

    names = [f"u{i}" for i in range(len(u))]
    frame = pd.DataFrame(dict(zip(names, moved(u, nk), strict=True))).assign(y=y)
    method = NFourSID(frame, output_columns=["y"], input_columns=names, num_block_rows=BLOCK_ROWS)
    method.subspace_identification()
    found, _ = method.system_identification(rank=2 * len(u))
    return state_space(found.a, found.b, found.c, found.d, nk)


def control_era(u: Array, y: Array, nk: Delays) -> Simulation:
    """Markov parameters by least squares, then the eigensystem realization that fits better.

    Short Hankel matrices suit quick systems, long ones slow systems.
    """
    import control

    count = MARKOV // len(u)
    parameters = np.reshape(control.markov(y[None], moved(u, nk), m=count, dt=True),
                            (1, len(u), -1))  # fmt: skip
    found = []
    for half in (min(30, count // 3), (count - 1) // 2 - 1):
        s, _ = control.eigensys_realization(parameters, r=2 * len(u), m=half, n=half, dt=True)
        if np.all(np.abs(np.linalg.eigvals(s.A)) < 1):
            simulate = state_space(s.A, s.B, s.C, s.D, nk)
            found.append((float(np.sum((y - simulate(u)) ** 2)), simulate))
    if not found:
        raise ValueError("no stable realization")
    return min(found, key=lambda pair: pair[0])[1]


PEERS: dict[str, Peer] = {
    "SIPPY OE": partial(sippy, "OE"),
    "SIPPY ARX": partial(sippy, "ARX"),
    "SIPPY ARMAX": partial(sippy, "ARMAX"),
    "SIPPY N4SID": partial(sippy, "N4SID"),
    "SIPPY CVA": partial(sippy, "CVA"),
    "SysIdentPy": sysidentpy,
    "nfoursid": nfoursid,
    "python-control ERA": control_era,
}
