"""How far the drives of a model can move its outputs, whatever a log shows of it."""

from __future__ import annotations

import numpy as np

from thermaltool.model.document import Model
from thermaltool.responses.modes import Float

# Instants of a step response that are looked at, up to so many of the slowest time constants.
INSTANTS, TIME_CONSTANTS = 200, 10.0


def spans(model: Model) -> dict[str, float]:
    """Largest change of every output by a step of each drive over its calibrated range, summed.

    Not the steady state alone: what bends one way and the other may end where it began.

    Parameters
    ----------
    model : Model
    """
    widths = {drive.channel: drive.range[1] - drive.range[0] for drive in model.drives}
    slowest = max((term.response.slowest() for term in model.terms), default=0.0)
    last = max(TIME_CONSTANTS * slowest, 2 * model.sample_period)
    time = np.geomspace(model.sample_period, last, INSTANTS)
    steps: dict[tuple[str, str], Float] = {}
    for term in model.terms:
        pair = term.drive, term.output
        steps[pair] = steps.get(pair, 0.0) + np.asarray(term.response.step(time))
    found = dict.fromkeys((o.channel for o in model.outputs), 0.0)
    for (drive, output), step in steps.items():
        found[output] += widths[drive] * float(np.max(np.abs(step)))
    return found
