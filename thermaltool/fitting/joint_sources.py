"""A joint beside linear responses, from logs of several levels.

Responses are those of a reference level (Fraser 1997, 7.4.1: half of the largest), as the source
has them; what displacements do beyond them at other levels is told by contact temperatures that
depart from the linear model, and by a bend with the heat (`thermaltool.fitting.joint_search`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.effects.joint_contact import JointContact
from thermaltool.errors import FitError, ModelError
from thermaltool.fitting.calibrate import as_simulated, calibrate, extent
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.fitting.joint_levels import reference_logs
from thermaltool.fitting.joint_search import JointSearch
from thermaltool.fitting.seen_changes import with_seen_changes
from thermaltool.fitting.sound_kinds import DECISIVE
from thermaltool.model import Drive, Model, Output, relative
from thermaltool.model.rest import rest_level
from thermaltool.record import Record
from thermaltool.responses.modes import Float
from thermaltool.units import is_displacement, is_temperature

# Kinds of a displacement (Fraser 1997, 6.16 and 7.19, and lags): what a simpler kind leaves at the
# reference level grows with the level. The first is taken beside which no other has evidence, and
# whose terms do not cancel.
KINDS = ("deflection", "joint_deflection", "rational4")


@dataclass(frozen=True)
class JointFit:
    """A model with its joint.

    Attributes
    ----------
    model : Model
    left_out : tuple of str
        Contact temperatures that say nothing more beside the others.
    """

    model: Model
    left_out: tuple[str, ...]


def calibrate_joint(
    records: Sequence[Record],
    plan: CalibrationPlan,
    contacts: Sequence[str],
    progress: Callable[[str], None] = lambda message: None,
) -> JointFit:
    """Fit linear responses to the reference level, and the joint to what departs from them.

    Parameters
    ----------
    records : sequence of Record
        From rest, of several levels: each log one, or all in one log.
    plan : CalibrationPlan
        Without the contact temperatures.
    contacts : sequence of str
        Temperatures that may depart from the linear model where the joint is.
    progress : callable
        Gets a word now and then.

    Raises
    ------
    ModelError
        What is no calibration of a joint.
    FitError
        Logs that show none, or one level alone.
    LogError
        A contact temperature that a log does not have.
    """
    _check(plan, contacts)
    plan = replace(plan, initial="rest", linear=True, at_rows=True)
    reference = reference_logs(records, [plan.drive(channel) for channel in plan.drives])
    steady = [record for record, own in zip(records, reference, strict=True) if own]

    def part(
        which: Sequence[Record], deflections: Sequence[str], sensors: Sequence[str] = ()
    ) -> Model:
        return calibrate(which, _of_outputs(plan, sensors, deflections), progress)

    found = [part(steady, contacts)]
    others = tuple(o for o in plan.deflections if not is_displacement(o))
    if plan.sensors or others:
        found.append(part(records, others, plan.sensors))
    linear = _joined(found)
    displacements = tuple(filter(is_displacement, plan.deflections))
    progress("looking for a joint")
    simulated = [linear.simulate(record) for record in records]
    near = next((o for o in plan.sensors if is_temperature(o)), None)
    search = JointSearch(
        records, linear.drives, displacements, simulated, near, contacts, reference
    )
    effects = search.effects()
    if not effects and search.beyond:
        raise FitError(
            f"{', '.join(displacements)} depart from proportion to {', '.join(plan.drives)} as "
            f"{', '.join(search.beyond)} tell, but by more a kelvin than the whole warming bends: "
            "take temperatures nearer to the joint, or logs of further levels"
        )
    if not effects:
        raise FitError(
            f"no joint shows in these logs: {', '.join(displacements)} are in proportion to "
            f"{', '.join(plan.drives)}, or depart from it otherwise; calibrate without --joint, "
            "and let diagnose say how they depart"
        )
    bent = [
        _without_joint(record, own, effects, displacements)
        for record, own, of in zip(records, simulated, reference, strict=True)
        if of
    ]
    straight = [_displacement(bent, plan, o, progress) for o in displacements]
    left_out = tuple(c for c in contacts if c not in {effect.partner for effect in effects})
    whole = _joined([*found, *straight])
    kept = [o for o in whole.outputs if o.channel not in left_out]
    order = [*plan.sensors, *plan.deflections, *contacts]
    model = replace(
        whole,
        outputs=tuple(sorted(kept, key=lambda output: order.index(output.channel))),
        terms=tuple(term for term in whole.terms if term.output not in left_out),
        effects=effects,
        provenance={"logs": [record.source for record in records if record.digest]},
    )
    model = with_seen_changes(_over_all(model, records), records)
    model = _with_errors(as_simulated(model, records), records)
    read = {effect.partner for effect in effects}
    return JointFit(_with_contacts(model, read), left_out)


def _displacement(
    records: Sequence[Record],
    plan: CalibrationPlan,
    channel: str,
    progress: Callable[[str], None],
) -> Model:
    """A displacement alone, by the kind that it has been given or the simplest that will do."""
    kinds = (plan.kinds[channel],) if channel in plan.kinds else KINDS
    plans = [_of_outputs(replace(plan, kinds={channel: k}), (), (channel,)) for k in kinds]
    fits = [calibrate(records, each, progress) for each in plans]
    cancelling = [any(map(_cancels, fit.outputs[0].fit["unidentified"])) for fit in fits]
    sound = [fit for fit, gone in zip(fits, cancelling, strict=True) if not gone] or fits
    least = min(map(_criterion, sound))
    return next(fit for fit in sound if _criterion(fit) <= least + DECISIVE)


def _of_outputs(
    plan: CalibrationPlan, sensors: Sequence[str], deflections: Sequence[str]
) -> CalibrationPlan:
    """The plan of some outputs, with the kinds and the fixed parameters that these have."""
    kinds = {o: kind for o, kind in plan.kinds.items() if o in (*sensors, *deflections)}
    own = replace(plan, kinds=kinds, sensors=tuple(sensors), deflections=tuple(deflections))
    return replace(own, fixed={n: v for n, v in plan.fixed.items() if n in own.constants()})


def _criterion(fit: Model) -> float:
    """The Bayesian information criterion of the one output of a model, to a constant."""
    own, count = fit.outputs[0].fit, sum(len(term.covariance_names) for term in fit.terms)
    return float(2 * own["rows"] * np.log(own["rmse_zero_free"]) + count * np.log(own["rows"]))


def _cancels(sentence: str) -> bool:
    return sentence.startswith("gains cancel")


def _check(plan: CalibrationPlan, contacts: Sequence[str]) -> None:
    if plan.initial == "free":
        raise ModelError("--joint needs logs from rest, so that --initial free does not go with it")
    if not any(map(is_displacement, plan.deflections)):
        raise ModelError("--joint needs a displacement among the deflections: it is what bends")
    for contact in contacts:
        if not is_temperature(contact):
            raise ModelError(f"--joint {contact}: not a temperature, as that of a contact is")
    replace(plan, deflections=(*plan.deflections, *contacts)).check()


def _joined(models: Sequence[Model]) -> Model:
    """One model of the outputs and terms of several with the same drives."""
    return replace(
        models[0],
        outputs=tuple(output for model in models for output in model.outputs),
        terms=tuple(term for model in models for term in model.terms),
    )


def _without_joint(
    record: Record,
    linear: Mapping[str, Float],
    effects: Sequence[JointContact],
    displacements: Sequence[str],
) -> Record:
    """A record whose displacements are what they would be without the joint."""
    straight = {o: np.zeros(len(record)) for o in displacements}
    changed = {}
    for o in displacements:
        added = [effect.output(o, {**linear, **straight}, record) for effect in effects]
        changed[o] = record.column(o) - np.sum(added, axis=0)
    return record.with_columns(changed)


def _over_all(model: Model, records: Sequence[Record]) -> Model:
    """The model with the ranges and counts of all records, whichever it was fitted to."""

    def drive(own: Drive) -> Drive:
        seen = [relative(r.column(own.channel), own.reference, own.hold) for r in records]
        return replace(own, range=extent(seen))

    def output(own: Output) -> Output:
        measured = [record.column(own.channel) for record in records]
        seen = [y - rest_level(y, "first", "first") for y in measured]
        rows = sum(int(np.isfinite(y).sum()) for y in measured)
        return replace(own, range=extent(seen), fit={**own.fit, "rows": rows})

    return replace(
        model,
        drives=tuple(map(drive, model.drives)),
        outputs=tuple(map(output, model.outputs)),
    )


def _with_contacts(model: Model, read: Collection[str | None]) -> Model:
    """The model with outputs that are read to tell of the joint, and are not judged."""
    outputs = [
        replace(o, fit={**o.fit, "contact": True}) if o.channel in read else o
        for o in model.outputs
    ]
    return replace(model, outputs=tuple(outputs))


def _with_errors(model: Model, records: Sequence[Record]) -> Model:
    """The model with errors whose zero is free in every record."""
    simulated = [model.simulate(record) for record in records]
    outputs = []
    for output in model.outputs:
        left = [r.column(output.channel) - y[output.channel]
                for r, y in zip(records, simulated, strict=True)]  # fmt: skip
        free = np.concatenate([each - np.nanmean(each) for each in left])
        error = float(np.sqrt(np.nanmean(free**2)))
        outputs.append(replace(output, fit={**output.fit, "rmse_zero_free": error}))
    return replace(model, outputs=tuple(outputs))
