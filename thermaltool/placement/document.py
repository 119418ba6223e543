"""Regressions as a model document: every temperature drives through a gain, or through lags.

Along an axis the weight of a temperature goes with the position. It is written as bands of the
position (`thermaltool.effects.band`), between whose levels weights go in a straight line: exact for
a first power, and within `LEVELS` pieces for higher ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from thermaltool.effects.band import ScheduleBand
from thermaltool.errors import ModelError
from thermaltool.fitting.data import Array
from thermaltool.fitting.seen_changes import with_seen_changes
from thermaltool.model import Drive, Model, Output, Role, Term, relative, rest_level
from thermaltool.placement.regression import Column, RegressionProblem, ThermalRegression
from thermaltool.record import Record
from thermaltool.responses.rational import rational_kind
from thermaltool.units import Reference, drive_reference, hold_of, is_displacement

# Levels between which a weight of a higher power goes straight.
LEVELS = 17


def regression_document(
    fits: Sequence[tuple[RegressionProblem, ThermalRegression]],
    logs: Sequence[Record],
    provenance: Mapping[str, Any],
) -> Model:
    """All outputs of some regressions in one model.

    Parameters
    ----------
    fits : sequence of (RegressionProblem, ThermalRegression)
        One for each output.
    logs : sequence of Record
        That were fitted.
    provenance : mapping

    Raises
    ------
    ModelError
        Low-pass states whose weight goes with the position: no document has them.
    """
    terms: list[Term] = []
    outputs: list[Output] = []
    channels: dict[str, None] = {}
    for problem, found in fits:
        own = list(_terms(problem, found))
        if not own:
            raise ModelError(f"{problem.output}: no sensor has a weight")
        terms += own
        channels |= {term.drive: None for term in own}
        outputs.append(_output(problem, found))
    drives = tuple(_drive(name, logs) for name in channels)
    model = Model(drives, tuple(outputs), tuple(terms), logs[0].period, provenance)
    return with_seen_changes(model, logs)


def _terms(problem: RegressionProblem, found: ThermalRegression) -> Iterator[Term]:
    basis, where = problem.basis, {column: k for k, column in enumerate(found.columns)}
    levels = _levels(problem, found)
    for sensor in basis.sensors:
        own = {c: k for c, k in where.items() if c.sensor == sensor and found.weights[k] != 0}
        if not own:
            continue
        if not any(c.power for c in own):
            yield Term(sensor, problem.output, *_response(problem, found, own, None))
            continue
        if any(c.lag for c in own):
            raise ModelError(
                f"{sensor}: no model file has states whose weight goes with the position: leave "
                "the time constants out"
            )
        for index, level in enumerate(levels):
            parts = _response(problem, found, own, level)
            yield Term(
                sensor, problem.output, *parts, ScheduleBand(_position(problem), levels, index)
            )
    alone = {c: k for c, k in where.items() if c.sensor is None}
    if not alone:
        return
    position = _position(problem)
    if max(c.power for c in alone) == 1:
        yield Term(position, problem.output, *_response(problem, found, alone, None))
        return
    # P² is P times what goes straight between levels of P.
    lower = {Column(None, 0, c.power - 1): k for c, k in alone.items()}
    for index, level in enumerate(levels):
        parts = _response(problem, found, lower, level)
        yield Term(position, problem.output, *parts, ScheduleBand(position, levels, index))


def _position(problem: RegressionProblem) -> str:
    assert problem.basis.position is not None
    return problem.basis.position


def _levels(problem: RegressionProblem, found: ThermalRegression) -> tuple[float, ...]:
    if problem.basis.position is None:
        return ()
    at = np.concatenate([r.column(problem.basis.position) for r in problem.data.records])
    highest = max(c.power for c in found.columns)
    count = 2 if highest <= 1 else LEVELS
    return tuple(np.linspace(np.nanmin(at), np.nanmax(at), count).tolist())


def _response(
    problem: RegressionProblem,
    found: ThermalRegression,
    own: Mapping[Column, int],
    level: float | None,
) -> tuple[Any, Array, tuple[str, ...]]:
    """Gain, or gains of lags, at one position; their covariance and names."""
    taus = problem.basis.time_constants
    lags = 1 + len(taus)
    turn = np.zeros((lags, len(found.weights)))
    for column, k in own.items():
        turn[column.lag, k] = 1.0 if level is None else level**column.power
    weights, covariance = turn @ found.weights, turn @ found.covariance @ turn.T
    # A gain alone is a lag without weight beside it.
    times = taus or (problem.data.period,)
    values = {f"tau{k + 1}": float(tau) for k, tau in enumerate(times)}
    values |= {f"K{k + 1}": 0.0 for k in range(len(times))}
    names = tuple(f"K{k}" for k in range(lags))
    values |= dict(zip(names, weights.tolist(), strict=True))
    return rational_kind(len(times), 0, True)(**values), covariance, names


def _drive(name: str, logs: Sequence[Record]) -> Drive:
    hold, rest = hold_of(name), drive_reference(name)
    moved = [relative(log.column(name), rest, hold) for log in logs]
    low, high = (float(f([f(v) for v in moved])) for f in (np.nanmin, np.nanmax))
    begins = None
    if rest == "first":
        begins = float(np.mean([rest_level(log.column(name), rest, hold) for log in logs]))
    return Drive(name, hold, rest, (low, high), begins)


def _output(problem: RegressionProblem, found: ThermalRegression) -> Output:
    name = problem.output
    arbitrary = is_displacement(name)
    offset: Reference = "first" if arbitrary else float(np.mean(list(found.offsets.values())))
    role: Role = "deflection" if arbitrary else "sensor"
    moved = [problem.measured[problem.origin == e] for e in np.unique(problem.origin)]
    if arbitrary:
        moved = [values - values[0] for values in moved]
    low, high = (float(f([f(v) for v in moved])) for f in (np.min, np.max))
    fit = {"rmse": found.rmse, "rows": found.rows, "method": f"regression, {found.method}"}
    return Output(name, role, offset, (low, high), fit)
