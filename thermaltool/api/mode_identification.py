"""Logs in, the thermal modes that all their channels share come out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Unpack

from thermaltool.api.inputs import Reading, all_of, read_for_fit, reads
from thermaltool.api.result import Notice, Result, notice
from thermaltool.units import names

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from thermaltool.logs import Log
    from thermaltool.logs.reader import Data
    from thermaltool.placement.mode_identification import IdentifiedModes


@dataclass(frozen=True, repr=False)
class LogModes(Result):
    """Thermal modes of measured logs.

    Attributes
    ----------
    modes : IdentifiedModes
        Time constants and weights with their intervals.
    logs : tuple of Log
    """

    modes: IdentifiedModes
    logs: tuple[Log, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know before using the modes, each a sentence."""
        from thermaltool.report.mode_identification import identified_notes

        return (*identified_notes(self.modes), *self._drift())

    def _drift(self) -> list[str]:
        """Where something slower than the log acts: what it may be."""
        if not self.modes.drifts:
            return []
        from thermaltool.effects.channels import is_air

        first = self.modes.network.outputs[0]
        used = {*first.names, *(output.target for output in self.modes.network.outputs)}
        air = [c for log in self.logs for c in log.columns if is_air(c) and c not in used]
        remedy = f"--drive {air[0]} takes it along" if air else "log its temperature as a --drive"
        return [f"the channels drift more slowly than the log is long: of the room, {remedy}"]

    @property
    def frame(self) -> pandas.DataFrame:
        """One row for each channel, drive and mode: time constant and weight with intervals."""
        import pandas

        from thermaltool.report.mode_identification import identified_columns

        return pandas.DataFrame(identified_columns(self.modes))

    def document(self) -> dict[str, Any]:
        """The modes as ``modes -o`` writes them."""
        from thermaltool.report.mode_identification import identified_document

        return identified_document(self.modes)

    def table(self) -> str:
        """Time constants, and the weight of each in every channel."""
        from thermaltool.report.mode_identification import identified_table

        return identified_table(self.modes)

    def draw(self) -> Figure:
        """Weights of every mode in every channel."""
        from thermaltool.report.mode_identification import draw_identified

        return draw_identified(self.modes, ", ".join(log.name for log in self.logs))


@reads(Reading)
def identify_modes(
    data: Data | Sequence[Data],
    drives: str | Sequence[str],
    outputs: str | Sequence[str],
    *,
    count: int | None = None,
    initial: Literal["auto", "rest", "free"] = "auto",
    start: float | None = None,
    stop: float | None = None,
    warn: Notice = notice,
    **reading: Unpack[Reading],
) -> LogModes:
    """Time constants that all channels of logs share, and the weight of each in every channel.

    Parameters
    ----------
    data : str, path, pandas.DataFrame, Record, or a sequence of them
        Heating and cooling in one log, or in several.
    drives : str or sequence of str
        What heats: a power, a speed, a temperature around.
    outputs : str or sequence of str
        Temperatures and deflections that follow.
    count : int, optional
        Number of modes. Default: by evidence (BIC).
    initial : {"auto", "rest", "free"}
        State at the first row.
    start, stop : float, optional [s]
        The stretch that is fitted.
    warn : callable
        Takes a sentence where a log pauses.
    **reading
        See `read_log`.

    Returns
    -------
    LogModes

    Raises
    ------
    LogError
        A log that cannot be read or lacks a channel.
    FitError
        A channel that is constant, a drive that never moves, fewer rows than modes need.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> time = np.arange(0.0, 36000.0, 60.0)
    >>> on = (time >= 600) & (time < 15000)
    >>> def lag(tau):
    ...     x = np.zeros(len(time))
    ...     for k in range(len(time) - 1):
    ...         x[k + 1] = on[k] + (x[k] - on[k]) * np.exp(-60.0 / tau)
    ...     return x
    >>> noise = 0.02 * np.random.default_rng(1).standard_normal(len(time))
    >>> frame = pd.DataFrame({"time_s": time, "n_spindle_rpm": 6000.0 * on})
    >>> frame["T_front_degC"] = 20 + 8 * lag(6000.0) + 4 * lag(900.0) + noise
    >>> found = tt.identify_modes(frame, "n_spindle_rpm", "T_front_degC")
    >>> [round(e.value, -2) for e in found.modes.time_constants]
    [6000.0, 900.0]
    """
    from thermaltool.placement.mode_identification import identify_modes as identify

    drives, outputs = names(drives), names(outputs)
    if not drives or not outputs:
        raise ValueError("modes of a log need a drive and a sensor: --drive and --sensor")
    if both := [name for name in drives if name in outputs]:
        raise ValueError(f"{both[0]} cannot both drive and follow")
    logs = tuple(
        read_for_fit(each, drives, "mode", (start, stop), outputs=outputs, warn=warn, **reading)
        for each in all_of(data)
    )
    return LogModes(identify(logs, drives, outputs, count, initial), logs)
