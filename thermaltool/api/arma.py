"""An AR or ARMA model of a series, and its forecasts."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Unpack

from thermaltool.api.inputs import reads
from thermaltool.api.result import Notice, Result, notice, to_frame
from thermaltool.api.series import SeriesReading, outlier_messages, place_of, prepared, read_even
from thermaltool.errors import FitError, LogError, counted

if TYPE_CHECKING:
    import numpy as np
    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from thermaltool.logs.reader import Data
    from thermaltool.record import Record
    from thermaltool.signals.whiteness import PortmanteauTest
    from thermaltool.timeseries.model import ArmaModel

    Array = NDArray[np.float64]

# Largest orders that are tried where none is given.
DEFAULT_MAX_ORDER = 10
# The period of a series may differ from that of the model by this share.
PERIOD_TOLERANCE = 0.05


@dataclass(frozen=True, repr=False)
class ArmaFit(Result):
    """A fitted AR or ARMA model.

    Attributes
    ----------
    model : ArmaModel
        Coefficients, their covariance, likelihood and criteria.
    whiteness : PortmanteauTest
        Ljung-Box test of the innovations.
    level : float
        Of the intervals in the table.
    notes : tuple of str
        What is not as it should be, each a sentence.
    """

    model: ArmaModel
    whiteness: PortmanteauTest
    level: float = 0.95
    notes: tuple[str, ...] = ()

    @property
    def frame(self) -> pandas.DataFrame:
        """Coefficients with their standard errors, one row each; NaN where undetermined."""
        import pandas

        ar, ma = self.model.ar, self.model.ma
        names = [f"ar{k + 1}" for k in range(ar.size)] + [f"ma{k + 1}" for k in range(ma.size)]
        values = {"value": [*ar, *ma], "standard_error": self.model.errors}
        return pandas.DataFrame(values, index=pandas.Index(names, name="coefficient"))

    def document(self) -> dict[str, Any]:
        """What ``thermaltool fit -o`` writes and `forecast` reads."""
        from thermaltool.timeseries.model import to_document

        return to_document(self.model)

    def table(self) -> str:
        """Coefficients, criteria, roots and modes."""
        from thermaltool.report.orders import fit_table

        return fit_table(self.model, self.level)

    def draw(self) -> Figure:
        """Spectrum of the model, and its roots in the unit circle."""
        from thermaltool.report.series_figures import draw_arma

        return draw_arma(self.model)


@reads(SeriesReading)
def fit(
    data: Data,
    column: str,
    order: tuple[int, int] | None = None,
    *,
    method: str = "ml",
    long_order: int | None = None,
    correct: bool = True,
    level: float = 0.95,
    command: str | None = None,
    detrend: str | None = None,
    difference: int | None = None,
    outliers: str = "omit",
    warn: Notice = notice,
    **reading: Unpack[SeriesReading],
) -> ArmaFit:
    """An AR or ARMA model of a series: x_t - m = Σ ar_i (x_{t-i} - m) + a_t + Σ ma_j a_{t-j}.

    Parameters
    ----------
    data : str, path, pandas.DataFrame or Record
    column : str
        Any name will do.
    order : (int, int), optional
        AR and MA order. Default: the best by BIC.
    method : str
        "ml" is exact maximum likelihood; "hannan-rissanen" and "innovations"; "burg",
        "yule-walker" and "least-squares" take (p, 0).
    long_order : int, optional
        Order of the first stage of hannan-rissanen and innovations.
    correct : bool
        Third regression of hannan-rissanen.
    level : float
        Of the intervals.
    command : str, optional
        Goes into the provenance.
    detrend, difference, outliers, warn, **reading
        As for `order`.

    Returns
    -------
    ArmaFit
        Likelihood and criteria are exact for every method.

    Raises
    ------
    FitError
        A constant or computed series, too few samples, an order that the method cannot fit.
    LogError
        As `read_log`; an uneven clock.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> x = np.random.default_rng(1).standard_normal(500)
    >>> for k in range(1, 500):
    ...     x[k] += 0.7 * x[k - 1]
    >>> frame = pd.DataFrame({"time_s": np.arange(500.0), "d_z_um": x})
    >>> found = tt.fit(frame, "d_z_um", (1, 0))
    >>> round(float(found.model.ar[0]), 2), found.whiteness.p_value > 0.01
    (0.62, True)
    """
    from thermaltool.report.orders import fit_warnings
    from thermaltool.timeseries.fit import AR_METHODS, fit_arma, whiteness
    from thermaltool.timeseries.order import select_order
    from thermaltool.timeseries.runs import difference as differences

    series, period = read_even(data, column, warn, **reading)
    record, degree, times = prepared(
        series, warn, detrend=detrend, difference=difference, outliers=outliers
    )
    place, changed, begin = place_of(record), differences(record, times), None
    try:
        if order is None:
            max_q = 0 if method in AR_METHODS else DEFAULT_MAX_ORDER
            orders = select_order(changed, DEFAULT_MAX_ORDER, max_q, degree, ("bic",))
            best = orders.best("bic")
            order, begin = (best.p, best.q), orders.fits[best.p, best.q]
            warn(f"{place}: order {best.p},{best.q} chosen by BIC")
        provenance = {"logs": [record.source]}
        model = fit_arma(
            record,
            *order,
            method=method,
            degree=degree,
            difference=times,
            period_s=period,
            long_order=long_order,
            correct=correct,
            begin=begin,
            provenance=provenance | ({"command": command} if command else {}),
        )
    except FitError as error:
        raise FitError(f"{place}: {error}") from error
    notes = tuple(fit_warnings(model, changed, degree))
    for message in notes:
        warn(f"{place}: {message}")
    return ArmaFit(model, whiteness(model, changed, degree), level, notes)


@dataclass(frozen=True, repr=False)
class SeriesForecast(Result):
    """Samples beyond the end of a series.

    Attributes
    ----------
    channel : str
    time : ndarray, shape (steps,) [s]
    value, low, high : ndarray, shape (steps,)
        Forecast and its interval [unit of the channel].
    history : Record or None
        The series up to where the forecast begins.
    """

    channel: str
    time: Array
    value: Array
    low: Array
    high: Array
    history: Record | None = None

    def columns(self) -> dict[str, Array]:
        """The table that ``thermaltool forecast`` writes."""
        named = {"forecast": self.value, "low": self.low, "high": self.high}
        return {"time_s": self.time, **{f"{k}_{self.channel}": v for k, v in named.items()}}

    def table(self) -> str:
        """The forecasts as text."""
        return self.frame.to_string()

    def draw(self) -> Figure:
        """The end of the series, forecasts and their interval."""
        from thermaltool.report.series_figures import ForecastCurve, draw_forecasts

        found = ForecastCurve(self.channel, self.time, self.value, self.low, self.high)
        return draw_forecasts([found], self.history)

    @property
    def frame(self) -> pandas.DataFrame:
        """The forecasts by their time."""
        return to_frame(self.columns())


@reads(SeriesReading)
def forecast(
    model: ArmaFit | ArmaModel | str | os.PathLike[str],
    data: Data,
    column: str | None = None,
    *,
    steps: int = 1,
    level: float = 0.95,
    outliers: str = "omit",
    warn: Notice = notice,
    **reading: Unpack[SeriesReading],
) -> SeriesForecast:
    """Forecasts of a fitted model beyond the end of a series, with intervals.

    Parameters
    ----------
    model : ArmaFit, ArmaModel or path
        What `fit` gave, or its file.
    data : str, path, pandas.DataFrame or Record
    column : str, optional
        The model's channel by default.
    steps : int
        Samples ahead.
    level : float
        Of the intervals.
    outliers, warn, **reading
        As for `order`.

    Returns
    -------
    SeriesForecast

    Raises
    ------
    FitError
        The last run is too short for the model's difference.
    LogError
        As `read_log`; an uneven clock, or one of another period than the model's.
    ModelError
        A file that is none of `fit`.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> x = np.random.default_rng(1).standard_normal(500)
    >>> for k in range(1, 500):
    ...     x[k] += 0.7 * x[k - 1]
    >>> frame = pd.DataFrame({"time_s": np.arange(500.0), "d_z_um": x})
    >>> ahead = tt.forecast(tt.fit(frame, "d_z_um", (1, 0)), frame, steps=3)
    >>> [str(name) for name in ahead.frame]
    ['forecast_d_z_um', 'low_d_z_um', 'high_d_z_um']
    """
    import numpy as np

    from thermaltool.documents import read_text
    from thermaltool.timeseries import forecast as forecasts
    from thermaltool.timeseries.model import loads
    from thermaltool.timeseries.runs import runs, without
    from thermaltool.timeseries.screening import find_outliers

    if isinstance(model, str | os.PathLike):
        model = loads(*read_text(os.fspath(model)))
    fitted = model.model if isinstance(model, ArmaFit) else model
    column = column or fitted.channel
    record, period = read_even(data, column, warn, **reading)
    if abs(period / fitted.period_s - 1.0) > PERIOD_TOLERANCE:
        raise LogError(
            f"the model has a period of {fitted.period_s:g} s, the log {period:g} s", record.name
        )
    if outliers == "omit":
        alone = find_outliers(record)
        for message in outlier_messages(record, alone):
            warn(message)
        record = without(record, alone)
    behind = len(record) - runs(record)[-1].stop
    if behind:
        warn(f"{place_of(record)}: no sample in the last {counted(behind, 'row')}: forecast")
    ahead = forecasts.forecast(fitted, record, behind + steps, level)
    time = np.round(record.time[-1] + period * np.arange(1, steps + 1), 9)
    value, low, high = (each[behind:] for each in (ahead.value, ahead.low, ahead.high))
    return SeriesForecast(column, time, value, low, high, record)
