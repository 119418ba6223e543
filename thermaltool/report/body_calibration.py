"""A finite-element model updated from logs: JSON document, table and sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from thermaltool.model import Model
from thermaltool.placement.updating import BodyParameter
from thermaltool.report.text import aligned
from thermaltool.report.thermal_modes import reduction_notes

# What is left of an output beside the noise of its readings, above which that is said.
MAX_LEFT = 3.0
NOT_SETTLED = (
    "the errors of the outputs do not settle how much each of them counts: take the intervals with "
    "care, and a longer log"
)
WORDS = {
    "film": "film coefficient",
    "conductivity": "conductivity",
    "heat": "share of the heat that enters",
    "expansion": "expansion, of the declared",
}


def update_document(parameters: Sequence[BodyParameter], model: Model) -> dict[str, Any]:
    """What ``calibrate --body --json`` writes."""
    return {
        "parameters": [
            {
                "kind": each.kind,
                "name": each.name,
                "declared": each.declared,
                "value": each.estimate.value,
                "interval_95": [each.estimate.low, each.estimate.high],
                "unit": each.estimate.unit,
                "identified": bool(each.identified),
            }
            for each in parameters
        ],
        "outputs": [{"channel": each.channel, "fit": dict(each.fit)} for each in model.outputs],
    }


def update_table(parameters: Sequence[BodyParameter], model: Model) -> str:
    """Each parameter before and after, and each output with its fit."""
    rows = [["parameter", "of", "declared", "by the logs, 95 %", "unit"]]
    for each in parameters:
        found = each.estimate
        said = f"{found.value:.4g} ({found.low:.4g} to {found.high:.4g})"
        rows.append([
            WORDS[each.kind], each.name, f"{each.declared:.4g}",
            said if each.identified else f"{said}, not identified", found.unit or "-",
        ])  # fmt: skip
    fits = [["output", "rmse", "zero free", "fit %", "max", "rows"]]
    for output in model.outputs:
        fit = output.fit
        fits.append(
            [output.channel, f"{fit['rmse']:.4g}", f"{fit['rmse_zero_free']:.4g}",
             f"{fit['fit_percent']:.2f}", f"{fit['max_error']:.3g}", str(fit["rows"])]
            if "rmse" in fit else [output.channel, "", "", "", "", "no log has it"]
        )  # fmt: skip
    return f"{aligned(rows)}\n\n{aligned(fits)}"


def update_notes(
    parameters: Sequence[BodyParameter], model: Model, noise: Mapping[str, float]
) -> list[str]:
    """What logs leave open, each a sentence."""
    notes = [
        f"{WORDS[each.kind].partition(',')[0]} of {each.name}: these logs say little of it, "
        "it stays near what is declared"
        for each in parameters
        if not each.identified
    ]
    for output in model.outputs:
        left, sigma = output.fit.get("rmse_zero_free", 0.0), noise.get(output.channel, 0.0)
        if sigma and left > MAX_LEFT * sigma:
            notes.append(
                f"{output.channel}: {left / sigma:.3g} times its noise is left: a log that begins "
                "warm, a room that drifts, heat and cooling "
                "that the declaration does not have, or a mesh that is coarse near the heat"
            )
    return [*notes, *reduction_notes(model)]
