"""Static curves in front of a linear model or behind it, fitted from records (``correct``).

In front (Hammerstein) where the channel is a drive, behind (Wiener) where it is an output. The
dynamics are those of the model, or searched again together with the curves: then gains and offsets
are linear and projected out (Golub and Pereyra 1973), and a curve agrees with the drive at its
largest level, for a curve and a gain cannot both be free. What a first fit leaves is taken apart
into white noise and a slow drift, and the fit is repeated with these weights: a drift that counts
as white noise pulls at the slow time constants. Gains have a wide prior.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from thermaltool.effects.curve import Curve
from thermaltool.effects.effect import Float, needed
from thermaltool.errors import FitError, ModelError
from thermaltool.fitting.output_noise import OutputNoise, measured, widest_range
from thermaltool.fitting.projection import linear_least_squares
from thermaltool.fitting.seen_changes import with_seen_changes
from thermaltool.model import (
    Drive,
    Model,
    Output,
    Term,
    acting_drives,
    agreements,
    relative,
    simulate_response,
    term_input,
)
from thermaltool.model.curves import Form, SearchedCurve, searched_curve
from thermaltool.model.simulate import acting_effects, dead_times
from thermaltool.record import Record
from thermaltool.signals.agreement import Agreement

# Logarithms of a spline's steps against those of a straight line stay within this.
MAX_LOG_STEP = 6.0
# Logarithms of time constants against where they were stay within this.
MAX_LOG_MOVE = 2.5
# A response that is damped more is one of real time constants.
MAX_SEARCHED = {"zeta": 0.999}
# A time constant beyond this share of the longest record is not searched.
MAX_DURATION_SHARE = 1 / 3
# Slowest and fastest time constant to start from, as shares of the longest record.
START_SHARES = 1 / 6, 1 / 40
# Times that the noise is found again from what the fit leaves.
NOISE_ROUNDS = 2
# Directions of the gains below this share of the largest, once scaled, are rounding.
MIN_DIRECTION = 1e-9
# Where a search ends: relative change of the loss, evaluations of the residuals.
LOSS_TOLERANCE, MAX_EVALUATIONS = 1e-6, 40
# Levels at which a curve has to rise.
CHECKED_LEVELS = 400


@dataclass(frozen=True)
class Corrected:
    """A model with curves, and what they are worth on the records of the fit.

    Attributes
    ----------
    model : Model
    before, after : mapping of output to Agreement
    """

    model: Model
    before: Mapping[str, Agreement]
    after: Mapping[str, Agreement]


class _CurveProblem:
    """Residuals of curves, and of the dynamics where they are searched again."""

    def __init__(
        self, model: Model, records: Sequence[Record], at: Sequence[str], form: Form, refit: bool
    ) -> None:
        self.model, self.records, self.refit = model, records, refit
        self.curves = [searched_curve(model, records, name, form, refit) for name in at]
        reached = {t.output for t in model.terms if t.drive in at} | set(at)
        self.outputs = [o for o in model.outputs if o.channel in reached]
        self.noise = {o.channel: OutputNoise.white_noise(o, records) for o in self.outputs}
        self.ranges = {
            o.channel: widest_range([measured(o, r) for r in records]) for o in self.outputs
        }
        self.largest = {d.channel: _largest(d, records) for d in model.drives}
        names = [o.channel for o in self.outputs]
        self.terms = [t for t in model.terms if t.output in names] if refit else []

    def bounds(self) -> tuple[Float, Float]:
        """Least and largest value of each searched number, each shape (p,)."""
        low: list[float] = []
        high: list[float] = []
        for curve in self.curves:
            widest = MAX_LOG_STEP if curve.form.kind == "spline" else np.inf
            low += [-widest] * curve.size
            high += [widest] * curve.size
        slowest = MAX_DURATION_SHARE * max(record.duration for record in self.records)
        for term in self.terms:
            for name in term.response.searched:
                largest = slowest if name.startswith("tau") else MAX_SEARCHED.get(name, np.inf)
                high.append(min(MAX_LOG_MOVE, np.log(largest / getattr(term.response, name))))
                low.append(high[-1] - 2 * MAX_LOG_MOVE)
        return np.array(low), np.array(high)

    def start(self) -> Float:
        """Straight curves, and the time constants as they are, within the bounds."""
        moved = sum(len(t.response.searched) for t in self.terms)
        start = np.concatenate([*(curve.start() for curve in self.curves), np.zeros(moved)])
        low, high = self.bounds()
        return np.clip(start, low + 1e-6, high - 1e-6)

    def spread(self, start: Float) -> Float:
        """The same curves, with time constants that divide the longest record among them."""
        p, at = start.copy(), sum(curve.size for curve in self.curves)
        longest = max(record.duration for record in self.records)
        for term in self.terms:
            names = term.response.searched
            own = [k for k, name in enumerate(names) if name.startswith("tau")]
            for k, tau in zip(own, np.geomspace(*START_SHARES, len(own)) * longest, strict=True):
                p[at + k] = np.log(tau / getattr(term.response, names[k]))
            at += len(names)
        low, high = self.bounds()
        return np.clip(p, low + 1e-6, high - 1e-6)

    def _parts(self, p: Float) -> tuple[list[Curve], list[Term]]:
        """Curves, and the terms at the time constants of the vector (gains as they were)."""
        at, curves, terms = 0, [], []
        for curve in self.curves:
            curves.append(curve.curve(p[at : at + curve.size]))
            at += curve.size
        for term in self.terms:
            names = term.response.searched
            factors = np.exp(p[at : at + len(names)])
            at += len(names)
            moved = {
                name: float(getattr(term.response, name) * factor)
                for name, factor in zip(names, factors, strict=True)
            }
            terms.append(replace(term, response=_changed(term.response, moved)))
        return curves, terms

    def model_at(self, p: Float) -> Model:
        """The model of a vector, with its gains."""
        curves, terms = self._parts(p)
        model = replace(self.model, effects=(*self.model.effects, *curves))
        if not self.refit:
            return model
        gained = self._gained(model, terms)
        kept = [t for t in model.terms if t not in self.terms]
        return replace(model, terms=(*kept, *gained))

    def _gained(self, model: Model, terms: Sequence[Term]) -> list[Term]:
        """Terms with the gains that fit best, offsets projected out."""
        inputs = [acting_drives(model, acting_effects(model, r.digest), r) for r in self.records]
        holds = {d.channel: d.hold for d in model.drives}
        late = [dead_times(model, acting_effects(model, r.digest)) for r in self.records]
        found = []
        for output in self.outputs:
            own = [t for t in terms if t.output == output.channel]
            blocks, noise = [], self.noise[output.channel]
            for k, (record, u) in enumerate(zip(self.records, inputs, strict=True)):
                shapes = [
                    simulate_response(
                        shape,
                        record.time,
                        term_input(model, t, u, record),
                        holds[t.drive],
                        dead_time=late[k][t.drive],
                    )
                    for t in own
                    for shape in _shapes(t.response)
                ]
                readings = measured(output, record)
                columns = np.column_stack([*shapes, readings])[np.isfinite(readings)]
                blocks.append(noise.whitened(k, columns))
            rows = np.vstack(blocks)
            rows, wanted = rows[:, :-1], rows[:, -1]
            prior = np.concatenate([[self.gain_prior(t)] * len(t.response.gains) for t in own])
            rows = np.vstack([rows, np.diag(1 / prior)])
            wanted = np.append(wanted, np.zeros(len(prior)))
            gains = linear_least_squares(rows, wanted, MIN_DIRECTION)
            at = 0
            for t in own:
                names = t.response.gains
                values = dict(zip(names, gains[at : at + len(names)].tolist(), strict=True))
                at += len(names)
                found.append(Term(t.drive, t.output, _changed(t.response, values), band=t.band))
        return found

    def residuals(self, p: Float) -> Float:
        """Whitened errors, gains and roughness over their priors: rows whose squares count."""
        model = self.model_at(p)
        rows = [
            self.noise[output.channel].whitened(k, error[:, None])[:, 0]
            for k, output, error in _errors(model, self.outputs, self.records)
        ]
        for t in model.terms if self.refit else ():
            if t.output in self.noise:
                gains = [getattr(t.response, name) for name in t.response.gains]
                rows.append(np.array(gains) / self.gain_prior(t))
        at = 0
        for curve in self.curves:
            rows.append(curve.roughness(p[at : at + curve.size]))
            at += curve.size
        return np.concatenate(rows)

    def gain_prior(self, term: Term) -> float:
        """Prior deviation of a gain: range of the output over the largest drive.

        Time constants that nearly agree can have gains of 10⁵ times that, which cancel in the
        records and nowhere else.
        """
        return self.ranges[term.output] / self.largest[term.drive]

    def weigh(self, p: Float) -> None:
        """Take the noise from what is left at `p`."""
        left: dict[str, list[Float]] = {o.channel: [] for o in self.outputs}
        for _, output, error in _errors(self.model_at(p), self.outputs, self.records):
            left[output.channel].append(error)
        self.noise = {
            o.channel: OutputNoise.of_errors(o, self.records, left[o.channel]) for o in self.outputs
        }

    def search(self, *starts: Float) -> Float:
        """The best of what each start leads to.

        By scipy's trust region: the curves have bounds, and no slopes but numerical ones.
        """
        if not np.isfinite(self.residuals(starts[0])).all():
            raise FitError("the model is too far from these logs for a curve to be found")
        found = [
            least_squares(self.residuals, start, bounds=self.bounds(), x_scale="jac",
                          ftol=LOSS_TOLERANCE, max_nfev=MAX_EVALUATIONS)
            for start in starts
        ]  # fmt: skip
        return np.asarray(min(found, key=lambda each: each.cost).x, float)


def _errors(
    model: Model, outputs: Sequence[Output], records: Sequence[Record]
) -> Iterator[tuple[int, Output, Float]]:
    """(number of the record, output, error) where there are readings, to a constant."""
    for k, record in enumerate(records):
        computed = model.simulate(record)
        for output in outputs:
            values = measured(output, record)
            there = np.isfinite(values)
            yield k, output, (values - computed[output.channel])[there]


def correct(
    model: Model, records: Sequence[Record], at: Sequence[str], form: Form, refit: bool = False
) -> Corrected:
    """The model with a static curve at each of some channels.

    Parameters
    ----------
    model : Model
    records : sequence of Record
        With the drives, what the effects need, and the outputs.
    at : sequence of str
        Drives (in front of their responses) or outputs (behind them).
    form : Form
    refit : bool
        Search time constants and gains again, together with the curves.

    Raises
    ------
    FitError
        A channel that never moves; a polynomial that does not rise over the records.
    ModelError
        A channel that is not in the model or has a curve, or effects beside which the dynamics
        cannot be searched.
    """
    if refit:
        _refuse_other_effects(model)
    problem = _CurveProblem(model, records, at, form, refit)
    starts = [problem.start()]
    if refit:
        # Curves first: time constants alone would stand for them. Dynamics that were found
        # without the curve may be far off: from spread ones, too.
        alone = _CurveProblem(model, records, at, form, False)
        start = _pinned(problem, alone.search(alone.start()), starts[0])
        starts = [start, problem.spread(start)]
    found = problem.search(*starts)
    # What a measured drive errs by is left over as well, and is no drift of the output.
    known = all(d.hold == "zero" for d in model.drives)
    for _ in range(NOISE_ROUNDS if known else 0):
        problem.weigh(found)
        found = problem.search(found, *starts[1:])
    corrected = problem.model_at(found)
    for searched, effect in zip(problem.curves, corrected.effects[-len(at) :], strict=True):
        _refuse_falling(searched, effect)
    after = agreements(corrected, records, problem.outputs)
    before = agreements(model, records, problem.outputs)
    return Corrected(_with_ranges(corrected, problem, after), before, after)


def _pinned(problem: _CurveProblem, known: Float, start: Float) -> Float:
    """Curves of a first fit, scaled so that they agree with the drive at the largest level."""
    start, taken, at = start.copy(), 0, 0
    for curve in problem.curves:
        p = known[taken : taken + curve.form.size]
        taken += curve.form.size
        if curve.form.kind == "spline":
            start[at : at + curve.size] = np.clip(
                p[:-1] - p[-1], -MAX_LOG_STEP / 2, MAX_LOG_STEP / 2
            )
        elif abs(np.sum(p)) > 0.1:
            start[at : at + curve.size] = p[1:] / np.sum(p)
        at += curve.size
    return start


def _changed(response: Any, values: Mapping[str, float]) -> Any:
    return replace(response, **values)


def _shapes(response: Any) -> Iterator[Any]:
    """The response with one gain at 1 and the others at 0, for each."""
    for name in response.gains:
        yield _changed(response, {other: float(other == name) for other in response.gains})


def _largest(drive: Drive, records: Sequence[Record]) -> float:
    """Largest distance of a drive from its reference."""
    moved = (relative(needed(r, drive.channel), drive.reference, drive.hold) for r in records)
    return max(*(float(np.nanmax(np.abs(u))) for u in moved), 1e-300)


def _refuse_other_effects(model: Model) -> None:
    for effect in model.effects:
        if effect.side != "drive":
            raise ModelError(f"the dynamics cannot be searched beside {effect.name}")


def _refuse_falling(searched: SearchedCurve, curve: Any) -> None:
    values = curve.bent(np.linspace(searched.low, searched.high, CHECKED_LEVELS))
    if np.any(np.diff(values) < 0):
        raise FitError(
            f"{searched.channel}: the polynomial does not rise over all levels of the logs: "
            "take another degree, or a spline"
        )


def _with_ranges(model: Model, problem: _CurveProblem, after: Mapping[str, Agreement]) -> Model:
    """Ranges that the records have widened, how well it fits, and where it comes from."""
    drives = []
    for drive in model.drives:
        values = [needed(r, drive.channel) for r in problem.records]
        seen = [relative(each, drive.reference, drive.hold) for each in values]
        drives.append(replace(drive, range=_widened(drive.range, seen)))
    outputs = []
    for output in model.outputs:
        if output.channel in after:
            seen = [measured(output, r) for r in problem.records]
            own = after[output.channel]
            fit = {"rmse": own.rmse, "max_error": own.max_error, "rows": own.rows,
                   "fit_percent": own.fit_percent, "method": "static curves"}  # fmt: skip
            output = replace(output, range=_widened(output.range, seen), fit=fit)
        outputs.append(output)
    sources = [record.source for record in problem.records if record.digest]
    logs = [*model.provenance.get("logs", []), *sources]
    widened = replace(model, drives=tuple(drives), outputs=tuple(outputs), design=None,
                      provenance={"logs": logs})  # fmt: skip
    return with_seen_changes(widened, problem.records)


def _widened(span: tuple[float, float], seen: Sequence[Float]) -> tuple[float, float]:
    low, high = span
    return (
        min(low, *(float(np.nanmin(values)) for values in seen)),
        max(high, *(float(np.nanmax(values)) for values in seen)),
    )
