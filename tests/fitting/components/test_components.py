"""Few components of many inputs: the plant is a bar, in finite volumes, with sixteen sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from machines.bar import NAMES, ROWS, SENSORS, bar

from thermaltool.errors import FitError
from thermaltool.fitting.components.choose import averaged
from thermaltool.fitting.components.model import output_of
from thermaltool.fitting.components.plan import ComponentPlan
from thermaltool.fitting.components.problem import Choice, ComponentProblem
from thermaltool.fitting.components.reduction import (
    Reduction,
    is_reducible,
    parse_reduction,
    same_inputs,
)
from thermaltool.fitting.data import even_training_data
from thermaltool.fitting.document import model_document
from thermaltool.fitting.identification import identify
from thermaltool.record import Record


def record(temperatures, growth, time, name="bar"):
    columns = dict(zip(NAMES, temperatures, strict=False))
    return Record(time, {**columns, "d_z_um": growth}, name=name)


@pytest.fixture(scope="module")
def log():
    return record(*bar(np.random.default_rng(1795470001)))


@pytest.fixture(scope="module")
def split(log):
    found = even_training_data([log], NAMES, ["d_z_um"]).split(0.6)
    return found.with_start(found.fitted.from_rest())


def rms(model, split):
    return float(np.sqrt(np.mean((split.held.output() - model.carried_on(split)) ** 2)))


def test_the_ridge_beats_the_inputs_as_they_are(split):
    """Held out: components of the bar against the same lags without a ridge."""
    (model,), _ = ComponentPlan().fit(split.fitted)
    problem = ComponentProblem(split.fitted, Reduction("none"))
    plain = Choice(SENSORS, tuple(range(6)), ridge=1e-12)
    everything = np.ones(len(problem.output), bool)
    (unreduced,) = problem.fit(everything, [plain])
    raw = output_of(problem, unreduced)
    assert rms(model, split) < 0.5 * rms(raw, split)
    # Noise of the growth is 0.1 um.
    assert rms(model, split) < 0.25
    assert sum(each.weight for each in model.choices) == pytest.approx(1)


@pytest.mark.parametrize(("slow", "share"), [(0.0, 0.0), (2.0, 0.5)])
def test_half_of_the_weight_takes_slow_errors_for_what_they_are(log, slow, share):
    """Errors over an hour in the growth: the half by the evidence says so, and only there."""
    rng = np.random.default_rng(8)
    kept, drift = np.exp(-log.elapsed[1] / 3600), np.zeros(len(log))
    for k, e in enumerate(rng.standard_normal(len(log) - 1)):
        drift[k + 1] = kept * drift[k] + e
    columns = {**log.columns, "d_z_um": log.column("d_z_um") + slow * np.sqrt(1 - kept**2) * drift}
    data = even_training_data([replace(log, columns=columns)], NAMES, ["d_z_um"]).from_rest()
    _, weighed = averaged(ComponentProblem(data, Reduction()))
    coloured = sum(each.weight for each in weighed if each.choice.error_time)
    assert coloured == pytest.approx(share, abs=0.01)
    assert sum(each.weight for each in weighed) == pytest.approx(1)


@pytest.mark.parametrize("method", ["pca", "pls"])
def test_one_component_is_too_few_and_five_are_not(split, method):
    one, five = (
        ComponentPlan(reduction=Reduction(method, k)).fit(split.fitted)[0][0] for k in (1, 5)
    )
    assert {each.choice.components for each in one.choices} == {1}
    assert {each.choice.components for each in five.choices} == {5}
    assert rms(five, split) < 0.5 * rms(one, split)


def test_loadings_of_least_squares_are_orthogonal_and_lead_with_the_output():
    rng = np.random.default_rng(5)
    columns = rng.standard_normal((6, 300)) * np.arange(1, 7)[:, None]
    output = columns[2] / 3 + 0.01 * rng.standard_normal(300)
    found = Reduction("pls").loadings(columns, output) * np.sqrt(np.mean(columns**2, 1))[:, None]
    assert found.T @ found == pytest.approx(np.eye(6), abs=1e-9)
    assert np.argmax(np.abs(found[:, 0])) == 2


def test_inputs_of_one_unit_have_one_scale():
    """A sensor that hardly moves has no component of its own; another unit is no part of it."""
    rng = np.random.default_rng(11)
    columns = rng.standard_normal((3, 4000)) * np.array([[4.0], [0.1], [900.0]])
    loadings = Reduction("pca").loadings(columns, columns[0], ["degC", "degC", "rpm"])
    scores = np.sqrt(np.mean((loadings.T @ columns) ** 2, axis=1))
    assert scores == pytest.approx([2**0.5, 1.0, 2**0.5 * 0.1 / 4], rel=0.05)


def test_no_more_weights_are_free_than_there_are(log):
    """Decays of an unknown start are none of them."""
    logs = [log.rows(slice(start, start + 300)) for start in range(0, 1500, 300)]
    data = even_training_data(logs, NAMES[:1], ["d_z_um"])
    (model,), _ = ComponentPlan(initial="free").fit(data)
    assert 0 < model.freedom <= model.weights.size


@pytest.mark.slow
def test_document_runs_as_the_model(log):
    (fit,) = identify([log], NAMES, ["d_z_um"], ComponentPlan(initial="rest", split=0.6))
    whole = model_document([fit], None, {})
    run = fit.model.simulate(replace(log, at_rest=True))
    levels = log.matrix(NAMES)[:, 0]
    simulated = whole.simulate(log)["d_z_um"]
    # Rest of a temperature is the median of its first rows, that of the fit the first one.
    gains = [fit.model.gain(k).value for k in range(SENSORS)]
    moved = np.array([np.median(log.column(n)[:40]) for n in NAMES]) - levels
    assert np.ptp(run - simulated) < 0.5 * np.abs(np.dot(gains, moved)) + 0.2
    assert fit.validation.carried_on.fit_percent > 90
    assert set(whole.redundancy.channels) == set(NAMES)


@pytest.mark.slow
def test_others_stand_in_for_a_lost_sensor(log):
    """The error that is announced bounds the one that is made on rows behind the fit."""
    (fit,) = identify([log], NAMES, ["d_z_um"], ComponentPlan(initial="rest", split=0.6))
    found = model_document([fit], None, {}).redundancy
    moved = log.matrix(NAMES) - log.matrix(NAMES)[:, :1]
    late = moved[:, int(0.6 * ROWS) :]
    for lost in ([4], [0, 9]):
        weights, deviation = found.expectation(lost)
        assert np.all(weights[:, lost] == 0)
        errors = np.sqrt(np.mean((late[lost] - weights @ late) ** 2, axis=1))
        assert np.all(errors < 3 * deviation)
        assert np.all(errors < 0.2 * np.std(late[lost], axis=1))


@pytest.mark.slow
def test_a_sensor_that_stands_still_is_left_out(log):
    still = replace(log, columns={**log.columns, "T_s3_degC": np.full(ROWS, 21.0)})
    (fit,) = identify([still], NAMES, ["d_z_um"], ComponentPlan(initial="rest"))
    assert fit.model.idle == ("T_s3_degC",)
    assert "T_s3_degC" not in fit.model.names
    drives = {drive.channel: drive for drive in model_document([fit], None, {}).drives}
    assert "T_s3_degC" not in drives
    assert drives["T_s4_degC"].range[1] == pytest.approx(np.ptp(log.column("T_s4_degC")), rel=0.3)


@pytest.mark.slow
def test_equal_columns_are_named_and_do_no_harm(log):
    twin = 3.0 + log.column("T_s1_degC")
    both = replace(log, columns={**log.columns, "T_s2_degC": twin})
    (fit,) = identify([both], NAMES, ["d_z_um"], ComponentPlan(split=0.6))
    assert ("T_s1_degC", "T_s2_degC") in [group[:2] for group in fit.model.same]
    assert fit.validation.carried_on.fit_percent > 90


def test_unequal_columns_are_not_named():
    rng = np.random.default_rng(3)
    data = even_training_data(
        [record(rng.standard_normal((SENSORS, 200)), np.zeros(200), np.arange(200.0))],
        NAMES, ["d_z_um"],
    )  # fmt: skip
    assert same_inputs(data) == ()
    assert not is_reducible(data)


def test_a_bar_is_reducible(split):
    assert is_reducible(split.fitted)
    assert not is_reducible(split.fitted.driven_by(NAMES[:5]))


def test_two_logs_and_a_pause(log):
    """Each log has a zero of its own; behind a pause the state is unknown."""
    first, second = log.rows(slice(0, 1300)), log.rows(slice(1400, ROWS))
    moved = replace(second, columns={**second.columns, "d_z_um": second.column("d_z_um") + 50})
    data = even_training_data([first, moved], NAMES, ["d_z_um"])
    (model,), _ = ComponentPlan().fit(data)
    errors = data.output() - model.run(data)
    assert np.sqrt(np.mean(errors**2)) < 0.25


def test_the_start_is_free_where_the_machine_comes_from_elsewhere(log):
    """The bar is hot in its core when the log begins; its sensors do not say so."""
    late = even_training_data([log.rows(slice(700, 2000))], NAMES, ["d_z_um"])
    at_rest = even_training_data([log], NAMES, ["d_z_um"])
    plan = ComponentPlan()
    assert plan.start(at_rest).records[0].at_rest
    assert not plan.start(late).records[0].at_rest


def test_too_few_rows_and_nothing_to_explain(log):
    with pytest.raises(FitError, match="too few to hold out"):
        ComponentPlan().fit(even_training_data([log.rows(slice(0, 20))], NAMES, ["d_z_um"]))
    flat = replace(log, columns={**log.columns, "d_z_um": np.zeros(ROWS)})
    with pytest.raises(FitError, match="d_z_um is constant"):
        ComponentPlan().fit(even_training_data([flat], NAMES, ["d_z_um"]))
    data = even_training_data([log], NAMES[:4], ["d_z_um"])
    with pytest.raises(FitError, match="more components than the 4 inputs"):
        ComponentPlan(reduction=Reduction("pca", 5)).fit(data)


@pytest.mark.parametrize(
    ("text", "why"),
    [("foo", "none of pca"), ("pca:0", "1 or more"), ("pls:x", "1 or more"), ("none:3", "no num")],
)
def test_reductions_that_are_none(text, why):
    with pytest.raises(ValueError, match=why):
        parse_reduction(text)
