"""Static curves in front of a linear model or behind it, fitted from logs (``correct``).

In front (Hammerstein) where the channel is a drive, behind (Wiener) where it is an output. The
dynamics are those of the model, or searched again together with the curves: then gains and offsets
are linear and projected out (Golub and Pereyra 1973), and a curve agrees with the drive at its
largest level, for a curve and a gain cannot both be free. What a first fit leaves is taken apart
into white noise and a slow drift, and the fit is repeated with these weights: a drift that counts
as white noise pulls at the slow lags. Gains have a wide prior.
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
from thermaltool.model import Drive, Model, Output, Term, driven, relative, simulate_response, taken
from thermaltool.model.curves import Form, place_of
from thermaltool.record import Record
from thermaltool.signals.agreement import Agreement, agreement
from thermaltool.signals.drift import fit_drift
from thermaltool.signals.likelihood import ColouredNoise, Factor

# Logarithms of a spline's steps against those of a straight line stay within this, and of time
# constants against where they were within that.
_WIDEST, _FARTHEST = 6.0, 2.5
# A response that is damped more is one of lags.
_MOST = {"zeta": 0.999}
# Lags to start from, as shares of the longest log.
_SPREAD = 1 / 6, 1 / 40
# Noise is taken for at least this share of an output's range.
_LEAST_NOISE = 1e-4
# Times that the noise is found again from what the fit leaves.
_AGAIN = 2


@dataclass(frozen=True)
class Corrected:
    """A model with curves, and what they are worth on the logs of the fit.

    Attributes
    ----------
    model : Model
    before, after : mapping of output to Agreement
    """

    model: Model
    before: Mapping[str, Agreement]
    after: Mapping[str, Agreement]


@dataclass(frozen=True)
class _Noise:
    """White noise, and a drift of each log, of one output.

    Attributes
    ----------
    white : float [unit of the output]
    factors : tuple of Factor
        Covariance in each log, in units of the white variance.
    offset : bool
        The zero of each log is free.
    """

    white: float
    factors: tuple[Factor, ...]
    offset: bool

    @staticmethod
    def of(output: Output, logs: Sequence[Record], errors: Sequence[Float] | None) -> _Noise:
        """From what a fit leaves in each log; white noise of the readings where there is none."""
        readings = [_measured(output, log) for log in logs]
        clocks = [log.time[np.isfinite(row)] for log, row in zip(logs, readings, strict=True)]
        white, ratio, tau = _white(readings), 0.0, 1.0
        if errors is not None:
            starts = np.cumsum([0, *(len(t) for t in clocks)])[:-1]
            try:
                found = fit_drift(np.concatenate(clocks), np.concatenate(errors), starts)
            except ValueError:
                pass  # too few, or nothing that scatters
            else:
                white = max(found.white_sigma, _least(readings))
                ratio = (found.sigma / white) ** 2 if found.time_constant else 0.0
                tau = found.time_constant or 1.0
        first = np.zeros(1, np.int64)
        factors = (ColouredNoise(time, first).factor(ratio, tau) for time in clocks)
        return _Noise(white, tuple(factors), output.offset == "first")

    def whitened(self, k: int, columns: Float) -> Float:
        """Rows of log k whose squares count: whitened, a free zero projected out."""
        rows = self.factors[k].whitened(columns) / self.white
        if self.offset:
            one = self.factors[k].whitened(np.ones((len(columns), 1)))
            one /= np.linalg.norm(one)
            rows = rows - one @ (one.T @ rows)
        return rows


class _Problem:
    """Residuals of curves, and of the dynamics where they are searched again."""

    def __init__(
        self, model: Model, logs: Sequence[Record], at: Sequence[str], form: Form, refit: bool
    ) -> None:
        self.model, self.logs, self.refit = model, logs, refit
        self.places = [place_of(model, logs, name, form, refit) for name in at]
        reached = {t.output for t in model.terms if t.drive in at} | set(at)
        self.outputs = [o for o in model.outputs if o.channel in reached]
        self.noise = {o.channel: _Noise.of(o, logs, None) for o in self.outputs}
        self.ranges = {o.channel: _range([_measured(o, log) for log in logs]) for o in self.outputs}
        self.largest = {d.channel: _largest(d, logs) for d in model.drives}
        names = [o.channel for o in self.outputs]
        self.terms = [t for t in model.terms if t.output in names] if refit else []

    def bounds(self) -> tuple[Float, Float]:
        """Of the search: a time constant beyond a third of the longest log is not in it."""
        low: list[float] = []
        high: list[float] = []
        for place in self.places:
            widest = _WIDEST if place.form.kind == "spline" else np.inf
            low += [-widest] * place.size
            high += [widest] * place.size
        longest = max(log.duration for log in self.logs)
        for term in self.terms:
            for name in term.response.searched:
                most = longest / 3 if name.startswith("tau") else _MOST.get(name, np.inf)
                high.append(min(_FARTHEST, np.log(most / getattr(term.response, name))))
                low.append(high[-1] - 2 * _FARTHEST)
        return np.array(low), np.array(high)

    def start(self) -> Float:
        """Straight curves, and the time constants as they are, within the bounds."""
        moved = sum(len(t.response.searched) for t in self.terms)
        start = np.concatenate([*(place.start() for place in self.places), np.zeros(moved)])
        low, high = self.bounds()
        return np.clip(start, low + 1e-6, high - 1e-6)

    def spread(self, start: Float) -> Float:
        """The same curves, with lags that divide the longest log among them."""
        p, at = start.copy(), sum(place.size for place in self.places)
        longest = max(log.duration for log in self.logs)
        for term in self.terms:
            names = term.response.searched
            lags = [k for k, name in enumerate(names) if name.startswith("tau")]
            for k, tau in zip(lags, np.geomspace(*_SPREAD, len(lags)) * longest, strict=True):
                p[at + k] = np.log(tau / getattr(term.response, names[k]))
            at += len(names)
        low, high = self.bounds()
        return np.clip(p, low + 1e-6, high - 1e-6)

    def _parts(self, p: Float) -> tuple[list[Curve], list[Term]]:
        """Curves, and the terms at the time constants of the vector (gains as they were)."""
        at, curves, terms = 0, [], []
        for place in self.places:
            curves.append(place.curve(p[at : at + place.size]))
            at += place.size
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
        inputs = [driven(model, [e for e in model.effects if e.log in (None, log.digest)], log)
                  for log in self.logs]  # fmt: skip
        holds = {d.channel: d.hold for d in model.drives}
        found = []
        for output in self.outputs:
            own = [t for t in terms if t.output == output.channel]
            blocks, noise = [], self.noise[output.channel]
            for k, (log, u) in enumerate(zip(self.logs, inputs, strict=True)):
                shapes = [
                    simulate_response(shape, log.time, taken(model, t, u, log), holds[t.drive])
                    for t in own
                    for shape in _shapes(t.response)
                ]
                measured = _measured(output, log)
                there = np.isfinite(measured)
                columns = np.column_stack([*shapes, measured])[there]
                blocks.append(noise.whitened(k, columns))
            rows = np.vstack(blocks)
            rows, wanted = rows[:, :-1], rows[:, -1]
            usual = np.concatenate([[self.usual(t)] * len(t.response.gains) for t in own])
            rows = np.vstack([rows, np.diag(1 / usual)])
            wanted = np.append(wanted, np.zeros(len(usual)))
            # Scaled columns: an ill-conditioned pair of lags must not decide by its size.
            scale = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
            gains = np.linalg.lstsq(rows / scale, wanted, rcond=1e-9)[0] / scale
            at = 0
            for t in own:
                names = t.response.gains
                values = dict(zip(names, gains[at : at + len(names)].tolist(), strict=True))
                at += len(names)
                found.append(Term(t.drive, t.output, _changed(t.response, values), band=t.band))
        return found

    def residuals(self, p: Float) -> Float:
        model = self.model_at(p)
        rows = [
            self.noise[output.channel].whitened(k, error[:, None])[:, 0]
            for k, output, _, error in _errors(model, self.outputs, self.logs)
        ]
        for t in model.terms if self.refit else ():
            if t.output in self.noise:
                gains = [getattr(t.response, name) for name in t.response.gains]
                rows.append(np.array(gains) / self.usual(t))
        at = 0
        for place in self.places:
            rows.append(place.roughness(p[at : at + place.size]))
            at += place.size
        return np.concatenate(rows)

    def usual(self, term: Term) -> float:
        """Prior deviation of a gain: range of the output over the largest drive.

        Lags that nearly agree can have gains of 10⁵ times that, which cancel in the logs and
        nowhere else.
        """
        return self.ranges[term.output] / self.largest[term.drive]

    def weigh(self, p: Float) -> None:
        """Take the noise from what is left at `p`."""
        left: dict[str, list[Float]] = {o.channel: [] for o in self.outputs}
        for _, output, _, error in _errors(self.model_at(p), self.outputs, self.logs):
            left[output.channel].append(error)
        self.noise = {o.channel: _Noise.of(o, self.logs, left[o.channel]) for o in self.outputs}

    def search(self, *starts: Float) -> Float:
        """The best of what each start leads to."""
        found = [
            least_squares(self.residuals, start, bounds=self.bounds(), x_scale="jac",
                          ftol=1e-6, max_nfev=40)
            for start in starts
        ]  # fmt: skip
        return np.asarray(min(found, key=lambda each: each.cost).x, float)


def judged(
    model: Model, logs: Sequence[Record], outputs: Sequence[Output] | None = None
) -> dict[str, Agreement]:
    """Agreement of every output over all logs, an arbitrary zero estimated in each."""
    measured: dict[str, list[Float]] = {}
    computed: dict[str, list[Float]] = {}
    every = model.outputs if outputs is None else outputs
    for _, output, values, error in _errors(model, every, logs):
        offset = np.mean(error) if output.offset == "first" and error.size else 0.0
        measured.setdefault(output.channel, []).append(values)
        computed.setdefault(output.channel, []).append(values - error + offset)
    return {
        name: agreement(np.concatenate(values), np.concatenate(computed[name]))
        for name, values in measured.items()
    }


def _errors(
    model: Model, outputs: Sequence[Output], logs: Sequence[Record]
) -> Iterator[tuple[int, Output, Float, Float]]:
    """(number of the log, output, measured, error) where there are readings."""
    for k, log in enumerate(logs):
        computed = model.simulate(log)
        for output in outputs:
            values = _measured(output, log)
            there = np.isfinite(values)
            yield k, output, values[there], (values - computed[output.channel])[there]


def correct(
    model: Model, logs: Sequence[Record], at: Sequence[str], form: Form, refit: bool = False
) -> Corrected:
    """The model with a static curve at each of some channels.

    Parameters
    ----------
    model : Model
    logs : sequence of Record
        With the drives, what the effects need, and the outputs.
    at : sequence of str
        Drives (in front of their responses) or outputs (behind them).
    form : Form
    refit : bool
        Search time constants and gains again, together with the curves.

    Raises
    ------
    FitError
        A channel that never moves; a polynomial that does not rise over the logs.
    ModelError
        A channel that is not in the model or has a curve, or effects beside which the dynamics
        cannot be searched.
    """
    if refit:
        _examine(model, at)
    problem = _Problem(model, logs, at, form, refit)
    starts = [problem.start()]
    if refit:
        # Curves first: time constants alone would stand for them. Dynamics that were found
        # without the curve may be far off: from spread ones, too.
        alone = _Problem(model, logs, at, form, False)
        start = _pinned(problem, alone.search(alone.start()), starts[0])
        starts = [start, problem.spread(start)]
    found = problem.search(*starts)
    # What a measured drive errs by is left over as well, and is no drift of the output.
    known = all(d.hold == "zero" for d in model.drives)
    for _ in range(_AGAIN if known else 0):
        problem.weigh(found)
        found = problem.search(found, *starts[1:])
    corrected = problem.model_at(found)
    for curve in corrected.effects[len(model.effects) :]:
        _examine_curve(curve, problem)
    after = judged(corrected, logs, problem.outputs)
    before = judged(model, logs, problem.outputs)
    return Corrected(_told(corrected, problem, after), before, after)


def _pinned(problem: _Problem, known: Float, start: Float) -> Float:
    """Curves of a first fit, scaled so that they agree with the drive at the largest level."""
    start, taken, at = start.copy(), 0, 0
    for place in problem.places:
        p = known[taken : taken + place.form.size]
        taken += place.form.size
        if place.form.kind == "spline":
            start[at : at + place.size] = np.clip(p[:-1] - p[-1], -_WIDEST / 2, _WIDEST / 2)
        elif abs(np.sum(p)) > 0.1:
            start[at : at + place.size] = p[1:] / np.sum(p)
        at += place.size
    return start


def _changed(response: Any, values: Mapping[str, float]) -> Any:
    return replace(response, **values)


def _shapes(response: Any) -> Iterator[Any]:
    """The response with one gain at 1 and the others at 0, for each."""
    for name in response.gains:
        yield _changed(response, {other: float(other == name) for other in response.gains})


def _measured(output: Output, log: Record) -> Float:
    return relative(needed(log, output.channel), output.offset)


def _least(parts: Sequence[Float]) -> float:
    """White noise that a sensor leaves in any case."""
    return _LEAST_NOISE * _range(parts)


def _range(parts: Sequence[Float]) -> float:
    """The widest of any log."""
    return max(*(float(np.nanmax(v) - np.nanmin(v)) for v in parts), 1e-300)


def _largest(drive: Drive, logs: Sequence[Record]) -> float:
    moved = (relative(needed(log, drive.channel), drive.reference) for log in logs)
    return max(*(float(np.nanmax(np.abs(u))) for u in moved), 1e-300)


def _white(parts: Sequence[Float]) -> float:
    """White noise of an output from second differences."""
    bent = np.concatenate([np.diff(values, 2) for values in parts])
    bent = bent[np.isfinite(bent)]
    white = 1.4826 * float(np.median(np.abs(bent))) / np.sqrt(6) if len(bent) else 0.0
    return max(white, _least(parts))


def _examine(model: Model, at: Sequence[str]) -> None:
    for effect in model.effects:
        if effect.side != "drive":
            raise ModelError(f"the dynamics cannot be searched beside {effect.name}")


def _examine_curve(curve: Any, problem: _Problem) -> None:
    place = next(p for p in problem.places if p.channel == curve.channel)
    values = curve.bent(np.linspace(place.low, place.high, 400))
    if np.any(np.diff(values) < 0):
        raise FitError(
            f"{curve.channel}: the polynomial does not rise over all levels of the logs: "
            "take another degree, or a spline"
        )


def _told(model: Model, problem: _Problem, after: Mapping[str, Agreement]) -> Model:
    """Ranges that the logs have widened, and how well it fits."""
    drives = []
    for drive in model.drives:
        seen = [relative(needed(log, drive.channel), drive.reference) for log in problem.logs]
        drives.append(replace(drive, range=_widened(drive.range, seen)))
    outputs = []
    for output in model.outputs:
        if output.channel in after:
            seen = [_measured(output, log) for log in problem.logs]
            judged = after[output.channel]
            fit = {"rmse": judged.rmse, "max_error": judged.max_error, "rows": judged.rows,
                   "fit_percent": judged.fit_percent, "method": "static curves"}  # fmt: skip
            output = replace(output, range=_widened(output.range, seen), fit=fit)
        outputs.append(output)
    return replace(model, drives=tuple(drives), outputs=tuple(outputs), design=None)


def _widened(span: tuple[float, float], seen: Sequence[Float]) -> tuple[float, float]:
    low, high = span
    return (
        min(low, *(float(np.nanmin(values)) for values in seen)),
        max(high, *(float(np.nanmax(values)) for values in seen)),
    )
