"""From records to a model: which channel drives, which is a sensor, which a deflection."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from thermaltool.effects.effect import Effect
from thermaltool.errors import FitError
from thermaltool.fitting.acting_record import acting_records
from thermaltool.fitting.averaging import average, averaged_rows, of_readings
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.fitting.hold_choice import ChosenKinds, switched_between_rows
from thermaltool.fitting.kind_candidate import (
    LEFT_OUT,
    KindCandidate,
    denies_equilibrium,
    is_as_good,
    near_weights,
    of_one_body,
    with_kept,
)
from thermaltool.fitting.law_choice import explain, laws_of
from thermaltool.fitting.laws import LOSSES
from thermaltool.fitting.output_fit import OutputFit, fit_output
from thermaltool.fitting.projection import GridStates, surroundings
from thermaltool.fitting.response_choice import choose_response
from thermaltool.fitting.seen_changes import with_seen_changes
from thermaltool.fitting.start_choice import begins_away_from_rest, free_where_known, rests
from thermaltool.fitting.zeros import with_zeros
from thermaltool.model import (
    Drive,
    Model,
    Output,
    Role,
    Term,
    agreements,
    relative,
    started_outputs,
)
from thermaltool.record import Record
from thermaltool.responses.modes import Float
from thermaltool.signals.resolution import reading_sigma
from thermaltool.units import (
    is_displacement,
)

# The kinds of response are chosen anew behind such laws, and these once more with them.
LAW_ROUNDS = 2


def calibrate(
    records: Sequence[Record],
    plan: CalibrationPlan,
    progress: Callable[[str], None] = lambda message: None,
) -> Model:
    """Fit every output of `plan` over all records and put the model together.

    Parameters
    ----------
    records : sequence of Record
        With the channels of `plan`.
    plan : CalibrationPlan
    progress : callable
        Gets a word now and then.

    Raises
    ------
    ModelError
        See `CalibrationPlan.check`.
    FitError, LogError
        See `fit_output`.
    """
    plan.check()
    measured, commanded = records, [plan.drive(channel) for channel in plan.drives]
    drives, rows = commanded, averaged_rows(records)
    if max(rows, default=1) > 1:
        progress("averaging rows")
        records, drives = average(records, drives, (*plan.sensors, *plan.deflections))
    outputs, terms, kinds = _fitted(records, plan, drives, progress)
    between: list[str] = []
    if plan.choose and plan.hold is None and not plan.at_rows:
        progress("trying whether drives switch between rows")
        between = switched_between_rows(records, drives, kinds, plan.fixed, plan.free_start)
        if between:
            drives = [replace(d, hold="first") if d.channel in between else d for d in drives]
            commanded = drives
            outputs, terms, kinds = _fitted(records, plan, drives, progress, between)
    effects, plain = tuple[Effect, ...](), kinds
    # Heat that is lost faster everywhere comes first; where it explains too little, the rest alone.
    losses = True
    turn = LAW_ROUNDS if plan.choose and not plan.linear else 0
    while turn:
        progress("trying laws of the drives and of the material")
        found = laws_of(records, drives, kinds, effects, plan.fixed, plan.free_start, losses)
        if not found:
            break
        acting, zeroed = acting_records(records, drives, found)
        with_laws = _fitted(acting, plan, zeroed, progress, between)
        kept = explain(records, drives, plain, with_laws[2], found, plan.fixed, plan.free_start)
        if kept is not None:
            effects = found
            if kept:
                with_laws = _fitted(acting, plan, zeroed, progress, between, kept)
            outputs, terms, kinds = with_laws
            turn -= 1
        elif losses and not effects and any(isinstance(each, LOSSES) for each in found):
            losses = False
        else:
            break
    ranges = (
        extent([relative(r.column(d.channel), d.reference, d.hold) for r in measured])
        for d in commanded
    )
    model = Model(
        drives=tuple(replace(d, range=own) for d, own in zip(commanded, ranges, strict=True)),
        outputs=tuple(of_readings(output, measured, rows) for output in outputs),
        terms=tuple(terms),
        sample_period=min(record.period for record in measured),
        effects=effects,
        provenance={"logs": [record.source for record in measured if record.digest]},
    )
    model = with_seen_changes(model, measured)
    model = as_simulated(with_zeros(model, measured), measured)
    if plan.choose and plan.initial == "auto":
        progress("trying whether the machine begins at rest")
        chosen = [each for each in kinds if plan.chosen(each.output)]
        still = all(rests(r, commanded, [each.output for each in chosen]) for r in measured)
        asked = [each for each in chosen if not still or surroundings(drives, each.output)]
        if begins_away_from_rest(records, drives, asked, effects, plan.fixed):
            with contextlib.suppress(FitError):
                free = calibrate(measured, replace(plan, initial="free"), progress)
                # How a log begins, `simulate` decides for all outputs.
                return as_simulated(free_where_known(free, model), measured)
    return model


def _fitted(
    records: Sequence[Record],
    plan: CalibrationPlan,
    drives: Sequence[Drive],
    progress: Callable[[str], None],
    between: Sequence[str] = (),
    kept: Sequence[ChosenKinds] = (),
) -> tuple[list[Output], list[Term], list[ChosenKinds]]:
    """Every output, what drives it, and the kinds of response that were chosen, or are kept."""
    outputs: list[Output] = []
    terms: list[Term] = []
    chosen: list[ChosenKinds] = []
    states: GridStates = {}

    def choice(channel: str, kind: str, equilibrium: bool = True) -> tuple[KindCandidate, ...]:
        if not plan.chosen(channel):
            return ()
        return choose_response(
            records, drives, channel, kind, plan.fixed, plan.free_start,
            partial(_say, progress, channel), states, equilibrium,
        )  # fmt: skip

    named = [(channel, kind) for channel, _, kind in plan.outputs()]
    choices = [choice(*each) for each in named]
    denied = [
        denies_equilibrium(found, drives, channel)
        for (channel, _), found in zip(named, choices, strict=True)
    ]
    for k, denies in enumerate(denied if any(denied) else ()):
        # Parts of one machine have the same surroundings, logged or not.
        if not denies and any(each.chosen and each.equilibrium for each in choices[k]):
            free = choice(*named[k], equilibrium=False)
            noise = max(reading_sigma(record.column(named[k][0])) for record in records)
            choices[k] = free if is_as_good(free, choices[k], noise) else choices[k]
    before = {each.output: each.of_all(len(drives)) for each in kept}
    choices = [
        with_kept(each, *before[channel]) if channel in before else each
        for (channel, _), each in zip(named, of_one_body(choices), strict=True)
    ]
    for (channel, role, kind), tried in zip(plan.outputs(), choices, strict=True):
        say = partial(_say, progress, channel)
        kinds = [kind] * len(drives)
        delays: tuple[float, ...] = (0.0,) * len(drives)
        equilibrium, common, near = False, False, None
        for taken in (each for each in tried if each.chosen):
            kinds, delays, near = list(taken.kinds), taken.delays, taken.theta
            equilibrium, common = taken.equilibrium, taken.common
        acting = [k for k, own in enumerate(kinds) if own != LEFT_OUT]
        left_out = [k for k, own in enumerate(kinds) if own == LEFT_OUT]
        used, kinds = [drives[k] for k in acting], [kinds[k] for k in acting]
        without = [drives[k] for k in left_out]
        fit = fit_output(
            records, used, channel, kinds, plan.fixed, plan.loss, plan.starts,
            plan.free_start, say, delays if any(delays) else None, states, between,
            equilibrium, near_weights(tried, [*acting, *left_out]), near, common, without,
        )  # fmt: skip
        outputs.append(_output(channel, role, fit, records, plan, [*used, *without], tried))
        terms += (
            Term(drive.channel, channel, fit.responses[k], *fit.response_covariance(k))
            for k, drive in enumerate(used)
        )
        own = tuple(delays[k] for k in acting)
        chosen.append(ChosenKinds(channel, tuple(acting), tuple(kinds), own, equilibrium, common))
    return outputs, terms, chosen


def as_simulated(model: Model, records: Sequence[Record]) -> Model:
    """The model with fits as `simulate` gives them; the fit itself leaves every zero free.

    Parameters
    ----------
    model : Model
    records : sequence of Record
        Those of the calibration.
    """
    found = agreements(model, records)
    zeros = [started_outputs(model, record, model.simulate(record)) for record in records]
    outputs, bent = [], {effect.channel for effect in model.effects if effect.side == "sensor"}
    for output in model.outputs:
        own, averaged = found[output.channel], "averaged_rows" in output.fit
        fit = {
            "rmse": own.rmse,
            # ... of straightened readings where they are bent.
            "rmse_zero_free": own.rmse_zero_free
            if output.channel in bent or (averaged and not output.fit["free_start"])
            else output.fit.get("rmse_zero_free", output.fit["rmse"]),
            "max_error": own.max_error,
            "fit_percent": own.fit_percent,
            "zeros": [each[output.channel].zero.document() for each in zeros],
        }
        outputs.append(replace(output, fit={**output.fit, **fit}))
    return replace(model, outputs=tuple(outputs))


def _output(
    channel: str,
    role: Role,
    fit: OutputFit,
    records: Sequence[Record],
    plan: CalibrationPlan,
    drives: Sequence[Drive],
    candidates: Sequence[KindCandidate],
) -> Output:
    measured = [record.column(channel) for record in records]
    levels = [y - offset for y, offset in zip(measured, fit.offsets, strict=True)]
    return Output(
        channel,
        role,
        # A displacement has no zero of its own; any other reading at rest is one of the sensor. Of
        # several logs it is found at last.
        "first" if is_displacement(channel) else float(np.mean(fit.offsets)),
        extent(levels),
        {
            "rmse": fit.rmse,
            "max_error": fit.max_error,
            "fit_percent": fit.fit_percent,
            "covered": fit.covered,
            "rows": sum(int(np.isfinite(y).sum()) for y in measured),
            "noise": max(map(reading_sigma, measured)),
            "offsets": list(fit.offsets),
            "offset_errors": np.sqrt(np.diag(fit.covariance)[-len(fit.offsets) :]).tolist(),
            "free_start": plan.free_start,
            "starts_rmse": list(fit.starts),
            "unidentified": list(fit.unidentified),
            **(
                {
                    "instants": {
                        "switches": fit.instants,
                        "rmse": fit.rmse_instants,
                        "rmse_without": fit.rmse,
                    }
                }
                if fit.instants
                else {}
            ),
            "discrepancy": _discrepancy(fit, [drive.channel for drive in drives]),
            **({"candidates": [each.document() for each in candidates]} if candidates else {}),
        },
    )


def _discrepancy(fit: OutputFit, drives: Sequence[str]) -> dict[str, Any]:
    """What the calibration knows beyond its kind of response, as JSON."""
    own = []
    for name in fit.names[: -len(fit.offsets)]:
        base, _, k = name.partition("[")
        own.append([drives[int(k.removesuffix("]") or 0)], base])
    return {
        "parameters": own,
        "lags": [[drive, tau] for drive in drives for tau in fit.time_constants],
        "mean": fit.discrepancy.mean.tolist(),
        "covariance": fit.discrepancy.covariance.tolist(),
        "spread": fit.discrepancy.spread.tolist(),
        "white_sigma": fit.discrepancy.white,
        "drift_sigma": fit.discrepancy.drift,
        "drift_time_s": fit.discrepancy.drift_time,
        "lag_sigma": fit.discrepancy.size.tolist(),
    }


def _say(progress: Callable[[str], None], channel: str, message: str) -> None:
    progress(f"{channel}, {message}")


def extent(series: Sequence[Float]) -> tuple[float, float]:
    """Least and largest value; NaN counts for nothing.

    Parameters
    ----------
    series : sequence of ndarray
    """
    joined = np.concatenate(series)
    return float(np.nanmin(joined)), float(np.nanmax(joined))
