"""A finite-element model updated from logs: films, conductivities, heat that enters, expansion.

Each quantity is the declared one times e^p, p normal about zero (what is known before): the
estimate is the mode of p after the logs (Kennedy and O'Hagan 2001 have the same without a mesh).
A basis of few shapes that spans the responses over all that the parameters may be (Benner, Gugercin
and Willcox 2015, 4) makes a run as cheap as that of a model file; conduction is a sum of matrices
times e^p in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.optimize import least_squares

from thermaltool.errors import FitError
from thermaltool.fitting.error_model import effective_share
from thermaltool.placement.finite_elements import BodyEquations, FiniteElements
from thermaltool.placement.reduction import MICROMETRES
from thermaltool.placement.sparse_solver import symmetric_solver
from thermaltool.placement.thermal_modes import thermal_modes
from thermaltool.record import Record
from thermaltool.responses.propagation import propagate, recursion_of
from thermaltool.signals.intervals import Estimate, log_normal_estimate
from thermaltool.units import UNITS, hold_of, parse_channel

Array = NDArray[np.float64]
# What a declaration is known to [ln]: a film to a factor of 2, the rest to 10 and 20 %.
FILM, CONDUCTIVITY, HEAT, EXPANSION = "film", "conductivity", "heat", "expansion"
PRIOR = {FILM: np.log(2.0), CONDUCTIVITY: 0.1, HEAT: 0.2, EXPANSION: 0.1}
UNIT = {FILM: "W/(m² K)", CONDUCTIVITY: "W/(m K)", HEAT: "", EXPANSION: ""}
# Factors of the parameters at which the basis is exact, and vectors for each heat there.
SPREAD, MOMENTS = 4.0, 4
# Modes of the declared body in the basis; a shape that adds less is none.
BASIS_MODES, NEGLIGIBLE = 20, 1e-12
# A parameter of which the logs leave more than this part of what was open is not identified.
MAX_LEFT_OPEN = 0.7
# Turns of fit and of the size of the errors, until no weight moves by more than this part.
MAX_TURNS, SETTLED = 50, 0.01


@dataclass(frozen=True)
class BodyParameter:
    """A quantity of the declaration, before and after the logs.

    Attributes
    ----------
    kind : {"film", "conductivity", "heat", "expansion"}
    name : str
        Boundary, region, heat or deflection.
    declared : float
        In its unit; 1 for a heat and an expansion.
    factor, error : float
        Of the declared value, and the standard error of its logarithm.
    """

    kind: str
    name: str
    declared: float
    factor: float
    error: float

    @property
    def estimate(self) -> Estimate:
        """With a 95 % interval."""
        return log_normal_estimate(self.declared * self.factor, self.error, UNIT[self.kind])

    @property
    def identified(self) -> bool:
        """Whether the logs say more than the declaration did."""
        return self.error < MAX_LEFT_OPEN * PRIOR[self.kind]


class ReducedBody:
    """A body in a basis of few shapes, as a function of its parameters.

    Parameters
    ----------
    elements : FiniteElements
    outputs : sequence of str
        Points and deflections that are computed, in their units.
    """

    def __init__(self, elements: FiniteElements, outputs: Sequence[str]) -> None:
        self.body = body = elements.body
        self.heat = tuple(body.heat)
        self.parts = {(CONDUCTIVITY, n): m for n, m in elements.conductances().items()}
        self.parts |= {(FILM, n): m for n, m in elements.films().items()}
        deflections = [name for name in outputs if name in body.deflections]
        self.parameters = [*self.parts, *((HEAT, name) for name in self.heat)]
        self.parameters += [(EXPANSION, name) for name in deflections]
        self.outputs = tuple(outputs)
        self.equations = equations = elements.equations()
        rows = np.vstack([equations.readings.toarray(), equations.deflections])
        names = [*body.points, *body.deflections]
        scale = [
            (MICROMETRES if name in deflections else 1.0) / UNITS[parse_channel(name).unit][1]
            for name in outputs
        ]
        rows = np.array(scale)[:, None] * rows[[names.index(name) for name in outputs]]
        basis = _basis(equations, self.parts)
        per_unit = [UNITS[parse_channel(name).unit][1] for name in self.heat]
        self.conduction = {key: basis.T @ (part @ basis) for key, part in self.parts.items()}
        self.loads = basis.T @ equations.loads * per_unit
        self.rows = rows @ basis

    def run(self, values: Array, log: Record) -> Array:
        """Outputs from rest over a log, shape (outputs, n).

        Parameters
        ----------
        values : ndarray, shape (parameters,)
            Logarithms of the factors.
        log : Record
        """
        factor = dict(zip(self.parameters, np.exp(values).tolist(), strict=True))
        whole = sum(factor[key] * part for key, part in self.conduction.items())
        rates, turn = np.linalg.eigh(whole)
        steps, inverse = np.unique(np.diff(log.time), return_inverse=True)
        states = np.zeros((len(rates), len(log)))
        for heat, load in zip(self.heat, self.loads.T, strict=True):
            u = factor[HEAT, heat] * log.column(heat)
            phi, now, then = (
                each[:, inverse]
                for each in propagate(-rates[:, None], steps[None, :], hold_of(heat))
            )
            moved = recursion_of(phi, now * u[:-1] + then * u[1:])
            states += (turn.T @ load)[:, None] * moved
        bent = np.array([factor.get((EXPANSION, name), 1.0) for name in self.outputs])
        return np.asarray(bent[:, None] * (self.rows @ (turn @ states)))


def _basis(equations: BodyEquations, parts: Mapping[tuple[str, str], Any]) -> Array:
    """Shapes, orthonormal in the capacity, shape (n, r): modes, and moments at other parameters."""
    shapes = [thermal_modes(equations, BASIS_MODES).shapes]
    films = [key for key in parts if key[0] == FILM]
    spreads: list[dict[tuple[str, str], float]] = [
        {}, dict.fromkeys(films, SPREAD), dict.fromkeys(films, 1 / SPREAD)
    ]  # fmt: skip
    spreads += [{key: SPREAD} for key in films if len(films) > 1]
    for spread in spreads:
        whole = sum(spread.get(key, 1.0) * part for key, part in parts.items())
        solve = symmetric_solver(sparse.csr_array(whole))
        for load in equations.loads.T:
            state = solve(load)
            for _ in range(MOMENTS):
                shapes.append(state[:, None] / np.sqrt(state @ (equations.capacity @ state)))
                state = solve(equations.capacity @ shapes[-1][:, 0])
    every = np.hstack(shapes)
    sizes, turn = np.linalg.eigh(every.T @ (equations.capacity @ every))
    kept = sizes > NEGLIGIBLE * sizes[-1]
    return np.asarray(every @ (turn[:, kept] / np.sqrt(sizes[kept])))


@dataclass(frozen=True)
class UpdatedBody:
    """What logs say of a declared body.

    Attributes
    ----------
    parameters : tuple of BodyParameter
    equations : BodyEquations
        Of the mesh, with them.
    settled : bool
        Whether the weights of the outputs, which follow from the errors, came to rest.
    """

    parameters: tuple[BodyParameter, ...]
    equations: BodyEquations
    settled: bool


def update_body(elements: FiniteElements, logs: Sequence[Record]) -> UpdatedBody:
    """Parameters of a body by logs that begin at rest, and the equations of its mesh with them.

    Parameters
    ----------
    elements : FiniteElements
    logs : sequence of Record
        With every heat, and points or deflections of the body.

    Raises
    ------
    FitError
        No log has readings of a point or a deflection of the body, or one of these is constant.
    """
    body = elements.body
    every = (*body.points, *body.deflections)
    outputs = [name for name in every if any(_is_read(log, name) for log in logs)]
    if not outputs:
        named = ", ".join(every) or "it has none"
        raise FitError(f"no log has readings of a point or a deflection of the body: {named}")
    for name in outputs:
        if all(np.nanmin(log.column(name)) == np.nanmax(log.column(name))
               for log in logs if _is_read(log, name)):  # fmt: skip
            raise FitError(f"{name} is constant: there is nothing to fit")
    reduced = ReducedBody(elements, outputs)
    prior = np.array([PRIOR[kind] for kind, _ in reduced.parameters])
    weights = np.ones(len(outputs))

    def errors(values: Array) -> list[list[Array]]:
        """About the mean of each output in each log that has readings of it; NaN without one."""
        found: list[list[Array]] = [[] for _ in outputs]
        for log in logs:
            computed = reduced.run(values, log)
            for k, name in enumerate(outputs):
                if _is_read(log, name):
                    left = log.column(name) - computed[k]
                    found[k].append(left - np.nanmean(left))
        return found

    def stacked(values: Array) -> Array:
        parts = [
            weight * each[np.isfinite(each)]
            for weight, own in zip(weights, errors(values), strict=True)
            for each in own
        ]
        return np.concatenate([*parts, values / prior])

    values, settled = np.zeros(len(prior)), False
    for _ in range(MAX_TURNS):
        before = weights.copy()
        for k, own in enumerate(errors(values)):
            # Rows that follow each other err alike: they count as few as their correlation says.
            spread = np.sqrt(np.nanmean(np.concatenate(own) ** 2))
            weights[k] = np.sqrt(effective_share(own)) / max(spread, 1e-300)
        settled = bool(np.all(np.abs(weights - before) <= SETTLED * before))
        found = least_squares(stacked, values, x_scale=prior)
        values = found.x
        if settled:
            break
    slopes = np.asarray(found.jac, float)
    covariance = np.linalg.inv(slopes.T @ slopes)
    declared = {**{(CONDUCTIVITY, n): m.conductivity for n, m in body.materials.items()},
                **{(FILM, n): film for n, film in body.convection.items()}}  # fmt: skip
    parameters = tuple(
        BodyParameter(*key, declared.get(key, 1.0), float(np.exp(value)), float(error))
        for key, value, error in zip(
            reduced.parameters, values, np.sqrt(np.diag(covariance)), strict=True
        )
    )
    return UpdatedBody(parameters, _with(reduced, parameters), settled)


def _is_read(log: Record, name: str) -> bool:
    """Whether a log has at least one reading of a channel."""
    return name in log.columns and bool(np.isfinite(log.column(name)).any())


def _with(reduced: ReducedBody, parameters: Sequence[BodyParameter]) -> BodyEquations:
    """Equations of the mesh with other parameters."""
    factor = {(each.kind, each.name): each.factor for each in parameters}
    parts = [factor[key] * part for key, part in reduced.parts.items()]
    bent = [factor.get((EXPANSION, name), 1.0) for name in reduced.body.deflections]
    equations = reduced.equations
    return replace(
        equations,
        conduction=sparse.csr_array(sum(parts[1:], parts[0])),
        loads=equations.loads * [factor[HEAT, name] for name in reduced.heat],
        deflections=np.array(bent)[:, None] * equations.deflections,
    )
