"""A heater that bends a machine back: the power that a model asks for, sample by sample.

After Mareš et al., who hold an angle by a controlled heat source. The source goes through inverse
transfer functions (Q_S = Q_C γ1 γ2⁻¹); here the model runs forward and the power is searched that
brings its output to zero after the lead. So curves and schedules need no inverse, and what the
limits keep from the machine is remembered by the model.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.model import Drive, Model, ModelRecursion, Term
from thermaltool.responses.streaming import split_delay

# Powers between the limits that are tried, quarter percents of the range; between two of them a
# straight line is taken.
POWER_CANDIDATES = 281


class Stabilizer:
    """The power of one heater that holds one output of a model at zero.

    The output is foretold, all drives held, for `lead` after the heater's delay.

    Parameters
    ----------
    model : Model
    heater : str
        The drive that is set.
    target : str
        The output that is held.
    limits : (float, float) [unit of the heater]
        Its least and largest value.
    lead : float [s]

    Raises
    ------
    ModelError
        As `parts_of`.
    """

    def __init__(
        self, model: Model, heater: str, target: str, limits: tuple[float, float], lead: float
    ) -> None:
        own, self.read, terms = parts_of(model, heater, target)
        self.heater, self._target, self._reference = heater, target, float(own.reference)
        # Readings come relative to their references.
        drives = tuple(replace(d, reference=0.0) for d in (own, *self.read))
        relative = replace(model, drives=drives, terms=terms)
        # Of several delays the shortest: then the heater begins to be felt.
        felt = min(_delay(model, term) for term in terms if term.drive == heater)
        self._recursion = ModelRecursion(relative, outputs=[target], horizon=felt + lead)
        self._candidates = np.linspace(*limits, POWER_CANDIDATES)
        self.start(dict.fromkeys((d.channel for d in self.read), 0.0))

    def start(self, readings: Mapping[str, float], settled: bool = False) -> None:
        """At rest in what is measured, or settled at the first readings with the heater off.

        Parameters
        ----------
        readings : mapping of channel to float
            All of `read`, relative to their references.
        """
        self._time, self._last = 0.0, dict(readings)
        self._outputs = self._recursion.start(0.0, self._row(readings, 0.0), settled, True)

    def advance(self, dt: float, readings: Mapping[str, float], power: float) -> None:
        """Go on by `dt` [s] to new readings; the heater stood at `power` meanwhile.

        Parameters
        ----------
        dt : float [s]
        readings : mapping of channel to float
        power : float [unit of the heater]
        """
        self._recursion.amend(self._row(self._last, power))
        self._time += dt
        self._outputs = self._recursion.step(self._time, self._row(readings, power))
        self._last = dict(readings)

    def now(self) -> float:
        """The output of the model, relative to rest."""
        return self._outputs[self._target]

    def power(self) -> float:
        """The power that is wanted from now on."""
        powers = self._candidates
        foretold = self._recursion.ahead({**self._last, self.heater: powers - self._reference})
        after = foretold[self._target]
        crossed = np.flatnonzero(after[:-1] * after[1:] <= 0)
        if not len(crossed):
            # No power reaches zero. Over a short lead a schedule can have its strongest effect
            # amid its range; what lasts is at an end.
            return float(powers[0 if abs(after[0]) <= abs(after[-1]) else -1])
        size = np.abs(after)
        k = int(crossed[np.argmin(np.minimum(size[crossed], size[crossed + 1]))])
        weight = size[k] / (size[k] + size[k + 1]) if size[k] else 0.0
        return float(powers[k] + weight * (powers[k + 1] - powers[k]))

    def _row(self, readings: Mapping[str, float], power: float) -> dict[str, float]:
        return {**readings, self.heater: power - self._reference}

    def state(self) -> list[Any]:
        """For `resume`, as JSON."""
        return [self._last, [response.state() for response in self._recursion.responses]]

    def resume(self, state: list[Any]) -> None:
        """Go on from `state`; raises KeyError, TypeError or ValueError where it is none."""
        self._last = {d.channel: float(state[0][d.channel]) for d in self.read}
        self._time = 0.0
        self._recursion.start(0.0, self._row(self._last, 0.0))
        for response, kept in zip(self._recursion.responses, state[1], strict=True):
            response.resume(kept)
        self._outputs = self._recursion.now()


def _delay(model: Model, term: Term) -> float:
    """Dead time of a term [s]."""
    return split_delay(term.response.modes(model.sample_period))[1]


def parts_of(
    model: Model, heater: str, target: str
) -> tuple[Drive, tuple[Drive, ...], tuple[Term, ...]]:
    """The heater, the drives that are read, and the terms that act on the target.

    Parameters
    ----------
    model : Model
    heater : str
        The drive that is set.
    target : str
        The output that is held.

    Raises
    ------
    ModelError
        A heater that is no drive, is measured instead of set, has no known zero, or does not act
        on the target; a target that is no output; nothing beside the heater; an effect other than
        what acts at once on a drive; a schedule by what is no drive.
    """
    drives = {d.channel: d for d in model.drives}
    if heater not in drives:
        raise ModelError(f"{heater} is not a drive of the model; there are {', '.join(drives)}")
    outputs = [o.channel for o in model.outputs]
    if target not in outputs:
        raise ModelError(f"{target} is not an output of the model; there are {', '.join(outputs)}")
    own = drives[heater]
    if own.hold != "zero" or own.reference == "first":
        raise ModelError(f"{heater} is not set like a power, but measured from its first value")
    terms = tuple(t for t in model.terms if t.output == target)
    choosers = [t.band.channel for t in terms if t.band is not None]
    needed = {*choosers, *(t.drive for t in terms)}
    if all(t.drive != heater for t in terms):
        raise ModelError(f"{heater} does not act on {target}")
    if needed == {heater}:
        raise ModelError(f"nothing but {heater} acts on {target}: there is nothing to hold off")
    for channel in needed:
        if channel not in drives:
            raise ModelError(f"a schedule by {channel}, which is no drive of the model")
    for effect in model.effects:
        if effect.side != "drive" or not effect.memoryless:
            raise ModelError(f"a heater cannot be set by a model with the effect {effect.name}")
    return own, tuple(d for d in model.drives if d.channel in needed - {heater}), terms


def powers(model: Model, heater: str, limits: tuple[float, float]) -> tuple[float, float]:
    """What the heater may be given: from 0, and where no limit is given to what was seen.

    Parameters
    ----------
    model : Model
    heater : str
    limits : (float, float)
        As the user gives them; infinite where not.

    Raises
    ------
    ModelError
        A limit below 0, or nothing above 0 is left.
    """
    if -math.inf < limits[0] < 0:
        raise ModelError(f"{heater}: a heater has no power below 0: give --limit 0:WATTS")
    low, high = max(limits[0], 0.0), limits[1]
    for drive in model.drives:
        if drive.channel == heater and drive.reference != "first" and math.isinf(high):
            high = drive.range[1] + drive.reference
    if not low < high < math.inf:
        raise ModelError(f"{heater}: no power between {low:g} and {high:g}: give --limit 0:WATTS")
    return low, high
