"""A diagnosis does not depend on units, on the zero of the clock, nor on the order of columns."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.diagnosis.result import Diagnosis
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.record import Record

TIME = 3.0 * np.arange(1200)
DUTY = np.repeat([0.0, 1.0, 0.0, 0.6, 0.3, 1.0, 0.0, 0.8, 0.0, 0.5], 120)
# A pump of a few runs, which warms the cold mass where it may.
PUMP = np.zeros(len(TIME))
for begin, length in ((250, 140), (620, 40), (705, 125), (1060, 80)):
    PUMP[begin : begin + length] = 1.0


def machine(pump: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Temperature [°C] and deflection [µm] of a mass that a hotter one warms, with noise."""
    hot = cold = 0.0
    found = []
    for q, other in zip(np.append(0.0, DUTY[:-1]), np.append(0.0, PUMP[:-1]), strict=True):
        hot += 3.0 * (20 * q - hot) / 150
        cold += 3.0 * (hot + pump * other - cold) / 500
        found.append(cold)
    noise = np.random.default_rng([1127, seed]).standard_normal((2, len(TIME)))
    warm = np.array(found)
    return 21.0 + warm + 0.02 * noise[0], 3 * warm + 0.1 * noise[1]


def diagnosed(heat: str, kilowatts: float, probe: str, scale: float, zero: float) -> Diagnosis:
    """A clean log calibrates, the pump warms in the other: `heat` is at most so many kW."""
    logs = []
    for k, pump in enumerate((0.0, 2.0)):
        temperature, deflection = machine(pump, k)
        columns = {
            heat: kilowatts * DUTY,
            "x_pump_1": PUMP,
            "T_column_degC": temperature,
            probe: scale * deflection,
        }
        if zero:
            columns = dict(reversed(columns.items()))
        logs.append(Record(zero + TIME, columns, digest=f"log {k}"))
    plan = CalibrationPlan((heat,), ("T_column_degC",), (probe,))
    return diagnose(calibrate(logs[:1], plan), logs[1:])


@pytest.mark.slow
def test_the_same_log_in_other_units_has_the_same_diagnosis():
    one = diagnosed("Q_main_W", 5000.0, "d_y_um", 1.0, 0.0)
    other = diagnosed("Q_main_kW", 5.0, "d_y_mm", 1e-3, 1.75e9)
    first = one.causes[0].effect
    assert (first.name, first.channel) == ("second_source", "x_pump_1")
    assert [c.effect.name for c in other.causes] == [c.effect.name for c in one.causes]
    for a, b in zip(one.causes, other.causes, strict=True):
        assert b.evidence == pytest.approx(a.evidence, rel=1e-3, abs=0.5)
    # ... and so has every cause that was tried, whatever its drive is called.
    these, those = (
        sorted((t.name, t.channel.split("_")[0], t.evidence) for t in each.tried)
        for each in (one, other)
    )
    assert [t[:2] for t in these] == [t[:2] for t in those]
    assert [t[2] for t in those] == pytest.approx([t[2] for t in these], rel=1e-3, abs=0.5)
