"""What ``estimate --method`` reports: every rule, and the one that was taken."""

from __future__ import annotations

from typing import Any

from thermaltool.estimation.deconvolution import Deconvolved
from thermaltool.report.text import aligned, symbol
from thermaltool.units import parse_channel


def deconvolution_table(found: Deconvolved) -> str:
    """A row for each rule, and a line that says which was taken, and why."""
    name = "future rows" if found.plan.method == "beck" else "\N{GREEK SMALL LETTER LAMDA}"
    unit = symbol(parse_channel(found.drive).unit)
    plan = found.plan
    # The rules of Tikhonov's methods look at the heat without bounds.
    is_free = (plan.low, plan.high) == (None, None) or not plan.method.startswith("tikhonov")
    residual = "residual/noise" if is_free else "residual/noise without bounds"
    rows = [["rule", name, f"expected error {unit}".rstrip(), residual, ""]]
    for each in found.choices:
        figures = each.parameter, each.expected_error, each.residual_over_noise
        refused = f"refused: {each.reason}" if each.reason else ""
        mark = "taken" if each.rule == found.chosen else ""
        told = ["-" if value is None else f"{value:.3g}" for value in figures]
        rows.append([str(each.rule), *told, "; ".join(filter(None, (mark, refused)))])
    by = f", by {found.chosen} ({found.reason})" if found.chosen else f" ({found.reason})"
    line = f"{found.drive} by {plan.method}: {name} = {found.parameter:.4g}{by}"
    line += f", residual/noise {found.residual_over_noise:.3g}"
    return f"{aligned(rows)}\n{line}" if found.choices else line


def deconvolution_document(found: Deconvolved) -> dict[str, Any]:
    """As JSON."""
    return {
        "method": found.plan.method,
        "drive": found.drive,
        "parameter": found.parameter,
        "rule": found.chosen,
        "reason": found.reason,
        "residual_over_noise": found.residual_over_noise,
        "at_least": found.plan.low,
        "at_most": found.plan.high,
        "notes": list(found.notes),
        "rules": [
            {
                "rule": each.rule,
                "parameter": each.parameter,
                "expected_error": each.expected_error,
                "residual_over_noise": each.residual_over_noise,
                "refused": each.reason or None,
            }
            for each in found.choices
        ],
    }
