"""What a cause has to show of each output that it reaches."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.diagnosis.evidence import DECISIVE_EVIDENCE
from thermaltool.diagnosis.fit import products_of, score, signatures_of
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.effects import effect_class
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.rational import Rational1

ASSUMPTIONS = frozenset({"offset", "accepted", "tight"})
HEAT, OUTPUTS, NOISE = "Q_main_W", ("T_a_degC", "T_b_degC", "T_c_degC"), 0.02
SHAPE = {"period": 6000.0, "phase": 0.0}


def evidence(swings, outputs, seed):
    """Of an unlogged swing in `outputs`, where each has one of these sizes in it."""
    time = 5.0 * np.arange(1200)
    heat = np.repeat([0.0, 1.0, 0.0, 1.0], 300)
    model = Model(
        drives=(Drive(HEAT, "zero", 0.0, (0.0, 1.0)),),
        outputs=tuple(Output(o, "sensor", 20.0, (20.0, 30.0)) for o in OUTPUTS),
        terms=tuple(Term(HEAT, o, Rational1(600.0, 5.0)) for o in OUTPUTS),
        sample_period=5.0,
    )
    noise = NOISE * np.random.default_rng([1128, seed]).standard_normal((3, len(time)))
    log = Record(time, {HEAT: heat})
    swing = np.sin(2 * np.pi * time / SHAPE["period"])
    measured = {
        o: y + 20.0 + size * swing + own
        for (o, y), size, own in zip(model.simulate(log).items(), swings, noise, strict=True)
    }
    log = Record(time, {HEAT: heat, **measured}, digest="log")
    hypothesis = Hypothesis.of(model, (log,), model, ASSUMPTIONS)
    trial = effect_class("ambient_drift")("", {**{f"swing[{o}]": 1.0 for o in outputs}, **SHAPE})
    signatures = signatures_of(hypothesis, trial)
    products = products_of(hypothesis, signatures, ASSUMPTIONS)
    return score(hypothesis, trial, list(signatures), products, ASSUMPTIONS)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.slow
def test_what_nobody_logged_is_sure_in_two_outputs_and_pays_in_others(seed):
    sizes = NOISE * np.geomspace(0.1, 2.0, 24)
    two = evidence((1.0, 1.0, 0.0), OUTPUTS[:2], seed)
    assert two.evidence > 500
    rises = [
        found.evidence - two.evidence
        for found in (evidence((1.0, 1.0, size), OUTPUTS, seed) for size in sizes)
        if f"swing[{OUTPUTS[2]}]" in found.effect.parameters
    ]
    assert min(rises) < DECISIVE_EVIDENCE / 2 < max(rises)
    # Of one output alone it is that output's, however surely.
    seen = [evidence((1.0, size, 0.0), OUTPUTS[:2], seed).evidence for size in sizes]
    assert seen[0] == -np.inf
    assert seen[-1] > 500
