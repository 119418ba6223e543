"""From logs to a model: which channel drives, which is a sensor, which a deflection."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.fitting.calibrate import Fit, Loss, fit_output
from thermaltool.fitting.projection import OutputRecord
from thermaltool.model import Drive, Model, Output, Role, Term, relative
from thermaltool.record import Record
from thermaltool.responses import response_class
from thermaltool.responses.modes import Float
from thermaltool.units import Hold, Reference, drive_reference, hold_of, is_displacement


@dataclass(frozen=True)
class Plan:
    """What to fit.

    Attributes
    ----------
    drives, sensors, deflections : tuple of str
        Channels by role.
    kinds : mapping of output channel to kind of response
        Default: conduction for a sensor, deflection for a deflection.
    reference : "first", float or None
        What counts as no drive; None is "first" for an absolute temperature and 0 otherwise.
    hold : "zero", "first" or None
        Of the drives between samples; None chooses by quantity.
    fixed : mapping of parameter name to value
    loss, starts, free_start
        See `fit_output`.
    """

    drives: tuple[str, ...]
    sensors: tuple[str, ...]
    deflections: tuple[str, ...]
    kinds: Mapping[str, str] = field(default_factory=dict)
    reference: Reference | None = None
    hold: Hold | None = None
    fixed: Mapping[str, float] = field(default_factory=dict)
    loss: Loss = "huber"
    starts: int = 6
    free_start: bool = False

    def drive_hold(self, channel: str) -> Hold:
        if self.hold is not None:
            return self.hold
        return hold_of(channel)

    def drive_reference(self, channel: str) -> Reference:
        if self.reference is not None:
            return self.reference
        return drive_reference(channel)

    def outputs(self) -> list[tuple[str, Role, str]]:
        """(channel, role, kind) of every output."""
        roles: list[tuple[str, Role, str]] = [(c, "sensor", "conduction") for c in self.sensors]
        roles += [(c, "deflection", "deflection") for c in self.deflections]
        return [(channel, role, self.kinds.get(channel, kind)) for channel, role, kind in roles]


def calibrate(
    logs: Sequence[Record],
    plan: Plan,
    provenance: Mapping[str, Any] | None = None,
    progress: Callable[[str], None] = lambda message: None,
) -> Model:
    """Fit every output of `plan` over all logs and put the model together.

    Raises
    ------
    ModelError
        Nothing to fit, a channel in two roles, an unknown kind.
    FitError
        See `fit_output`.
    """
    outputs = plan.outputs()
    names = [*plan.drives, *(channel for channel, _, _ in outputs)]
    if not plan.drives or not outputs:
        raise ModelError("a calibration needs a drive and at least one sensor or deflection")
    for name in names:
        if names.count(name) > 1:
            raise ModelError(f"{name} is named twice: a channel has one role")
    for channel in plan.kinds:
        if channel not in names[len(plan.drives) :]:
            raise ModelError(f"a kind of response for {channel}, which is no output of the fit")
    constants = {name for _, _, kind in outputs for name in response_class(kind).fixed}
    for name, value in plan.fixed.items():
        if name not in constants or not 0 < value < float("inf"):
            known = f"one of {', '.join(sorted(constants))}" if constants else "nothing here"
            raise ModelError(f"cannot fix {name} = {value:g}: it must be above 0, and {known}")
    driven = [
        tuple(relative(log.columns[c], plan.drive_reference(c)) for c in plan.drives)
        for log in logs
    ]
    fitted = []
    for channel, role, kind in outputs:
        records = [
            OutputRecord(log.time, inputs, log.columns[channel])
            for log, inputs in zip(logs, driven, strict=True)
        ]
        fit = fit_output(
            records,
            [kind] * len(plan.drives),
            [plan.drive_hold(c) for c in plan.drives],
            {k: v for k, v in plan.fixed.items() if k in response_class(kind).fixed},
            plan.loss,
            plan.starts,
            plan.free_start,
            partial(_say, progress, channel),
        )
        fitted.append((channel, role, fit, records))
    drives = tuple(
        Drive(
            channel,
            plan.drive_hold(channel),
            plan.drive_reference(channel),
            _extent([inputs[k] for inputs in driven]),
        )
        for k, channel in enumerate(plan.drives)
    )
    return Model(
        drives=drives,
        outputs=tuple(_output(*each, plan.drives, plan.free_start) for each in fitted),
        terms=tuple(
            Term(drive, channel, fit.responses[k], *_own_covariance(fit, k))
            for channel, _, fit, _ in fitted
            for k, drive in enumerate(plan.drives)
        ),
        sample_period=min(float(np.median(np.diff(log.time))) for log in logs),
        provenance=provenance or {},
    )


def _output(
    channel: str,
    role: Role,
    fit: Fit,
    records: Sequence[OutputRecord],
    drives: Sequence[str],
    free_start: bool,
) -> Output:
    levels = [r.values - offset for r, offset in zip(records, fit.offsets, strict=True)]
    # A displacement has no zero of its own; any other reading at rest is a property of the sensor.
    arbitrary = is_displacement(channel)
    return Output(
        channel,
        role,
        "first" if arbitrary else float(np.mean(fit.offsets)),
        _extent(levels),
        {
            "rmse": fit.rmse,
            "max_error": fit.max_error,
            "fit_percent": fit.fit_percent,
            "covered": fit.covered,
            "rows": sum(int(np.isfinite(r.values).sum()) for r in records),
            "offsets": list(fit.offsets),
            "free_start": free_start,
            "starts_rmse": list(fit.starts),
            "unidentified": list(fit.unidentified),
            "discrepancy": _discrepancy(fit, drives),
        },
    )


def _discrepancy(fit: Fit, drives: Sequence[str]) -> dict[str, Any]:
    """What the calibration knows beyond its kind of response, as JSON."""
    own = []
    for name in fit.names[: -len(fit.offsets)]:
        base, _, k = name.partition("[")
        own.append([drives[int(k.removesuffix("]") or 0)], base])
    return {
        "parameters": own,
        "lags": [[drive, tau] for drive in drives for tau in fit.lags],
        "mean": fit.discrepancy.mean.tolist(),
        "covariance": fit.discrepancy.covariance.tolist(),
        "white_sigma": fit.discrepancy.white,
        "drift_sigma": fit.discrepancy.drift,
        "drift_time_s": fit.discrepancy.drift_time,
        "lag_sigma": fit.discrepancy.size,
    }


def _say(progress: Callable[[str], None], channel: str, message: str) -> None:
    progress(f"{channel}, {message}")


def _extent(series: Sequence[Float]) -> tuple[float, float]:
    joined = np.concatenate(series)
    return float(np.nanmin(joined)), float(np.nanmax(joined))


def _own_covariance(fit: Fit, drive: int) -> tuple[Float, tuple[str, ...]]:
    """The block of the covariance that belongs to the response of one drive."""
    own = [
        k
        for k, name in enumerate(fit.names)
        if not name.startswith("offset") and (len(fit.responses) == 1 or f"[{drive}]" in name)
    ]
    names = tuple(fit.names[k].partition("[")[0] for k in own)
    return fit.covariance[np.ix_(own, own)], names
