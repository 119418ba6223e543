"""Regressions of thermal errors as a JSON document and as text."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from thermaltool.documents import jsonable
from thermaltool.report.style import channel_unit
from thermaltool.report.text import aligned
from thermaltool.signals.intervals import NORMAL_95

if TYPE_CHECKING:
    from collections.abc import Sequence

    from thermaltool.placement.regression import Column
    from thermaltool.placement.robustness import OutputRegression

CHOSEN_ON_ALL = "time constants and terms are chosen on all rows of the fitted logs"


def regression_json(outputs: Sequence[OutputRegression]) -> list[dict[str, Any]]:
    """What ``regress --json`` writes of each output."""
    return [_output(each) for each in outputs]


def _output(each: OutputRegression) -> dict[str, Any]:
    own, basis = each.regression, each.problem.basis
    return {
        "output": each.problem.output,
        "method": own.method,
        "rmse": own.rmse,
        "rows": own.rows,
        "free_weights": own.freedom,
        "time_constants_s": list(basis.time_constants),
        "position": basis.position,
        "terms": [
            {
                "sensor": column.sensor,
                "state": column.lag,
                "power": column.power,
                "weight": float(weight),
                "standard_error": float(deviation),
            }
            for column, weight, deviation in zip(
                own.columns, own.weights, own.deviations, strict=True
            )
        ],
        "trials": [
            {"method": method, "form": form,
             "rmse": {trial: jsonable(error) for trial, error in errors.items()}}
            for (method, form), errors in each.errors.items()
        ],
    }  # fmt: skip


def regression_table(outputs: Sequence[OutputRegression]) -> str:
    """Of every output the weights, and the errors of every method in every trial."""
    return "\n\n".join(part for each in outputs for part in _parts(each))


def _parts(each: OutputRegression) -> tuple[str, str]:
    own, basis, output = each.regression, each.problem.basis, each.problem.output
    unit = channel_unit(output)
    lags = ", ".join(f"{tau:.3g}" for tau in basis.time_constants)
    rows = [["term", "weight", "95 %"]]
    for column, weight, deviation in zip(own.columns, own.weights, own.deviations, strict=True):
        half = NORMAL_95 * float(deviation)
        rows.append([_name(column, basis.time_constants, basis.position), f"{weight:.4g}",
                     f"± {half:.2g}"])  # fmt: skip
    head = (
        f"{output} [{unit}]: {own.method}, {own.freedom:.3g} of {len(own.weights)} weights free"
        f"{f', states of {lags} s' if lags else ''}; {own.rows} rows, RMS error {own.rmse:.3g}"
    )
    trials = list(next(iter(each.errors.values())))
    errors = [["method", "form", *trials]]
    for (method, form), values in each.errors.items():
        cells = ["-" if math.isnan(e) else f"{e:.3g}" for e in values.values()]
        errors.append([method, form, *cells])
    return (
        f"{head}\n{aligned(rows, 1)}",
        f"RMS error over rows that the weights were not fitted to [{unit}]; {CHOSEN_ON_ALL}:\n"
        f"{aligned(errors, 2)}",
    )


def _name(column: Column, taus: tuple[float, ...], position: str | None) -> str:
    parts = []
    if column.power:
        parts.append(f"{position}^{column.power}" if column.power > 1 else f"{position}")
    if column.sensor is not None:
        lag = f" after {taus[column.lag - 1]:.3g} s" if column.lag else ""
        parts.append(column.sensor + lag)
    return " · ".join(parts)
