"""The runner of the exam: one machine, a clean log and strong known trouble in another.

What it counts is tested here, on a machine that it draws; how the tool fares is for `make exam`.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import exam
import exam_machine
import exam_scoring as scoring
import exam_tables as tables
from as_simulated import MAX_DIFFERENCE, compared, largest
from machines.foreign import PLANTS

SEED = 20261122


def trial(group: str, kind: str, size: float = 15.0, index: int = 0) -> scoring.Trial:
    return scoring.Trial(index, "rod", SEED, group, kind, size, SEED)


def small_rod(generator):
    """A rod with one thermometer and a log of 300 rows."""
    plant = PLANTS["rod"](generator)
    sensors = {"T_near_degC": plant.sensors["T_near_degC"]}
    return replace(plant, sensors=sensors, dt=5 * plant.dt, steps=300)


@pytest.fixture
def scores(monkeypatch):
    monkeypatch.setattr(exam_machine, "PLANTS", {"rod": small_rod})
    trials = [trial("clean", "", 0.0), trial("size 15", "sensor_gain", index=1)]
    return exam_machine.score_machine(trials)


@pytest.mark.slow
def test_the_runner_scores_a_clean_and_a_troubled_log(scores):
    clean, gain = scores
    assert not clean.failure
    assert not gain.failure
    assert clean.size == 0.0
    assert gain.size == pytest.approx(15.0, rel=0.06)
    assert gain.channel == "T_near_degC"
    assert gain.power == pytest.approx(1.0)
    # Three logs of two outputs.
    assert {each.log for each in gain.agreed} == {"diagnosed", "validation", "calibration"}
    assert len(gain.agreed) == 6
    # So large a gain is seen, whatever it is called, and the report tells what is written.
    assert not gain.adequate
    assert gain.told_off < MAX_DIFFERENCE
    text = "\n".join(tables.tables(scores, exam.SIZES, SEED))
    assert f"Seed {SEED}, 2 logs of 1 machines" in text


def test_what_is_right_and_wrong():
    plain = scoring.Score(trial("size 5", "sensor_gain"), channel="T_far_degC")

    def named(name: str, evidence: float = 50.0, channel: str = "T_far_degC", begins=None):
        return scoring.Named(name, channel, evidence, 0.9, begins)

    right = replace(plain, causes=(named("sensor_gain"), named("periodic")))
    near = replace(plain, causes=(named("sensor_conversion"),))
    wrong = replace(plain, causes=(named("periodic"),))
    weak = replace(plain, causes=(named("periodic", 5.0),))
    told = replace(wrong, declared=("periodic", "sensor_gain"))
    assert [s.first for s in (plain, right, near, wrong)] == [False, True, False, False]
    assert [s.grouped for s in (plain, right, near, wrong, told)] == [
        False,
        True,
        True,
        False,
        True,
    ]
    assert [s.wrong for s in (plain, right, wrong, weak, told)] == [
        False,
        False,
        True,
        False,
        False,
    ]
    assert [s.silent for s in (plain, wrong)] == [True, False]


def test_what_an_unknown_kind_is_told_as():
    plain = scoring.Score(
        trial("unknown", "contact_loss"), channel="T_far_degC", begins=500.0, duration=1000.0
    )

    def told(name: str, channel: str = "", evidence: float = 50.0, begins: float | None = None):
        return replace(plain, causes=(scoring.Named(name, channel, evidence, 0.9, begins),))

    assert told("unknown").called
    assert not told("unknown").misnamed
    assert told("sensor_drift", "T_far_degC").located
    assert told("geometry_step", "d_x_um", begins=560.0).located
    assert told("geometry_step", "d_x_um", begins=700.0).misnamed
    assert not told("geometry_step", "d_x_um", 5.0).misnamed
    assert not plain.misnamed
    assert plain.silent


def test_what_is_worse():
    same = scoring.Agreed("diagnosed", "d_x_um", 2.0, 2.0, 1.0, 1.0, 0.5)
    assert not same.worse
    assert replace(same, after_free=1.2).worse
    assert not replace(same, after_free=1.01).worse
    # As counted, the zero is that of one noisy reading.
    assert not replace(same, after=2.1).worse
    assert replace(same, after=2.5).worse
    # Within the noise nothing counts.
    assert not replace(same, after_free=1.2, noise=5.0).worse


def test_a_figure_that_simulate_does_not_have_is_seen():
    def rows(*steps: int):
        return [{"log": "a", "output": "d_x_um", "step": k, "rmse": 4.0 - k,
                 "rmse_zero_free": None} for k in steps]  # fmt: skip

    def runs(rmse: float | None, free: float | None = None):
        return lambda log: {"d_x_um": {"rmse": rmse, "rmse_zero_free": free}}

    assert largest(compared(rows(0, 1, 2), runs(4.0), runs(2.0))) == 0.0
    assert largest(compared(rows(0, 1), runs(4.0), runs(2.5))) == pytest.approx(0.2)
    # Nothing was written; and what came is written as it came.
    assert largest(compared(rows(0, 1), runs(4.0), None)) == 0.0
    assert len(compared(rows(0), runs(4.0), runs(4.0))) == 4
    # Only one of them has a figure, or none was compared.
    for other in (runs(0.0), runs(None), runs(np.nan), runs(4.0, 1.0)):
        assert largest(compared(rows(0), other, None)) == np.inf
    assert largest([]) == np.inf


def test_the_default_run_is_large_and_the_same_for_every_choice_of_plants():
    trials = exam.draw(exam.LOGS, list(PLANTS), exam.SIZES, 1)
    assert len(trials) >= 300
    kinds = {t.kind for t in trials if t.group == "unknown"}
    assert len(kinds) >= 8
    slabs = [(t.kind, t.machine, t.seed) for t in trials if t.plant == "slab"]
    alone = [(t.kind, t.machine, t.seed) for t in exam.draw(exam.LOGS, ["slab"], exam.SIZES, 1)]
    assert slabs == alone
    assert not [t for t in trials if t.plant in exam.NOT_FOR.get(t.kind, ())]
