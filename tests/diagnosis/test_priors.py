"""What a calibration leaves open is no more than its own log has shown."""

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt
from thermaltool.diagnosis.correction import corrected
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.priors import root_of
from thermaltool.diagnosis.state import WITHIN_CALIBRATION

OUTPUT = "T_far_degC"


def slab(seed, rows=1200, cells=12):
    """The far face of a slab by finite volumes, heated on the other one."""
    rng = np.random.default_rng(seed)
    heat = np.repeat(rng.choice([0.0, 0.4, 0.8], rows // 40), 40)
    heat[:20] = 0.0
    T, far = np.zeros(cells), []
    for q in heat:
        far.append(T[-1])
        for _ in range(20):
            flux = np.concatenate([[30.0 * q - 0.1 * T[0]], -np.diff(T), [0.3 * T[-1]]])
            T = T - 0.02 * np.diff(flux)
    readings = 20.0 + np.array(far) + rng.normal(0, 0.03, rows)
    return pd.DataFrame({"time_s": 60.0 * np.arange(rows), "Q_pad_kW": heat, OUTPUT: readings})


@pytest.mark.parametrize("kind", ["deflection", "joint_deflection", "rational3"])
@pytest.mark.parametrize("seed", [2, 3])
def test_what_is_left_open_of_the_calibration_log_is_below_its_noise(kind, seed):
    log = slab(seed)
    model = corrected(
        tt.calibrate(log, ["Q_pad_kW"], sensors=[OUTPUT], kinds={OUTPUT: kind}, linear=True,
                     warn=lambda message: None).model
    )  # fmt: skip
    hypothesis = Hypothesis.of(model, (tt.read_log(log),), model, WITHIN_CALIBRATION)
    nuisance = hypothesis.nuisance[OUTPUT]
    moves = nuisance.moves[0] @ nuisance.calibrated_prior.root
    spread = np.sqrt(np.mean(np.sum((moves - moves.mean(axis=0)) ** 2, axis=1)))
    assert spread < 0.03


def test_directions_that_cancel_stay_known():
    """Two parameters of units a million apart, of which one sum is known and no other."""
    size = np.array([1e-3, 1e3])
    correlation = np.array([[1.0, -1.0], [-1.0, 1.0]]) + 1e-10 * np.eye(2)
    root = root_of(correlation * np.outer(size, size), np.array([1e6, 1e6]))
    assert np.linalg.norm((1 / size) @ root) < 1e-4
    assert np.linalg.norm([1 / size[0], 0.0] @ root) == pytest.approx(1.0, rel=0.01)


def test_a_wide_direction_is_held_by_the_size():
    root = root_of(np.diag([1e8, 1.0]), np.array([10.0, 10.0]))
    assert np.sqrt(np.diag(root @ root.T)) == pytest.approx([10.0, 1.0], rel=0.01)
