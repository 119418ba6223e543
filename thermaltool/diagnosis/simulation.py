"""A model simulated on logs beside what they measured: residuals, and what a cause would change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermaltool.diagnosis.correction import is_bank
from thermaltool.diagnosis.slopes import ModelSlopes
from thermaltool.effects.effect import Effect, Float, Outputs, reference_of
from thermaltool.effects.scene import Scene
from thermaltool.errors import ModelError
from thermaltool.model import (
    Model,
    StartedOutput,
    acting_drives,
    read_outputs,
    started_outputs,
    sum_terms,
    with_acting_terms,
    zero_of,
)
from thermaltool.model.decays import slow_bodies
from thermaltool.model.simulate import acting_effects, dead_times
from thermaltool.model.span import spans
from thermaltool.record import Record
from thermaltool.signals.row_groups import RowGroups

Series = list[Float]  # one array for each log
Changes = Mapping[str, Series]  # of each output
Mask = Mapping[tuple[str, str], NDArray[np.bool_]]  # of (digest of a log, output)

# A channel offers a place to a cause where more than this share of its rows has a value.
MIN_SHARE_MEASURED = 0.5
# An amplitude whose slope is taken moves some output by such a share of what it goes through.
MIN_SLOPE, MAX_SLOPE = 1e-3, 0.3
# A small move of what is not linear in a cause, relative.
RELATIVE_MOVE = 0.02


def without(model: Model, effect: Effect) -> Model:
    """A model without one of its effects; itself where it does not have it.

    Parameters
    ----------
    model : Model
    effect : Effect
    """
    rest = tuple(e for e in model.effects if e != effect)
    return model if len(rest) == len(model.effects) else replace(model, effects=rest)


@dataclass(frozen=True, eq=False)
class SimulatedLogs:
    """A model with its accepted causes, simulated on every log.

    Attributes
    ----------
    model : Model
        Effects included.
    logs : tuple of Record
    masked : mapping of (digest, output) to ndarray of bool
        Rows that are left out (outliers).
    """

    model: Model
    logs: tuple[Record, ...]
    masked: Mask

    @cached_property
    def inputs(self) -> list[dict[str, Float]]:
        """What acts in place of every drive in each log, relative to its reference."""
        return [
            acting_drives(self.model, acting_effects(self.model, log.digest), log)
            for log in self.logs
        ]

    @property
    def dead_times(self) -> list[dict[str, float]]:
        """Time by which every drive acts later than it is logged, in each log [s]."""
        return [dead_times(self.model, acting_effects(self.model, log.digest)) for log in self.logs]

    @cached_property
    def responses(self) -> list[dict[str, Float]]:
        """Sums of the terms in each log, before what reads them."""
        model = self.model
        return [sum_terms(model, acting_effects(model, log.digest), log) for log in self.logs]

    @cached_property
    def outputs(self) -> list[dict[str, Float]]:
        """Outputs of each log, relative to rest."""
        return self._read(self.model)

    def _read(self, model: Model) -> list[dict[str, Float]]:
        """What the effects of a model make of the responses that are there."""
        return [
            read_outputs(acting_effects(model, log.digest), response, log)
            for log, response in zip(self.logs, self.responses, strict=True)
        ]

    @cached_property
    def measured(self) -> list[dict[str, Float]]:
        """Outputs of each log as measured, relative to rest."""
        return [
            {
                o.channel: log.columns[o.channel]
                - zero_of(log.time, log.columns[o.channel], simulated[o.channel], o.offset).value
                for o in self.model.outputs
                if o.channel in log.columns
            }
            for log, simulated in zip(self.logs, self.outputs, strict=True)
        ]

    @cached_property
    def groups(self) -> dict[str, RowGroups]:
        """Rows that count, of every output that is judged and has some."""
        found = {}
        for o in self.model.outputs:
            if not o.judged:
                continue
            groups = RowGroups.of(self.logs, [self._usable(log, o.channel) for log in self.logs])
            if groups is not None:
                found[o.channel] = groups
        return found

    def _usable(self, log: Record, output: str) -> NDArray[np.bool_]:
        """Rows in which an output is measured and not masked."""
        if output not in log.columns:
            return np.zeros(len(log), bool)
        measured = np.isfinite(log.columns[output])
        return measured & ~self.masked.get((log.digest, output), np.zeros(len(log), bool))

    def measured_rows(self, output: str) -> Float:
        """An output as measured, relative to rest, in the rows that count, shape (n,).

        Parameters
        ----------
        output : str
        """
        return self.groups[output].joined([m.get(output, np.zeros(0)) for m in self.measured])

    def residual(self, output: str) -> Series:
        """Measured minus simulated in each log; NaN where not measured."""
        return [
            m[output] - y[output] if output in m else np.full(len(y[output]), np.nan)
            for m, y in zip(self.measured, self.outputs, strict=True)
        ]

    @cached_property
    def started(self) -> list[dict[str, StartedOutput]]:
        """Measured outputs of each log as `simulate` runs them, in the state in which it begins."""
        return [
            started_outputs(self.model, log, outputs)
            for log, outputs in zip(self.logs, self.outputs, strict=True)
        ]

    def as_simulated(self, output: str) -> list[tuple[Float, Float]]:
        """An output as measured and as `simulate` has it, for each log; NaN where not measured.

        Parameters
        ----------
        output : str
        """
        nothing = [np.full(len(log.time), np.nan) for log in self.logs]
        return [
            (log.columns[output] - own[output].zero.value, own[output].computed)
            if output in own
            else (none, none)
            for log, own, none in zip(self.logs, self.started, nothing, strict=True)
        ]

    @property
    def warm_logs(self) -> tuple[int, ...]:
        """Numbers of the logs that begin away from rest, as `simulate` has it."""
        return tuple(
            k
            for k, own in enumerate(self.started)
            if any(each.initial == "free" for each in own.values())
        )

    def with_effects(self, *more: Effect, model: Model | None = None) -> list[dict[str, Float]]:
        """Outputs of every log with more effects, or with another model.

        What acts behind the responses alone takes those that are there.

        Parameters
        ----------
        *more : Effect
        model : Model, optional
        """
        own = model or self.model
        changed = replace(own, effects=(*own.effects, *more))
        if self._responds_otherwise(changed):
            runs = []
            for log, near in zip(self.logs, self.responses, strict=True):
                effects = acting_effects(changed, log.digest)
                sums = sum_terms(changed, effects, log, near)
                runs.append(read_outputs(effects, sums, log))
            return runs
        return self._read(changed)

    def _responds_otherwise(self, model: Model) -> bool:
        """Whether another model has other sums of its terms."""
        own = self.model
        same = model.drives is own.drives and model.outputs is own.outputs
        same &= [id(term) for term in model.terms] == [id(term) for term in own.terms]
        before, after = (
            [e for e in each.effects if e.side in ("drive", "state")] for each in (own, model)
        )
        return not same or before != after

    @cached_property
    def slopes(self) -> ModelSlopes:
        """What small moves of the model change."""
        return ModelSlopes(self)

    def change(
        self, changed: Sequence[Outputs], bare: Sequence[Outputs] | None = None
    ) -> dict[str, Series]:
        """What changed outputs differ by from those of the model; unchanged ones are left out.

        Parameters
        ----------
        changed : sequence of mapping of output to ndarray, one for each log
        bare : likewise, optional
            In place of the model's.
        """
        result = {}
        for output in self.groups:
            series = [
                new[output] - old[output]
                for new, old in zip(changed, bare or self.outputs, strict=True)
            ]
            if any(np.any(s) for s in series):
                result[output] = series
        return result

    def displacement(self, effect: Effect) -> dict[str, Series]:
        """Change of every output by a cause as it stands.

        Parameters
        ----------
        effect : Effect
        """
        return self.change(self.with_effects(effect))

    def signatures(self, effect: Effect) -> dict[str, dict[str, Series]]:
        """How each amplitude of an effect changes each output, per unit of the amplitude.

        Parameters
        ----------
        effect : Effect
            At a trial size.

        Returns
        -------
        dict of amplitude to dict of output to list of ndarray
            Linear parameters; the amplitude ``""`` where there is none: the whole displacement, and
            where the cause stands without them. Outputs that do not change are left out.
        """
        linear = effect.linear()
        if not linear:
            return {"": self.displacement(effect)}
        result: dict[str, dict[str, Series]] = {}
        neutral = {name: effect.parameter(name).neutral for name in linear}
        bare = self.outputs
        if effect.stands:
            bare = self.with_effects(effect.changed(neutral))
            result[""] = self.change(bare)
        for base in dict.fromkeys(reference_of(name)[0] for name in linear):
            mine = [n for n in linear if reference_of(n)[0] == base]
            changes = self._slope(effect.changed(neutral), mine, effect.known[base].neutral, bare)
            for name in mine:
                own = reference_of(name)[1]
                if reached := {o: s for o, s in changes.items() if own in (None, o)}:
                    result[name] = reached
        return result

    def _slope(
        self, effect: Effect, names: Sequence[str], neutral: float, bare: Sequence[Outputs]
    ) -> Changes:
        """Change of every output by amplitudes of an effect, per unit of them, from `bare`."""

        def by(amplitude: float) -> dict[str, Series]:
            moved = effect.changed(dict.fromkeys(names, neutral + amplitude))
            return self.change(self.with_effects(moved), bare)

        found = by(1.0)
        if not self.model.effects:
            return found
        # What bends behind it follows an amplitude of no machine elsewhere: a unit is one of many.
        shares = [
            float(np.nanmax(np.abs(self.groups[o].joined(series)))) / size
            for o, series in found.items()
            if (size := float(np.ptp(self.measured_rows(o)))) > 0
        ]
        largest = max(shares, default=0.0)
        if not np.isfinite(largest) or MIN_SLOPE < largest < MAX_SLOPE or largest == 0:
            return found
        amplitude = np.sqrt(MIN_SLOPE * MAX_SLOPE) / largest
        return {o: [each / amplitude for each in s] for o, s in by(amplitude).items()}

    def span(self, effect: Effect) -> dict[str, dict[str, Series]]:
        """Changes by each amplitude of a cause, and by a small move of what is not linear in it.

        Parameters
        ----------
        effect : Effect

        Returns
        -------
        dict of amplitude or parameter to dict of output to list of ndarray
        """
        # What stands is what it is; its amplitudes alone are no cause.
        found = {"": self.displacement(effect)} if effect.stands else self.signatures(effect)
        # An instant that was found by scanning has no slope.
        searched = () if effect.event else effect.searched()
        if (effect.linear() and searched) or len(searched) > 1:
            here = self.with_effects(effect)
            for name in searched:
                known, value = effect.parameter(name), effect.parameters[name]
                step = RELATIVE_MOVE * (
                    abs(value) if known.log else abs(value - known.neutral) or 1.0
                )
                # A loss at its bound may be too strong to be followed beyond it.
                for move in (step, -step) if value + step <= known.high else (-step,):
                    try:
                        there = self.with_effects(effect.changed({name: value + move}))
                    except ModelError:
                        continue
                    found[name] = {
                        o: [(t[o] - h[o]) / move for t, h in zip(there, here, strict=True)]
                        for o in self.groups
                    }
                    break
        return found

    def duration_of(self, effect: Effect) -> float:
        """Length of the log in which an effect acts, the longest where it acts in all [s]."""
        own = [log.duration for log in self.logs if effect.log in (None, log.digest)]
        return max(own, default=0.0)

    def level(self, drive: str) -> float:
        """Largest value of a drive in these logs, relative to its reference; 1 where it rests."""
        return max(float(np.max(np.abs(each[drive]))) for each in self.inputs) or 1.0

    def slowest(self, output: str) -> float:
        """Slowest time constant of the terms of an output [s]."""
        return max(t.response.slowest() for t in self.model.terms if t.output == output)

    def scene(self, noise: Mapping[str, float], residuals: Mapping[str, Series]) -> Scene:
        """What the catalogue of causes sees.

        Parameters
        ----------
        noise : mapping of output to float
            White noise of a reading.
        residuals : mapping of output to list of ndarray
            What is to be explained.
        """
        known = {d.channel for d in self.model.drives} | {o.channel for o in self.model.outputs}
        used = {c for e in self.model.effects for c in e.needs()}
        beside = [c for c in self.logs[0].columns if c not in known | used]
        own = [t for t in self.model.terms if not is_bank(t)]
        answered = {(term.drive, term.output) for term in own}
        now = with_acting_terms(replace(self.model, terms=tuple(own)))
        unanswered = {
            d.channel: tuple(o for o in self.groups if (d.channel, o) not in answered)
            for d in self.model.drives
            if d.channel not in used and all(_moves(log, d.channel) for log in self.logs)
        }
        return Scene(
            logs=self.logs,
            drives=tuple(d.channel for d in self.model.drives),
            outputs=tuple(self.groups),
            extra=tuple(c for c in beside if all(_moves(log, c) for log in self.logs)),
            unanswered={drive: outputs for drive, outputs in unanswered.items() if outputs},
            spans=spans(self.model),
            acting_drives=tuple(self.inputs),
            simulated=tuple(self.outputs),
            residual=tuple(
                {o: residuals[o][k] for o in self.groups} for k in range(len(self.logs))
            ),
            noise=noise,
            slowest={o: self.slowest(o) for o in self.groups},
            bodies=slow_bodies(now.terms, self.groups, now.sample_period),
        )


def _moves(log: Record, channel: str) -> bool:
    """Whether a channel has values enough, and changes."""
    values = log.columns.get(channel)
    if values is None:
        return False
    values = values[np.isfinite(values)]
    return len(values) > MIN_SHARE_MEASURED * len(log.time) and float(np.ptp(values)) > 0
