"""What a cause costs one output counts beside what it gains in the others."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from thermaltool.diagnosis.gain import Gain
from thermaltool.diagnosis.validate import holds

NOISE = 0.01
MODEL = SimpleNamespace(groups={"T_a_degC": None, "T_b_degC": None}, white=lambda output: NOISE)


def gain(before: float, after: float) -> Gain:
    return Gain(before, after, before, after, 0.0, 0.0, (before - after, before - after))


@pytest.mark.parametrize(
    ("gained", "loss", "stands"),
    [
        ((0.25, 0.018), (0.012, 0.0145), True),  # 600 and 0.7 times the noise
        ((0.25, 0.018), (0.012, 0.019), False),  # more than the noise
        ((0.03, 0.018), (0.012, 0.0145), False),  # 6 and 0.7 times
    ],
)
def test_a_slight_loss_of_one_output_says_nothing_against_a_cause(gained, loss, stands):
    gains = {"T_a_degC": gain(*gained), "T_b_degC": gain(*loss)}
    assert gains["T_b_degC"].harmful
    assert holds(MODEL, gains) is stands


def test_an_output_of_unseen_logs_alone_may_not_be_spoiled():
    gains = {"T_a_degC": gain(0.25, 0.018), "T_c_degC": gain(0.012, 0.0145)}
    assert not holds(MODEL, gains)
