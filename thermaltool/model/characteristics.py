"""What a person asks of a response: its static gain and its time constants, with intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np

from thermaltool.model.document import Term
from thermaltool.responses import parameter_names
from thermaltool.signals.intervals import (
    Estimate,
    log_normal_estimate,
    normal_estimate,
    standard_error,
)
from thermaltool.units import parse_channel, per, printed

# Step of a derivative, as a share of the parameter.
STEP = 1e-4


@dataclass(frozen=True)
class Characteristics:
    """One drive's effect on one output.

    Attributes
    ----------
    drive, output, kind : str
    gain : Estimate
        Steady state of the output per unit of the drive, with its 95 % interval.
    time_constants : tuple of Estimate [s]
        The slowest first.
    delay : float [s]
    """

    drive: str
    output: str
    kind: str
    gain: Estimate
    time_constants: tuple[Estimate, ...]
    delay: float

    @property
    def may_be_zero(self) -> bool:
        """Whether the interval of the gain holds zero."""
        return self.gain.low <= 0 <= self.gain.high

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "drive": self.drive,
            "output": self.output,
            "kind": self.kind,
            "gain": [self.gain.value, self.gain.low, self.gain.high],
            "gain_unit": self.gain.unit,
            "time_constants_s": [[t.value, t.low, t.high] for t in self.time_constants],
            "delay_s": self.delay,
        }


def characteristics(term: Term) -> Characteristics:
    """Static gain and time constants of a term.

    Parameters
    ----------
    term : Term
        Without a covariance the intervals have no width.
    """
    unit = printed(per(parse_channel(term.output).unit, parse_channel(term.drive).unit))
    gain = term.response.dc_gain()
    constants = [
        log_normal_estimate(of(term.response), _error(term, of) / of(term.response), "s")
        for of in _time_constants(term.response)
    ]
    return Characteristics(
        term.drive,
        term.output,
        term.response.kind,
        normal_estimate(gain, _error(term, lambda response: response.dc_gain()), unit),
        tuple(sorted(constants, key=lambda each: -each.value)),
        getattr(term.response, "delay", 0.0),
    )


def _time_constants(response: Any) -> Iterator[Callable[[Any], float]]:
    """What gives each time constant of a response."""
    if response.kind.startswith("rational"):
        for name in response.searched:
            yield attrgetter(name)
    elif response.kind.endswith("deflection"):
        for name in response.searched:
            yield partial(_inverse, name)
    else:
        yield lambda each: float(each.slowest())


def _inverse(name: str, response: Any) -> float:
    """Time constant of a rate [s]."""
    return 1 / float(getattr(response, name))


def _error(term: Term, of: Callable[[Any], float]) -> float:
    """Standard error of a function of a response, to first order; 0 without a covariance."""
    if term.covariance is None:
        return 0.0
    response: Any = term.response
    values = {name: getattr(response, name) for name in parameter_names(response.kind)}
    slope = []
    for name in term.covariance_names:
        step = STEP * abs(values[name]) or STEP
        ahead, behind = (
            type(response)(**{**values, name: values[name] + h}) for h in (step, -step)
        )
        slope.append((of(ahead) - of(behind)) / (2 * step))
    return standard_error(np.array(slope), np.asarray(term.covariance))
