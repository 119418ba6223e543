"""The nomenclature of column names."""

from __future__ import annotations

import pytest

from thermaltool.errors import UnitError
from thermaltool.units import (
    UNITS,
    Channel,
    clock_unit,
    converted,
    counts_from_first,
    drive_reference,
    hold_of,
    is_displacement,
    parse_channel,
    per,
    printed,
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
        ("V_coolant_l/min", ("V", "coolant", "l/min"), "flow"),
        ("m_air_kg/s", ("m", "air", "kg/s"), "mass flow"),
        ("p_coolant_kPa", ("p", "coolant", "kPa"), "pressure"),
        ("v_x_m/min", ("v", "x", "m/min"), "velocity"),
        ("v_x_mm/s", ("v", "x", "mm/s"), "velocity"),
        ("M_spindle_Nm", ("M", "spindle", "Nm"), "torque"),
        ("q_wall_W/m2", ("q", "wall", "W/m2"), "heat flux"),
        ("q_wall_W/m^2", ("q", "wall", "W/m^2"), "heat flux"),
        ("R_joint_K/W", ("R", "joint", "K/W"), "thermal resistance"),
        ("C_node_J/K", ("C", "node", "J/K"), "heat capacity"),
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
        parse_channel("T_a_degc")
    with pytest.raises(UnitError, match="did you mean d_z_um"):
        parse_channel("d_z_µm")


@pytest.mark.parametrize("name", ["T_a_degF", "Q_m_hW", "d_z_cm"])
def test_no_other_unit_is_suggested(name: str) -> None:
    with pytest.raises(UnitError) as caught:
        parse_channel(name)
    assert "did you mean" not in str(caught.value)


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


@pytest.mark.parametrize(
    ("value", "unit", "to", "expected"),
    [
        (1.0, "m3/h", "l/min", 1000 / 60),
        (2.0, "m3/s", "m3/h", 7200.0),
        (1.0, "l/h", "ml/min", 1000 / 60),
        (7.2, "kg/h", "kg/s", 0.002),
        (1013.25, "mbar", "kPa", 101.325),
        (0.6, "MPa", "bar", 6.0),
        (1.0, "bar", "Pa", 1e5),
        (1.0, "W/cm2", "W/m^2", 1e4),
        (1.0, "kW/m2", "W/m2", 1e3),
        (1.0, "d", "h", 24.0),
        (1.0, "us", "ns", 1e3),
        (1.0, "kg/s", "l/min", None),
        (1.0, "K/W", "W", None),
    ],
)
def test_units_of_one_quantity_are_converted(
    value: float, unit: str, to: str, expected: float | None
) -> None:
    found = converted(value, unit, to)
    assert found is None if expected is None else found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("unit", "by", "name", "text"),
    [
        ("um", "degC", "um/degC", "µm/°C"),
        ("K", "W", "K/W", "K/W"),
        ("um", "1", "um/1", "µm"),
        ("K", "W/m2", "K/(W/m2)", "K/(W/m²)"),
        ("W/m2", "K", "W/m2/K", "W/m²/K"),
        ("l/min", "rpm", "l/min/rpm", "l/min/rpm"),
        ("1", "m3/h", "1/(m3/h)", "1/(m³/h)"),
    ],
)
def test_the_unit_of_a_gain(unit: str, by: str, name: str, text: str) -> None:
    assert per(unit, by) == name
    assert printed(name) == text
