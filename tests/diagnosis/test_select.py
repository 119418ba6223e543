"""Which candidates of a scan are fitted."""

from __future__ import annotations

from thermaltool.diagnosis.fit import CauseCandidate
from thermaltool.diagnosis.select import shortlist
from thermaltool.effects import effect_class

PRESENT, FREED = frozenset({"tight"}), frozenset({"released"})


def candidate(name, evidence, assumptions, channel="dT_a_K"):
    cls = effect_class(name)
    effect = cls(channel, dict.fromkeys(cls.known, 1.0))
    return CauseCandidate(effect, evidence, 0.0, assumptions, {})


def test_a_cause_that_needs_no_change_of_the_model_is_fitted():
    names = ["sensor_gain", "sensor_drift", "sensor_offset_step", "sensor_conversion"]
    names += ["sensor_self_heating", "radiation", "joint_contact", "backlash", "hysteresis"]
    free = [candidate(name, 680.0 - k, FREED) for k, name in enumerate(names)]
    lag = candidate("sensor_lag", 650.0, PRESENT)
    found = shortlist([*free, lag], {PRESENT: 0.0, FREED: 616.0})
    assert found[0] is lag
    assert len(found) == 8
    assert all(each in found for each in free[:5])


def test_few_of_one_name_and_none_without_evidence():
    gains = [candidate("sensor_gain", 100.0 - k, PRESENT, f"dT_{k}_K") for k in range(4)]
    found = shortlist([*gains, candidate("sensor_lag", -11.0, PRESENT)], {PRESENT: 0.0})
    assert [each.effect.channel for each in found] == ["dT_0_K", "dT_1_K"]
