"""What ``present`` tells of a model: outputs, gains, time constants, effects, estimator."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from thermaltool.documents import jsonable
from thermaltool.effects import Effect
from thermaltool.effects.convection_state import ConvectionState
from thermaltool.model import (
    Characteristics,
    Model,
    OperatingPoint,
    Output,
    Term,
    at_operating_points,
)
from thermaltool.report.orders import arma_document, fit_table
from thermaltool.report.style import channel_unit, with_unit
from thermaltool.report.text import aligned
from thermaltool.signals.intervals import Estimate, normal_estimate
from thermaltool.timeseries.model import ArmaModel
from thermaltool.units import parse_channel, printed

# From here on a time constant is told in minutes, and in hours [s].
MINUTES_FROM, HOURS_FROM = 120.0, 7200.0
MAX_DIGITS = 6  # of a time whose interval is narrow
# Digits of the numbers in the JSON: the model file has all.
DIGITS = 6
# Of a line of compact JSON: of one with objects in it, and of one without.
SHORT_LINE, LONG_LINE = 100, 400


def presented(model: Model | ArmaModel) -> str:
    """A model as tables.

    Parameters
    ----------
    model : Model or ArmaModel
    """
    if isinstance(model, ArmaModel):
        return fit_table(model)
    parts = [_origin(model), _outputs(model), _responses(model)]
    parts.extend(
        f"gains and time constants change with {effect.channel} (convection_state)"
        if effect.table is None
        else f"gains and time constants at a level of {effect.channel} are with the loss rate "
        "there (convection_state)"
        for effect in model.effects
        if isinstance(effect, ConvectionState)
    )
    if model.effects:
        parts.append(_effects(model.effects))
    if model.design is not None:
        parts.append(_estimator(model.design))
    if model.redundancy is not None:
        known = model.redundancy
        parts.append(
            f"where up to {known.most_lost} of {len(known.channels)} drives are lost, the others "
            "stand in for them"
        )
    return "\n\n".join(parts)


def _origin(model: Model) -> str:
    drives = ", ".join(
        f"{d.channel} (seen {_extent(d.channel, d.range, d.reference)})" for d in model.drives
    )
    lines = [f"driven by {drives}", f"one row every {duration(model.sample_period)}"]
    if logs := _log_names(model.provenance):
        lines.append(f"from {', '.join(logs)}")
    if diagnosed := _diagnosed(model.provenance):
        lines.append(f"causes from {', '.join(diagnosed)}: errors are those of the model there")
    return "\n".join(lines)


def _diagnosed(provenance: Mapping[str, Any]) -> list[str]:
    """Logs that a diagnosis extended the model by, on which its errors are told."""
    made = provenance.get("diagnosed")
    return _log_names(made) if isinstance(made, dict) else []


def _log_names(provenance: Mapping[str, Any]) -> list[str]:
    """Logs that a file says it comes from, without their folders."""
    logs = provenance.get("logs")
    listed = logs if isinstance(logs, list | tuple) else ()
    named = (log.get("name") for log in listed if isinstance(log, dict))
    found = (Path(name).name for name in named if isinstance(name, str))
    return [name for name in dict.fromkeys(found) if name]


def _extent(channel: str, ends: tuple[float, float], rest: float | str) -> str:
    low, high = ends
    beside = ", from rest" if rest == "first" else ""
    return f"{with_unit(low, '1')} to {with_unit(high, channel_unit(channel))}{beside}"


def _outputs(model: Model) -> str:
    rows = [["output", "role", "rmse", "zero free", "fit %", "rows", "seen from rest"]]
    for output in model.outputs:
        fit = {name: value for name, value in _fit(output).items() if value is not None}
        rows.append(
            [
                output.channel,
                output.role,
                *(f"{fit[key]:.4g}" if key in fit else "" for key in ("rmse", "rmse_zero_free")),
                f"{fit['fit_percent']:.2f}" if "fit_percent" in fit else "",
                f"{fit['rows']:.0f}" if "rows" in fit else "",
                _extent(output.channel, output.range, 0.0),
            ]
        )
    kept = [k for k in range(len(rows[0])) if any(row[k] for row in rows[1:])]
    return aligned([[row[k] for k in kept] for row in rows])


def _fit(output: Output) -> dict[str, float | None]:
    """Numbers of a fit; None for what a file does not have or has as something else."""
    found = {key: output.fit.get(key) for key in ("rmse", "rmse_zero_free", "fit_percent", "rows")}
    return {
        key: value
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        else None
        for key, value in found.items()
    }


def _responses(model: Model) -> str:
    told = at_operating_points(model)
    terms, points = [term for term, _, _ in told], [point for _, point, _ in told]
    return responses_table([found for _, _, found in told], terms, points)


def responses_table(
    found: Sequence[Characteristics],
    terms: Sequence[Term] = (),
    points: Sequence[OperatingPoint] = (),
) -> str:
    """One row per response: gain, time constants and oscillations with intervals, delay.

    Parameters
    ----------
    found : sequence of Characteristics
    terms : sequence of Term, optional
        Of each its kind is told.
    points : sequence of OperatingPoint, optional
        Of each term the level at which it is told.
    """
    own = ["response"] if terms else []
    rows = [["drive", "output", *own, "static gain", "", "time constants"]]
    for k, each in enumerate(found):
        told = [*map(with_interval, each.time_constants), *_oscillations(each)]
        if each.delay.value:
            told.append(f"delay {with_interval(each.delay)}")
        rows.append(
            [
                each.drive,
                each.output,
                *([f"{terms[k].response.kind}{at_level(points[k])}"] if terms else []),
                f"{each.gain.value:.4g} {each.gain.unit}".strip(),
                _interval(each.gain),
                ", ".join(told),
            ]
        )
    if any(term.covariance is None for term in terms):
        return f"{aligned(rows)}\nno interval where the file holds no covariance"
    return aligned(rows)


def at_level(point: OperatingPoint) -> str:
    """A level in words, behind the kind of a response; empty where there is none.

    Parameters
    ----------
    point : OperatingPoint
    """
    if not point.channel:
        return ""
    return f", at {with_unit(point.level, channel_unit(point.channel))} of {point.channel}"


def _oscillations(found: Characteristics) -> list[str]:
    return [
        f"oscillation of {with_interval(each.period)}, damping {each.damping}"
        for each in found.oscillations
    ]


def _interval(estimate: Estimate) -> str:
    known = estimate.high > estimate.low
    return f"({estimate.low:.4g} to {estimate.high:.4g})" if known else ""


def with_interval(constant: Estimate) -> str:
    """A time with its interval, if that is known.

    Parameters
    ----------
    constant : Estimate [s]
    """
    if not constant.high > constant.low:
        return duration(constant.value)
    # As many digits as show that the ends are two.
    for digits in range(3, MAX_DIGITS + 1):
        value, low, high = (
            duration(each, digits) for each in (constant.value, constant.low, constant.high)
        )
        if low != high:
            break
    return f"{value} ({low} to {high})"


def duration(seconds: float, digits: int = 3) -> str:
    """A time in seconds, minutes or hours.

    Parameters
    ----------
    seconds : float [s]
    digits : int
    """
    if abs(seconds) < MINUTES_FROM:
        return f"{seconds:.{digits}g} s"
    return (
        f"{seconds / 60:.{digits}g} min"
        if seconds < HOURS_FROM
        else f"{seconds / 3600:.{digits}g} h"
    )


def _parameters(effect: Effect) -> dict[str, Estimate]:
    """Parameters of an effect with their intervals; without width where none are known."""
    errors = [0.0] * len(effect.parameters)
    if effect.covariance is not None and len(effect.covariance) == len(errors):
        errors = [math.sqrt(max(float(v), 0.0)) for v in effect.covariance.diagonal()]
    return {
        name: normal_estimate(value, error, printed(effect.unit(name)))
        for (name, value), error in zip(effect.parameters.items(), errors, strict=True)
    }


def _effects(effects: Sequence[Effect]) -> str:
    rows = [["effect", "channel", "parameter", "value", ""]]
    for effect in effects:
        where = f"{effect.name}, in one log alone" if effect.log else effect.name
        knots = [k.removeprefix("x") for k in effect.parameters if k.startswith("x")]
        if knots and all(f"y{k}" in effect.parameters for k in knots):
            pairs = ((effect.parameters[f"x{k}"], effect.parameters[f"y{k}"]) for k in knots)
            told = ", ".join(f"{x:.4g} → {y:.4g}" for x, y in pairs)
            rows.append([where, effect.channel, "knots", told, ""])
            continue
        for name, each in _parameters(effect).items() or [("", Estimate(0.0, 0.0, 0.0))]:
            value = [name, f"{each.value:.4g} {each.unit}".strip(), _interval(each)]
            rows.append([where, effect.channel, *(value if name else ["", "", ""])])
    return aligned(rows)


def _estimator(design: Mapping[str, Any]) -> str:
    """The form of an estimator, its settings, and the error that was predicted of it."""
    settings = _numbers(design.get("settings"))
    told = [f"{name} = {value:.4g}" for name, value in settings.items()]
    lines = [f"estimator: {', '.join([str(design.get('form', 'of no form')), *told])}"]
    if bands := _bands(design):
        lag = _numbers(design["predicted"]).get("lag")
        behind = "" if lag is None else f", behind by {duration(lag)}"
        each = (f"{name} {with_unit(band, channel_unit(name))}" for name, band in bands.items())
        lines.append(f"predicted error band: {', '.join(each)}{behind}")
    return "\n".join(lines)


def _bands(design: Mapping[str, Any]) -> dict[str, float]:
    """Predicted error band of each deflection; empty where the design tells none."""
    predicted, outputs = design.get("predicted"), design.get("outputs")
    bands = predicted.get("band") if isinstance(predicted, dict) else None
    if not isinstance(bands, list) or not isinstance(outputs, list) or len(bands) != len(outputs):
        return {}
    return _numbers(dict(zip(map(str, outputs), bands, strict=True)))


def _numbers(found: Any) -> dict[str, float]:
    """The numbers of a mapping; empty where it is none."""
    pairs = found.items() if isinstance(found, dict) else ()
    return {name: float(v) for name, v in pairs if isinstance(v, int | float)}


def presented_document(model: Model | ArmaModel) -> dict[str, Any]:
    """A model as JSON below one screen: no covariance, numbers of six digits.

    Parameters
    ----------
    model : Model or ArmaModel
    """
    found = arma_document(model) if isinstance(model, ArmaModel) else _document(model)
    found["logs"] = _log_names(model.provenance)
    if diagnosed := _diagnosed(model.provenance):
        found["diagnosed"] = diagnosed
    rounded: dict[str, Any] = _rounded(jsonable(found))
    return rounded


def _document(model: Model) -> dict[str, Any]:
    found: dict[str, Any] = {
        "sample_period_s": model.sample_period,
        "drives": [{"channel": d.channel, "seen": d.range} for d in model.drives],
        "outputs": [
            {"channel": o.channel, "role": o.role, "unit": parse_channel(o.channel).unit}
            | {key: value for key, value in _fit(o).items() if value is not None}
            for o in model.outputs
        ],
        "responses": [
            each.document() | ({"level": point.level} if point.channel else {})
            for _, point, each in at_operating_points(model)
        ],
    }
    if model.effects:
        found["effects"] = [
            {
                "name": e.name,
                "channel": e.channel,
                "parameters": {n: [p.value, p.low, p.high] for n, p in _parameters(e).items()},
            }
            for e in model.effects
        ]
    if model.design is not None:
        found["estimator"] = {
            "form": model.design.get("form"),
            **_numbers(model.design.get("settings")),
            "band": _bands(model.design),
        }
    return found


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _rounded(each) for name, each in value.items()}
    if isinstance(value, list):
        return [_rounded(each) for each in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def to_compact_json(value: Any, indent: int = 0) -> str:
    """A document as text, sorted, as few lines as a person reads: an object without others on one.

    Parameters
    ----------
    value : JSON-ready, without NaN
    """
    line = json.dumps(value, sort_keys=True, allow_nan=False, ensure_ascii=False)
    if not isinstance(value, dict | list):
        return line
    if len(line) + indent <= (SHORT_LINE if "{" in line[1:] else LONG_LINE):
        return line
    inside = " " * (indent + 1)
    if isinstance(value, dict):
        pairs = ((f"{json.dumps(k, ensure_ascii=False)}: ", value[k]) for k in sorted(value))
        ends = "{}"
    else:
        pairs = (("", each) for each in value)
        ends = "[]"
    rows = [f"{inside}{name}{to_compact_json(v, indent + 1)}" for name, v in pairs]
    return "\n".join([ends[0], ",\n".join(rows), f"{' ' * indent}{ends[1]}"])
