"""What a model gets wrong on measured logs, why, and what knowing it is worth.

Forward selection: at each step the whole catalogue is scored against what is left over, the best
few are refitted, and the strongest is accepted if its evidence is decisive after correction for the
number of causes tried, if it helps on data that its fit has not seen, and if what it explains is
not smaller than the error that the model had on its clean calibration. Backward check: what later
causes made idle is taken out again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from thermaltool.diagnosis import geometry, heldout
from thermaltool.diagnosis.answer import curves_of, reports_of
from thermaltool.diagnosis.correction import corrected, uncorrected
from thermaltool.diagnosis.evidence import DECISIVE, STRONG, State, released
from thermaltool.diagnosis.result import Alternative, Cause, Diagnosis, Gain, Tried
from thermaltool.diagnosis.scan import LEAST, Candidate, refine, scan
from thermaltool.diagnosis.settling import settled
from thermaltool.diagnosis.shortlist import (
    every_place,
    other_form,
    plain_forms_first,
    shortlist,
)
from thermaltool.diagnosis.special import find_outliers_in, short_outputs, too_short
from thermaltool.diagnosis.workbench import Mask, Progress, Workbench
from thermaltool.effects.effect import Effect
from thermaltool.errors import FitError, ModelError
from thermaltool.model import Model
from thermaltool.record import Record
from thermaltool.signals.intervals import NORMAL_95
from thermaltool.units import printed

# A cause has to explain this many times the slow discrepancy of a clean log.
PRACTICAL = 1.0
# ... or, where that is large, this share of what is wrong now.
MOST = 0.7
# Causes that are held out at each step before the search is given up.
HELD_OUT = 4
MOST_CAUSES = 6
# Turns between the model's own parameters and those of an effect.
TURNS = 2
# Share of the residual's power that noise and floor must account for in an adequate model.
ADEQUATE = 0.5

TIGHT: State = frozenset({"offset", "accepted", "tight"})
RELEASED: State = frozenset({"offset", "accepted", "released"})


def diagnose(
    model: Model,
    logs: Sequence[Record],
    validate: Sequence[Record] = (),
    progress: Progress = lambda message: None,
) -> Diagnosis:
    """Compare a model with measured logs and name what it gets wrong.

    Parameters
    ----------
    model : Model
        As calibrated. Where one of `logs` was used for that, its own parameters are free; else
        they stay within the covariance of the calibration.
    logs : sequence of Record
        Each with the model's drives, and with at least one output in one of them.
    validate : sequence of Record
        Logs on which gains are measured; without them, blocks of `logs` are held out in turn.

    Raises
    ------
    ModelError, FitError
        No output of the model in any log, a channel without values, a drive that never moves.
    """
    _check(model, logs)
    if validate:
        _check(model, validate)
    return _Diagnosing(model, tuple(logs), tuple(validate), progress).run()


def _check(model: Model, logs: Sequence[Record]) -> None:
    for log in logs:
        if len(log.time) < 20:
            raise FitError(f"{len(log.time)} rows are too few to judge a model by")
        for drive in model.drives:
            if drive.channel not in log.columns:
                raise ModelError(f"the model's drive {drive.channel} is not in the log")
            if not np.isfinite(log.columns[drive.channel]).all():
                raise ModelError(f"the model's drive {drive.channel} has missing values")
    outputs = [o.channel for o in model.outputs]
    if not any(o in log.columns for o in outputs for log in logs):
        raise ModelError(f"no output of the model in the logs: {', '.join(outputs)}")
    if any(term.band is not None for term in model.terms):
        raise ModelError("a schedule of transfer functions: diagnose its members one by one")
    for o in outputs:
        there = [log.columns[o] for log in logs if o in log.columns]
        if there and not any(np.isfinite(values).sum() >= 20 for values in there):
            raise ModelError(f"{o} has fewer than 20 values")
    if not any(np.ptp(log.columns[d.channel]) > 0 for d in model.drives for log in logs):
        names = ", ".join(d.channel for d in model.drives)
        raise FitError(f"{names} never moves: nothing to compare a response with")


class _Diagnosing:
    def __init__(
        self,
        model: Model,
        logs: tuple[Record, ...],
        validate: tuple[Record, ...],
        progress: Progress,
    ) -> None:
        self.calibrated, self.logs, self.validate, self.progress = model, logs, validate, progress
        sources = {each.get("sha256") for each in model.provenance.get("logs", ())}
        self.own = any(log.digest in sources for log in logs)
        self.state: State = RELEASED if self.own else TIGHT
        if self.own and any(o.fit.get("free_start") for o in model.outputs):
            self.state |= {"initial"}
        # On the calibration's own log the error of its shape is what is to be explained.
        self.known = model if self.own else corrected(model)
        self.masked: Mask = {}
        self.notes: list[str] = []
        self.unconfirmed: Candidate | None = None
        self.suspects: tuple[Workbench, list[Candidate]] | None = None
        self.unseen: list[Alternative] = []
        self.tried: tuple[Tried, ...] = ()
        self.rivals: list[tuple[Candidate, list[Candidate], Workbench]] = []

    def bench(self, model: Model, logs: Sequence[Record] | None = None) -> Workbench:
        return Workbench(model, logs or self.logs, self.known, self.masked, self.state)

    def ready(self, model: Model) -> Workbench:
        bench = self.bench(model)
        bench.weigh()
        return bench

    def run(self) -> Diagnosis:
        self.progress("noise")
        bench = self.ready(self.known)
        first = bench
        self.progress("what these logs cannot show")
        unseen = geometry.invisible(first, first.state)
        self.unseen = [replace(each, kind="invisible") for each in unseen]
        causes: list[Cause] = []
        spikes = find_outliers_in(bench)
        if spikes is not None:
            # They are left out from here on; whether they are a cause is told at the end.
            self.masked = spikes.masked
            bench = self.ready(self.known)
        for _ in range(MOST_CAUSES):
            found = self._next(bench, first_step=not self.tried)
            if found is None:
                break
            cause, bench = found
            causes.append(cause)
        bench = self._second_look(bench, causes)
        causes, bench = self._backward(causes, bench)
        if spikes is not None:
            self.masked = {}
            spikes = find_outliers_in(self.ready(bench.model))
        if spikes is not None and not any(g.useful for g in spikes.cause.gain.values()):
            self.masked = spikes.masked
            self.notes.append("a few readings stand out of their neighbours and are left out")
            bench = self.ready(bench.model)
        elif spikes is not None:
            at = 0 if not causes or spikes.cause.evidence > causes[0].evidence else len(causes)
            causes.insert(at, spikes.cause)
            self.masked = spikes.masked
            bench = self.ready(bench.model)
        return self._result(first, bench, causes)

    # ------------------------------------------------------------ forward

    def _states(self) -> list[State]:
        states = [self.state]
        if "initial" not in self.state:
            states.append(self.state | {"initial"})
        if "tight" in self.state:
            states.append(released(self.state))
        return states

    def _switch(self, bench: Workbench, state: State) -> float:
        """Evidence for letting the model say more for itself."""
        return 2 * sum(
            e.share * (e.base(self.state).best - e.base(state).best)
            for e in bench.evidence.values()
        )

    def _next(self, bench: Workbench, first_step: bool) -> tuple[Cause, Workbench] | None:
        while True:
            alone = {s: self._switch(bench, s) for s in self._states()}
            # What the model may say for itself counts where these logs ask for it.
            states = [s for s, evidence in alone.items() if evidence > LEAST]
            candidates = scan(bench, states, self.progress)
            places = {c.place for c in candidates}
            white = "white" in self.state
            # Where held-out levels decide, the number of trials is no matter of the evidence.
            correction = 0.0 if white else 2 * float(np.log(max(len(places), 1)))
            # What these logs cannot show they cannot confirm either.
            blind = {p for each in self.unseen for p in zip(each.names, each.channels, strict=True)}
            visible = [c for c in candidates if (c.effect.name, c.effect.channel) not in blind]
            short = shortlist(visible)
            refined = []
            for k, candidate in enumerate(short):
                self.progress(f"fitting {candidate.effect.name} ({k + 1} of {len(short)})")
                refined.append(refine(bench, candidate))
                if candidate.state != self.state:
                    # Far from its trial size a cause may need no other change of the model.
                    refined.append(refine(bench, replace(candidate, state=self.state)))
            refined = [replace(c, evidence=c.evidence - correction) for c in refined]
            refined.sort(key=lambda c: -(c.evidence - DECISIVE * (c.state != self.state)))
            if first_step:
                self.tried = every_place(bench, candidates, refined, correction, alone)
                first_step = False
            best_switch = max(states, key=lambda s: alone[s])
            top = refined[0].evidence if refined else -np.inf
            own_share = top - alone[refined[0].state] if refined else -np.inf
            if alone[best_switch] > DECISIVE and alone[best_switch] > own_share:
                newly = "released" in best_switch and "tight" in self.state
                if newly and short_outputs(self.calibrated):
                    found = self._too_short(bench, best_switch)
                    if found is not None:
                        return found
                bench = self._switched(bench, best_switch)
                continue
            least = 0.0 if white else STRONG
            decisive = [c for c in refined if c.evidence - alone[c.state] > least]
            for candidate in plain_forms_first(decisive)[:HELD_OUT]:
                found = self._accepted(bench, candidate, refined)
                if found is not None:
                    return found
            self.unconfirmed = decisive[0] if decisive else None
            self.suspects = bench, [c for c in refined if c.evidence > alone[c.state]]
            return None

    def _too_short(self, bench: Workbench, state: State) -> tuple[Cause, Workbench] | None:
        """A short calibration as the cause, where setting the parameters free helps unseen rows."""
        kept = self.state, self.known
        after = self.ready(self._settled(self._in_state(bench, state).model))
        cause = too_short(self.calibrated, bench, after)
        if cause is None:
            self.state, self.known = kept
            return None
        return cause, after

    def _switched(self, bench: Workbench, state: State) -> Workbench:
        """Let the model say more for itself: it did not begin at rest, or it has changed."""
        if "released" in state and "tight" in self.state:
            self.notes.append(
                "the model's own parameters have changed since the calibration, beyond its "
                "uncertainty: calibrate again"
            )
            return self.ready(self._settled(self._in_state(bench, state).model))
        self.notes.append("a log does not begin at rest: its start decays are fitted apart")
        return self._in_state(bench, state)

    def _settled(self, model: Model) -> Model:
        """The model's own parameters where these logs want them, if they are free at all."""
        return settled(model, self.ready) if "released" in self.state else model

    def _accepted(
        self, bench: Workbench, candidate: Candidate, refined: Sequence[Candidate]
    ) -> tuple[Cause, Workbench] | None:
        """The cause and the workbench after it, unless it is worth nothing on unseen data."""
        kept = self.state, self.known
        if candidate.state != self.state:
            bench = self._in_state(bench, candidate.state)
        try:
            found = self._tried_out(bench, candidate, refined)
        except ModelError:  # the effect runs away with the parameters that go with it
            found = None
        if found is None:
            self.state, self.known = kept
        elif "released" in self.state and "tight" in kept[0]:
            self.notes.append("the model's own parameters are free beside the cause")
        return found

    def _in_state(self, bench: Workbench, state: State) -> Workbench:
        """The workbench with another nuisance; what was calibrated goes when it is set free."""
        terms = bench.model.terms
        if "released" in state and "tight" in self.state:
            self.known, terms = self.calibrated, self.calibrated.terms
        self.state = state
        return self.ready(replace(bench.model, terms=terms))

    def _tried_out(
        self, bench: Workbench, candidate: Candidate, refined: Sequence[Candidate]
    ) -> tuple[Cause, Workbench] | None:
        self.progress(f"held-out gain of {candidate.effect.name}")
        model = replace(bench.model, effects=(*bench.model.effects, candidate.effect))
        after, candidate = self._joint(model, candidate)
        free = "released" in self.state
        before = self.ready(self._settled(bench.model)) if free else bench
        if not self._practical(bench, heldout.gains(before, after)):
            return None
        gain = self._gain(before, after)
        if self.validate and not self._practical(bench, gain):
            return None
        self.rivals.append((candidate, list(refined), bench))
        last = len(after.model.effects) - 1
        return Cause(
            candidate.effect,
            candidate.evidence,
            _intervals(after, last),
            gain,
            _explained(bench, gain),
            tuple((c.effect, c.evidence) for c in refined if other_form(c, candidate)),
        ), after

    def _joint(self, model: Model, candidate: Candidate) -> tuple[Workbench, Candidate]:
        """The model's own parameters and the last effect, in turns until they agree."""
        after = self.ready(self._settled(model))
        for _ in range(TURNS if "released" in self.state else 0):
            rest = replace(after.model, effects=after.model.effects[:-1])
            again = refine(self.ready(rest), replace(candidate, state=self.state))
            effect = again.effect
            if not np.isfinite(again.gain):
                break
            candidate = replace(candidate, effect=effect)
            after = self.ready(self._settled(replace(rest, effects=(*rest.effects, effect))))
        return after, candidate

    def _gain(self, before: Workbench, after: Workbench) -> dict[str, Gain]:
        old, new = self._simulated(before.model), self._simulated(after.model)
        if self.validate:
            return heldout.transferred(
                self.bench(old, self.validate), self.bench(new, self.validate)
            )
        return heldout.gains(before, after, (self.bench(old), self.bench(new)))

    def _simulated(self, model: Model) -> Model:
        """The model as a user gets it."""
        return uncorrected(model, self.calibrated, "released" in self.state)

    def _practical(self, bench: Workbench, gain: Mapping[str, Gain]) -> bool:
        # What helps one output and spoils another is no cause.
        if any(g.harmful for g in gain.values()):
            return False
        for output, g in gain.items():
            white = bench.evidence[output].base(self.state).white
            removed = max(g.rms_before**2 - g.rms_after**2, 0.0)
            misfit = max(g.rms_before**2 - white**2, 0.0)
            floor = bench.floor(output) if "tight" in self.state else white
            enough = min(PRACTICAL * floor, MOST * np.sqrt(misfit))
            if _helps(g) and removed >= enough**2:
                return True
        return False

    def _second_look(self, bench: Workbench, causes: list[Cause]) -> Workbench:
        """Slow causes on the calibration's own log, where a slow discrepancy explains as much.

        Without a clean calibration nothing says how large a discrepancy may be. What is left over
        is then taken for white, its rows count as few as their correlation says, and prediction
        of held-out levels decides.
        """
        if not self.own or self._misfit(bench) < 1:
            return bench
        self.state |= {"white"}
        bench = self.ready(self._settled(bench.model))
        while len(causes) < MOST_CAUSES:
            found = self._next(bench, first_step=False)
            if found is None:
                return bench
            causes.append(found[0])
            bench = found[1]
        return bench

    def _misfit(self, bench: Workbench) -> float:
        """Power of the worst output's residual over that of its noise, less one."""
        return max(
            float(np.mean(np.square(seen.whole(bench.corrected(o))))) / bench.white(o) ** 2 - 1
            for o, seen in bench.observed.items()
        )

    # ------------------------------------------------------------ backward, and the answer

    def _backward(self, causes: list[Cause], bench: Workbench) -> tuple[list[Cause], Workbench]:
        for cause in list(causes):
            acting = [e for e in bench.model.effects if e == cause.effect]
            if len(bench.model.effects) < 2 or not acting:
                continue
            rest = tuple(e for e in bench.model.effects if e != cause.effect)
            without = self.ready(replace(bench.model, effects=rest))
            again = refine(without, _as_candidate(cause.effect, self.state))
            if again.evidence < (0.0 if "white" in self.state else STRONG):
                causes.remove(cause)
                bench = without
        return causes, bench

    def _result(self, first: Workbench, last: Workbench, causes: list[Cause]) -> Diagnosis:
        plain, extended = self.bench(self.calibrated), self.bench(self._simulated(last.model))
        reports, share = reports_of(first, last, plain)
        adequate = not causes and share >= ADEQUATE
        if not causes and not adequate:
            self.notes.append("misfit found, no cause in the catalogue explains it")
        if self.unconfirmed is not None:
            self.notes.append(_unconfirmed(self.unconfirmed.effect))
        alternatives: list[Alternative] = []
        if self.suspects is not None and not causes:
            alternatives += geometry.suspected(*self.suspects)
        named = [c.effect for c in causes]
        places = [(e.name, e.channel, e.log) for e in named]
        for candidate, refined, bench in self.rivals:
            if candidate.place in places:  # not made idle by a later one
                self.progress(f"what else could be {candidate.effect.name}")
                alternatives += geometry.alternatives(bench, candidate, refined, named)
        return Diagnosis(
            adequate,
            float(np.clip(share, 0.0, 1.0)),
            reports,
            tuple(causes),
            (*alternatives, *self.unseen),
            self.tried,
            tuple(dict.fromkeys(self.notes)),
            extended.model,
            curves_of(first, last, plain, extended),
        )


