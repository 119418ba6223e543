"""What a diagnosis is asked, and how far its search for causes is."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from thermaltool.diagnosis.assumptions import STARTS, Assumptions
from thermaltool.diagnosis.balance import is_slight
from thermaltool.diagnosis.correction import corrected
from thermaltool.diagnosis.effect_intervals import intervals_of
from thermaltool.diagnosis.evidence import DECISIVE_EVIDENCE
from thermaltool.diagnosis.fit import CauseCandidate
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.joint_fit import fitted_together
from thermaltool.diagnosis.limits import USUAL_LIMITS, ExperimentLimits
from thermaltool.diagnosis.long_logs import averaged_logs, rows_of
from thermaltool.diagnosis.residual_budget import misfit_of
from thermaltool.diagnosis.result import Alternative, Cause, Tried
from thermaltool.diagnosis.select import Progress
from thermaltool.diagnosis.severity import fraction_removed, moves
from thermaltool.diagnosis.simulation import Mask, without
from thermaltool.diagnosis.validate import AcceptedCause
from thermaltool.diagnosis.written import cannot_run, rezeroed, spoiled_by
from thermaltool.effects.effect import Effect
from thermaltool.model import Model
from thermaltool.record import Record

# What a model may say for itself: of other logs than the calibration's, and of its own.
WITHIN_CALIBRATION: Assumptions = frozenset({"offset", "accepted", "effects", "tight"})
RELEASED: Assumptions = frozenset({"offset", "accepted", "effects", "released"})


@dataclass(frozen=True)
class DiagnosisTask:
    """What is asked.

    Attributes
    ----------
    model : Model
    logs, validate, calibration : tuple of Record
        Diagnosed, unseen, and the calibration's.
    progress : callable
        Told what is being done.
    limits : ExperimentLimits
        What can be done at the machine.
    simulated : mapping of digest to Record
        Logs as `simulate` has them, where that is otherwise.
    readings : DiagnosisTask or None
        The same with every reading, where `logs`, `validate` and `calibration` are averages.
    sound : tuple of Record
        Unseen logs that the model as it came fits: what is wrong now was not there. They are no
        veto of a cause, but of the written model.
    """

    model: Model
    logs: tuple[Record, ...]
    validate: tuple[Record, ...]
    calibration: tuple[Record, ...]
    progress: Progress
    limits: ExperimentLimits = USUAL_LIMITS
    simulated: Mapping[str, Record] = field(default_factory=dict)
    readings: DiagnosisTask | None = None
    sound: tuple[Record, ...] = ()

    def apart(self, sound: Collection[int]) -> DiagnosisTask:
        """The task with some unseen logs as sound ones.

        Parameters
        ----------
        sound : collection of int
            Their numbers in `validate`.
        """
        rest = tuple(log for k, log in enumerate(self.validate) if k not in sound)
        chosen = tuple(log for k, log in enumerate(self.validate) if k in sound)
        readings = None if self.readings is None else self.readings.apart(sound)
        return replace(self, validate=rest, sound=chosen, readings=readings)

    def averaged(self) -> DiagnosisTask:
        """The task with averages in place of very many rows; itself where there are few."""
        groups = self.logs, self.validate, self.calibration
        if max(rows for logs in groups for rows in (1, *rows_of(logs))) == 1:
            return self
        self.progress("averaging rows")
        model, (logs, validate, calibration) = averaged_logs(self.model, groups)
        return replace(
            self,
            model=model,
            logs=logs,
            validate=validate,
            calibration=calibration,
            readings=self,
        )

    @property
    def own(self) -> bool:
        """Whether the model was calibrated on one of the logs."""
        sources = {each.get("sha256") for each in self.model.provenance.get("logs", ())}
        return any(log.digest in sources for log in self.logs)

    @cached_property
    def calibrated_misfit(self) -> dict[str, float]:
        """What the model left of its calibration beside the noise of a reading, by output.

        Empty where it was calibrated on one of the logs: they show that misfit themselves.
        """
        return (
            {}
            if self.own
            else {o.channel: misfit_of(self.model, o.channel) for o in self.model.outputs}
        )

    def explained(
        self,
        model: Model,
        effect: Effect,
        masked: Mask,
        noise: Mapping[str, float],
        assumptions: Assumptions,
    ) -> float:
        """Share of the misfit that an effect explains, on unseen logs where it acts in them.

        Parameters
        ----------
        model : Model
            With all causes.
        effect : Effect
        masked, noise
            As for `fraction_removed`.
        assumptions : frozenset of str
            Under which the search ended: whether the diagnosed logs begin at rest.
        """
        logs, unseen = (
            [log for log in each if cannot_run(model, log) is None]
            for each in (self.logs, () if effect.log else self.validate)
        )
        acting = [log for log in unseen if moves(model, effect, log, noise)]
        runs, from_rest = acting or logs, not (STARTS & assumptions or acting)
        return fraction_removed(model, effect, runs, masked, noise, from_rest)

    def first(self) -> Hypothesis:
        """The model without any cause."""
        # On the calibration's own log the error of its shape is what is to be explained.
        known = self.model if self.own else corrected(self.model)
        assumptions = RELEASED if self.own else WITHIN_CALIBRATION
        if self.own and any(o.fit.get("free_start") for o in self.model.outputs):
            assumptions |= {"initial"}
        plain = Hypothesis.of(known, self.logs, known, assumptions)
        # Commands switch at the rows unless the logs say clearly that they do not.
        between = assumptions | {"instants"}
        early = replace(plain, assumptions=between | {"earlier"})
        at_rows, later = early.evidence_of(assumptions), early.evidence_of(between)
        # A model of commands that switch at the rows has them late; what acts later is a cause.
        fitted = [e.fitted(early.assumptions, "earlier") for e in early.evidence.values()]
        if max(at_rows, later) < -DECISIVE_EVIDENCE and np.sum(fitted) > 0:
            return early
        if later - at_rows > DECISIVE_EVIDENCE:
            return replace(plain, assumptions=between)
        return plain


@dataclass(frozen=True)
class SearchState:
    """How far the search for causes is.

    Attributes
    ----------
    hypothesis : Hypothesis
        With the accepted causes.
    ended : Hypothesis
        In which the last step ended: its assumptions hold for what follows.
    unseen : tuple of Alternative
        What the logs cannot show.
    causes : tuple of Cause
    verdicts : tuple of AcceptedCause
        Those that accepted them.
    notes : tuple of str
    tried : tuple of Tried
    unconfirmed : CauseCandidate or None
        The strongest one that unseen data did not confirm.
    suspects : tuple of CauseCandidate
        What has some evidence in the end.
    exhausted : bool
        No further cause was found.
    undecided : str or None
        Why these logs cannot judge the model.
    left_out : mapping of (digest, output) to ndarray of bool
        Outliers among the readings, where the search has averages of them.
    """

    hypothesis: Hypothesis
    ended: Hypothesis
    unseen: tuple[Alternative, ...]
    causes: tuple[Cause, ...] = ()
    verdicts: tuple[AcceptedCause, ...] = ()
    notes: tuple[str, ...] = ()
    tried: tuple[Tried, ...] = ()
    unconfirmed: CauseCandidate | None = None
    suspects: tuple[CauseCandidate, ...] = ()
    exhausted: bool = False
    undecided: str | None = None
    left_out: Mask = field(default_factory=dict)

    def noted(self, note: str) -> SearchState:
        """The same with a note more.

        Parameters
        ----------
        note : str
        """
        return replace(self, notes=(*self.notes, note))

    def accepting(self, cause: Cause, after: Hypothesis, *verdict: AcceptedCause) -> SearchState:
        """The same with a cause more.

        Parameters
        ----------
        cause : Cause
        after : Hypothesis
            With it.
        *verdict : AcceptedCause
            What led there, where a candidate did.
        """
        search = self.moved_to(after)
        return replace(
            search,
            ended=after,
            causes=(*search.causes, cause),
            verdicts=(*self.verdicts, *verdict),
        )

    def without(self, *causes: Cause) -> SearchState:
        """The same without some of its causes, the others fitted anew.

        Parameters
        ----------
        *causes : Cause
        """
        model = self.hypothesis.model
        for cause in causes:
            model = without(model, cause.effect)
        kept = tuple(c for c in self.causes if not any(c is gone for gone in causes))
        search = replace(self, causes=kept)
        if model is self.hypothesis.model:
            return search
        bare = self.hypothesis.with_model(model)
        found = replace(search, hypothesis=bare).moved_to(fitted_together(bare))
        # What is left without any cause is that of a model without one.
        return found if kept else replace(found, ended=found.open())

    def moved_to(self, after: Hypothesis) -> SearchState:
        """The same with its causes as another hypothesis has them.

        Parameters
        ----------
        after : Hypothesis
            With the same effects in the same order, or some more at the end.
        """
        effects, causes = self.hypothesis.model.effects, list(self.causes)
        for k, (old, new) in enumerate(zip(effects, after.model.effects, strict=False)):
            for j, cause in enumerate(causes):
                if cause.effect == old and new != old:
                    causes[j] = replace(cause, effect=new, intervals=intervals_of(after, k))
                    break
        return replace(self, hypothesis=after, causes=tuple(causes))

    def written(self, task: DiagnosisTask) -> Model:
        """The model with the causes as a user gets it; as it came in where there are none.

        Parameters
        ----------
        task : DiagnosisTask
        """
        # Readings that are left out change nothing of the model.
        if all(cause.effect.name == "outliers" for cause in self.causes):
            return task.model
        last = self.hypothesis
        masked = last.simulation.masked
        if "released" not in last.assumptions or task.own:
            plain = [last.written(task.model).model]
        else:
            known = [log for log in task.calibration if cannot_run(last.model, log) is None]
            # What many logs have settled one log does not overturn.
            joint = last.fitted_beside(known) if known else last
            # A change of the model's own parameters that makes a log worse is left out.
            held = replace(task.model, effects=last.model.effects)
            plain = [joint.written(task.model).model, held]
        # ... and so is another zero that does.
        every = [*(rezeroed(model, task.logs, masked) for model in plain), *plain]
        # A cause may do nothing in a log without what is wrong; another parameter does.
        whole = replace(task, validate=(*task.validate, *task.sound))
        for judged in (whole, task) if task.sound else (task,):
            for model in every:
                if self.spoiled(judged, model) is None:
                    return model
        return every[0]

    def spoiled(
        self,
        task: DiagnosisTask,
        model: Model,
        before: Model | None = None,
        surely: bool = False,
    ) -> tuple[Record, str] | None:
        """Log and output of which a model is worse than another; None where it is not.

        Parameters
        ----------
        task : DiagnosisTask
        model : Model
        before : Model, optional
            The other one. Default: the model as it came.
        surely : bool
            See `spoiled_by`.
        """
        last, before = self.hypothesis, task.model if before is None else before
        logs, noise = self._compared(task, before, model)
        return spoiled_by(before, model, logs, last.simulation.masked, noise, surely)

    def harmed(
        self, task: DiagnosisTask, model: Model, before: Model | None = None
    ) -> tuple[Record, str] | None:
        """Log and output made worse by more than a slight part of what a model makes better.

        Parameters
        ----------
        task : DiagnosisTask
        model : Model
        before : Model, optional
            As in `spoiled`.
        """
        found = self.spoiled(task, model, before)
        if found is None:
            return None
        before = task.model if before is None else before
        logs, noise = self._compared(task, before, model)
        is_small = is_slight(before, model, logs, self.hypothesis.simulation.masked, noise)
        return None if is_small else found

    def _compared(
        self, task: DiagnosisTask, *models: Model
    ) -> tuple[list[Record], dict[str, float]]:
        """Logs over which all models can be run, and the noise of each output."""
        logs = [
            log
            for log in (*task.logs, *task.validate)
            if all(cannot_run(each, log) is None for each in models)
        ]
        return logs, self.noise

    @property
    def noise(self) -> dict[str, float]:
        """White noise of a reading of each output."""
        return {o: self.hypothesis.white(o) for o in self.hypothesis.groups}

    def open(self) -> Hypothesis:
        """The accepted causes under the assumptions in which the last step ended."""
        return self.hypothesis.under(self.ended.assumptions, self.ended.calibrated)


def judged_by(last: Hypothesis, task: DiagnosisTask, written: Model) -> Hypothesis:
    """The hypothesis by which what a written model leaves is judged.

    As the search had it; but where the model's own parameters were free and are written as they
    came, by what their calibration knows.

    Parameters
    ----------
    last : Hypothesis
        With the accepted causes.
    task : DiagnosisTask
    written : Model
    """
    if "released" not in last.assumptions or task.own or written.terms != task.model.terms:
        return last
    known = corrected(task.model)
    held = last.with_model(replace(known, effects=written.effects))
    assumptions = (last.assumptions - {"released"}) | {"tight"}
    return replace(held, calibrated=known, assumptions=assumptions, near={})
