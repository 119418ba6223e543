"""Heat that is lost faster or slower for good: machines that share no code with the models."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.model import Model, dumps, loads
from thermaltool.record import Record

HEAT, ROOM, NEAR, FAR = "P_heater_W", "T_room_degC", "T_near_degC", "T_far_degC"
PERIOD, ROWS, CELLS = 10.0, 900, 24
# Of a fin of aluminium: conduction between cells over the capacity of one, and the film [1/s].
EXCHANGE, FILM, WATT = 0.05, 1e-3, 2e-3


def fin(seed: int, loss: float = 1.0, power: float = 1.0, noise: float = 0.01) -> Record:
    """Heated at one end in steps, in still air along all of it; read near the heater and far."""
    generator = np.random.default_rng(seed)
    heat = np.repeat(generator.choice([0.0, 10.0, 25.0, 40.0], 18), ROWS // 18)
    rates = np.zeros((CELLS, CELLS))
    for k in range(CELLS - 1):
        rates[k : k + 2, k : k + 2] += EXCHANGE * np.array([[-1.0, 1.0], [1.0, -1.0]])
    rates -= loss * FILM * np.eye(CELLS)
    # Implicit: each row by its own power, in ten steps.
    step = np.linalg.inv(np.eye(CELLS) - PERIOD / 10 * rates)
    state, rows = np.zeros(CELLS), []
    for watts in heat:
        rows.append(state)
        for _ in range(10):
            state = step @ (state + PERIOD / 10 * WATT * power * watts * (np.arange(CELLS) == 0))
    read = 20.0 + np.array(rows)[:, [1, -2]] + noise * generator.standard_normal((ROWS, 2))
    columns = {HEAT: heat, NEAR: read[:, 0], FAR: read[:, 1]}
    return Record(PERIOD * np.arange(ROWS), columns, name=f"{seed}.csv", digest=f"{seed}")


def two_lumps(seed: int, loss: float = 1.0, noise: float = 0.03, power: float = 1.0) -> Record:
    """A head of 400 J/K on a base of 900 J/K in a room that moves, films of 0.8 and 0.6 W/K."""
    generator = np.random.default_rng(seed)
    heat = np.repeat(generator.choice([0.0, 20.0, 50.0, 80.0], 20), ROWS // 20)
    time = PERIOD * np.arange(ROWS)
    room = 21.0 + 1.5 * np.sin(2 * np.pi * time / generator.uniform(4e3, 8e3))
    state, rows = np.full(2, 21.0), []
    for watts, air in zip(power * heat, room, strict=True):
        rows.append(state)
        for _ in range(10):
            head, base = state
            through = 1.5 * (head - base)
            gained = watts - 0.8 * loss * (head - air) - through
            rates = np.array([gained / 400.0, (through - 0.6 * loss * (base - air)) / 900.0])
            state = state + PERIOD / 10 * rates
    read = np.array(rows) + noise * generator.standard_normal((ROWS, 2))
    columns = {HEAT: heat, ROOM: room, NEAR: read[:, 0], FAR: read[:, 1]}
    return Record(time, columns, name=f"{seed}.csv", digest=f"{seed}")


def most_left(after: Model, before: Model, later: Record) -> float:
    """What is left of the error of either output at most, by a model that knows of the change."""

    def left(model: Model, output: str) -> float:
        return float(np.std(later.columns[output] - model.simulate(later)[output]))

    return max(left(after, output) / left(before, output) for output in (NEAR, FAR))


@pytest.fixture(scope="module")
def model() -> Model:
    kinds = dict.fromkeys((NEAR, FAR), "rational3")
    return calibrate([fin(1), fin(2)], CalibrationPlan((HEAT,), (NEAR, FAR), kinds=kinds))


@pytest.mark.slow
@pytest.mark.parametrize("loss", [1.5, 0.7])
def test_another_loss_of_heat_is_named_with_its_factor(model: Model, loss: float) -> None:
    found = diagnose(model, [fin(3, loss)])
    assert [cause.effect.name for cause in found.causes] == ["loss_change"]
    (cause,) = found.causes
    assert cause.effect.parameters["factor"] == pytest.approx(loss, rel=0.05)
    # What it is good for: another log of the changed machine.
    assert most_left(found.model, model, fin(4, loss, noise=0.0)) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("power", "named"), [(1.0, []), (0.8, ["drive_gain"])])
def test_no_other_loss_is_told_of_a_sound_or_a_weaker_machine(
    model: Model, power: float, named: list[str]
) -> None:
    found = diagnose(model, [fin(5, power=power)])
    assert [cause.effect.name for cause in found.causes] == named


@pytest.mark.slow
def test_films_that_are_not_as_the_bodies_behind_them_in_a_room_that_moves() -> None:
    loss = 1.4
    plan = CalibrationPlan((HEAT, ROOM), (NEAR, FAR), kinds=dict.fromkeys((NEAR, FAR), "rational2"))
    model = calibrate([two_lumps(1), two_lumps(2)], plan)
    found = diagnose(model, [two_lumps(3, loss)], [two_lumps(4, loss)])
    assert [cause.effect.name for cause in found.causes] == ["loss_change"]
    assert found.causes[0].effect.parameters["factor"] == pytest.approx(loss, rel=0.1)
    # How modes mix is followed to first order.
    assert most_left(found.model, model, two_lumps(5, loss, noise=0.0)) < 0.1
    # Weights of outputs are no gain of a drive.
    weak = diagnose(model, [two_lumps(6, power=0.8)], [two_lumps(7, power=0.8)])
    assert [cause.effect.name for cause in weak.causes] == ["drive_gain"]
    assert not any("loss_change" in each.names for each in weak.alternatives)


@pytest.mark.slow
def test_a_loss_that_changed_in_one_of_two_logs_is_of_that_log_alone(model: Model) -> None:
    logs = [fin(3), fin(4, 1.5)]
    found = diagnose(model, logs)
    assert [(cause.effect.name, cause.effect.log) for cause in found.causes] == [
        ("loss_change", logs[1].digest)
    ]
    assert all(term.response.kind == "rational3" for term in found.model.terms)


@pytest.mark.slow
def test_a_changed_machine_is_the_one_that_the_written_model_knows(model: Model) -> None:
    found = diagnose(model, [fin(3, 1.5)])
    assert found.model.effects == ()
    assert [each["name"] for each in found.model.provenance["changed"]] == ["loss_change"]
    changed = loads(dumps(found.model))
    assert diagnose(changed, [fin(4, 1.5)]).verdict == "adequate"
    (again,) = diagnose(changed, [fin(5, 1.2)]).causes
    assert again.effect.name == "loss_change"
    assert again.effect.parameters["factor"] == pytest.approx(1.2 / 1.5, rel=0.05)
