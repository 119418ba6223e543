"""Calibration of many drives that say much the same: components of them, as `identify` has them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from thermaltool.fitting.calibrate import as_simulated
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.fitting.components.plan import ComponentPlan
from thermaltool.fitting.components.reduction import Reduction
from thermaltool.fitting.document import model_document
from thermaltool.fitting.fit import Fit
from thermaltool.fitting.identification import identify
from thermaltool.fitting.seen_changes import with_seen_changes
from thermaltool.model import Model
from thermaltool.record import Record
from thermaltool.signals.resolution import reading_sigma


def calibrate_reduced(
    records: Sequence[Record], plan: CalibrationPlan, reduction: Reduction
) -> tuple[Model, tuple[Fit, ...]]:
    """Every output of `plan` as weights of all drives, directly and through lags.

    Parameters
    ----------
    records : sequence of Record
        With the channels of `plan`.
    plan : CalibrationPlan
        Whose channels, reference and initial state count.
    reduction : Reduction

    Returns
    -------
    model : Model
        With a term for each drive as it is measured.
    fits : tuple of Fit
        One for each output.

    Raises
    ------
    ModelError
        See `CalibrationPlan.check`.
    FitError
        Data that carry no such model.
    """
    plan.check()
    roles = {channel: role for channel, role, _ in plan.outputs()}
    fits = identify(records, plan.drives, tuple(roles),
                    ComponentPlan(reduction=reduction, initial=plan.initial),
                    reference=plan.reference)  # fmt: skip
    provenance = {"logs": [record.source for record in records if record.digest]}
    model = model_document(fits, plan.reference, provenance)
    outputs = tuple(
        replace(
            output,
            role=roles[output.channel],
            fit={
                **output.fit,
                "noise": max(reading_sigma(record.column(output.channel)) for record in records),
                "unidentified": [],
            },
        )
        for output in model.outputs
    )
    model = with_seen_changes(replace(model, outputs=outputs), records)
    return as_simulated(model, records), fits
