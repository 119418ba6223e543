from __future__ import annotations

import numpy as np
import pytest
from matplotlib.dates import num2date

from thermaltool.logs import Log
from thermaltool.record import Record
from thermaltool.report.clock_axis import clock_axis, record_axis
from thermaltool.report.records import draw_log
from thermaltool.report.series_figures import ForecastCurve, draw_forecasts


def wall_clock(axis, time):
    """What the axis shows at a time [s]."""
    return num2date(axis.of(np.array([time]))[0]).strftime("%Y-%m-%d %H:%M:%S")


def test_seconds_minutes_or_hours():
    assert clock_axis(np.array([0.0, 500.0])).label == "time [s]"
    axis = clock_axis(np.array([100.0, 9000.0]))
    assert (axis.label, axis.dated) == ("time [min]", False)
    assert axis.of(np.array([600.0])) == pytest.approx(10.0)


def test_stamps_are_dates_of_their_own_wall_clock():
    axis = clock_axis(np.array([0.0, 60.0]), "2024-03-30T22:10:00+01:00")
    assert axis.label == "time, UTC+01:00"
    assert wall_clock(axis, 3600.0) == "2024-03-30 23:10:00"
    assert clock_axis(np.array([0.0]), "2024-03-30T22:10:00").label == "time"


def test_seconds_since_1970_are_dates():
    axis = clock_axis(np.array([1.7e9, 1.7e9 + 60]))
    assert axis.label == "time, UTC"
    assert wall_clock(axis, 1.7e9) == "2023-11-14 22:13:20"
    # Thirty years of uptime are none.
    assert not clock_axis(np.array([9e8, 9e8 + 60])).dated


@pytest.mark.parametrize("span", [100.0, 230.0, 4 * 3600.0, 4 * 86400.0, 150 * 86400.0])
def test_dates_of_any_span_have_ticks(span):
    """Warnings are errors here: matplotlib had no interval for some spans."""
    log = Log(
        np.linspace(0.0, span, 50), {"T_a_degC": np.arange(50.0)}, epoch="2024-03-30T22:10:00"
    )
    figure = draw_log(log)
    figure.canvas.draw()
    assert 2 <= len(figure.axes[-1].get_xticks()) <= 8


def test_a_log_of_one_stamp_shows_hours_and_no_years():
    log = Log(np.array([0.0]), {"T_a_degC": np.array([20.0])}, epoch="2024-01-01T10:00:00")
    (ax,) = draw_log(log).axes
    low, high = (num2date(x).strftime("%m-%d %H:%M") for x in ax.get_xlim())
    assert (low, high) == ("01-01 09:00", "01-01 11:00")


def test_a_forecast_follows_its_history():
    history = Record(np.arange(200.0), {"d_tool_um": np.arange(200.0)})
    ahead = np.arange(200.0, 210.0)
    (ax,) = draw_forecasts(
        [ForecastCurve("d_tool_um", ahead, ahead, ahead - 1, ahead + 1)], history
    ).axes
    lines = {line.get_label(): line.get_xdata() for line in ax.lines}
    # Sixty rows of history for ten of forecast.
    assert (lines["measured"][0], lines["measured"][-1]) == (140.0, 199.0)
    assert lines["forecast"].tolist() == ahead.tolist()
    assert ax.get_ylabel() == "displacement [µm]"
    assert record_axis(history).label == ax.get_xlabel()
