"""The model document: simulation, ranges, and what a file may not say."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from thermaltool.effects import effect_class
from thermaltool.effects.actuator_saturation import ActuatorSaturation
from thermaltool.effects.drive_nonlinearity import DriveNonlinearity
from thermaltool.errors import ModelError
from thermaltool.model import (
    Drive,
    Model,
    Output,
    Term,
    acting_drives,
    acting_effects,
    dumps,
    excursions,
    loads,
    relative,
    to_document,
)
from thermaltool.model.validity import unit_suspects
from thermaltool.record import Record
from thermaltool.responses.conduction import Conduction
from thermaltool.responses.deflection import Deflection
from thermaltool.responses.rational import Rational1

NEAR = Conduction(3.4, 0.9, 1 / 3000, 0.3)
BEND = Deflection(10.0, 1 / 900, 5.0, 1 / 3, 0.1, 0.004)


def model(**changes):
    parts = {
        "drives": (
            Drive("Q_main_1", "zero", 0.0, (0.0, 1.0)),
            Drive("T_room_degC", "first", "first", (-2.0, 2.0)),
        ),
        "outputs": (
            Output("T_a_degC", "sensor", 20.5, (0.0, 8.0), {"rmse": 0.02}),
            Output("d_x_um", "deflection", "first", (-1.0, 80.0)),
        ),
        "terms": (
            Term("Q_main_1", "T_a_degC", NEAR, np.diag([1e-3, 2e-5]), ("K", "r")),
            Term("Q_main_1", "d_x_um", BEND),
            Term("T_room_degC", "d_x_um", BEND),
        ),
        "sample_period": 0.1 + 0.2,
        "provenance": {"command": "thermaltool calibrate", "logs": []},
    }
    return Model(**{**parts, **changes})


def edited(*path, value=..., text=None):
    """The file with one place changed, or left out."""
    document = json.loads(text or dumps(model()))
    place = document
    for key in path[:-1]:
        place = place[key]
    if value is ...:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return json.dumps(document)


def test_round_trip():
    text = dumps(model())
    back = loads(text)
    assert dumps(back) == text
    assert back.sample_period == 0.1 + 0.2
    assert back.terms[0].response == NEAR
    np.testing.assert_array_equal(back.terms[0].covariance, np.diag([1e-3, 2e-5]))
    assert back.terms[0].covariance_names == ("K", "r")
    assert [o.channel for o in back.sensors] == ["T_a_degC"]
    assert [o.channel for o in back.deflections] == ["d_x_um"]
    assert list(json.loads(text)) == sorted(json.loads(text))


def test_outputs_are_sums_of_terms_from_rest():
    time = 5.0 * np.arange(300)
    heat = (time > 50).astype(float)
    room = 21 + 0.001 * time
    both = model().simulate(Record(time, {"Q_main_1": heat, "T_room_degC": room}))
    still = model().simulate(Record(time, {"Q_main_1": heat, "T_room_degC": np.full(300, 35.0)}))
    only_room = model().simulate(Record(time, {"Q_main_1": 0 * heat, "T_room_degC": room}))
    np.testing.assert_allclose(both["d_x_um"], still["d_x_um"] + only_room["d_x_um"], atol=1e-10)
    on = np.maximum(time - 55, 0)
    np.testing.assert_allclose(still["d_x_um"], BEND.step(on), atol=1e-10)
    np.testing.assert_allclose(still["T_a_degC"], NEAR.step(on), atol=3e-5 * NEAR.dc_gain())


def test_simulation_needs_every_drive_and_takes_any_length():
    with pytest.raises(ModelError, match="T_room_degC is not in the log"):
        model().simulate(Record(np.arange(3.0), {"Q_main_1": np.ones(3)}))
    for n in (0, 1, 2):
        drives = {"Q_main_1": np.ones(n), "T_room_degC": np.ones(n)}
        outputs = model().simulate(Record(np.arange(float(n)), drives))
        assert all(values.shape == (n,) for values in outputs.values())


def test_relative_to_the_first_value_that_is_there():
    values = np.array([np.nan, 3.0, 5.0])
    np.testing.assert_array_equal(relative(values, "first"), [np.nan, 0, 2])
    np.testing.assert_array_equal(relative(values, 1.0), [np.nan, 2, 4])
    assert relative(np.empty(0), "first").shape == (0,)


@pytest.mark.parametrize(
    ("size", "moved", "unit"),
    [
        (1.2, 20.0, "kW"),  # a thousandth, and the machine warms up all the same
        (1.2e6, 20.0, "mW"),
        (1.2, 0.1, None),  # hardly any heat, and nothing moves
        (100.0, 20.0, None),
        (700.0, 20.0, None),
    ],
)
def test_a_drive_in_another_unit_is_suspected(size, moved, unit):
    heater = Model(
        drives=(Drive("Q_a_W", "zero", 0.0, (0.0, 1500.0)),),
        outputs=(Output("T_a_degC", "sensor", 20.0, (0.0, 40.0)),),
        terms=(Term("Q_a_W", "T_a_degC", Rational1(0.03, 900.0)),),
        sample_period=10.0,
    )
    rise = np.linspace(0.0, 1.0, 50)
    found = unit_suspects(heater, {"Q_a_W": size * rise, "T_a_degC": 20.0 + moved * rise})
    assert [each.unit for each in found] == ([unit] if unit else [])
    assert [each.unit for each in unit_suspects(heater, {"Q_a_W": 1.2 * rise})] == ["kW"]


@pytest.mark.parametrize(
    ("channel", "offset", "first", "moved", "unit"),
    [
        ("T_a_degC", 20.0, 293.0, 40.0, "K"),
        ("T_a_degC", 20.0, 333.0, 60.0, "K"),  # warmer than the calibration, too
        ("T_a_degC", 20.0, 20.0, 280.0, None),  # hot, and not from the first row on
        ("T_a_degC", 20.0, 120.0, 40.0, None),
        ("T_a_degC", 20.0, 68.0, 72.0, "degF"),
        ("T_a_degC", 20.0, 77.0, 40.0, "degF"),  # a warmer shop, less heat
        ("T_a_degC", 20.0, 50.0, 40.0, None),  # it may be 50 degC: the calibration has seen it
        ("T_a_degC", 20.0, 293.0, 0.04, "K"),  # no thousandth of a temperature that has a zero
        ("d_x_um", "first", 5.0, 0.035, "mm"),
        ("d_x_um", "first", 5.0, 35.0, None),
        ("d_x_um", "first", 5.0, 0.0, None),  # dead
    ],
)
def test_an_output_in_another_unit_is_suspected(channel, offset, first, moved, unit):
    machine = Model(
        drives=(Drive("Q_a_W", "zero", 0.0, (0.0, 1500.0)),),
        outputs=(Output(channel, "sensor", offset, (0.0, 40.0)),),
        terms=(Term("Q_a_W", channel, Rational1(0.03, 900.0)),),
        sample_period=10.0,
    )
    rise = np.linspace(0.0, 1.0, 50)
    found = unit_suspects(machine, {"Q_a_W": 1200.0 * rise, channel: first + moved * rise})
    assert [(each.channel, each.unit) for each in found] == ([(channel, unit)] if unit else [])
    # A machine that rests moves as little by right.
    at_rest = unit_suspects(machine, {"Q_a_W": 0 * rise, channel: first + moved * rise})
    assert [each.unit for each in at_rest] == ([unit] if unit in ("K", "degF") else [])


def test_excursions():
    columns = {
        "Q_main_1": np.array([0, 1.05, 1.2, -0.2, np.nan]),
        "T_a_degC": np.array([20.5, 28.5, 28.5, 28.5, 28.5]),
        "d_x_um": np.array([500.0, 500, 570, 580, 500]),
    }
    (found,) = excursions(model(), columns)
    assert (found.channel, found.rows, found.first) == ("Q_main_1", 2, 2)
    assert (found.value, found.low, found.high) == (1.2, 0.0, 1.0)
    columns["d_x_um"][4] = 400
    assert [e.channel for e in excursions(model(), columns)] == ["Q_main_1", "d_x_um"]


def test_levels_of_a_loss_have_a_range():
    table = {"level0": 0.0, "rate0": 0.0, "level1": 10.0, "rate1": 1e-3}
    flowing = replace(model(), effects=(effect_class("convection_state")("V_water_l/min", table),))
    columns = {"V_water_l/min": np.array([0.0, 5.0, 10.9, 12.0, np.nan])}
    (found,) = excursions(flowing, columns)
    assert (found.channel, found.rows, found.value) == ("V_water_l/min", 1, 12.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"f\.json:1: not JSON"),
        ("{\n1", r"f\.json:2: not JSON"),
        ("[1]", r"f\.json: not a thermaltool model"),
        ('{"format": "else"}', r"f\.json: not a thermaltool model"),
        (edited("version", value=2), r"f\.json: version 2 is newer .* update it"),
        (edited("version"), r"f\.json: no version"),
        (edited("version", value="1"), r"f\.json: no version"),
        (edited("version", value=0), r"f\.json: no version"),
        (edited("drives"), r"f\.json: 'drives' is missing"),
        (
            edited("terms", 0, "parameters", "alpha"),
            r"^f\.json: terms\[0\]\.parameters: 'alpha' is missing",
        ),
        (
            edited("terms", 0, "parameters", "alpha", value=-1),
            r"f\.json: terms\[0\]: conduction needs",
        ),
        (
            edited("terms", 0, "parameters", "K", value=float("nan")),
            r"\[0\]\.parameters\.K: not a f",
        ),
        (
            edited("terms", 1, "parameters", "B", value=float("inf")),
            r"\[1\]\.parameters\.B: not a f",
        ),
        (edited("terms", 1, "parameters", "B", value="much"), "B: not a finite number: 'much'"),
        (edited("terms", 1, "parameters", value=[1]), r"terms\[1\]\.parameters: not an object"),
        (edited("terms", 0, "kind", value="radiation"), "unknown response 'radiation'; known: con"),
        (edited("terms", 0, "output", value="T_b_degC"), "'T_b_degC', which are not there"),
        (edited("terms", 0, "drive", value="Q_2_1"), "from 'Q_2_1'"),
        (edited("drives", 0, "hold", value="linear"), "'linear' is none of zero, first"),
        (edited("outputs", 0, "role", value="probe"), "'probe' is none of sensor, deflection"),
        (edited("drives", 0, "reference", value="last"), "last"),
        (edited("outputs", 0, "offset", value=float("nan")), "not a finite number"),
        (edited("outputs", 0, "range", value=[1]), r"outputs\[0\]\.range: not two numbers: \[1\]"),
        (edited("outputs", 0, "range", value=[0, float("inf")]), "not a finite number"),
        (edited("sample_period_s", value=0), "sample_period_s: not above 0: 0"),
        (edited("sample_period_s", value=None), "sample_period_s: not a finite number: None"),
        (edited("terms", value=7), "terms: not a list: 7"),
        (edited("terms", value=[]), "terms: there is none"),
        (edited("terms", 0, value=[]), r"terms\[0\]: not an object: \[\]"),
        (edited("terms", 0, value="T_a_degC"), r"terms\[0\]: not an object: 'T_a_degC'"),
        (edited("terms", 0, "kind", value=["a"]), r"terms\[0\]\.kind: not a name: \['a'\]"),
        (
            edited("terms", 0, "covariance", value=[[1], [1, 2]]),
            r"covariance: cannot be read: \[\[1\]",
        ),
        (edited("terms", 0, "covariance", value=[1]), r"terms\[0\]\.covariance: not a square of f"),
        (
            edited("terms", 0, "band", value={"channel": 3}),
            r"terms\[0\]\.band: channel: not a name",
        ),
        (edited("effects", value=[{"channel": 3}]), r"effects\[0\]\.channel: not a name: 3"),
        (edited("terms", 0, "covariance_names", value="K"), "covariance_names: not a list: 'K'"),
        (
            edited("terms", 0, "band", value={"channel": "n_1_rpm"}),
            r"\[0\]\.band: 'levels' is missing",
        ),
        (edited("terms", 0, "band", value="high"), r"terms\[0\]\.band: not an object: 'high'"),
        (edited("drives", 0, "channel", value=3), r"drives\[0\]\.channel: not a name: 3"),
        (edited("drives", 1, "channel", value="Q_main_1"), "Q_main_1 is there twice"),
        (edited("drives", 0, "range", value=[5, 1]), r"drives\[0\]\.range: 5 is above 1"),
        (
            edited("outputs", 1, "range", value="wide"),
            r"outputs\[1\]\.range: not two numbers: 'wide'",
        ),
        (edited("outputs", 1, "fit", value=3), r"outputs\[1\]\.fit: not an object: 3"),
        (
            edited("effects", value=[{"name": "sensor_lag", "channel": "T_a_degC"}]),
            r"effects\[0\]: 'parameters' is missing",
        ),
        (
            edited("effects", value=[{"name": ["a"], "channel": "T_a_degC"}]),
            r"effects\[0\]: cannot be read: \{\"name\": \[",
        ),
        (edited("effects", value=["drift"]), r"effects\[0\]: not an object: 'drift'"),
        (edited("provenance", value="calibrate"), "provenance: not an object: 'calibrate'"),
        (edited("design", value="kalman"), "design: not an object: 'kalman'"),
        (
            edited("drives", 0, "range", value=[0, 10**400]),
            "range\\[1\\]: not a finite number: 10{59}$",
        ),
    ],
)
def test_unsound_files_are_named(text, message):
    with pytest.raises(ModelError, match=message) as caught:
        loads(text, "f.json")
    assert str(caught.value).startswith("f.json:")
    assert "\n" not in str(caught.value)


def test_what_an_older_file_may_lack():
    text = dumps(model())
    for path in (("provenance",), ("outputs", 0, "fit"), ("terms", 0, "covariance")):
        text = edited(*path, text=text)
    back = loads(text)
    assert back.terms[0].covariance is None
    assert back.design is None
    assert to_document(back)["outputs"][0]["fit"] == {}


def test_no_nan_is_written():
    bad = model(outputs=(Output("T_a_degC", "sensor", float("nan"), (0.0, 1.0)),))
    with pytest.raises(ValueError, match="not a finite number: nan"):
        dumps(bad)


def test_a_design_that_reads_an_unknown_sensor():
    with pytest.raises(ModelError, match="sensor that the model does not have"):
        model().with_design({"sensors": ["T_b_degC"]}).estimator_design()


def test_a_drive_saturates_before_it_is_squared():
    """Whichever of the two was found first."""
    square = DriveNonlinearity("Q_1_1", {"exponent": 2.0, "level": 1.0})
    limit = ActuatorSaturation("Q_1_1", {"limit": 0.5, "level": 1.0})
    time = np.arange(3.0)
    record = Record(time, {"Q_1_1": np.array([0.0, 0.4, 1.0])})
    drive = Drive("Q_1_1", "zero", 0.0, (0.0, 1.0))
    for effects in ((square, limit), (limit, square)):
        model = Model((drive,), (), (), 1.0, effects=effects)
        acts = acting_drives(model, acting_effects(model), record)["Q_1_1"]
        np.testing.assert_allclose(acts, [0.0, 0.16, 0.25])
