"""Causes that the logs would have shown and did not."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from thermaltool.diagnosis.residual import ResidualReport
    from thermaltool.diagnosis.result import Tried

# A cause is ruled out where this fraction of what matters would have been seen: then what matters
# has four times the evidence or more, which noise seldom takes away.
MAX_FRACTION = 0.5
# Causes of any period or course: what one of them would have shown says nothing of the others.
# So do sources that nobody logged.
OF_ANY_COURSE = ("periodic",)
# Evidence is the fall of BIC, of which exp(half) is odds; more than these are not told.
MAX_ODDS = 1000.0


@dataclass(frozen=True)
class RuledOut:
    """A cause that is not there in a size that matters.

    Attributes
    ----------
    name, channel : str
    output : str
        In which it would be seen first.
    above : float [unit of the output]
        RMS change of the output that the logs would have shown.
    matters : float [unit of the output]
        The tolerance or, without one, the residual that was to be explained.
    odds : float
        Against the cause; 1000 stands for more.
    """

    name: str
    channel: str
    output: str
    above: float
    matters: float
    odds: float


def ruled_out(
    tried: Sequence[Tried],
    residuals: Mapping[str, ResidualReport],
    named: Collection[tuple[str, str]],
    tolerance: Mapping[str, float],
) -> tuple[RuledOut, ...]:
    """Causes without any evidence, of which half of what matters would have been seen.

    Parameters
    ----------
    tried : sequence of Tried
    residuals : mapping of output to ResidualReport
    named : collection of (name, channel)
        Causes that are accepted, and what they could be instead.
    tolerance : mapping of output to float [unit of the output]

    Returns
    -------
    tuple of RuledOut, the surest first
    """
    found = []
    for each in tried:
        output, seen = each.output, each.detectable
        if output is None or seen is None or (each.name, each.channel) in named:
            continue
        if each.name in OF_ANY_COURSE or not each.channel:
            continue
        report = residuals.get(output)
        matters = tolerance.get(output, report.spread if report else 0.0)
        if each.evidence >= 0 or not np.isfinite(each.evidence) or seen > MAX_FRACTION * matters:
            continue
        odds = float(np.exp(min(-each.evidence / 2, np.log(MAX_ODDS))))
        found.append(RuledOut(each.name, each.channel, output, seen, matters, odds))
    return tuple(sorted(found, key=lambda r: r.above / r.matters))
