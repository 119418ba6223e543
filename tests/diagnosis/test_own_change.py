"""What the model's own parameters have become: a machine that loses its heat at another rate."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.diagnosis.own_change import loss_of_heat
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.model import Term
from thermaltool.record import Record
from thermaltool.responses.rational import Rational1

HEAT, HEAD, BASE = "P_heater_W", "T_head_degC", "T_base_degC"
PERIOD, ROWS = 8.0, 700
END = np.array([0.0, 6000.0])


def two_lumps(seed: int, loss: float = 1.0) -> Record:
    """A head of 400 J/K on a base of 900 J/K, both in still air [W/K], heated in steps."""
    generator = np.random.default_rng(seed)
    heat = np.repeat(generator.choice([0.0, 20.0, 50.0, 80.0], 20), ROWS // 20)
    state = np.zeros(2)
    rows = [state]
    for power in heat[:-1]:
        for _ in range(8):
            head, base = state
            through = 1.5 * (head - base)
            state = state + PERIOD / 8 * np.array(
                [
                    (power - 0.8 * loss * head - through) / 400.0,
                    (through - 0.6 * loss * base) / 900.0,
                ]
            )
        rows.append(state)
    read = 21.0 + np.array(rows) + 0.03 * generator.standard_normal((ROWS, 2))
    columns = {HEAT: heat, HEAD: read[:, 0], BASE: read[:, 1]}
    return Record(PERIOD * np.arange(ROWS), columns, name=f"{seed}.csv", digest=f"{seed}")


@pytest.mark.slow
@pytest.mark.parametrize(("loss", "told"), [(1.4, "as fast"), (0.7, "as slowly")])
def test_another_loss_of_heat_is_told(loss: float, told: str) -> None:
    plan = CalibrationPlan((HEAT,), (HEAD, BASE), kinds=dict.fromkeys((HEAD, BASE), "rational2"))
    model = calibrate([two_lumps(1)], plan)
    (cause,) = diagnose(model, [two_lumps(2, loss)]).causes
    assert cause.effect.name == "unknown"
    factor = float(cause.action.partition("heat is lost ")[2].partition(" times")[0])
    assert told in cause.action
    assert factor == pytest.approx(max(loss, 1 / loss), rel=0.1)


@pytest.mark.parametrize(
    ("gain", "rate", "told"),
    [
        (0.5, 2.0, "less, and sooner, as where heat is lost 2 times as fast"),
        (1.25, 0.8, "more, and later, as where heat is lost 1.2 times as slowly"),
        (0.5, 1.0, ""),  # a weaker drive
        (1.0, 2.0, ""),  # a lighter machine
        (-0.5, 2.0, ""),
        (0.0, 2.0, ""),
        (0.95, 1.05, ""),  # hardly anything
    ],
)
def test_gains_and_time_constants_that_change_alike(gain: float, rate: float, told: str) -> None:
    before = [Term(HEAT, HEAD, Rational1(0.8, 600.0)), Term(HEAT, BASE, Rational1(0.3, 900.0))]
    room = Term("T_room_degC", HEAD, Rational1(1.0, 900.0))
    after = [
        Term(t.drive, t.output, Rational1(gain * t.response.K1, t.response.tau1 / rate))
        for t in before
    ]
    said = loss_of_heat([*before, room], [*after, room], END * 10)
    assert (told in said) if told else not said


def test_one_output_alone_does_not_tell_another_loss() -> None:
    before = [Term(drive, HEAD, Rational1(0.8, 600.0)) for drive in (HEAT, "P_pump_W")]
    after = [Term(each.drive, HEAD, Rational1(0.4, 300.0)) for each in before]
    assert loss_of_heat(before, after, END * 10) == ""
