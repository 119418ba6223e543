"""A first cause: the code of docs/development/causes.md, copied, registered, hidden and found."""

from __future__ import annotations

import re
import sys
import types
from pathlib import Path

import numpy as np
import pytest

import thermaltool.effects as effects
from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.record import Record

PAGE = Path(__file__).parents[2] / "docs/development/causes.md"


def machine(heat: np.ndarray, generator: np.random.Generator) -> dict[str, np.ndarray]:
    """Two masses by hand, 2 s a sample, with noise."""
    rise, deflection, warm = np.zeros(len(heat)), np.zeros(len(heat)), np.zeros(2)
    for k in range(1, len(heat)):
        warm = warm + 2.0 * np.array(
            [(20 * heat[k - 1] - warm[0]) / 150, (3 * warm[0] - warm[1]) / 600]
        )
        rise[k], deflection[k] = warm
    noise = generator.standard_normal((2, len(heat)))
    return {"dT_pair1_K": rise + 0.02 * noise[0], "d_y_um": deflection + 0.1 * noise[1]}


@pytest.fixture
def with_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    module = types.ModuleType("thermaltool.effects.supply_droop")
    exec(compile(code, str(PAGE), "exec"), module.__dict__)
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(effects.CATALOGUE, "supply_droop", "SupplyDroop")


@pytest.mark.slow
@pytest.mark.usefixtures("with_the_page")
def test_the_cause_of_the_page_is_found() -> None:
    generator = np.random.default_rng(20261121)
    time = 2.0 * np.arange(1500)
    levels = np.repeat([0.0, 1.0, 0.0, 0.6, 0.3, 1.0, 0.0, 0.8, 0.0, 0.5], 150)
    model = calibrate(
        [Record(time, {"Q_main_1": levels, **machine(levels, generator)})],
        CalibrationPlan(("Q_main_1",), ("dT_pair1_K",), ("d_y_um",), {"dT_pair1_K": "deflection"}),
    )
    supply = 230 + 5 * np.sin(time / 400) + generator.standard_normal(len(time))
    droop = levels * (supply / np.median(supply)) ** 2
    log = {"Q_main_1": levels, "U_supply_V": supply, **machine(droop, generator)}
    found = diagnose(model, [Record(time, log, digest="today")])
    assert [cause.effect.name for cause in found.causes] == ["supply_droop"]
    assert found.causes[0].effect.parameters["sensitivity"] == pytest.approx(2.0, rel=0.2)
    low, high = found.causes[0].intervals["sensitivity"]
    assert low < high < 3.0
