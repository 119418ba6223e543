"""A model row by row: a state and a row in, a state and outputs out.

The same effects and responses as in `thermaltool.model.simulate`, which takes whole records;
``tests/model/test_step.py`` holds the two together for every kind of response and every effect.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.effects.effect import SIDES, STILL, Effect
from thermaltool.errors import ModelError
from thermaltool.model.rest import rest_shifts
from thermaltool.model.simulate import acting_effects, acting_terms, dead_times, state_rates
from thermaltool.record import Record
from thermaltool.responses.modes import Float
from thermaltool.responses.sample_clock import CLOCK_STEP
from thermaltool.responses.streaming import ResponseRecursion, Span, SpanDelay

if TYPE_CHECKING:
    from thermaltool.model.document import Model

Row = Mapping[str, float]
# An effect, and what it keeps of the rows before.
EffectMemory = tuple[Effect, dict[str, Any]]

# Where the integral of a varying loss [1] passes this, all that is stored is scaled anew: e^Γ
# would overflow at 700.
MAX_COOLING = 50.0


class ModelRecursion:
    """The state of a model; every row costs the same, however long the record.

    Parameters
    ----------
    model : Model
    digest : str
        Of the record: effects that are confined to one act in that one alone.
    period : float, optional [s]
        The shortest sample that comes; that of the model by default.
    outputs : iterable of str, optional
        Those that are computed; all by default.
    horizon : float [s]
        How far `ahead` looks.
    rests : mapping of channel to float, optional
        What drives count from that have no zero of their own, where it is known (`drive_rests`).
        A stream has no more than their first value.

    Attributes
    ----------
    responses : list of ResponseRecursion
        One for each term of the outputs, in the order of the model.

    Raises
    ------
    ModelError
        An effect that takes whole records alone, by name.
    """

    def __init__(
        self,
        model: Model,
        digest: str = "",
        period: float | None = None,
        outputs: Iterable[str] | None = None,
        horizon: float = 0.0,
        rests: Mapping[str, float] | None = None,
    ) -> None:
        self._model, effects = model, acting_effects(model, digest)
        for effect in effects:
            if not (effect.causal or effect.memoryless):
                raise ModelError(f"the effect {effect.name} takes whole records, not rows")
        wanted = [o.channel for o in model.outputs] if outputs is None else list(outputs)
        self.terms = tuple(t for t in acting_terms(model, effects) if t.output in wanted)
        holds = {d.channel: d.hold for d in model.drives}
        late = dead_times(model, effects)
        for drive, time in late.items():
            if time < 0 and holds[drive] == "first":
                raise ModelError(f"{drive} acts {-time:g} s before its row: no stream knows that")
        # Of every term, so that a level's share is taken before it.
        self._dead_times = [SpanDelay(round(late[t.drive] / CLOCK_STEP)) for t in self.terms]
        self.responses = [
            ResponseRecursion(
                t.response.modes(period or model.sample_period), holds[t.drive], horizon
            )
            for t in self.terms
        ]
        self._outputs, self._held = wanted, [holds[t.drive] == "zero" for t in self.terms]
        choosers = [t.band.channel for t in self.terms if t.band is not None]
        drives = [d.channel for d in model.drives]
        self._references = {
            c: (rests or {}).get(c, model.reference(c)) for c in dict.fromkeys([*drives, *choosers])
        }
        self._drives: list[tuple[str, list[EffectMemory]]] = [
            (c, [(e, {}) for e in effects if (e.side, e.channel) == ("drive", c)]) for c in drives
        ]
        self._states: list[EffectMemory] = [(e, {}) for e in effects if e.varies]
        self._readings: list[tuple[Effect, dict[str, dict[str, Any]]]] = [
            (e, {name: {} for name in wanted})
            for e in sorted(effects, key=lambda e: SIDES.index(e.side))
            if e.side not in ("drive", "state")
        ]
        self._whole_row = any(not e.memoryless for e in effects)
        self._time, self._inputs = math.nan, [0.0] * len(self.terms)
        # None until the first value is there.
        self._rests: dict[str, float | None] = {}
        self._shifts: dict[str, float] | None = None
        # Γ, the rate at which it rises, and by what factor the machine's own time goes faster.
        self._cooling, self._rate, self._pace = 0.0, 0.0, 1.0

    def start(
        self, time: float, row: Row, settled: bool = False, follows: bool = False
    ) -> dict[str, float]:
        """Outputs at the first row: at rest, or in the steady state of what acts there.

        Parameters
        ----------
        time : float [s]
        row : mapping of channel to float
            All that `Model.needs` names; NaN only beside the drives.
        settled : bool
        follows : bool
            Of what is measured alone: a machine at rest has the temperature of its surroundings.

        Returns
        -------
        dict of channel to float
            Relative to rest.

        Raises
        ------
        ModelError
            A channel is missing; settled, with a loss of heat that changes.
        """
        if settled and self._states:
            raise ModelError(f"no steady state is known with {self._states[0][0].name}")
        self._time, self._cooling, self._rate, self._pace = time, 0.0, 0.0, 1.0
        for memory in self._memories():
            memory.clear()
        self._rests = {c: None if r == "first" else r for c, r in self._references.items()}
        self._shifts = None
        record = self._record_of(time, row)
        self._inputs = [float(u) for u in self._acting(row, record)]
        for k, (response, u) in enumerate(zip(self.responses, self._inputs, strict=True)):
            stood = u if settled or (follows and not self._held[k]) else 0.0
            response.start(stood, u)
            self._dead_times[k].start(stood)
            if (early := -self._dead_times[k].ticks) > 0:
                response.advance(early, u, u)
        return self._read(record)

    def step(self, time: float, row: Row) -> dict[str, float]:
        """Outputs at the next row; see `start`.

        Parameters
        ----------
        time : float [s]
            After that of the last row.
        row : mapping of channel to float

        Raises
        ------
        ModelError
            The time does not rise; a channel is missing; the loss of heat is not finite.
        """
        ticks = round((time - self._time) / CLOCK_STEP)
        if ticks <= 0:
            raise ModelError(f"time {time:.15g} s does not come after {self._time:.15g} s")
        record = self._record_of(time, row)
        inputs = [float(u) for u in self._acting(row, record)]
        if self._states:
            self._advance_changed(ticks, inputs, self._rate * (time - self._time))
        else:
            for k, response in enumerate(self.responses):
                for part in self._acting_parts(k, ticks, inputs[k]):
                    response.advance(*part)
        self._time, self._inputs = time, inputs
        return self._read(record)

    def _acting_parts(self, k: int, ticks: int, now: float) -> list[Span]:
        """What acts on a response in the sample that ends: its input, by the dead time later."""
        dead_time = self._dead_times[k]
        if not dead_time.ticks:
            return [(ticks, self._inputs[k], now)]
        end = self._inputs[k] if self._held[k] and dead_time.ticks > 0 else now
        return dead_time.advance([(ticks, self._inputs[k], end)])

    def _advance_changed(self, ticks: int, inputs: list[float], rise: float) -> None:
        """As `simulate_response`: modes of e^Γ u in the machine's own time, times e^(−Γ)."""
        if not abs(rise) < MAX_COOLING:
            raise ModelError("the loss of heat changes too much in a sample to be followed")
        if abs(self._cooling) > MAX_COOLING:
            for response in self.responses:
                response.scale(math.exp(-self._cooling))
            self._cooling = 0.0
        for k, response in enumerate(self.responses):
            done = 0
            for length, start, end in self._acting_parts(k, ticks, inputs[k]):
                first = self._cooling + rise * done / ticks
                done += length
                last = self._cooling + rise * done / ticks
                # A held drive acts, on the mean, half a sample later than its first moment.
                at = (first + last) / 2 if self._held[k] else first
                own = max(round(length * self._pace), 1)
                response.advance(own, start * math.exp(at), end * math.exp(last))
        self._cooling += rise

    def amend(self, row: Row) -> None:
        """Take `row` for what has acted since the last one, in place of that one.

        For drives that are set, and whose value is known when their time is over.

        Parameters
        ----------
        row : mapping of channel to float

        Raises
        ------
        ModelError
            An effect on a drive that looks at more than the value of the moment.
        """
        self._inputs = [float(u) for u in self._acting(row, None)]

    def now(self) -> dict[str, float]:
        """Sums of the terms of every output, before sources and sensors, relative to rest."""
        decayed = math.exp(-self._cooling) if self._states else 1.0
        sums = dict(self._at_rest())
        for term, response in zip(self.terms, self.responses, strict=True):
            sums[term.output] += decayed * response.now()
        return sums

    def ahead(self, row: Mapping[str, float | Float]) -> dict[str, Float]:
        """Sums of the terms at the horizon where the drives stay from now on as in `row`.

        Parameters
        ----------
        row : mapping of channel to float or ndarray, shape (k,)
            One value, or one for each of several futures.

        Raises
        ------
        ModelError
            As `amend`; a loss of heat that changes.
        """
        if self._states:
            raise ModelError(f"nothing is foretold with {self._states[0][0].name}")
        sums = {name: np.asarray(shift) for name, shift in self._at_rest().items()}
        for term, response, u in zip(
            self.terms, self.responses, self._acting(row, None), strict=True
        ):
            sums[term.output] = sums[term.output] + response.ahead(np.asarray(u))
        return sums

    def _at_rest(self) -> dict[str, float]:
        """What every output is at rest, as far as first values of drives are known."""
        if self._shifts is not None:
            return self._shifts
        known = {c: rest for c, rest in self._rests.items() if rest is not None}
        found = rest_shifts(self._model, known)
        shifts = {name: found.get(name, 0.0) for name in self._outputs}
        if len(known) == len(self._rests):
            self._shifts = shifts
        return shifts

    def _record_of(self, time: float, row: Row) -> Record:
        """The row as the effects read it."""
        if not self._whole_row:
            return STILL
        return Record(np.array([time]), {name: np.array([row[name]], float) for name in row})

    def _relative(self, channel: str, row: Mapping[str, Any]) -> Any:
        """A channel of a row minus its rest, which may be its first value that is there."""
        try:
            value, rest = row[channel], self._rests[channel]
        except KeyError:
            raise ModelError(f"the model reads {channel}, which is not in the row") from None
        if rest is None:
            if not math.isfinite(value):
                return math.nan
            rest = self._rests[channel] = float(value)
        return value - rest

    def _acting(self, row: Mapping[str, Any], record: Record | None) -> list[Any]:
        """What every term takes of a row, of one value or several a channel.

        Without `record` the row is one that may come, and no effect remembers it.
        """
        drives = {}
        for channel, effects in self._drives:
            u = self._relative(channel, row)
            for effect, memory in effects:
                if effect.memoryless:
                    u = effect.drive(STILL, np.asarray(u, float))
                elif record is None:
                    raise ModelError(f"nothing is foretold with the effect {effect.name}")
                else:
                    u = effect.drive(record, np.array([u], float), memory)[0]
            drives[channel] = u
        return self._taken(drives, row)

    def _taken(self, drives: Mapping[str, Any], row: Mapping[str, Any]) -> list[Any]:
        """Of each drive all, or the share of a level."""
        return [
            drives[t.drive]
            if t.band is None
            else drives[t.drive] * t.band.share(self._relative(t.band.channel, row))
            for t in self.terms
        ]

    def _read(self, record: Record) -> dict[str, float]:
        """The outputs of the moment; loss and pace until the next row follow from them."""
        sums = self.now()
        if not self._states and not self._readings:
            return sums
        outputs = {name: np.array([value]) for name, value in sums.items()}
        if self._states:
            rate, pace = state_rates(self._states, record, outputs)
            self._rate, self._pace = float(rate[0]), float(pace[0])
        for effect, memories in self._readings:
            outputs = {
                name: effect.output(name, outputs, record, memories[name]) for name in outputs
            }
        return {name: float(values[0]) for name, values in outputs.items()}

    def _memories(self) -> list[dict[str, Any]]:
        """Of all effects, in one order."""
        drives = [memory for _, effects in self._drives for _, memory in effects]
        readings = [m for _, memories in self._readings for m in memories.values()]
        return [*drives, *(memory for _, memory in self._states), *readings]

    def state(self) -> dict[str, Any]:
        """For `resume`, as JSON."""
        memories = [_snapshot(memory) for memory in self._memories()]
        return {
            "time_s": self._time,
            "inputs": self._inputs,
            "cooling": [self._cooling, self._rate, self._pace],
            "rests": self._rests,
            "responses": [response.state() for response in self.responses],
            "dead_times": [dead_time.state() for dead_time in self._dead_times],
            "effects": memories,
        }

    def resume(self, state: Mapping[str, Any]) -> None:
        """Go on from `state`; raises KeyError, TypeError or ValueError where it is none."""
        self._time, self._inputs = float(state["time_s"]), [float(u) for u in state["inputs"]]
        self._cooling, self._rate, self._pace = (float(v) for v in state["cooling"])
        rests = {c: state["rests"][c] for c in self._references}
        self._rests = {c: None if rest is None else float(rest) for c, rest in rests.items()}
        self._shifts = None
        for response, kept in zip(self.responses, state["responses"], strict=True):
            response.resume(kept)
        for dead_time, kept in zip(self._dead_times, state["dead_times"], strict=True):
            dead_time.resume(kept)
        for memory, kept in zip(self._memories(), state["effects"], strict=True):
            memory.clear()
            memory.update(_snapshot(kept))


def _snapshot(memory: Mapping[str, Any]) -> dict[str, Any]:
    """What an effect keeps, as JSON that later rows do not change."""
    return {
        name: _snapshot(kept) if isinstance(kept, Mapping) else np.asarray(kept).tolist()
        for name, kept in memory.items()
    }
