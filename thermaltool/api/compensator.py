"""Setpoints from readings, row by row: what ``thermaltool compensate`` does with its lines."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, Unpack

from thermaltool.api.inputs import Reading, as_model, reads
from thermaltool.api.result import Notice, notice, to_frame
from thermaltool.logs import read_log

if TYPE_CHECKING:
    import pandas

    from thermaltool.api.inputs import ModelLike
    from thermaltool.logs.reader import Data

Interval = tuple[float, float]


class Compensator:
    """Offsets that cancel the deflections of a machine, one row of readings at a time.

    Readings that are bad (NaN, out of range, frozen) are held, then the safe setpoint is given
    until good ones return.

    Parameters
    ----------
    model : Model with a design, a result that holds one, str or path
        From `regularize`.
    limits : (float, float) [unit of the deflection]
        Range of the setpoints.
    slew : float [unit of the deflection per s] or str, optional
        Largest rate of the setpoints.
    step : float [unit of the deflection] or str, optional
        Step of the setpoints, with a hysteresis of a quarter step; 0 for none. A text has a unit
        (``"0.5um"``, ``"10um/s"``); the default is 0.5 µm, at 10 µm/s.
    safe : float [unit of the deflection] or None
        The setpoint while readings are lost; None holds the last one.
    sign : {-1, 1}
        Setpoint over deflection: -1 cancels it.
    initial : {"rest", "settled"}
        The machine at the first row: cold, or settled at the first readings.
    period : float, optional [s]
        Sample period. Default: that of the design.
    hold : float, optional [s]
        How long a bad reading is bridged. Default: ten periods, at least 10 s.
    max_gap : float, optional [s]
        Longest pause that is not reported. Default: as `hold`.
    frozen_after : float [s]
        A reading that is bit-identical for longer than this is bad.
    ranges : mapping of channel to (low, high), optional
        Of good readings, in place of what the model gives.
    warn : callable
        Takes a sentence about every fault. Default: a `ThermalToolWarning`.

    Attributes
    ----------
    columns : tuple of str
        That are read.
    names : tuple of str
        Of the setpoints.

    Raises
    ------
    ModelError
        No design, one for other parameters, or no deflection to cancel.
    ValueError
        Limits without a multiple of the step between them, or a safe setpoint outside; a step
        larger than what the calibration has seen.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> time = np.arange(0.0, 1200.0, 10.0)
    >>> frame = pd.DataFrame({"time_s": time, "Q_motor_W": np.where(time < 60, 0.0, 100.0)})
    >>> frame["d_z_um"] = np.where(time < 60, 0.0, 20 * -np.expm1(-(time - 60) / 200))
    >>> fit = tt.calibrate(frame, ["Q_motor_W"], deflections=["d_z_um"])
    >>> compensator = tt.Compensator(tt.regularize(fit), step=0.0)
    >>> compensator.run(frame)["offset_z_um"].round(1).iloc[-1]
    np.float64(-19.9)
    """

    def __init__(
        self,
        model: ModelLike,
        *,
        limits: Interval = (-math.inf, math.inf),
        slew: float | str | None = None,
        step: float | str | None = None,
        safe: float | None = 0.0,
        sign: Literal[-1, 1] = -1,
        initial: Literal["rest", "settled"] = "rest",
        period: float | None = None,
        hold: float | None = None,
        max_gap: float | None = None,
        frozen_after: float = math.inf,
        ranges: Mapping[str, Interval] | None = None,
        warn: Notice = notice,
    ) -> None:
        from thermaltool.runtime.compensation import offsets
        from thermaltool.runtime.messages import Messages
        from thermaltool.runtime.settings import Settings

        settings = Settings(
            period=period,
            hold=hold,
            max_gap=max_gap,
            frozen_after=frozen_after,
            ranges=ranges or {},
            limits=limits,
            slew=slew,
            step=step,
            safe=safe,
        )
        self._messages = Messages(warn, "<rows>")
        self._process = offsets(
            as_model(model), settings, self._messages, float(sign), initial == "settled"
        )
        self.columns = self._process.columns
        self.names = self._process.names

    def step(self, time: float, readings: Mapping[str, float]) -> dict[str, float]:
        """Setpoints after a row of readings.

        Parameters
        ----------
        time : float [s]
        readings : mapping of channel to float
            A channel that is absent, or NaN, is a bad reading.

        Returns
        -------
        dict of setpoint to float [unit of the deflection]
        """
        from thermaltool.runtime.rows.row import Row

        values = [float(readings.get(name, math.nan)) for name in self.columns]
        faults = ["" if name in readings else "missing" for name in self.columns]
        self._messages.line += 1
        reply = self._process.take(Row(float(time), values, faults))
        assert reply is not None
        return dict(zip(self.names, reply[1], strict=False))

    @reads(Reading)
    def run(self, data: Data, **reading: Unpack[Reading]) -> pandas.DataFrame:
        """Setpoints of every row of a log, going on from the rows before.

        Parameters
        ----------
        data : str, path, pandas.DataFrame or Record
        **reading
            See `read_log`.

        Returns
        -------
        pandas.DataFrame
            Setpoints against time [s].

        Raises
        ------
        LogError
            A log that cannot be read, or that lacks a column.
        """
        log = read_log(data, **reading)
        columns = [log.column(name).tolist() for name in self.columns]
        rows = [
            self.step(time, dict(zip(self.columns, values, strict=True)))
            for time, *values in zip(log.time.tolist(), *columns, strict=True)
        ]
        setpoints = {name: [row[name] for row in rows] for name in self.names}
        return to_frame({"time_s": log.time, **setpoints})

    def finish(self) -> dict[str, float]:
        """The safe setpoint, at once."""
        values = self._process.finish() or ()
        return dict(zip(self.names, values, strict=False))

    def state(self) -> dict[str, Any]:
        """All that a restart needs, JSON-ready."""
        return self._process.state()

    def resume(self, state: dict[str, Any]) -> None:
        """Go on from `state`.

        Raises
        ------
        KeyError, TypeError, ValueError
            `state` is not one of this model.
        """
        self._process.resume(state)
