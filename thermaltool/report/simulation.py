"""What ``simulate`` and ``estimate`` report: how far the computed is from the measured."""

from __future__ import annotations

from collections.abc import Mapping

from thermaltool.report.text import aligned
from thermaltool.signals.agreement import Agreement

# Figures of an agreement.
HEADING = ["rmse", "zero free", "fit %", "max", "mean", "rows"]


def simulation_table(agreements: Mapping[str, Agreement]) -> str:
    """One row per output that was measured."""
    rows = [["output", *HEADING]]
    return aligned(rows + [[name, *_figures(a)] for name, a in agreements.items()])


def comparison_table(found: Mapping[str, Mapping[str, Agreement]]) -> str:
    """One row per model, output by output; the least RMSE is marked.

    Parameters
    ----------
    found : mapping of output to mapping of the model's name to Agreement
    """
    rows = [["output", "model", *HEADING, ""]]
    for output, models in found.items():
        least = min(a.rmse for a in models.values())
        for k, (name, a) in enumerate(models.items()):
            mark = "least rmse" if len(models) > 1 and a.rmse == least else ""
            rows.append(["" if k else output, name, *_figures(a), mark])
    return aligned(rows)


def _figures(a: Agreement) -> list[str]:
    return [
        f"{a.rmse:.4g}",
        f"{a.rmse_zero_free:.4g}",
        f"{a.fit_percent:.2f}",
        f"{a.max_error:.4g}",
        f"{a.mean:.3g}",
        str(a.rows),
    ]


def estimate_table(agreements: Mapping[str, Agreement]) -> str:
    """One row per estimate whose true value was measured."""
    rows = [["estimate", "band", "steady", "rmse", "max", "rows"]]
    for name, a in agreements.items():
        rows.append(
            [
                name,
                f"{a.band:.4g}",
                f"{a.steady:.3g}",
                f"{a.rmse:.4g}",
                f"{a.max_error:.4g}",
                str(a.rows),
            ]
        )
    return aligned(rows)