def _helps(gain: Gain) -> bool:
    """Whether a gain is sure, and of practical use."""
    return gain.claimed and gain.useful


def _unconfirmed(effect: Effect) -> str:
    """Tell of the strongest cause that unseen data did not confirm."""
    told = ", ".join(
        f"{name} {effect.parameters[name]:.3g} {printed(effect.unit(name))}".rstrip()
        for name in (*effect.linear(), *effect.searched())
    )
    return (
        f"what is left looks most like {effect.name} ({effect.channel or 'no channel'}: "
        f"{told}), but rows that its fit has not seen do not confirm it"
    )


def _as_candidate(effect: Effect, state: State) -> Candidate:
    return Candidate(effect, 0.0, 0.0, state, {})


def _intervals(bench: Workbench, at: int) -> dict[str, tuple[float, float]]:
    """95 % intervals of the parameters of an effect of the model."""
    effect, result = bench.model.effects[at], {}
    for name, deviation in bench.deviations(at).items():
        known, value = effect.parameter(name), effect.parameters[name]
        low, high = value - NORMAL_95 * deviation, value + NORMAL_95 * deviation
        result[name] = (max(low, known.low), min(high, known.high))
    return result


def _explained(bench: Workbench, gain: Mapping[str, Gain]) -> float:
    """Share of the misfit above noise that is gone, the channels weighed by their noise."""
    before = after = 0.0
    for output, g in gain.items():
        white = bench.evidence[output].base(bench.state).white
        before += max((g.rms_before / white) ** 2 - 1, 0.0)
        after += max((g.rms_after / white) ** 2 - 1, 0.0)
    return float(np.clip(1 - after / before, 0.0, 1.0)) if before else 0.0
