"""What is told of a finished diagnosis: how wrong the model was, where, and the curves to draw."""

from __future__ import annotations

import numpy as np

from thermaltool.diagnosis.residual import ResidualReport, residual_report
from thermaltool.diagnosis.result import Curves
from thermaltool.diagnosis.workbench import LIMIT, Workbench


def reports_of(
    first: Workbench, last: Workbench, plain: Workbench
) -> tuple[dict[str, ResidualReport], float]:
    """Every output's residual, and the share of its power that noise and floor account for.

    Parameters
    ----------
    first, last : Workbench
        Before any cause, and with all of them.
    plain : Workbench
        The model as calibrated, as a user simulates it.

    Returns
    -------
    reports : dict of output to ResidualReport
    share : float
        Of the worst output.
    """
    reports, share = {}, 1.0
    # Where what is left was taken for white, its noise is not that of the sensor.
    judged = first if "white" in last.state else last
    for output, seen in first.observed.items():
        white = judged.evidence[output].base(judged.state).white
        start = first.beginning(output)
        residual = [r - x for r, x in zip(plain.residual(output), start, strict=True)]
        rms = float(np.std(seen.whole(residual)))
        floor = LIMIT * first.floor(output) if "tight" in first.state else 0.0
        wrong = rms**2
        if "tight" in first.state:
            wrong = float(np.mean(seen.whole(first.corrected(output)) ** 2))
        accounted = 1 - max(wrong - white**2 - floor**2, 0.0) / rms**2 if rms else 1.0
        share = min(share, accounted)
        k = int(np.argmax([len(rows) for rows in seen.rows]))
        log = first.logs[k]
        known = {d.channel for d in first.model.drives}
        reports[output] = residual_report(
            log.time,
            residual[k],
            first.measured[k][output],
            {d: log.columns[d] for d in known},
            {c: v for c, v in log.columns.items() if c in first.scene().extra},
            white,
            floor,
        )
    return reports, share


def curves_of(
    first: Workbench, last: Workbench, plain: Workbench, extended: Workbench
) -> tuple[Curves, ...]:
    """Measured, simulated and extended of every log and output, from the start that each fits."""
    starts = {o: (first.beginning(o), last.beginning(o)) for o in first.observed}
    return tuple(
        Curves(
            log.digest,
            output,
            log.time,
            first.measured[k][output],
            plain.outputs[k][output] + before[k],
            extended.outputs[k][output] + after[k],
        )
        for k, log in enumerate(first.logs)
        for output, (before, after) in starts.items()
        if output in first.measured[k]
    )
