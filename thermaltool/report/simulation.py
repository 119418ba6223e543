"""What ``simulate`` and ``estimate`` report: how far the computed is from the measured."""

from __future__ import annotations

from collections.abc import Mapping

from thermaltool.report.text import aligned
from thermaltool.signals.agreement import Agreement


def simulation_table(agreements: Mapping[str, Agreement]) -> str:
    """One row per output that was measured."""
    rows = [["output", "rmse", "zero free", "fit %", "max", "mean", "rows"]]
    for name, a in agreements.items():
        rows.append(
            [
                name,
                f"{a.rmse:.4g}",
                f"{a.rmse_zero_free:.4g}",
                f"{a.fit_percent:.2f}",
                f"{a.max_error:.4g}",
                f"{a.mean:.3g}",
                str(a.rows),
            ]
        )
    return aligned(rows)


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
