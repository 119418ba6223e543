"""A hypothesis, its rows and its amplitudes: what does not change, and what comes next."""

from __future__ import annotations

import itertools
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from thermaltool.diagnosis.assumptions import started
from thermaltool.diagnosis.fit import CandidateProducts, CauseCandidate, evaluate, profile
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.select import fit_candidate
from thermaltool.diagnosis.simulation import SimulatedLogs
from thermaltool.diagnosis.state import RELEASED, WITHIN_CALIBRATION
from thermaltool.diagnosis.validate import judge
from thermaltool.effects import effect_class
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.deflection import Deflection
from thermaltool.responses.rational import Rational1
from thermaltool.signals.row_groups import MAX_ROWS, RowGroups

HEAT, Z = "Q_main_1", "d_z_um"
TIME = 5.0 * np.arange(800)
LEVELS = np.repeat([0.0, 1.0, 0.3, 0.8, 0.0, 0.5, 1.0, 0.0], 100)
MODEL = Model(
    drives=(Drive(HEAT, "zero", 0.0, (0.0, 1.0)),),
    outputs=(Output(Z, "deflection", "first", (-100.0, 100.0)),),
    terms=(Term(HEAT, Z, Deflection(80.0, 1 / 900, 0.0, 1.0, 0.0, 1.0)),),
    sample_period=5.0,
)
DELAY = effect_class("transport_delay")(HEAT, {"delay": 30.0})
STEP = effect_class("sensor_offset_step")(Z, {"step": 3.0, "time": 1500.0}, "log")


def hypothesis(*truth) -> Hypothesis:
    """The plain model on a log of the machine with `truth`."""
    columns = {HEAT: LEVELS}
    with_truth = Model(MODEL.drives, MODEL.outputs, MODEL.terms, 5.0, effects=truth)
    columns[Z] = with_truth.simulate(Record(TIME, columns, digest="log"))[Z]
    columns[Z] = columns[Z] + 0.1 * np.random.default_rng(7).standard_normal(len(TIME))
    return Hypothesis.of(MODEL, [Record(TIME, columns, digest="log")], MODEL, RELEASED)


# ---------------------------------------------------------------- rows


