"""The workbench of a diagnosis: a model on its logs, what is left over, what may explain it.

One workbench stands for one set of accepted causes; the next cause gets a new one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from thermaltool.diagnosis import prior
from thermaltool.diagnosis.correction import known_discrepancy
from thermaltool.diagnosis.evidence import OutputEvidence, State
from thermaltool.diagnosis.observed import Observed, measured_rows
from thermaltool.diagnosis.prior import Prior
from thermaltool.diagnosis.profile import Part, Reduced
from thermaltool.effects.dynamics import lagged
from thermaltool.effects.effect import Effect, Float, Scene, reference_of
from thermaltool.model import Model, driven, read_outputs, relative, respond
from thermaltool.record import Record
from thermaltool.signals.detrend import difference_sigma

Value = TypeVar("Value")
Series = list[Float]  # one array for each log
Mask = Mapping[tuple[str, str], NDArray[np.bool_]]

# A wide prior: what a parameter may be where nothing was calibrated before. Of a logarithm, and
# of a gain relative to the response's largest one.
WIDE_LOG, WIDE_GAIN = 1.0, 1.0
# The discrepancy of a clean log, of other inputs than the calibration's, is taken to be no larger
# than this many times its floor.
LIMIT = 2.0
LEAST_FLOOR = 0.5
SLOWER = 2.0
# Directions of a prior that change a whole log by less, over the noise of a reading, are left out.
UNSEEN = 0.1
# A sensor's noise may be smaller by this factor than at the calibration.
QUIETER = 0.7


def kept(method: Callable[[Workbench, str], Value]) -> Callable[[Workbench, str], Value]:
    """A property of an output, computed once: a workbench does not change."""

    @wraps(method)
    def once(self: Workbench, output: str) -> Value:
        found = self._once.setdefault(method.__name__, {})
        if output not in found:
            found[output] = method(self, output)
        return cast(Value, found[output])

    return once


@dataclass(frozen=True)
class Own:
    """A parameter of the model itself.

    Attributes
    ----------
    term : int
    name : str
    log : bool
        Counted by its logarithm.
    """

    term: int
    name: str
    log: bool


class Workbench:
    """A model with its accepted causes, simulated on every log.

    Parameters
    ----------
    model : Model
        Effects included.
    logs : sequence of Record
    calibrated : Model
        The model as its calibration knows it: the centre of the priors.
    masked : mapping of (log, output) to ndarray of bool
        Rows that are left out (outliers).
    state : frozenset of str
        Groups of nuisance in use.
    """

    def __init__(
        self,
        model: Model,
        logs: Sequence[Record],
        calibrated: Model,
        masked: Mask,
        state: State,
    ) -> None:
        self.model, self.logs = model, tuple(logs)
        self.calibrated, self.masked, self.state = calibrated, masked, state
        self.plain = [respond(model, self.acting(log), log) for log in self.logs]
        self.outputs = [
            read_outputs(self.acting(log), plain, log)
            for log, plain in zip(self.logs, self.plain, strict=True)
        ]
        self.measured = [
            {
                o.channel: relative(log.columns[o.channel], o.offset)
                for o in model.outputs
                if o.channel in log.columns
            }
            for log in self.logs
        ]
        self.observed: dict[str, Observed] = {}
        for o in model.outputs:
            seen = Observed.of(o.channel, self.logs, measured_rows(self.logs, o.channel, masked))
            if seen is not None:
                self.observed[o.channel] = seen
        self.evidence: dict[str, OutputEvidence] = {}
        self._scene: Scene | None = None
        self._once: dict[str, dict[str, Any]] = {}
        self.inputs = [driven(model, self.acting(log), log) for log in self.logs]

    def floor(self, output: str, tau: float = np.inf) -> float:
        """Discrepancy of the calibration, of time constant `tau` or faster.

        A slower one than the calibration has shown is at most a share of the white noise.
        """
        known = known_discrepancy(self.calibrated, output)
        least = LEAST_FLOOR * self.white(output)
        if not known or tau > SLOWER * known["drift_time_s"]:
            return least
        return max(float(known["drift_sigma"]), least)

    def expected(self, output: str) -> Callable[[float], float]:
        """Discrepancy of a clean log by its time constant."""
        slow, fast = self.floor(output), self.floor(output, 0.0)
        known = known_discrepancy(self.calibrated, output)
        shown = SLOWER * known["drift_time_s"] if known else 0.0
        return lambda tau: fast if tau <= shown else slow

    def acting(self, log: Record) -> list[Effect]:
        return [e for e in self.model.effects if e.log in (None, log.digest)]

    def residual(self, output: str) -> Series:
        """Measured minus simulated; NaN where not measured."""
        return [
            m[output] - y[output] if output in m else np.full(len(y[output]), np.nan)
            for m, y in zip(self.measured, self.outputs, strict=True)
        ]

    def with_effects(self, *more: Effect, model: Model | None = None) -> list[dict[str, Float]]:
        """Outputs of every log with more effects, or with another model."""
        model = model or self.model
        result = []
        inside = any(e.side in ("drive", "state") for e in more)
        for k, log in enumerate(self.logs):
            effects = [e for e in (*model.effects, *more) if e.log in (None, log.digest)]
            again = inside or model is not self.model
            plain = respond(model, effects, log) if again else self.plain[k]
            result.append(read_outputs(effects, plain, log))
        return result

    def signatures(self, effect: Effect) -> dict[str, dict[str, Series]]:
        """How each amplitude of an effect changes each output, per unit of the amplitude.

        Returns
        -------
        dict of amplitude to dict of output to list of ndarray
            Linear parameters; the amplitude ``""`` where there is none: the whole displacement.
            Outputs that do not change are left out.
        """
        linear = effect.linear()
        if not linear:
            return {"": self._changes(self.with_effects(effect), 1.0)}
        result: dict[str, dict[str, Series]] = {}
        for base in dict.fromkeys(reference_of(name)[0] for name in linear):
            neutral = effect.known[base].neutral
            others = {n: effect.parameter(n).neutral for n in linear if reference_of(n)[0] != base}
            trial = {n: neutral + 1.0 for n in linear if reference_of(n)[0] == base}
            changes = self._changes(self.with_effects(effect.changed({**others, **trial})), 1.0)
            for name in trial:
                own = reference_of(name)[1]
                reached = {o: s for o, s in changes.items() if own in (None, o)}
                if reached:
                    result[name] = reached
        return result

    def _changes(self, changed: list[dict[str, Float]], size: float) -> dict[str, Series]:
        result = {}
        for output in self.observed:
            series = [
                (new[output] - old[output]) / size
                for new, old in zip(changed, self.outputs, strict=True)
            ]
            if any(np.any(s) for s in series):
                result[output] = series
        return result

    # ------------------------------------------------------------ what the model says for itself

    def own(self, output: str) -> list[Own]:
        """The parameters of the model that an output depends on."""
        found = []
        for k, term in enumerate(self.model.terms):
            if term.output == output:
                cls = type(term.response)
                found += [Own(k, name, True) for name in cls.searched]
                found += [Own(k, name, False) for name in cls.gains]
        return found

    def moved(self, own: Sequence[Own], steps: Float) -> Model:
        """The model with parameters moved, logarithms by their steps."""
        terms = list(self.model.terms)
        for each, step in zip(own, steps.tolist(), strict=True):
            term = terms[each.term]
            value = getattr(term.response, each.name)
            value = value * np.exp(step) if each.log else value + step
            terms[each.term] = replace(term, response=replace(term.response, **{each.name: value}))  # type: ignore[type-var]
        return replace(self.model, terms=tuple(terms))

    @kept
    def sensitivities(self, output: str) -> list[Series]:
        """Change of an output per unit of each of its `own` parameters."""
        own, result = self.own(output), []
        only = replace(
            self.model,
            terms=tuple(t for t in self.model.terms if t.output == output),
            outputs=tuple(o for o in self.model.outputs if o.channel == output),
        )
        lossy = any(e.side == "state" for e in self.model.effects)
        for k, each in enumerate(own):
            scale = 1.0 if each.log else self._gain_scale(each)
            steps = np.zeros(len(own))
            steps[k] = 1e-3 * scale
            try:
                model = self.moved(own, steps)
            except ValueError:  # at the end of its range: the other way
                steps[k] = -steps[k]
                model = self.moved(own, steps)
            if lossy or any(e.side == "wiring" for e in self.model.effects):
                changed = self.with_effects(model=model)
            else:
                kept = tuple(t for t in model.terms if t.output == output)
                changed = self.with_effects(model=replace(only, terms=kept))
            result.append(
                [
                    (new[output] - old[output]) / steps[k]
                    for new, old in zip(changed, self.outputs, strict=True)
                ]
            )
        return result

    def level(self, drive: str) -> float:
        """Largest value of a drive, relative to its reference, in these logs."""
        return max(float(np.max(np.abs(each[drive]))) for each in self.inputs) or 1.0

    def _gain_scale(self, own: Own) -> float:
        response = self.model.terms[own.term].response
        gains = [abs(getattr(response, name)) for name in response.gains]
        return max(gains) or 1.0

    def prior(self, output: str, wide: bool) -> Prior:
        """What the `own` parameters and the `lags` may be, before these logs are looked at."""
        return self._wide(output) if wide else self._tight(output)

    @kept
    def _wide(self, output: str) -> Prior:
        at, size = self._moves(output)
        lags = known_discrepancy(self.calibrated, output).get("lags", ())
        # A lag at the largest drive is of the size of the noise.
        heights = np.array([self.white(output) / self.level(drive) for drive, _ in lags])
        return prior.wide(at, size, lags, heights)

    @kept
    def _tight(self, output: str) -> Prior:
        own, known = self.own(output), known_discrepancy(self.calibrated, output)
        at, size = self._moves(output)
        if not known:
            covariance = np.zeros((len(own), len(own)))
            for term in {e.term for e in own}:
                index = [k for k, e in enumerate(own) if e.term == term]
                block = self._calibrated_covariance([own[k] for k in index])
                covariance[np.ix_(index, index)] = block
        elif [tuple(n) for n in known["parameters"]] != [
            (self.model.terms[e.term].drive, e.name) for e in own
        ]:
            return self._wide(output)
        else:
            covariance = np.array(known["covariance"])
            q = len(covariance) - len(own)
            at = np.append(at, np.zeros(q))
            size = np.append(size, np.full(q, known["lag_sigma"]))
        columns = self.observed[output].whole(self.movements(output))
        return prior.visible(covariance, size, at, columns, UNSEEN * self.white(output))

    def _moves(self, output: str) -> tuple[Float, Float]:
        """How far the `own` parameters are from the calibration, and their sizes."""
        own = self.own(output)
        at = np.zeros(len(own))
        for k, each in enumerate(own):
            now = getattr(self.model.terms[each.term].response, each.name)
            was = getattr(self.calibrated.terms[each.term].response, each.name)
            at[k] = np.log(now / was) if each.log else now - was
        size = np.array([WIDE_LOG if e.log else WIDE_GAIN * self._gain_scale(e) for e in own])
        return at, size

    def _calibrated_covariance(self, own: Sequence[Own]) -> Float:
        """Of some parameters of one term, by the fit alone."""
        term = self.calibrated.terms[own[0].term]
        if term.covariance is None:
            return np.diag(
                [(WIDE_LOG if e.log else WIDE_GAIN * self._gain_scale(e)) ** 2 for e in own]
            )
        names = list(term.covariance_names)
        index = [names.index(e.name) for e in own]
        factor = np.array([1 / getattr(term.response, e.name) if e.log else 1.0 for e in own])
        return np.asarray(term.covariance)[np.ix_(index, index)] * np.outer(factor, factor)

    @kept
    def lags(self, output: str) -> list[Series]:
        """Lags of the drives, of unit height: what a response's kind leaves out of its shape."""
        holds = {d.channel: d.hold for d in self.model.drives}
        return [
            [
                lagged(log.time, each[drive], tau, holds[drive])
                for log, each in zip(self.logs, self.inputs, strict=True)
            ]
            for drive, tau in known_discrepancy(self.calibrated, output).get("lags", ())
        ]

    @kept
    def movements(self, output: str) -> Series:
        """Change of an output per unit of each of its `own` parameters and `lags`, (n, p + q)."""
        columns = [*self.sensitivities(output), *self.lags(output)]
        return [np.column_stack([c[k] for c in columns]) for k in range(len(self.logs))]

    def decays(self, output: str) -> list[Series]:
        """What a machine that was not at rest at the first row adds, per log."""
        slowest = max(t.response.slowest() for t in self.model.terms if t.output == output)
        reach = max(float(np.max(np.abs(y[output]))) for y in self.outputs)
        result = []
        for k, _ in enumerate(self.logs):
            for share in (1.0, 0.25, 0.06):
                result.append(
                    [
                        reach * np.exp(-(log.time - log.time[0]) / (share * slowest)) * (j == k)
                        for j, log in enumerate(self.logs)
                    ]
                )
        return result

    def offsets(self) -> list[Series]:
        return [
            [np.full(len(log.time), float(j == k)) for j, log in enumerate(self.logs)]
            for k, _ in enumerate(self.logs)
        ]

    @kept
    def accepted(self, output: str) -> dict[tuple[int, str], Series]:
        """Sensitivities to the parameters of the effects that the model holds already."""
        result = {}
        for at, effect in enumerate(self.model.effects):
            # The instant of an accident is found by scanning: it has no slope.
            searched = () if effect.event else effect.searched()
            for name in (*effect.linear(), *searched):
                changed = self.with_effects(model=self._nudged(at, name))
                change = self._changes(changed, self._nudge(effect, name)).get(output)
                if change is not None:
                    result[at, name] = change
        return result

    def deviations(self, at: int) -> dict[str, float]:
        """Standard errors of the parameters of an effect that the model holds."""
        names = list(self.model.effects[at].parameters)
        precision = np.zeros((len(names), len(names)))
        for output, evidence in self.evidence.items():
            base = evidence.base(self.state)
            own = [name for k, name in self.accepted(output) if k == at]
            if not own:
                continue
            places = np.flatnonzero(np.array(evidence.names)[base.active] == "accepted")
            index = places[[k for k, (e, _) in enumerate(self.accepted(output)) if e == at]]
            half = base.whitening[base.level][index]
            block = half @ half.T * base.white**2
            rows = [names.index(name) for name in own]
            size = np.sqrt(np.maximum(np.diag(block), 1e-300))
            inverse = np.linalg.pinv(block / np.outer(size, size), hermitian=True)
            precision[np.ix_(rows, rows)] += evidence.share * inverse / np.outer(size, size)
        known = np.flatnonzero(np.diag(precision) > 0)
        size = np.sqrt(np.diag(precision)[known])
        scaled = precision[np.ix_(known, known)] / np.outer(size, size)
        variance = np.diag(np.linalg.pinv(scaled, hermitian=True)) / size**2
        return {names[k]: float(np.sqrt(v)) for k, v in zip(known, variance, strict=True)}

    def _nudge(self, effect: Effect, name: str) -> float:
        value = effect.parameters[name]
        if effect.parameter(name).linear:
            return max(1e-3 * abs(value), 1e-6)
        return max(1e-2 * abs(value), 1e-6)

    def _nudged(self, at: int, name: str) -> Model:
        effects = list(self.model.effects)
        effect = effects[at]
        step = self._nudge(effect, name)
        effects[at] = effect.changed({name: effect.parameters[name] + step})
        return replace(self.model, effects=tuple(effects))

    def corrected(self, output: str) -> Series:
        """Residual without what the calibration allows for: moves of parameters, shape, offset."""
        evidence = self.evidence[output]
        base = evidence.base(self.state)
        names = np.array(evidence.names)[base.active]
        fitted = base.fitted[base.level]
        group = "released" if "released" in self.state else "tight"
        moves = self.prior(output, group == "released").root @ fitted[names == group]
        present = [k for k, rows in enumerate(self.observed[output].rows) if len(rows)]
        offsets = dict(zip(present, fitted[names == "offset"].tolist(), strict=True))
        start = fitted[names == "initial"].tolist()
        result = []
        for k, residual in enumerate(self.residual(output)):
            known = self.movements(output)[k] @ moves
            for weight, decay in zip(start, self.decays(output) if start else [], strict=True):
                known = known + weight * decay[k]
            result.append(residual - known - offsets.get(k, 0.0))
        return result

    def beginning(self, output: str) -> Series:
        """What is left of an unknown state at the first row; zero where logs begin at rest."""
        if "initial" not in self.state:
            return [np.zeros(len(log.time)) for log in self.logs]
        evidence = self.evidence[output]
        base = evidence.base(frozenset({"offset", "initial"}))
        weights = base.fitted[base.level][np.array(evidence.names)[base.active] == "initial"]
        decays = self.decays(output)
        return [
            np.asarray(sum(w * c[k] for w, c in zip(weights, decays, strict=True)))
            for k in range(len(self.logs))
        ]

    def weigh(self) -> None:
        """Prepare the evidence of every output."""
        for output in self.observed:
            self.evidence[output] = self._weigh(output)

    def _weigh(self, output: str) -> OutputEvidence:
        seen = self.observed[output]

        def matrix(columns: list[Series]) -> Float:
            if not columns:
                return np.zeros((seen.size, 0))
            return np.column_stack([seen.gather(series) for series in columns])

        own = seen.gather(self.movements(output))
        groups = {"released": self.prior(output, True)}
        if "tight" in self.state:
            groups["tight"] = self.prior(output, False)
        present = [k for k, rows in enumerate(seen.rows) if len(rows)]
        offsets = self.offsets()
        residual = seen.gather(self.residual(output))
        return OutputEvidence(
            seen,
            residual,
            {
                "offset": matrix([offsets[k] for k in present]),
                "accepted": matrix(list(self.accepted(output).values())),
                **{group: own @ prior.root for group, prior in groups.items()},
                "initial": matrix(self.decays(output)),
            },
            {group: prior.centre for group, prior in groups.items()},
            self.white(output),
            self.state,
            self.expected(output) if "tight" in self.state else None,
        )

    def white(self, output: str) -> float:
        """White noise of a reading, from the differences of neighbours.

        Not far below that of the calibration: a sensor that stands still is no quiet sensor.
        """
        residual = self.observed[output].whole(self.residual(output))
        known = known_discrepancy(self.calibrated, output).get("white_sigma", 0.0)
        least = QUIETER * float(known) if "tight" in self.state else 1e-3 * float(np.std(residual))
        return max(difference_sigma(residual), least, 1e-12)

    def reduce(
        self, found: Mapping[str, Mapping[str, Series]], state: State
    ) -> tuple[list[Part], list[str], list[str]]:
        """One candidate's parts, its amplitudes, and the outputs of the parts."""
        amplitudes = list(found)
        parts, outputs = [], []
        for output, evidence in self.evidence.items():
            here = [name for name in amplitudes if output in found[name]]
            if not here:
                continue
            block = np.column_stack(
                [evidence.observed.gather(found[name][output]) for name in here]
            )
            index = list(range(len(here)))
            reduced: Reduced = evidence.reduced(state, evidence.products(block, [index]))
            parts.append(reduced.part(index, [amplitudes.index(n) for n in here]))
            outputs.append(output)
        return parts, amplitudes, outputs

    def scene(self) -> Scene:
        """What the catalogue sees."""
        if self._scene is None:
            self._scene = self._new_scene()
        return self._scene

    def _new_scene(self) -> Scene:
        known = {d.channel for d in self.model.drives} | {o.channel for o in self.model.outputs}
        used = {c for e in self.model.effects for c in e.needs()}
        extra = [c for c in self.logs[0].columns if c not in known | used]
        extra = [c for c in extra if all(_moves(log, c) for log in self.logs)]
        return Scene(
            logs=self.logs,
            drives=tuple(d.channel for d in self.model.drives),
            outputs=tuple(self.observed),
            extra=tuple(extra),
            driven=tuple(self.inputs),
            simulated=tuple(self.outputs),
            residual=tuple(
                {o: self.residual(o)[k] for o in self.observed} for k in range(len(self.logs))
            ),
            noise={o: e.base(self.state).white for o, e in self.evidence.items()},
            slowest={
                o: max(t.response.slowest() for t in self.model.terms if t.output == o)
                for o in self.observed
            },
        )


def _moves(log: Record, channel: str) -> bool:
    values = log.columns.get(channel)
    if values is None:
        return False
    values = values[np.isfinite(values)]
    return len(values) > 0.5 * len(log.time) and float(np.ptp(values)) > 0


Progress = Callable[[str], None]
