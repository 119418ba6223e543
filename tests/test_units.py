"""The nomenclature of column names."""

from __future__ import annotations

import pytest

from thermaltool.errors import UnitError
from thermaltool.units import (
    UNITS,
    Channel,
    clock_unit,
    counts_from_first,
    drive_reference,
    hold_of,
    is_displacement,
    parse_channel,
)


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


@pytest.mark.parametrize(
    ("name", "hold", "reference", "displacement", "from_first"),
    [
        ("T_spindle_degC", "first", "first", False, True),
        ("dT_pair1_K", "first", 0.0, False, False),
        ("d_z_um", "first", 0.0, True, True),
        ("a_head_urad", "first", 0.0, True, True),
        ("Q_main_W", "zero", 0.0, False, False),
        ("Q_main_1", "zero", 0.0, False, False),
        ("n_spindle_rpm", "zero", 0.0, False, False),
        ("U_heater_V", "zero", 0.0, False, False),
    ],
)
def test_hold_and_zero_follow_from_the_quantity(
    name: str, hold: str, reference: float | str, displacement: bool, from_first: bool
) -> None:
    assert hold_of(name) == hold
    assert drive_reference(name) == reference
    assert is_displacement(name) is displacement
    assert counts_from_first(name) is from_first


def test_the_clock_is_found_by_its_name() -> None:
    assert clock_unit(["time", "time_min", "T_a_degC"]) == "min"
    assert clock_unit(["T_a_degC", "time"]) == "iso"
    assert clock_unit(["t_s", "T_a_degC"]) is None