def test_groups_are_means_that_reach_over_no_pause() -> None:
    rows = 2 * MAX_ROWS + 10
    time = np.arange(rows, dtype=float)
    time[7:] += 100.0  # a pause inside what would be a group
    log = Record(time, {Z: np.sin(time)})
    groups = RowGroups.of([log], [np.ones(rows, bool)])
    assert groups is not None
    assert groups.size < rows / 2 < groups.count == rows
    assert 7 in groups.first
    edges = [*groups.first.tolist(), rows]
    means = [log.column(Z)[a:b].mean() for a, b in itertools.pairwise(edges)]
    np.testing.assert_allclose(groups.means([log.column(Z)]), means, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(1 / groups.weight, np.diff(edges))


def test_rows_that_do_not_count_are_in_no_group() -> None:
    logs = [Record(np.arange(5.0), {}), Record(np.arange(4.0), {})]
    use = [np.array([True, False, True, True, False]), np.zeros(4, bool)]
    groups = RowGroups.of(logs, use)
    assert groups is not None
    assert (groups.count, groups.present) == (3, [0])
    assert groups.joined([10 * log.time for log in logs]).tolist() == [0.0, 20.0, 30.0]
    assert RowGroups.of(logs, [np.zeros(5, bool), np.zeros(4, bool)]) is None


def test_masked_rows_change_the_next_hypothesis_alone() -> None:
    first = hypothesis()
    before = first.evidence[Z].columns.copy()
    mask = np.zeros(len(TIME), bool)
    mask[::10] = True
    masked = first.with_masked({("log", Z): mask})
    assert masked.groups[Z].count == 0.9 * len(TIME)
    assert first.groups[Z].count == len(TIME)
    np.testing.assert_array_equal(first.evidence[Z].columns, before)


# ---------------------------------------------------------------- steps


def test_a_hypothesis_does_not_change() -> None:
    first = hypothesis()
    with pytest.raises(FrozenInstanceError):
        first.assumptions = frozenset()  # type: ignore[misc]
    assert first.under(first.assumptions, MODEL) is first
    started = first.under(first.assumptions | {"initial"}, MODEL)
    assert "initial" not in first.assumptions
    # Other assumptions need no other simulation.
    assert started.simulation is first.simulation


def test_parameters_that_are_set_free_leave_what_the_calibration_knew() -> None:
    tight = Hypothesis.of(MODEL, hypothesis().logs, MODEL, frozenset({"offset", "tight"}))
    moved = tight.with_model(tight.nuisance[Z].moved(np.array([0.1] + [0.0] * 5)))
    assert moved.model.terms != MODEL.terms
    freed = moved.under(frozenset({"offset", "released"}), MODEL)
    assert freed.model.terms == MODEL.terms
    assert moved.under(moved.assumptions | {"initial"}, MODEL).model is moved.model


def test_free_parameters_are_fitted_and_held_ones_stay() -> None:
    other = Deflection(80.0, 1 / 900, 0.0, 1.0, 0.0, 1.0)
    wrong = Model(MODEL.drives, MODEL.outputs, (Term(HEAT, Z, Deflection(
        70.0, 1 / 800, 0.0, 1.0, 0.0, 1.0)),), 5.0)  # fmt: skip
    free = Hypothesis.of(wrong, hypothesis().logs, wrong, RELEASED).fitted()
    response = free.model.terms[0].response
    assert isinstance(response, Deflection)
    assert response.dc_gain() == pytest.approx(other.dc_gain(), rel=0.01)
    held = Hypothesis.of(wrong, hypothesis().logs, wrong, frozenset({"offset", "tight"}))
    assert held.fitted() is held


# ---------------------------------------------------------------- one candidate


def test_under_white_noise_the_amplitude_is_that_of_least_squares() -> None:
    found = hypothesis(STEP)
    signature = found.simulation.signatures(STEP)["step"][Z][0]
    evidence = found.evidence[Z].at([])
    products = evidence.products(signature[:, None], [[0]])
    projected = evidence.projected(frozenset({"offset"}), products)
    result = profile([CandidateProducts.of(projected, [0], [0])], 1, np.array([np.nan]))
    table = np.column_stack([signature, np.ones(len(TIME))])
    residual = found.simulation.residual(Z)[0]
    (amplitude, _), (square,), *_ = np.linalg.lstsq(table, residual, rcond=None)
    assert result.amplitudes[0] == pytest.approx(amplitude, rel=1e-9)
    # ... and the rise of the likelihood that of its sum of squares.
    plain = float(np.sum((residual - residual.mean()) ** 2))
    expected = 0.5 * (len(TIME) - 1) * np.log(plain / square)
    assert result.gains[0] == pytest.approx(expected, rel=1e-6)


def test_what_looks_like_the_model_itself_has_no_evidence() -> None:
    found = hypothesis(STEP)
    gain = effect_class("sensor_gain")(Z, {"gain": 1.2})
    assert evaluate(found, STEP, RELEASED).evidence > 100
    assert evaluate(found, gain, RELEASED).evidence < 0


@pytest.mark.slow
def test_a_true_cause_is_accepted_and_a_false_one_is_not() -> None:
    found = hypothesis(DELAY)
    true = fit_candidate(found, CauseCandidate.unfitted(DELAY, RELEASED))
    false = fit_candidate(found, CauseCandidate.unfitted(STEP, RELEASED))
    verdict = judge(found, true, [true, false], MODEL)
    assert verdict is not None
    assert verdict.cause.effect.parameters["delay"] == pytest.approx(30.0, abs=3.0)
    assert verdict.cause.gain[Z].claimed
    assert [e.name for e in verdict.after.model.effects] == ["transport_delay"]
    assert found.model.effects == ()
    assert judge(found, false, [true, false], MODEL) is None


# ---------------------------------------------------------------- what a calibration knows


def two_drives(exponent=1.0):
    """A machine of two drives, each with two lags, computed at every instant; and its log."""
    rng = np.random.default_rng(11)
    time = 10.0 * np.arange(900)
    columns, y = {}, 0.02 * rng.standard_normal(len(time))
    for name, lags in {"Q_a_W": ((9.0, 60.0), (7.0, 700.0)), "Q_b_W": ((5.0, 150.0),)}.items():
        at = 10.0 * np.sort(rng.choice(np.arange(20, 850), 24, replace=False))
        level = rng.choice([0.0, 0.3, 0.6, 1.0], len(at))
        held = np.searchsorted(at, time, side="right")
        columns[name] = 100.0 * np.append(0.0, level)[held]
        since = time[:, None] - at
        on = np.where(since >= 0, since, np.nan)
        change = np.diff(level**exponent, prepend=0.0)
        y = y + sum(np.nansum(change * g * -np.expm1(-on / tau), axis=1) for g, tau in lags)
    return Record(time, {**columns, "T_a_degC": y}, digest="log")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("exponent", "most"), [(1.0, 0.02), pytest.param(1.5, 0.1, marks=pytest.mark.slow)]
)
def test_a_calibration_knows_its_own_log_to_the_noise(exponent, most) -> None:
    log = two_drives(exponent)
    plan = CalibrationPlan(("Q_a_W", "Q_b_W"), ("T_a_degC",), choose=True, reference=0.0)
    model = calibrate([log], plan)
    assert len(model.effects) == (0 if exponent == 1.0 else 2)
    nuisance = Hypothesis.of(model, [log], model, WITHIN_CALIBRATION).nuisance["T_a_degC"]
    moves = np.column_stack([c @ nuisance.calibrated_prior.root for c in nuisance.moves])
    effects = [each[0] for each in nuisance.calibrated_effects]
    assert len(effects) == len(model.effects)
    open_to = np.sqrt(np.sum(np.var(np.column_stack([moves, *effects]), axis=0)))
    # Noise is 0.02: what many rows have settled is not open. The error of a curve holds what the
    # gains may make up for, which is counted beside it once more.
    assert open_to < most


