"""A body as a model document: every heat into every output by few of its modes.

The modes that contribute most are kept as they are; what the others add is one lag more, with their
steady state and their first moment (static correction and moment matching about s = 0), so that
slow inputs are followed exactly whatever is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import ModelError
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.placement.body import SolidBody
from thermaltool.placement.sparse_solver import shifted_solver, symmetric_solver
from thermaltool.placement.thermal_modes import ThermalEigenmodes
from thermaltool.responses.rational import rational_kind
from thermaltool.units import UNITS, hold_of, is_absolute, parse_channel

Array = NDArray[np.float64]
# Modes of one term beside the lag of the rest, at most.
MAX_MODES = 5
# A part of the steady state that is left to the rest without a mode of its own.
NEGLIGIBLE = 1e-3
# Modes whose time constants differ by less are one.
SAME = 1e-6
# Angular frequencies at which the reduction is judged; in time constants, from 0.1/τ of the slowest
# mode to 3/τ of the fastest that is kept.
FREQUENCIES, SLOWEST_PART, FASTEST_PART = 9, 0.1, 3.0
MICROMETRES = 1e6  # per metre
METHOD = "modes of a finite-element model"


@dataclass(frozen=True)
class ReducedTerm:
    """Lags of one heat into one output, and how far they are from the mesh.

    Attributes
    ----------
    taus : ndarray, shape (k,) [s]
    gains : ndarray, shape (k,) [K/W] or [m/W]
    error : float
        Largest difference of the frequency responses, as part of the largest response.
    band : (float, float) [rad/s]
        Where it was looked for.
    """

    taus: Array
    gains: Array
    error: float
    band: tuple[float, float]


def reduced_terms(modes: ThermalEigenmodes) -> dict[tuple[int, int], ReducedTerm]:
    """Reduced responses by output (points, then deflections) and heat; no term where none acts.

    Parameters
    ----------
    modes : ThermalEigenmodes
    """
    equations = modes.equations
    solve = symmetric_solver(equations.conduction)
    second = np.array([solve(equations.capacity @ state) for state in modes.steady_states.T]).T
    moments = np.vstack([equations.readings @ second, equations.deflections @ second])
    found = {}
    scale = np.max(np.abs(modes.gains), axis=1)
    for k, h in np.ndindex(modes.gains.shape):
        if np.max(np.abs(modes.contributions[k, :, h])) > 1e-9 * scale[k]:
            found[k, h] = _lags(modes, k, h, float(moments[k, h]))
    if not found:
        return {}
    band = (
        SLOWEST_PART / float(modes.time_constants[0]),
        FASTEST_PART / min(float(term.taus.min()) for term in found.values()),
    )
    omega = np.geomspace(*band, FREQUENCIES)
    exact = np.zeros((FREQUENCIES, *modes.gains.shape), complex)
    for f, w in enumerate(omega):
        shifted = shifted_solver(equations.conduction, equations.capacity, 1j * w)
        states = np.array([shifted(load) for load in equations.loads.T]).T
        exact[f] = np.vstack([equations.readings @ states, equations.deflections @ states])
    errors = {}
    for (k, h), term in found.items():
        response = np.sum(term.gains / (1 + 1j * omega[:, None] * term.taus), axis=1)
        largest = max(float(np.max(np.abs(exact[:, k, h]))), abs(float(modes.gains[k, h])))
        error = float(np.max(np.abs(response - exact[:, k, h]))) / largest
        errors[k, h] = ReducedTerm(term.taus, term.gains, error, band)
    return errors


def _lags(modes: ThermalEigenmodes, k: int, h: int, moment: float) -> ReducedTerm:
    """The largest contributions, and the rest by its steady state and first moment."""
    each, taus, gain = modes.contributions[k, :, h], modes.time_constants, modes.gains[k, h]
    chosen: dict[float, float] = {}
    for j in np.argsort(-np.abs(each)):
        same = next((tau for tau in chosen if abs(tau - taus[j]) < SAME * tau), None)
        if same is not None:
            chosen[same] += float(each[j])
        elif len(chosen) < MAX_MODES and abs(each[j]) > NEGLIGIBLE * np.max(np.abs(each)):
            chosen[float(taus[j])] = float(each[j])
    rest = float(gain) - sum(chosen.values())
    if abs(rest) > NEGLIGIBLE**2 * np.max(np.abs(each)):
        tau = (moment - sum(t * g for t, g in chosen.items())) / rest
        # Parts of both signs have no lag of their own: they are taken for fast.
        fastest = min(chosen)
        tau = tau if 0 < tau < fastest else 0.5 * fastest
        chosen[tau] = chosen.get(tau, 0.0) + rest
    kept = sorted(chosen, reverse=True)
    return ReducedTerm(np.array(kept), np.array([chosen[t] for t in kept]), np.nan, (0.0, 0.0))


def reduced_model(
    modes: ThermalEigenmodes, body: SolidBody, provenance: Mapping[str, Any]
) -> Model:
    """Model document of a body, in the units of its channels.

    Parameters
    ----------
    modes : ThermalEigenmodes
    body : SolidBody
    provenance : mapping

    Raises
    ------
    ModelError
        Neither points nor deflections, or none that a heat reaches.
    """
    names, heat = (*body.points, *body.deflections), tuple(body.heat)
    if not names:
        raise ModelError("a model needs [points] or [deflections]: there are none")
    terms = reduced_terms(modes)
    if not terms:
        raise ModelError("no heat reaches a point or a deflection")
    fastest = min(float(term.taus.min()) for term in terms.values())
    document, errors = [], dict.fromkeys(names, 0.0)
    reach = {name: [0.0, 0.0] for name in names}
    for (k, h), term in terms.items():
        name = names[k]
        unit = UNITS[parse_channel(name).unit][1]
        per_unit = UNITS[parse_channel(heat[h]).unit][1] / unit
        scale = per_unit * (1.0 if name in body.points else MICROMETRES)
        values = {f"tau{i + 1}": float(tau) for i, tau in enumerate(term.taus)}
        values |= {f"K{i + 1}": scale * float(gain) for i, gain in enumerate(term.gains)}
        document.append(Term(heat[h], name, rational_kind(len(term.taus), 0)(**values)))
        errors[name] = max(errors[name], term.error)
        largest = scale * float(term.gains.sum()) * body.largest[heat[h]]
        reach[name][largest > 0] += largest
    band = next(iter(terms.values())).band
    statistics = {"method": METHOD, "band_hz": [w / (2 * np.pi) for w in band]}
    outputs = tuple(
        Output(
            name, "sensor" if name in body.points else "deflection",
            "first" if name in body.deflections or is_absolute(name) else 0.0,
            (reach[name][0], reach[name][1]), {**statistics, "reduction_error": errors[name]},
        )
        for name in names if any(term.output == name for term in document)
    )  # fmt: skip
    used = {term.drive for term in document}
    drives = tuple(
        Drive(name, hold_of(name), 0.0, (0.0, body.largest[name])) for name in heat if name in used
    )
    return Model(drives, outputs, tuple(document), fastest / 5, provenance)
