"""Options that are times take seconds, or a time with its unit."""

from __future__ import annotations

import click
import pytest

from thermaltool.cli.types import DELAY, DURATION, SECONDS, DeadTime


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("8h", 28800.0), ("10 min", 600.0), ("1.5d", 129600.0), ("250ms", 0.25), ("1e3s", 1000.0),
     ("90", 90.0), ("1e3", 1000.0)],
)  # fmt: skip
def test_a_time_may_have_its_unit(text, seconds):
    for kind in (SECONDS, DURATION, DELAY, DeadTime()):
        assert kind.convert(text, None, None) == pytest.approx(seconds)


def test_a_time_may_be_below_zero_where_a_number_may():
    assert SECONDS.convert("-2min", None, None) == -120.0
    for kind in (DURATION, DELAY):
        with pytest.raises(click.BadParameter, match="not in the range"):
            kind.convert("-2min", None, None)


@pytest.mark.parametrize("text", ["5m", "3psi", "8H", "2K", "5µm"])
def test_another_unit_is_no_time(text):
    with pytest.raises(click.BadParameter, match="is not a time, like 30s, 10min or 8h"):
        DURATION.convert(text, None, None)


@pytest.mark.parametrize("text", ["nan", "inf", "s", "1h30", "h8", "", "nans", "1 2s"])
def test_what_is_no_number_is_no_time(text):
    with pytest.raises(click.BadParameter):
        DURATION.convert(text, None, None)