def test_a_loss_at_its_bound_is_moved_the_other_way() -> None:
    """By one fiftieth more heat would be lost than can be followed beside a delay."""
    late = Term(HEAT, Z, Rational1(80.0, 900.0, delay=12.0))
    model = Model(MODEL.drives, MODEL.outputs, (late,), 5.0)
    columns = {HEAT: LEVELS, Z: np.where(LEVELS > 0.4, 1.0, -1.0)}
    on = 5.0 * np.sum(columns[Z] > 0)
    loss = effect_class("switching_loss")(Z, {"rate": 298.0 / on, "on": 0.5, "off": -0.5})
    found = SimulatedLogs(model, (Record(TIME, columns),), {}).span(loss)
    assert {"rate", "on", "off"} <= found.keys()


# ---------------------------------------------------------------- starts


FOLLOWS = {"candidates": [{"chosen": True, "equilibrium": True}]}


def test_a_machine_as_a_whole_warmer_than_its_room_is_the_likelier_start() -> None:
    """0.6 K off in a log: too little for ten decays of any size, and no other cause is asked."""
    room, spot = "T_room_degC", "T_spot_degC"
    model = Model(
        drives=(Drive(HEAT, "zero", 0.0, (0.0, 1.0)), Drive(room, "first", "first", (-2.0, 2.0))),
        outputs=(Output(spot, "sensor", 20.0, (-5.0, 15.0), FOLLOWS),),
        terms=(Term(HEAT, spot, Rational1(8.0, 700.0)), Term(room, spot, Rational1(1.0, 1500.0))),
        sample_period=5.0,
    )
    columns = {HEAT: LEVELS, room: 20 + 0.3 * np.sin(TIME / 900.0)}
    truth = model.simulate(Record(TIME, columns, digest="log"))[spot]
    noise = 0.05 * np.random.default_rng(8).standard_normal(len(TIME))
    columns[spot] = 20 + truth + 0.6 * np.exp(-TIME / 1500.0) + noise
    log = Record(TIME, columns, digest="log")
    found = Hypothesis.of(model, [log], model, WITHIN_CALIBRATION)
    ways = [WITHIN_CALIBRATION | {way} for way in ("uniform", "modes", "initial")]
    assert started(WITHIN_CALIBRATION) == ways
    likely, of_modes, any_start = ways
    others = max(map(found.evidence_of, (any_start, of_modes)))
    assert found.evidence_of(likely) > max(10.0, others + 5.0)
    (start,) = found.under(likely, model).beginning(spot)
    decay = 0.6 * np.exp(-TIME / 1500.0)
    assert np.allclose(start - start[-1], decay - decay[-1], atol=0.1)
    # A start of its own needs no plainer one beside it.
    assert started(likely) == [of_modes, any_start]
    assert started(of_modes) == [any_start]
    assert started(any_start) == []
    # A model that is free has no modes of its own.
    assert started(RELEASED) == [RELEASED | {way} for way in ("uniform", "initial")]
    # A temperature that drives may be a part of the machine.
    part = replace(model, outputs=(replace(model.outputs[0], fit={}),))
    starts = Hypothesis.of(part, [log], part, WITHIN_CALIBRATION).nuisance[spot].starts
    assert starts["uniform"] == []


@pytest.mark.parametrize(("deviations", "left"), [(2.0, 0.0), (8.0, 5.0)])
def test_what_is_far_off_the_calibration_is_not_open(deviations, left) -> None:
    """Beyond three standard deviations of what is open a move explains nothing."""
    (log,) = hypothesis().logs
    beginning = log.rows(slice(0, 125))
    model = calibrate([beginning], CalibrationPlan((HEAT,), (), (Z,), kinds={Z: "rational1"}))
    plain = Hypothesis.of(model, [log], model, WITHIN_CALIBRATION)
    nuisance = plain.nuisance[Z]
    # Along the direction that is open the most.
    move = nuisance.moves[0] @ nuisance.prior.root[:, 0]
    assert np.std(move) > 0.5
    columns = {**log.columns, Z: model.simulate(log)[Z] + deviations * move}
    columns[Z] = columns[Z] + 0.1 * np.random.default_rng(9).standard_normal(len(log))
    found = plain.with_logs([Record(TIME, columns, digest="moved")]).unexplained(Z)[0]
    about = left * (move - move.mean())
    assert np.std(found - about) < max(0.15, 0.2 * np.std(about))
