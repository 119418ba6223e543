"""What each channel's noise is made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from thermaltool.api.inputs import Reading, read, reads, refuse_unread
from thermaltool.api.result import Notice, Result, notice, silent, to_frame
from thermaltool.errors import LogError
from thermaltool.units import names, parse_channel

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from thermaltool.logs import Log
    from thermaltool.logs.reader import Data
    from thermaltool.signals.noise import NoiseEstimate


@dataclass(frozen=True, repr=False)
class NoiseReport(Result):
    """Noise of the channels of a log.

    Attributes
    ----------
    log : str
        Name of the log.
    period : float [s]
    units : mapping of channel to unit
    estimates : mapping of channel to NoiseEstimate or str
        A string says why there is no estimate.
    epoch : str or None
        The moment at which the clock is 0, where it is known.
    """

    log: str
    period: float
    units: Mapping[str, str]
    estimates: Mapping[str, NoiseEstimate | str]
    epoch: str | None = None

    def document(self) -> dict[str, Any]:
        """What ``thermaltool noise -o`` writes and `regularize` reads."""
        from thermaltool.report.noise import noise_document

        return noise_document(self.log, self.period, self.units, self.estimates)

    def table(self) -> str:
        """One row per channel, its notes below."""
        from thermaltool.report.noise import noise_table

        return noise_table(self.units, self.estimates)

    def draw(self) -> Figure:
        """Residual, Allan deviation and spectrum, one channel per row."""
        from thermaltool.report.noise import draw_figure

        return draw_figure(self.log, self.units, self.estimates, self.epoch)

    @property
    def frame(self) -> pandas.DataFrame:
        """White level, drift and its time constant, one row per channel; NaN where unknown."""
        rows = {
            name: (float("nan"),) * 3
            if isinstance(found, str)
            else (found.drift.white_sigma, found.drift.sigma, found.drift.time_constant)
            for name, found in self.estimates.items()
        }
        names = ("white_sigma", "drift_sigma", "drift_time_constant_s")
        columns = dict(zip(names, zip(*rows.values(), strict=True), strict=True))
        frame = to_frame({"channel": list(rows), **columns}).set_index("channel")
        return frame.astype(float)


@reads(Reading)
def noise(
    data: Data,
    *,
    channels: str | Sequence[str] = (),
    start: float | None = None,
    stop: float | None = None,
    warn: Notice = notice,
    progress: Notice = silent,
    **reading: Unpack[Reading],
) -> NoiseReport:
    """Noise of every channel: resolution, white, drift, lines, outliers.

    White level and drift come from the longest stretch on which a channel stays level; where there
    is none, the drift is an upper bound.

    Parameters
    ----------
    data : str, path, pandas.DataFrame or Record
    channels : str or sequence of str
        Only these; all by default.
    start, stop : float, optional [s]
        A stretch without signal, which is then taken whole.
    warn : callable
        Takes a sentence about each channel without an estimate. Default: a `ThermalToolWarning`.
    progress : callable
        Takes the name of the channel that is looked at.
    **reading
        See `read_log`.

    Returns
    -------
    NoiseReport

    Raises
    ------
    LogError
        No channel has a usable record.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> rng = np.random.default_rng(1)
    >>> readings = 20 + 0.01 * rng.standard_normal(2000)
    >>> frame = pd.DataFrame({"time_s": np.arange(2000.0), "T_spindle_degC": readings})
    >>> round(float(tt.noise(frame).frame.loc["T_spindle_degC", "white_sigma"]), 3)
    0.01
    """
    from thermaltool.signals.noise import estimate_noise

    whole = read(data, warn=warn, unread=True, **reading)
    (whole,) = refuse_unread([whole], names(channels) or [*whole.columns], warn)
    log = whole.between(start, stop)
    idle = start is not None or stop is not None
    estimates: dict[str, NoiseEstimate | str] = {}
    for name in names(channels) or log.columns:
        progress(name)
        values = log.column(name)
        try:
            found = estimate_noise(log.time, values, idle=idle, max_gap=reading.get("max_gap"))
            estimates[name] = _with_spikes(found, name, whole, log)
        except ValueError as error:
            estimates[name] = str(error)
            warn(f"{log.name}: {name}: {error}")
    if all(isinstance(found, str) for found in estimates.values()):
        raise LogError("no channel has a usable record", log.name)
    units = {name: parse_channel(name).unit for name in estimates}
    return NoiseReport(whole.name, whole.period, units, estimates, whole.epoch)


def _with_spikes(estimate: NoiseEstimate, channel: str, whole: Log, part: Log) -> NoiseEstimate:
    """The estimate with the spikes that reading has left out, as outliers."""
    spikes = [each for each in whole.faults if each.channel == channel and each.kind == "spike"]
    if not spikes:
        return estimate
    time = whole.time[np.concatenate([each.rows for each in spikes])]
    values = np.concatenate([each.values for each in spikes])
    inside = (time >= part.time[0]) & (time <= part.time[-1])
    time = np.concatenate([estimate.outlier_time, time[inside]])
    values = np.concatenate([estimate.outlier_value, values[inside]])
    order = np.argsort(time)
    return replace(
        estimate,
        samples=estimate.samples + int(inside.sum()),
        outlier_time=time[order],
        outlier_value=values[order],
    )
