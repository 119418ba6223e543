"""One log with hidden effects: calibrated, diagnosed, and the answer compared with the truth."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from as_simulated import compared, largest
from numpy.typing import NDArray
from scipy.stats import norm

from thermaltool.api.simulation import simulate
from thermaltool.diagnosis.correction import corrected, uncorrected
from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.result import Diagnosis
from thermaltool.diagnosis.select import fit_candidate, scan
from thermaltool.diagnosis.state import WITHIN_CALIBRATION
from thermaltool.effects.effect import Effect, reference_of
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.model import Model, relative
from thermaltool.model.model_file import dumps, loads
from thermaltool.record import Record
from thermaltool.units import is_displacement

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from machines.hidden import Hidden, HiddenLog, hide
from machines.scenario import DEFLECTIONS, DRIVE, SENSORS, Table

Float = NDArray[np.float64]

LOG = "log with hidden effects"
# A declared group of causes that cannot be told apart counts up to so many names.
LARGEST_GROUP = 3
# The fits of the held-out test see this share of a log and are judged on the rest of it.
SEEN = 0.8
# Trials of the right cause that the fit which was told it may refine.
TOLD_STARTS = 3


@dataclass(frozen=True)
class Trial:
    """What is hidden in a log.

    Attributes
    ----------
    group : str
        What the log counts for.
    effects : tuple of str
        Empty for a clean log.
    variant : str or None
        Of the first effect.
    size : float
        Wanted, over noise; see `machines.hidden.Hidden.size`.
    machine_seed, seed : int
    held_out : bool
        Whether a second diagnosis, of the first part of the log, is judged on the rest of it.
    """

    group: str
    effects: tuple[str, ...]
    variant: str | None
    size: float
    machine_seed: int
    seed: int
    held_out: bool = False


@dataclass(frozen=True)
class Score:
    """How a diagnosis fared.

    Attributes
    ----------
    sizes : tuple of float
        Reached by each effect.
    named : tuple of (name, channel)
        Causes in the order of acceptance.
    alarm : bool
        A cause is named, or the model is called not adequate.
    first, grouped, all_named : bool
        The (first) hidden effect is named first; first or in a declared group with the first
        cause; every hidden effect is among the causes.
    channel : bool or None
        The cause is named right and at the right channel; None where none is meant or it is not
        named first.
    error : float or None
        Of its parameters, see `parameter_error`; None where they cannot be compared.
    ratio : float or None
        Held-out RMS over that of a fit that was told the cause.
    power : float
        Of a test that is told all of the effect, see `power_of_knowing`; NaN but for one effect.
    difference : float
        Largest of an RMSE in the report from that of `simulate` with the written file, relative.
    seconds : float
        CPU time of the diagnosis.
    failure : str
        What the tool raised; such a log counts as answered wrong.
    """

    trial: Trial
    sizes: tuple[float, ...] = ()
    named: tuple[tuple[str, str], ...] = ()
    alarm: bool = True
    first: bool = False
    grouped: bool = False
    all_named: bool = False
    channel: bool | None = None
    error: float | None = None
    ratio: float | None = None
    power: float = float("nan")
    difference: float = float("nan")
    seconds: float = float("nan")
    failure: str = ""


# False alarms of the test that is told all.
FALSE = 0.03


def calibrated(table: Table) -> Model:
    """The model of a clean log; each sensor by the kind of response that fits it better."""
    log = Record(table["time_s"], table)
    model = calibrate([log], CalibrationPlan((DRIVE,), SENSORS, DEFLECTIONS))
    other = calibrate(
        [log], CalibrationPlan((DRIVE,), SENSORS, (), dict.fromkeys(SENSORS, "deflection"))
    )
    rmse = {o.channel: o.fit["rmse"] for o in model.outputs}
    better = {o.channel: o for o in other.outputs if o.fit["rmse"] < rmse[o.channel]}
    terms = {t.output: t for t in other.terms if t.output in better}
    return replace(
        model,
        outputs=tuple(better.get(o.channel, o) for o in model.outputs),
        terms=tuple(terms.get(t.output, t) for t in model.terms),
    )


def score(trial: Trial, model: Model | None = None, powers: bool = True) -> Score:
    """Hide, calibrate (unless the machine's `model` is given), diagnose, compare.

    `powers`: with the power of a test that is told all.
    """
    found = hide(trial.effects, trial.size, trial.machine_seed, trial.seed, trial.variant)
    sizes = tuple(hidden.size for hidden in found.hidden)
    model = model or calibrated(found.calibration)
    power = power_of_knowing(model, found) if powers and len(sizes) == 1 else float("nan")
    begin = time.process_time()
    try:
        answer = diagnose(model, [signals(found.log)])
        seconds = time.process_time() - begin
        off = from_simulated(answer, model, found)
    except Exception as error:  # whatever it is, the user has no answer
        return Score(trial, sizes, failure=f"{type(error).__name__}: {error}")
    named = tuple((cause.effect.name, cause.effect.channel) for cause in answer.causes)
    alarm = bool(named) or not answer.adequate
    plain = Score(trial, sizes, named, alarm, seconds=seconds, power=power, difference=off)
    if not found.hidden:
        return plain
    truth = found.hidden[0]
    causes = {name for name, _ in named}
    first = bool(named) and named[0][0] == truth.effect
    effect = answer.causes[0].effect if first else None
    at_place = None if effect is None else in_place(effect, truth)
    return replace(
        plain,
        first=first,
        grouped=first or truth.effect in group_of(answer),
        all_named=all(hidden.effect in causes for hidden in found.hidden),
        channel=at_place,
        error=parameter_error(truth, effect, found) if effect and at_place is not False else None,
        ratio=held_out_ratio(model, found) if trial.held_out else None,
    )


def from_simulated(answer: Diagnosis, model: Model, found: HiddenLog) -> float:
    """Largest difference of an RMSE in the report from that of `simulate`, relative."""
    log, written = signals(found.log), loads(dumps(answer.model))
    before, after = (simulate(each, log, faults="keep").document() for each in (model, written))
    rows = [row.document() for row in answer.written]
    return largest(compared(rows, lambda _: before, lambda _: after))


def signals(table: Table, rows: slice = slice(None)) -> Record:
    columns = {name: values[rows] for name, values in table.items() if name != "time_s"}
    return Record(table["time_s"][rows], columns, digest=LOG)


def group_of(answer: Diagnosis) -> set[str]:
    """Names that the tool declares indistinguishable from its first cause, in groups of three.

    Of an answer without a cause, the group of those that it suspects.
    """
    first = answer.causes[0].effect.name if answer.causes else None
    kind = "indistinguishable" if answer.causes else "suspected"
    names: set[str] = set()
    for each in answer.alternatives:
        group = set(each.names)
        declared = each.kind == kind and first in (None, each.names[0])
        if declared and len(group) <= LARGEST_GROUP:
            names |= group
    return names


def in_place(effect: Effect, truth: Hidden) -> bool | None:
    """Whether a cause acts where the hidden one does; None where no channel is meant."""
    if truth.channel is None:
        return None
    return truth.channel in (effect.channel, effect.partner)


# ---------------------------------------------------------------- parameters


# Numbers of one value: in the truth, in the tool, and the value at which there is no effect.
SCALARS: Mapping[str, tuple[tuple[str, str, float], ...]] = {
    "transport_delay": (("delay_s", "delay", 0.0),),
    "sensor_lag": (("time_constant_s", "time_constant", 0.0),),
    "sensor_gain": (("gain", "gain", 1.0),),
    "sensor_offset_step": (("step", "step", 0.0),),
    "sensor_drift": (("rate_per_h", "rate", 0.0),),
    "backlash": (("width", "width", 0.0),),
    "actuator_saturation": (("limit", "limit", 1.0),),
    "outliers": (("share", "share", 0.0), ("amplitude", "amplitude", 0.0)),
    "periodic": (("period_s", "period", 0.0),),
    "convection_state": (("rate", "rate", 0.0),),
    "radiation": (("rate", "rate", 0.0),),
    "drive_nonlinearity": (("exponent", "exponent", 1.0), ("dead_band", "dead_band", 0.0)),
}
# Numbers with a value for each output.
VECTORS = {
    "geometry_step": ("step", "step"),
    "part_temperature": ("coefficient", "coefficient"),
    "second_source": ("gain", "gain"),
    "ambient_drift": ("gain", "gain"),
    "periodic": ("amplitude", "amplitude"),
}
# Plant and tool have different laws, the truth is the nearest number in the tool's: a steady gain
# for a first-order lag, the slowest mode's rate for all, a leading term, the depth of a loop.
EQUIVALENT = (
    "second_source",
    "ambient_drift",
    "convection_state",
    "radiation",
    "joint_contact",
    "hysteresis",
    "sensor_conversion/thermistor",
)
# No number of the tool stands for the truth, or there is none but a time or a place.
INCOMPARABLE = (
    "drive_nonlinearity/quadratic",
    "ambient_drift/latent",
    "sensor_frozen",
    "sensors_swapped",
    "record_too_short",
)


def law_of(effect: str, variant: str | None) -> Literal["same", "equivalent", "none"]:
    """Whether plant and tool mean the same by the parameters of an effect."""
    names = {effect, f"{effect}/{variant}"}
    if names & set(INCOMPARABLE):
        return "none"
    return "equivalent" if names & set(EQUIVALENT) else "same"


def parameter_error(truth: Hidden, effect: Effect, found: HiddenLog) -> float | None:
    """Largest relative error of the parameters of a cause that is named right.

    Relative to the true departure from no effect: of a gain of 1.05 taken for 1.06 it is 20 %.
    Values for several outputs are one vector, each over the noise of its output; an output that
    the tool leaves out counts as 0. Times at which something happened are not compared.
    """
    if law_of(truth.effect, truth.variant) == "none":
        return None
    errors = []
    for theirs, ours, neutral in SCALARS.get(truth.effect, ()):
        if theirs in truth.parameters:
            departure = truth.parameters[theirs] - neutral
            value = effect.parameters.get(ours, neutral) - neutral
            errors.append(abs(value / departure - 1.0))
    if truth.effect in VECTORS:
        errors.append(_vector_error(truth, effect, found))
    if truth.effect in _SPECIAL:
        errors.append(_distance(*_SPECIAL[truth.effect](truth, effect, found)))
    return max(errors)


def _vector_error(truth: Hidden, effect: Effect, found: HiddenLog) -> float:
    theirs, ours = VECTORS[truth.effect]
    values = dict(effect.parameters)
    if truth.effect == "periodic":
        sines = [o for n in values if (o := reference_of(n)[1]) and n.startswith("sine")]
        for o in sines:
            values[f"amplitude[{o}]"] = np.hypot(values[f"sine[{o}]"], values[f"cosine[{o}]"])
    noise = np.array(list(found.noise.values()))
    value = [values.get(f"{ours}[{o}]", 0.0) for o in found.noise]
    true = [truth.parameters.get(f"{theirs}_{o}", 0.0) for o in found.noise]
    return _distance(value / noise, true / noise)


def _distance(value: Float, true: Float) -> float:
    return float(np.linalg.norm(value - true) / np.linalg.norm(true))


def _conversion(truth: Hidden, effect: Effect, found: HiddenLog) -> tuple[Float, Float]:
    """Departures of gain and curvature at the largest reading."""
    assert truth.channel is not None
    reading = found.clean[truth.channel]
    reach = float(np.max(np.abs(reading - reading[0])))
    pair = [
        np.array([(p.get("gain", 1.0) - 1.0) * reach, p["curvature"] * reach**2])
        for p in (effect.parameters, truth.parameters)
    ]
    return pair[0], pair[1]


def _joint(truth: Hidden, effect: Effect, found: HiddenLog) -> tuple[Float, Float]:
    """Curvature: of y² in the plant, of y|y| in the tool."""
    assert truth.channel is not None
    way = np.sign(np.sum(found.clean[truth.channel]))
    value = way * effect.parameters.get("curvature", 0.0)
    return np.array([value]), np.array([truth.parameters["curvature"]])


def _loop(truth: Hidden, effect: Effect, found: HiddenLog) -> tuple[Float, Float]:
    """By how much the heat lags behind the command once a reversal is far behind.

    Share times half a width in the plant; the tool's three plays have two thirds of that.
    """
    value = effect.parameters.get("share", 1.0) * effect.parameters["width"] / 3
    true = truth.parameters["share"] * truth.parameters["width"] / 2
    return np.array([value]), np.array([true])


_SPECIAL: Mapping[str, Callable[[Hidden, Effect, HiddenLog], tuple[Float, Float]]] = {
    "sensor_conversion": _conversion,
    "joint_contact": _joint,
    "hysteresis": _loop,
}


# ---------------------------------------------------------------- data that no fit has seen


def held_out_ratio(model: Model, found: HiddenLog) -> float | None:
    """RMS on the end of a log, of a diagnosis of its beginning over a fit that was told the cause.

    All outputs, each over its noise. Both models run free from the first row. None for a
    calibration that is too short: there is nothing to be told.
    """
    rows = slice(int(SEEN * len(found.log["time_s"])))
    seen = signals(found.log, rows)
    told = told_the_cause(model, seen, found.hidden[0])
    if told is None:
        return None
    ours = diagnose(model, [seen]).model
    return unseen_rms(ours, found, rows.stop) / unseen_rms(told, found, rows.stop)


def told_the_cause(model: Model, log: Record, truth: Hidden) -> Model | None:
    """The model with the right cause at the right place, fitted to a log."""
    if truth.effect == "outliers":
        return model
    known = corrected(model)
    plain = Hypothesis.of(known, [log], known, WITHIN_CALIBRATION)
    right = [
        c
        for c in scan(plain, [WITHIN_CALIBRATION])
        if c.effect.name == truth.effect and in_place(c.effect, truth) is not False
    ]
    if not right:
        return None
    best = max((fit_candidate(plain, c) for c in right[:TOLD_STARTS]), key=lambda c: c.gain)
    return uncorrected(replace(known, effects=(best.effect,)), model, False)


def power_of_knowing(model: Model, found: HiddenLog) -> float:
    """Power of a test that is told all of the effect: cause, place, time, sign and size.

    At `FALSE` false alarms, under the noise and within what the calibration leaves open: the change
    that the effect makes, known to the row, is what the model's parameters, its shape within their
    covariance and the zero of the log cannot make (Neyman and Pearson 1933).
    """
    known = corrected(model)
    plain = Hypothesis.of(known, [signals(found.log)], known, WITHIN_CALIBRATION)
    size = 0.0
    for output, evidence in plain.evidence.items():
        change = evidence.groups.means([found.truth[output] - found.clean[output]])
        products = evidence.products(change[:, None], [[0]])
        projected = evidence.projected(WITHIN_CALIBRATION, products)
        null, own = projected.null, projected.own[:, 0]
        left = null.square - 2 * projected.b[:, 0] + own
        level = int(np.argmin(null.negative_log(left)))
        size += float(own[level] * null.dof / max(left[level], null.least))
    return float(norm.cdf(np.sqrt(size) + norm.ppf(FALSE)))


def unseen_rms(model: Model, found: HiddenLog, begin: int) -> float:
    """RMS over noise from row `begin` on; of a displacement, which has no zero, about its mean."""
    log = signals(found.log)
    simulated = model.simulate(Record(log.time, log.columns, digest=LOG))
    squares = []
    for output in model.outputs:
        name = output.channel
        error = (relative(log.columns[name], output.offset) - simulated[name])[begin:]
        if is_displacement(name):
            error = error - error.mean()
        squares.append(np.mean((error / found.noise[name]) ** 2))
    return float(np.sqrt(np.mean(squares)))
