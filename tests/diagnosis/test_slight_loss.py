"""What a cause costs one output counts beside what it gains in the others."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from thermaltool.diagnosis import balance
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


@pytest.mark.parametrize(
    ("zero_free", "counted", "slight"),
    [
        ((270.0, 0.0), (880.0, 2.5), True),  # a zero that is off by more than noise already
        ((270.0, 1.5), (880.0, 0.0), False),
        ((270.0, 0.0), (880.0, 4.5), False),
        ((270.0, 0.0), (200.0, 2.5), False),
    ],
)
def test_a_zero_that_is_counted_has_the_noise_of_its_readings(
    monkeypatch, zero_free, counted, slight
):
    """Powers over that of the noise that a model gains and loses, with zeros free and counted."""
    monkeypatch.setattr(
        balance, "balance", lambda *models, **more: zero_free if models[-1] else counted
    )
    assert balance.is_slight(None, None, (), {}, {}) is slight
