"""A heater that is set instead of offsets: what a stream asks for with every line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from thermaltool.control.heaters import Stabilizer
from thermaltool.errors import ModelError
from thermaltool.model import Model
from thermaltool.responses.sample_clock import CLOCK_STEP
from thermaltool.runtime.stepper import Steps

# Without a lead of the user's the output is foretold for so many sample periods.
LEAD_PERIODS = 2


class HeaterStepper(Steps):
    """A `Stabilizer` as the stream's estimator: estimates are the power wanted, and the output.

    Parameters
    ----------
    stabilizer : Stabilizer
    given : callable
        The power that the heater was given last: limits, steps and the safe state have changed it.
        Over a silence it counts as what it was at the end.
    settling_time : float [s]
        Of the output.
    """

    def __init__(
        self, stabilizer: Stabilizer, given: Callable[[], float], settling_time: float
    ) -> None:
        super().__init__()
        self._stabilizer, self._given = stabilizer, given
        self.settling_time = settling_time

    def rest(self) -> list[float]:
        """Estimates before anything is known."""
        return [0.0, 0.0]

    def start(self, readings: list[float], settled: bool = False) -> list[float]:
        """Estimates at the first readings: the machine is at rest, or has settled at them.

        Parameters
        ----------
        readings : list of float
            In the order of `Stabilizer.read`.
        settled : bool
        """
        self._stabilizer.start(self._named(readings), settled)
        return self._estimates()

    def at_rest(self, readings: list[float]) -> list[float]:
        """None: every reading is of a drive."""
        return []

    def step(self, ticks: int, readings: list[float]) -> list[float]:
        """Estimates after a sample of `ticks` clock steps (1 ns), which ends with `readings`.

        Parameters
        ----------
        ticks : int
        readings : list of float
        """
        self._stabilizer.advance(ticks * CLOCK_STEP, self._named(readings), self._given())
        return self._estimates()

    def _estimates(self) -> list[float]:
        return [self._stabilizer.power(), self._stabilizer.now()]

    def _named(self, readings: list[float]) -> dict[str, float]:
        names = [drive.channel for drive in self._stabilizer.read]
        return dict(zip(names, readings, strict=True))

    def state(self) -> list[Any]:
        """For `resume`, as JSON."""
        return self._stabilizer.state()

    def resume(self, values: list[Any]) -> None:
        """Raises KeyError, TypeError or ValueError where `values` are no state of this model."""
        self._stabilizer.resume(values)


def held_output(model: Model, target: str | None) -> str:
    """The output that is held: the one that is named, else the only deflection.

    Parameters
    ----------
    model : Model
    target : str or None

    Raises
    ------
    ModelError
        Several to choose from, or none.
    """
    known = [output.channel for output in model.deflections]
    if target is None and len(known) != 1:
        several = f"the deflections {', '.join(known)}" if known else "no deflection"
        raise ModelError(f"the model has {several}: name what is held with --target")
    return target or known[0]
