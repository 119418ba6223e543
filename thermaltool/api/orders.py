"""Which AR or ARMA order a series has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Unpack

from thermaltool.api.inputs import reads
from thermaltool.api.result import Notice, Result, notice, to_frame
from thermaltool.api.series import SeriesReading, place_of, prepared, read_even
from thermaltool.errors import FitError

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from thermaltool.logs.reader import Data
    from thermaltool.timeseries.order import OrderTable


@dataclass(frozen=True, repr=False)
class OrderReport(Result):
    """Information criteria of every order.

    Attributes
    ----------
    name : str
        Channel and log.
    orders : OrderTable
    criteria : tuple of str
        What the best orders were looked for by.
    notes : tuple of str
        What to know before the best orders are believed, each a sentence.
    """

    name: str
    orders: OrderTable
    criteria: tuple[str, ...]
    notes: tuple[str, ...] = ()

    def best(self, criterion: str = "bic") -> tuple[int, int]:
        """The order (p, q) of the least `criterion`."""
        found = self.orders.best(criterion)
        return found.p, found.q

    def document(self) -> dict[str, Any]:
        """What ``thermaltool order --json`` writes."""
        from thermaltool.report.orders import order_document

        return order_document(self.name, self.orders, self.criteria)

    def table(self) -> str:
        """The best orders by each criterion, side by side."""
        from thermaltool.report.orders import order_table

        return order_table(self.orders, self.criteria)

    def draw(self) -> Figure:
        """Criteria above their best against the AR order."""
        from thermaltool.report.series_figures import draw_orders

        return draw_orders(self.document())

    @property
    def frame(self) -> pandas.DataFrame:
        """Criteria, one row per order; `exact` where the likelihood is at its maximum."""
        rows = self.document()["table"]
        return to_frame({key: [row[key] for row in rows] for key in rows[0]})


@reads(SeriesReading)
def order(
    data: Data,
    column: str,
    *,
    max_p: int = 10,
    max_q: int = 10,
    criteria: Sequence[str] = ("aic", "aicc", "bic"),
    effort: float = 1.0,
    detrend: str | None = None,
    difference: int | None = None,
    outliers: str = "omit",
    warn: Notice = notice,
    **reading: Unpack[SeriesReading],
) -> OrderReport:
    """Which AR or ARMA order a series has: every order up to (max_p, max_q) at once.

    Parameters
    ----------
    data : str, path, pandas.DataFrame or Record
    column : str
        Any name will do.
    max_p, max_q : int
        Largest AR and MA order.
    criteria : sequence of {"aic", "aicc", "bic", "gao"}
    effort : float
        Factor on the likelihoods that the search may take.
    detrend : {"mean", "linear", "none"}, optional
        What is estimated along. Default: the mean; nothing with a difference.
    difference : int, optional
        The series is differenced so often first.
    outliers : {"omit", "keep"}
        Samples that stand alone count as missing, or are taken as they are.
    warn : callable
        Takes sentences on what a user must know before the best orders are believed. Default: a
        `ThermalToolWarning` each.
    **reading
        columns, from_format, max_gap as for `read_log`; period, start, stop [s].

    Returns
    -------
    OrderReport

    Raises
    ------
    FitError
        A constant or computed series, or too short for the smallest models.
    LogError
        As `read_log`; an uneven clock.
    ValueError
        An unknown criterion.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> x = np.random.default_rng(1).standard_normal(500)
    >>> for k in range(1, 500):
    ...     x[k] += 0.7 * x[k - 1]
    >>> frame = pd.DataFrame({"time_s": np.arange(500.0), "d_z_um": x})
    >>> tt.order(frame, "d_z_um", max_p=3, max_q=1, criteria=["bic"]).best("bic")
    (1, 0)
    """
    from thermaltool.report.orders import order_warnings
    from thermaltool.timeseries.criteria import criteria_named
    from thermaltool.timeseries.order import BUDGET, select_order
    from thermaltool.timeseries.runs import difference as differences

    names = criteria_named(criteria)
    series, _ = read_even(data, column, warn, **reading)
    record, degree, times = prepared(
        series, warn, detrend=detrend, difference=difference, outliers=outliers
    )
    changed, place = differences(record, times), place_of(record)
    budget = max(round(effort * BUDGET), 1)
    try:
        orders = select_order(changed, max_p, max_q, degree, names, budget)
    except FitError as error:
        raise FitError(f"{place}: {error}") from error
    notes = tuple(order_warnings(orders, names, changed, degree, times))
    for message in notes:
        warn(f"{place}: {message}")
    return OrderReport(f"{column}, {record.name}", orders, names, notes)
