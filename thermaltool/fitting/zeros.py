"""Zeros of the sensors of a model that several logs have calibrated.

The fit leaves the zero of every log free. The one that is written is their mean, each weighed by
how surely its log shows it: by the standard error of the fit, by the level of the readings where a
log begins at rest, and by how far logs scatter beyond both. A log that begins warm hardly pulls.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from thermaltool.fitting.start_choice import rests
from thermaltool.model import Drive, Model, Output, drive_rests, rest_shifts
from thermaltool.record import Record
from thermaltool.responses.modes import Float
from thermaltool.signals.resolution import reading_sigma
from thermaltool.signals.start_level import MEDIAN_LOSS, start_level
from thermaltool.units import is_absolute

# A zero is known to no less than this of itself, or of one unit.
ROUNDING = 1e-9


def with_zeros(model: Model, records: Sequence[Record]) -> Model:
    """The model with one zero for every sensor, and what its temperatures at rest go with.

    The zeros at rest go with what is measured of the room where these records do not deny it.

    Parameters
    ----------
    model : Model
        As fitted: ``offsets`` and their ``offset_errors`` in the fit of each output, by record.
    records : sequence of Record
        Those of the calibration.
    """
    levels = [drive_rests(model, record) for record in records]
    drives = tuple(
        replace(d, rest=float(np.mean([each[d.channel] for each in levels])))
        if d.reference == "first" and is_absolute(d.channel)
        else d
        for d in model.drives
    )
    moved = replace(model, drives=drives)
    shifts = [rest_shifts(moved, each) for each in levels]
    plain, with_rests = 0.0, 0.0
    for output in model.outputs:
        if output.channel in shifts[0]:
            zeros = np.array(output.fit["offsets"])
            left = zeros - [each[output.channel] for each in shifts]
            white = output.fit["noise"] or 1.0
            plain += float(np.var(zeros)) / white**2
            with_rests += float(np.var(left)) / white**2
    if with_rests > plain:
        moved, shifts = model, [{} for _ in records]
    if len(records) < 2:
        return moved
    outputs = tuple(_joint(o, moved.drives, records, shifts) for o in moved.outputs)
    return replace(moved, outputs=outputs)


def _joint(
    output: Output,
    drives: Sequence[Drive],
    records: Sequence[Record],
    shifts: Sequence[Mapping[str, float]],
) -> Output:
    """The output with the zero that all logs speak for, and the zero that each shows."""
    if output.offset == "first":
        return output
    fit, channel = output.fit, output.channel
    drift = float(fit["discrepancy"]["drift_sigma"])
    own = [
        _shown(zero, error, drift, record, drives, channel)
        for zero, error, record in zip(fit["offsets"], fit["offset_errors"], records, strict=True)
    ]
    values, variances, still = np.array(own).T
    values = values - [each.get(channel, 0.0) for each in shifts]
    at_rest = still > 0
    if at_rest.any():
        off = values - _weights(values[at_rest], variances[at_rest]) @ values[at_rest]
        variances = np.where(at_rest, variances, np.maximum(variances, off**2))
    weights = _weights(values, variances)
    shown = {"zeros_shown": values.tolist(), "zero_weights": weights.tolist()}
    return replace(output, offset=float(weights @ values), fit={**fit, **shown})


def _shown(
    zero: float, error: float, drift: float, record: Record, drives: Sequence[Drive], channel: str
) -> tuple[float, float, bool]:
    """The zero that a log shows, its variance, and whether it begins at rest.

    Of the fit, and of its readings at rest.
    """
    readings = record.column(channel)
    white = reading_sigma(readings)
    rows = int(np.isfinite(readings).sum())
    # No level is better known than the mean of all readings.
    if not rows:
        return zero, np.inf, False
    least = (ROUNDING * max(abs(zero), 1.0)) ** 2
    variance = max(error**2, white**2 / rows, least)
    if not rests(record, drives, [channel]):
        return zero, variance, False
    level = start_level(readings)
    # A drift beyond the noise would show in rows that stand still: there it is misfit.
    at_rest = max((MEDIAN_LOSS * white) ** 2 / level.rows + min(drift, white) ** 2, least)
    known = 1 / variance + 1 / at_rest
    return (zero / variance + level.value / at_rest) / known, 1 / known, True


def _weights(values: Float, variances: Float) -> Float:
    """Weights of a mean under a scatter between the values, shape (n,); they add up to one.

    The variance of the scatter is that of the moments of the weighted squares (R. DerSimonian and
    N. Laird, Controlled Clinical Trials 7 (1986) 177).
    """
    weights = 1 / variances
    centre = float(weights @ values / weights.sum())
    # Logs without readings are of no weight.
    excess = float(weights @ (values - centre) ** 2) - (np.count_nonzero(weights) - 1)
    freedom = float(weights.sum() - (weights @ weights) / weights.sum())
    scatter = max(excess / freedom, 0.0) if freedom > 0 else 0.0
    weights = 1 / (variances + scatter)
    return weights / weights.sum()
