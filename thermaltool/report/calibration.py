"""What ``calibrate`` reports: the fit of every output, and what the records leave open."""

from __future__ import annotations

from typing import Any

from thermaltool.model import Model, to_document
from thermaltool.report.text import aligned
from thermaltool.responses import Response, parameter_names


def calibration_table(model: Model) -> str:
    """Each output with its fit and its responses."""
    rows = [["output", "rmse", "zero free", "fit %", "max", "rows", "parameters"]]
    for output in model.outputs:
        fit = output.fit
        responses = [t.response for t in model.terms if t.output == output.channel]
        rows.append(
            [
                output.channel,
                f"{fit['rmse']:.4g}",
                f"{fit.get('rmse_zero_free', fit['rmse']):.4g}",
                f"{fit['fit_percent']:.2f}",
                f"{fit['max_error']:.3g}",
                str(fit["rows"]),
                "; ".join(map(_parameters, responses)),
            ]
        )
    return aligned(rows)


def calibration_warnings(model: Model) -> list[str]:
    """What the records leave open, each a sentence."""
    return [f"{o.channel}: {sentence}" for o in model.outputs for sentence in o.fit["unidentified"]]


def calibration_document(model: Model) -> dict[str, Any]:
    """Outputs and terms as the model file has them."""
    document = to_document(model)
    return {key: document[key] for key in ("outputs", "terms")}


def _parameters(response: Response) -> str:
    names = parameter_names(response.kind)
    return " ".join([response.kind, *(f"{n}={getattr(response, n):.4g}" for n in names)])
