"""What ``correct`` reports: fits before and after, on the records of the fit and on another."""

from __future__ import annotations

from typing import Any

import numpy as np

from thermaltool.effects.curve import Curve
from thermaltool.fitting.static import Corrected
from thermaltool.model import Model, agreements, relative
from thermaltool.record import Record

# A drive farther from its reference than this share of its range is on.
MAX_OFF_SHARE = 0.01


def correction_warnings(model: Model, record: Record) -> list[str]:
    """Drives that are on where a record begins, each a sentence."""
    sentences = []
    for drive in model.drives:
        first = relative(record.column(drive.channel), drive.reference, drive.hold)[0]
        if abs(first) > MAX_OFF_SHARE * max(map(abs, drive.range)):
            sentences.append(
                f"{record.name}: begins with {drive.channel} {first:g} away from rest: it is taken "
                "as switched on there, which misleads the fit where it was on before"
            )
    return sentences


def correction_table(found: Corrected, model: Model, fresh: Record | None) -> list[list[str]]:
    """Rows of a table: each output, then each curve at its knots.

    Parameters
    ----------
    found : Corrected
    model : Model
        Before the correction.
    fresh : Record or None
        For validation.
    """
    rows = [["output", "log", "fit before %", "after %", "rmse before", "after"]]
    for name, before in found.before.items():
        after = found.after[name]
        rows.append([name, "fitted", *_fits(before, after)])
        if fresh is not None:
            pair = agreements(model, [fresh])[name], agreements(found.model, [fresh])[name]
            rows.append([name, "validation", *_fits(*pair)])
    for curve in _curves(found, model):
        low, high = _span(found.model, curve)
        at = np.linspace(low, high, 5)
        shown = (f"{u:.4g} → {y:.4g}" for u, y in zip(at, curve.bent(at), strict=True))
        rows.append([curve.channel, curve.name, *list(shown)[1:]])
    return rows


def correction_document(found: Corrected, model: Model, fresh: Record | None) -> dict[str, Any]:
    """The same as JSON."""
    outputs: dict[str, Any] = {
        name: {"before": before.document(), "after": found.after[name].document()}
        for name, before in found.before.items()
    }
    if fresh is not None:
        before, after = agreements(model, [fresh]), agreements(found.model, [fresh])
        for name, each in outputs.items():
            each["validation"] = {
                "before": before[name].document(),
                "after": after[name].document(),
            }
    return {"outputs": outputs, "curves": [c.document() for c in _curves(found, model)]}


def _fits(before: Any, after: Any) -> list[str]:
    return [f"{before.fit_percent:.2f}", f"{after.fit_percent:.2f}",
            f"{before.rmse:.4g}", f"{after.rmse:.4g}"]  # fmt: skip


def _curves(found: Corrected, model: Model) -> list[Curve]:
    added = found.model.effects[len(model.effects) :]
    return [effect for effect in added if isinstance(effect, Curve)]


def _span(model: Model, curve: Curve) -> tuple[float, float]:
    ranges = {d.channel: d.range for d in model.drives} | {
        o.channel: o.range for o in model.outputs
    }
    return ranges[curve.channel]
