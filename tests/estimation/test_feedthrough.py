"""Direct feedthrough on its way through a sensor, a file and a recursion."""

from __future__ import annotations

import json

import numpy as np
import pytest

from thermaltool.errors import ModelError
from thermaltool.estimation.cascade import lagged_modes
from thermaltool.estimation.rational import inverted
from thermaltool.responses.delay import DelayedModes, load_modes
from thermaltool.responses.rational import rational_kind

RESPONSE = rational_kind(1, 1, True)(
    K=2.0, D=0.4, omega=0.06, zeta=0.2, K1=-1.0, tau1=300.0, K0=0.7
)


def test_a_sensor_reads_it_late():
    modes = lagged_modes(RESPONSE.modes(1.0), 25.0)
    s = 1j * np.geomspace(1e-4, 10, 30)
    np.testing.assert_allclose(modes.transfer(s), RESPONSE.transfer(s) / (25 * s + 1), rtol=1e-9)
    assert modes.direct == 0
    assert modes.step(np.zeros(1))[0] == 0


def test_a_file_keeps_it():
    modes = RESPONSE.modes(1.0)
    back = load_modes(json.loads(json.dumps(modes.document())))
    assert back.direct == 0.7
    time, u = np.arange(50.0), np.random.default_rng(5).standard_normal(50)
    np.testing.assert_array_equal(back.run(time, u, "zero"), modes.run(time, u, "zero"))


def test_what_has_none_says_so():
    with pytest.raises(ModelError, match="direct feedthrough has no inverse"):
        inverted(RESPONSE, 10.0)
    modes = RESPONSE.modes(1.0)
    with pytest.raises(ModelError, match="a delay has no direct feedthrough"):
        DelayedModes(modes.poles, modes.weights, delay=3.0, direct=0.5)
