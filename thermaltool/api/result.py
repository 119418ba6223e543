"""What the results of all stages have in common."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from thermaltool.errors import ThermalToolWarning

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from thermaltool.record import Record

Notice = Callable[[str], None]
PACKAGE = __name__.partition(".")[0]


class Result:
    """A result that prints as the table of its command and draws itself.

    A subclass gives `table` and `frame`, `notes` where there are any, and `draw` where there is a
    figure.
    """

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know before using the result, each a sentence; printed below the table."""
        return ()

    @property
    def frame(self) -> pandas.DataFrame:
        """The result as a data frame."""
        raise NotImplementedError

    def table(self) -> str:
        """The result as text, the table that the command prints."""
        raise NotImplementedError

    def draw(self) -> Figure:
        """The figure of the result, in whatever style is set."""
        raise NotImplementedError(f"{type(self).__name__} has no figure")

    def plot(self) -> Figure:
        """The figure of the result, in the style of the commands' figures.

        Returns
        -------
        matplotlib.figure.Figure
        """
        from thermaltool.report.style import common_style

        with common_style():
            return self.draw()

    def __repr__(self) -> str:
        return "\n".join([self.table(), *self.notes])


def notice(message: str) -> None:
    """Tell what a result is to be read with, as a `ThermalToolWarning`."""
    level, frame = 2, sys._getframe(1)
    # The line to show is that of the caller outside the package.
    while frame.f_back and frame.f_globals.get("__name__", "").startswith(f"{PACKAGE}."):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, ThermalToolWarning, stacklevel=level)


def silent(message: str) -> None:
    """Tell nobody."""


def to_frame(columns: Mapping[str, Any] | Record) -> pandas.DataFrame:
    """A data frame of columns, ``time_s`` as its index where it is there.

    Parameters
    ----------
    columns : mapping of str to ndarray, shape (n,), or Record

    Returns
    -------
    pandas.DataFrame

    Examples
    --------
    >>> import numpy as np, thermaltool as tt
    >>> tt.to_frame(tt.Record(np.array([0.0, 10.0]), {"T_a_degC": np.array([20.0, 20.5])}))
            T_a_degC
    time_s
    0.0         20.0
    10.0        20.5
    """
    import pandas

    if not isinstance(columns, Mapping):
        columns = {"time_s": columns.time, **columns.columns}
    frame = pandas.DataFrame(dict(columns))
    return frame.set_index("time_s") if "time_s" in frame else frame
