"""The nomenclature of column names."""

from __future__ import annotations

import pytest

from thermaltool.errors import UnitError
from thermaltool.units import UNITS, Channel, parse_channel


@pytest.mark.parametrize(
    ("name", "channel", "dimension"),
    [
        ("T_spindle_degC", ("T", "spindle", "degC"), "temperature"),
        ("T_degC", ("T", "", "degC"), "temperature"),
        ("dT_pair1_K", ("dT", "pair1", "K"), "temperature difference"),
        ("T_bed_target_degC", ("T", "bed_target", "degC"), "temperature"),
        ("Q_main_1", ("Q", "main", "1"), "ratio"),
        ("d_z_um", ("d", "z", "um"), "length"),
    ],
)
def test_parts_of_a_name(name: str, channel: tuple[str, str, str], dimension: str) -> None:
    parsed = parse_channel(name)
    assert parsed == Channel(name, *channel)
    assert parsed.dimension == dimension


@pytest.mark.parametrize("name", ["", "T", "temperature", "T_spindle", "T_spindle_C", "_", "T_"])
def test_an_unknown_unit_is_told_with_the_list(name: str) -> None:
    with pytest.raises(UnitError, match="unknown unit") as caught:
        parse_channel(name)
    assert all(unit in str(caught.value) for unit in UNITS)


def test_the_near_unit_is_named() -> None:
    with pytest.raises(UnitError, match="did you mean T_a_degC"):
        parse_channel("T_a_degF")


def test_absolute_and_difference_temperatures_are_not_mixed() -> None:
    for name in ("dT_a_degC", "T_a_K", "T_a_mK"):
        with pytest.raises(UnitError):
            parse_channel(name)
