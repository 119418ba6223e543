"""What the user may choose of a stream, whatever is made of its rows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from thermaltool.control.setpoint import Limits, Setpoint
from thermaltool.errors import ModelError
from thermaltool.runtime.clocks import ArrivalClock, LineClock, PeriodClock
from thermaltool.runtime.rows.layout import Wanted
from thermaltool.units import amount_in, parse_channel, small_unit, symbol

if TYPE_CHECKING:
    from thermaltool.logs.columns import ColumnMap

Interval = tuple[float, float]
ANYTHING: Interval = (-math.inf, math.inf)
# Arrival times are rounded to this [s]: far below what a pipe and a scheduler add to them.
ARRIVAL_STEP = 1e-3
# Beyond it a set point is a slip of the pen [unit of the setpoint].
LARGEST_SETPOINT = 1e9
# What actuators take, where nobody says [um or urad, else the unit of the setpoint], and per s.
USUAL_STEP, USUAL_SLEW = 0.5, 10.0
# For the slew rate a pause counts as this many sample periods at the most: a stall must not save
# up way for one large step.
SLEW_PERIODS = 2


@dataclass(frozen=True)
class Settings:
    """Of the lines, of the readings in them, and of the setpoints; times in s.

    Attributes
    ----------
    from_format, to_format : str
        Keys of `runtime.rows.ROW_FORMATS` and `runtime.sinks.SINKS`.
    header : bool
        Whether CSV begins with a line of names.
    template : str or None
        Pattern of the lines that are written, of the format ``template``.
    columns : str or None
        File of a column map.
    period : float or None
        Sample period; None where the model or the clock of the stream gives it.
    clock : "column", "count" or "arrival"
        Time from the input, one `period` for each line, or the time of arrival.
    timeout : float or None
        Silence that is answered; 0 never, None for what the process takes.
    hold, max_gap : float or None
        How long bad readings are bridged, and longest pause that is not reported; None for what
        the process takes.
    frozen_after : float
        A reading that is bit-identical for longer than this is bad.
    ranges : mapping of channel to (low, high)
        Of readings as they come, in place of what the model gives.
    limits : (low, high)
    slew, step : float, str, or None
        Rate and quantizer of the setpoints; inf and 0 for none. A number counts in the unit of the
        setpoint, a text has its own (``0.5um``, ``10um/s``); None for the usual ones, `USUAL_SLEW`
        and `USUAL_STEP`.
    safe : float or None
        The safe setpoint; None holds the last one.
    end : "safe", "ramp" or "hold"
        The last line: the safe setpoint at once or at the slew rate, or none.
    estimates : bool
        Whether more is written than the setpoints: what they were made of.
    status : bool
        Whether each line says what it rests on: ok, settles, held, reduced, safe, extrapolates,
        resumed, parted.
    bands : bool
        Whether standard errors of the estimates are written, and model and machine compared.
    lag : float or None [s]
        Whether estimates with so much look-ahead are written, too.
    trust : bool
        Whether every reading in range is taken: no test of its rate, its noise, or against others.
    at : mapping of set point to float, float, or None
        Where the actuator stands at the start; None where a checkpoint says it, or at the safe one.
    checkpoint : str or None
        File in which the state is kept.
    checkpoint_every, checkpoint_max_age : float
        An older state is not gone on from.
    audit : str or None
        File to which every change of state is appended.
    """

    from_format: str = "csv"
    to_format: str = "csv"
    header: bool = True
    template: str | None = None
    columns: str | None = None
    period: float | None = None
    clock: Literal["column", "count", "arrival"] = "column"
    timeout: float | None = None
    hold: float | None = None
    max_gap: float | None = None
    frozen_after: float = math.inf
    ranges: Mapping[str, Interval] = field(default_factory=dict)
    limits: Interval = ANYTHING
    slew: float | str | None = math.inf
    step: float | str | None = 0.0
    safe: float | None = 0.0
    end: Literal["safe", "ramp", "hold"] = "safe"
    estimates: bool = False
    status: bool = False
    bands: bool = False
    lag: float | None = None
    trust: bool = False
    at: Mapping[str, float] | float | None = None
    checkpoint: str | None = None
    checkpoint_every: float = 10.0
    checkpoint_max_age: float = 3600.0
    audit: str | None = None

    def sink_options(self, names: Sequence[str]) -> dict[str, Any]:
        """What the sink is made with, beside its output, for these names behind the time."""
        if self.to_format == "template":
            return {"template": self.template, "names": names}
        return {} if self.header else {"header": False}

    def template_fields(self, names: Sequence[str]) -> list[str]:
        """Fields of the template beside the time and `names`; ValueError where it is none."""
        if self.template is None:
            return []
        from thermaltool.runtime.sinks.template_sink import other_fields

        return other_fields(self.template, names)

    def wanted(self, columns: tuple[str, ...], clock_advice: str) -> Wanted:
        """What is looked for in the lines; LogError where the column map cannot be read."""
        mapping: ColumnMap | None = None
        if self.columns is not None:
            # Imported for a map alone: a stream starts without it.
            from thermaltool.logs.columns import read_map

            mapping = read_map(self.columns)
        return Wanted(columns, mapping, self._line_clock(), clock_advice)

    def _line_clock(self) -> LineClock | None:
        if self.clock == "arrival":
            return ArrivalClock(ARRIVAL_STEP)
        if self.clock == "count":
            assert self.period is not None
            return PeriodClock(self.period)
        return None

    def setpoint(
        self, limits: Interval, noun: str = "setpoint", channel: str = "", seen: float = math.inf
    ) -> Setpoint:
        """A setpoint within `limits`, which stands at the safe one.

        It counts in the unit of its `channel`, which has moved by `seen` in the calibration.

        Raises
        ------
        ValueError
            The safe setpoint is outside (called by its `noun`), or no multiple of the step inside;
            a step or rate of another quantity, or a step beyond `seen`.
        """
        allowed = Limits(*limits)
        if self.safe is not None and abs(self.safe) > LARGEST_SETPOINT:
            raise ValueError(f"the safe {noun} {self.safe:g} is none that an actuator has")
        if self.safe is not None and allowed.clip(self.safe) != self.safe:
            raise ValueError(f"the safe {noun} {self.safe:g} is outside the limits")
        step, slew = self._amount(self.step, USUAL_STEP, channel), self.slew
        slew = slew.removesuffix("/s") if isinstance(slew, str) else slew
        if step > seen > 0:
            unit = symbol(parse_channel(channel).unit)
            raise ValueError(
                f"a step of {step:g} {unit} for {channel}, which has moved by {seen:.3g} {unit} in "
                "the calibration: give a smaller one, with its unit (--step 0.5um), or 0 for none"
            )
        grid = allowed.on_grid(step)
        if grid.low == grid.high and allowed.low < allowed.high:
            raise ValueError(
                f"between {allowed.low:g} and {allowed.high:g} the step {step:g} has nothing but "
                f"{grid.low:g}: give a smaller one"
            )
        return Setpoint(allowed, self._amount(slew, USUAL_SLEW, channel), step, self.safe or 0.0)

    @staticmethod
    def _amount(amount: float | str | None, usual: float, channel: str) -> float:
        """An amount in the unit of a channel."""
        if amount is None:
            amount = f"{usual}{small_unit(channel)}"
        return amount_in(amount, parse_channel(channel).unit) if channel else float(amount)

    def bridged(self, usual: float) -> tuple[float, float]:
        """`hold` and `max_gap` [s], each the `usual` one where it is None."""
        hold = usual if self.hold is None else self.hold
        return hold, usual if self.max_gap is None else self.max_gap

    def check_ranges(self, columns: Sequence[str]) -> None:
        """Raise ModelError where a range is for none of the columns that are read."""
        for channel in self.ranges:
            if channel not in columns:
                raise ModelError(
                    f"a range for {channel}, but the sensors of the model are {', '.join(columns)}"
                )
