"""A thermal transient in, its time-constant spectrum and networks out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Unpack

from thermaltool.api.inputs import Reading, read, reads
from thermaltool.api.result import Notice, Result, notice, to_frame
from thermaltool.units import drive_reference

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from thermaltool.fitting.spectrum.find import ThermalSpectrum
    from thermaltool.logs import Log
    from thermaltool.logs.reader import Data
    from thermaltool.model import Model
    from thermaltool.units import Reference


@dataclass(frozen=True, repr=False)
class SpectrumReport(Result):
    """Time-constant spectrum of a log, and its networks.

    Attributes
    ----------
    spectrum : ThermalSpectrum
    log : Log
    drive : str
    reference : "first", float or None
        What counts as no power in the model document.
    """

    spectrum: ThermalSpectrum
    log: Log
    drive: str
    reference: Reference | None = None

    @cached_property
    def model(self) -> Model:
        """The model document: one lag for each line."""
        from thermaltool.fitting.spectrum.document import spectrum_model

        rest = drive_reference(self.drive) if self.reference is None else self.reference
        return spectrum_model(self.spectrum, self.log, self.drive, self.spectrum.transient.output,
                              rest, {"logs": [self.log.source]})  # fmt: skip

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know before using the spectrum, each a sentence."""
        from thermaltool.report.spectrum import spectrum_notes

        return tuple(spectrum_notes(self.spectrum))

    @property
    def frame(self) -> pandas.DataFrame:
        """One row for each line: time constant, Foster cell and part of the Cauer ladder."""
        return to_frame(self.columns)

    @property
    def columns(self) -> dict[str, Any]:
        """What `frame` holds, as arrays."""
        from thermaltool.report.spectrum import spectrum_columns

        return dict(spectrum_columns(self.spectrum))

    def document(self) -> dict[str, Any]:
        """The spectrum as ``spectrum --json`` writes it."""
        from thermaltool.report.spectrum import spectrum_document

        return {"input": self.drive, **spectrum_document(self.spectrum)}

    def table(self) -> str:
        """Lines with their intervals, and both networks."""
        from thermaltool.report.spectrum import spectrum_table

        return spectrum_table(self.spectrum, self.drive)

    def draw(self) -> Figure:
        """Transient, spectrum, cumulative resistance and structure function."""
        from thermaltool.report.spectrum import draw_spectrum

        return draw_spectrum(self.spectrum, self.log.name, self.drive)


@reads(Reading)
def spectrum(
    data: Data,
    input: str,
    output: str,
    *,
    lines: int | None = None,
    before: float | None = None,
    step_at: float | None = None,
    reference: Reference | None = None,
    start: float | None = None,
    stop: float | None = None,
    warn: Notice = notice,
    **reading: Unpack[Reading],
) -> SpectrumReport:
    """Time-constant spectrum of a thermal transient: lines, Foster and Cauer networks.

    Parameters
    ----------
    data : str, path, pandas.DataFrame or Record
        On any clock; all had settled when it begins.
    input : str
        A power that steps once or several times, held between rows.
    output : str
        A temperature, or a difference of two.
    lines : int, optional
        Number of lines. Default: that of the least BIC.
    before : float, optional [unit of the input]
        Input before the first row. Default: that of the first row; with `step_at` zero.
    step_at : float, optional [s]
        When the input changed to what the next row says. Default: in the row that says so.
    reference : "first" or float, optional
        What counts as no power in the model. Default: 0.
    start, stop : float, optional [s]
        The stretch that is fitted.
    warn : callable
        Takes a sentence where a sensor's faults are left out. Default: a `ThermalToolWarning`.
    **reading
        See `read_log`.

    Returns
    -------
    SpectrumReport

    Raises
    ------
    LogError
        A log that cannot be read or lacks a channel; no step, an output that does not move, too
        few rows or too short a time behind the step.
    FitError
        The output falls where the power rises, or the log carries fewer lines.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> time = np.append(0.0, np.geomspace(1e-3, 100, 200))
    >>> rise = 2 * (0.5 * -np.expm1(-time / 0.02) + 1.5 * -np.expm1(-time / 3))
    >>> noise = 0.002 * np.random.default_rng(1).standard_normal(201)
    >>> frame = pd.DataFrame({"time_s": time, "P_die_W": 2.0, "dT_die_K": rise + noise})
    >>> found = tt.spectrum(frame, "P_die_W", "dT_die_K", before=0.0)
    >>> found.frame[["tau_s", "R_foster_K/W"]].round(2)
       tau_s  R_foster_K/W
    0   0.02           0.5
    1   3.00           1.5
    """
    from thermaltool.fitting.spectrum.find import thermal_spectrum

    log = read(data, (input,), (output,), warn=warn, **reading).between(start, stop)
    found = thermal_spectrum(log, input, output, lines, before, step_at)
    return SpectrumReport(found, log, input, reference)
