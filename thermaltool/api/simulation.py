"""A model's outputs for the drives in a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Unpack

from thermaltool.api.inputs import Reading, as_model, drives_over_pauses, read, reads, warn_pauses
from thermaltool.api.pauses import placed_in_pauses
from thermaltool.api.result import Notice, Result, notice, to_frame

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from thermaltool.api.inputs import ModelLike
    from thermaltool.logs import Log
    from thermaltool.logs.reader import Data
    from thermaltool.model import Model, Start, Zero
    from thermaltool.signals.agreement import Agreement


@dataclass(frozen=True, repr=False)
class Simulation(Result):
    """Outputs of a model over a log.

    Attributes
    ----------
    model : Model
    log : Log
        The drives, and what was measured of the outputs.
    columns : mapping of str to ndarray, shape (n,)
        ``time_s``, every output, and ``residual_...`` (measured minus simulated) where the output
        was measured. A displacement counts from rest.
    agreements : mapping of output to Agreement
        Of the outputs that were measured, over the rows that are judged.
    zeros : mapping of output to Zero
        What each of them counts from, and the rows that this was taken from.
    initials : mapping of output to {"rest", "free"}
        The machine was at rest at the first row, or in a state that was estimated.
    from_rest : mapping of output to Agreement
        Where a state was estimated: what the agreement is from rest.
    """

    model: Model
    log: Log
    columns: Mapping[str, NDArray[Any]]
    agreements: Mapping[str, Agreement]
    zeros: Mapping[str, Zero]
    initials: Mapping[str, Literal["rest", "free"]]
    from_rest: Mapping[str, Agreement]

    @property
    def frame(self) -> pandas.DataFrame:
        """Outputs and residuals against time [s]."""
        return to_frame(self.columns)

    def document(self) -> dict[str, Any]:
        """The agreement of every measured output, its zero and its start, JSON-ready."""
        return {
            name: each.document()
            | self.zeros[name].document()
            | {"initial": self.initials[name]}
            | ({"rmse_from_rest": self.from_rest[name].rmse} if name in self.from_rest else {})
            for name, each in self.agreements.items()
        }

    @property
    def notes(self) -> tuple[str, ...]:
        """How the log begins, and what outputs count from without a zero of their own."""
        from thermaltool.report.text import start_message, zero_message

        rmse = {name: each.rmse for name, each in self.from_rest.items()}
        start = (start_message(self.log, rmse),) if rmse else ()
        return start + tuple(
            zero_message(name, zero, self.log) for name, zero in self.zeros.items() if zero.rows
        )

    def computed(self, output: str) -> NDArray[Any]:
        """An output that was measured, in the readings of the log, shape (n,)."""
        own = next(o for o in self.model.outputs if o.channel == output)
        rest = 0.0 if own.offset == "first" else own.offset
        found: NDArray[Any] = self.columns[output] - rest + self.zeros[output].value
        return found

    @property
    def judged(self) -> bool:
        """Whether any output that is judged was measured over the rows that are."""
        return any(a.rows for a in self._of_judged())

    def exceeds(self, rmse: float) -> bool:
        """Whether the RMSE of an output that is judged is above this [unit of the output]."""
        return any(a.rmse > rmse for a in self._of_judged())

    def _of_judged(self) -> list[Agreement]:
        """Agreements without those of a contact by which a joint is told."""
        of = self.agreements
        return [of[o.channel] for o in self.model.outputs if o.judged and o.channel in of]

    def table(self) -> str:
        """RMSE and fit of every measured output."""
        from thermaltool.report.simulation import simulation_table

        return simulation_table(self.agreements)

    def draw(self) -> Figure:
        """Simulated and measured outputs, and their difference."""
        from thermaltool.report.pairs import draw_simulation

        columns = {name: values for name, values in self.columns.items() if name != "time_s"}
        return draw_simulation(replace(self.log, columns=columns))


@reads(Reading)
def simulate(
    model: ModelLike,
    data: Data,
    *,
    initial: Start = "auto",
    start: float | None = None,
    stop: float | None = None,
    warn: Notice = notice,
    **reading: Unpack[Reading],
) -> Simulation:
    """Outputs of a model for the drives in a log.

    All rows drive the model.

    Parameters
    ----------
    model : Model, a result that holds one, str or path
    data : str, path, pandas.DataFrame or Record
    initial : {"auto", "rest", "free"}
        The machine is at rest at the first row; or in a state that is estimated, for each output
        that was measured, from the rows before `start` (without one, from all). "auto": at rest,
        unless most of what is wrong in these rows is a start that decays, or the calibration
        itself did not begin at rest.
    start, stop : float, optional [s]
        The rows that are judged where outputs were measured.
    warn : callable
        Takes a sentence where the model extrapolates or the log pauses. Default: a
        `ThermalToolWarning`.
    **reading
        See `read_log`.

    Returns
    -------
    Simulation

    Raises
    ------
    LogError
        A log that cannot be read, that lacks a drive, or none of whose rows is judged.
    ModelError
        A file that is no model.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> time = np.arange(0.0, 1200.0, 10.0)
    >>> frame = pd.DataFrame({"time_s": time, "Q_motor_W": np.where(time < 60, 0.0, 100.0)})
    >>> frame["d_z_um"] = np.where(time < 60, 0.0, 20 * -np.expm1(-(time - 60) / 200))
    >>> fit = tt.calibrate(frame, ["Q_motor_W"], deflections=["d_z_um"])
    >>> tt.simulate(fit, frame).agreements["d_z_um"].rmse < 0.01
    True
    """
    import numpy as np

    from thermaltool.model import started_outputs
    from thermaltool.record import Record
    from thermaltool.report.text import range_messages
    from thermaltool.signals.agreement import agreement

    model = as_model(model)
    need = model.needs()
    log = read(data, need, warn=warn, **reading)
    warn_pauses(log, warn, drives_over_pauses(drive.hold for drive in model.drives))
    absent = [o.channel for o in model.outputs if o.channel not in log.columns]
    if 0 < len(absent) < len(model.outputs):
        warn(f"{log.name}: not in the log, so simulated and not judged: {', '.join(absent)}")
    if len(log):
        log.between(start, stop)  # where there is none it says which rows there are
    low, high = (-np.inf if start is None else start), (np.inf if stop is None else stop)
    # Where no row is kept apart, all say how the log begins.
    first = np.inf if start is None else start
    as_read, outputs = log, [o.channel for o in model.outputs if o.channel in log.columns]
    # Rows that are judged do not say when a command has changed.
    seen = {name: np.where(log.time < first, log.columns[name], np.nan) for name in outputs}
    log = placed_in_pauses(
        log, [drive.channel for drive in model.drives], outputs, warn, log.with_columns(seen)
    )
    drives = Record(log.time, {name: log.column(name) for name in need}, digest=log.digest)
    simulated = model.simulate(drives)
    columns: dict[str, Any] = {"time_s": log.time}
    agreements, zeros, at_rest = {}, {}, {}
    before, judged = log.time < first, (log.time >= low) & (log.time <= high)
    started = started_outputs(model, log, simulated, initial, before)
    moved = {name: each.zero.value for name, each in started.items() if each.initial == "free"}
    for message in range_messages(log, model, moved):
        warn(message)
    for output in model.outputs:
        name, level = output.channel, simulated[output.channel]
        if name in started:
            level, zeros[name] = started[name].computed, started[name].zero
        columns[name] = level if output.offset == "first" else level + output.offset
        if name in started:
            measured = log.columns[name] - zeros[name].value
            columns[f"residual_{name}"] = measured - level
            agreements[name] = agreement(measured[judged], level[judged])
    if moved:
        for name, each in started_outputs(model, log, simulated, "rest").items():
            measured = log.columns[name] - each.zero.value
            at_rest[name] = agreement(measured[judged], each.computed[judged])
    initials = {name: each.initial for name, each in started.items()}
    rows = np.isin(log.time, as_read.time)
    columns = {name: values[rows] for name, values in columns.items()}
    return Simulation(model, as_read, columns, agreements, zeros, initials, at_rest)
