"""The search for laws beside each other, on residuals that are linear in their parameters."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from thermaltool.effects.drive_nonlinearity import DriveNonlinearity
from thermaltool.effects.radiation import Radiation
from thermaltool.effects.sensor_conversion import SensorConversion
from thermaltool.fitting.law_search import LawSearch
from thermaltool.fitting.laws import Law

POWER = Law(DriveNonlinearity, "Q_a_W", 100.0)
HOT = Law(Radiation, "T_a_degC", 80.0, 20.0, 600.0)
BENT = Law(SensorConversion, "T_a_degC", 80.0)


@dataclass
class LinearSearch(LawSearch):
    """What every law makes of the residual is known: a course of its own times its place."""

    def __init__(self, laws, courses, truth):
        super().__init__((), (), (), (), laws)
        self.courses, self.truth = courses, truth

    def _fits(self, effects, near=None, base=None):
        left = self.truth.copy()
        for effect in effects:
            law = next(law for law in self.laws if law.name == (effect.name, effect.channel))
            name = next(name for name in law.forms if name in effect.parameters)
            left -= law.place(name, effect.parameters[name]) * self.courses[law.name, name]
        size = float(np.sum(left**2))
        return [SimpleNamespace(residual=left, size=size, independent=400.0, theta=None)]


def courses():
    """One course for each parameter, none like another; and noise."""
    generator = np.random.default_rng(20261128)
    whole = np.linalg.qr(generator.standard_normal((400, 5)))[0].T * 20.0
    names = [(law.name, name) for law in (POWER, HOT, BENT) for name in law.forms]
    return dict(zip(names, whole, strict=False)), 0.1 * generator.standard_normal(400)


def test_a_known_law_that_is_none_any_more_keeps_no_other_out() -> None:
    own, noise = courses()
    truth = 0.3 * own[POWER.name, "exponent"] + noise
    known = [HOT.at("rate", 0.1)]
    (found,) = LinearSearch((POWER, HOT), own, truth).found(known)
    assert found.name == "drive_nonlinearity"
    assert abs(np.log(found.parameters["exponent"]) - 0.3) < 0.03


def test_a_law_that_says_nothing_alone_is_asked_again_beside_the_others() -> None:
    own, noise = courses()
    small, large = own[BENT.name, "curvature"], own[POWER.name, "exponent"]
    truth = 0.5 * large + 0.04 * small + 0.2 * noise
    names = {effect.name for effect in LinearSearch((BENT, POWER), own, truth).found(())}
    assert names == {"drive_nonlinearity", "sensor_conversion"}


def test_a_single_law_that_decides_nothing_goes() -> None:
    own, noise = courses()
    assert not LinearSearch((POWER, HOT), own, noise).found([POWER.at("exponent", 0.2)])
