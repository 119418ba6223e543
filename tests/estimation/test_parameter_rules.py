"""Parameter rules on paths that are written down."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermaltool.estimation.parameter_rules import RULES, Path, apply_rules

WEIGHTS = np.geomspace(1e6, 1e-6, 25)
COUNT = 400


@pytest.fixture
def path():
    """A diagonal problem: singular values that fall, a white solution, noise of 1."""
    s = np.geomspace(100.0, 1e-4, COUNT)
    x = 3 * np.random.default_rng(5).standard_normal(COUNT)
    y = s * x + np.random.default_rng(6).standard_normal(COUNT)
    filters = s**2 / (s**2 + WEIGHTS[:, None])
    solutions, left = filters * y / s, 1 - filters
    squares, logs = np.sum(left * y**2, axis=1), -np.sum(np.log1p(-filters), axis=1)
    return Path(
        WEIGHTS,
        solutions,
        np.sum((left * y) ** 2, axis=1),
        COUNT,
        np.sum(filters, axis=1),
        np.sum(solutions**2, axis=1),
        -0.5 * (COUNT * np.log(squares / COUNT) + logs),
        np.sqrt(np.mean((solutions - x) ** 2, axis=1)),
    )


def chosen(path):
    return {each.rule: each for each in apply_rules(path)}


def test_every_rule_is_told_and_near_the_best(path):
    found = chosen(path)
    assert tuple(found) == RULES
    best = float(np.min(path.expected_error))
    for rule in ("likelihood", "gcv"):
        assert found[rule].reason == ""
        assert found[rule].expected_error < 1.2 * best
    assert found["discrepancy"].residual_over_noise == pytest.approx(1.0)


def test_an_expected_error_refuses(path):
    spoilt = replace(path, expected_error=np.geomspace(1.0, 1e3, len(WEIGHTS)))
    gcv = chosen(spoilt)["gcv"]
    assert gcv.parameter == pytest.approx(chosen(path)["gcv"].parameter)
    assert "its expected error is" in gcv.reason


def test_what_has_no_answer_is_refused_with_the_reason(path):
    assert "no likelihood" in chosen(replace(path, log_likelihood=None))["likelihood"].reason
    assert "no penalty" in chosen(replace(path, penalty=None))["l-curve"].reason
    assert "not known, or zero" in chosen(replace(path, noise_known=False))["discrepancy"].reason
    quiet = chosen(replace(path, misfit=path.misfit / 1e6))
    assert "below the noise on the whole grid" in quiet["discrepancy"].reason
    loud = chosen(replace(path, misfit=path.misfit * 1e6))
    assert "above the noise on the whole grid" in loud["discrepancy"].reason
    rising = chosen(replace(path, log_likelihood=np.arange(25.0)))["likelihood"]
    assert rising.reason.endswith("falls to its weakest regularization")
    straight = replace(path, misfit=WEIGHTS, penalty=1 / WEIGHTS)
    assert "no corner inside the grid" in chosen(straight)["l-curve"].reason
    growing = replace(path, solutions=np.outer(2.0 ** np.arange(25), np.ones(3)))
    assert "no minimum inside the grid" in chosen(growing)["quasi-optimality"].reason


def test_every_length_of_a_path_has_an_answer_or_a_reason(path):
    for n in range(1, 9):
        short = replace(path, **{
            name: getattr(path, name)[9 : 9 + n]
            for name in ("parameter", "solutions", "misfit", "freedom", "penalty",
                         "log_likelihood", "expected_error")
        })  # fmt: skip
        told = chosen(short)
        assert all(each.place is not None or each.reason for each in told.values())
        assert ("a corner needs 4 points" in told["l-curve"].reason) == (n < 4)


def test_a_grid_of_steps_is_told_as_it_is(path):
    gcv = chosen(replace(path, is_stepped=True))["gcv"]
    k = int(gcv.place)
    assert gcv.parameter == pytest.approx(WEIGHTS[k])
    assert gcv.residual_over_noise == pytest.approx(np.sqrt(path.misfit[k] / COUNT))
