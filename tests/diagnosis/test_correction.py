"""What a calibration knows beyond its kind of response has to hold on other inputs."""

from __future__ import annotations

import numpy as np
import pytest
from machines.hidden import hide

from thermaltool.diagnosis.correction import corrected
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.state import WITHIN_CALIBRATION
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.record import Record

HEAT = "Q_main_1"
# Further machines.
SLOWLY = [pytest.param(k, marks=pytest.mark.slow) for k in (8, 9)]


@pytest.fixture(scope="module", params=[7, *SLOWLY])
def clean(request):
    """A machine calibrated on steps, and a clean log of a random duty."""
    found = hide([], 5.0, request.param, request.param + 100)
    sensors = [name for name in found.noise if not name.endswith("_um")]
    deflections = [name for name in found.noise if name.endswith("_um")]
    log = Record(found.calibration["time_s"], found.calibration)
    model = calibrate(
        [log], CalibrationPlan((HEAT,), sensors, deflections, dict.fromkeys(sensors, "deflection"))
    )
    return found, model


def wrong(found, model, output):
    """RMS error of a noise-free log about its mean, over the noise of a reading."""
    simulated = model.simulate(Record(found.log["time_s"], found.log, digest="log"))[output]
    return np.std(found.clean[output] - simulated) / found.noise[output]


def test_the_corrected_model_follows_inputs_that_the_calibration_has_not_seen(clean):
    found, model = clean
    better = corrected(model)
    before = [wrong(found, model, output) for output in found.noise]
    after = [wrong(found, better, output) for output in found.noise]
    assert np.mean(after) < 0.7 * np.mean(before)
    assert max(after) < 1.0


def test_what_it_still_gets_wrong_is_what_it_says_that_it_may(clean):
    """Coordinates of the error in the prior are of the order of one."""
    found, model = clean
    known = corrected(model)
    columns = {name: values for name, values in found.log.items() if name != "time_s"}
    log = Record(found.log["time_s"], columns, digest="log")
    made = Hypothesis.of(known, [log], known, WITHIN_CALIBRATION)
    sizes = []
    for output in found.noise:
        nuisance = made.nuisance[output]
        own = np.column_stack([s[0] for s in (*nuisance.sensitivities, *nuisance.lags)])
        moved = own @ nuisance.calibrated_prior.root
        simulated = known.simulate(Record(found.log["time_s"], found.log, digest="log"))[output]
        error, noise = found.clean[output] - simulated, found.noise[output]
        table = np.column_stack([moved, np.ones(len(error))])
        penalty = np.append(np.ones(moved.shape[1]), 0.0)
        coordinates = np.linalg.solve(
            table.T @ table / noise**2 + np.diag(penalty), table.T @ error / noise**2
        )[:-1]
        sizes.append(np.sqrt(np.mean(coordinates**2)))
    assert np.median(sizes) < 2.0
