"""From logs to identified models of every output, whatever their form.

Split, state at the start, choice of the orders or fit, validation, tests of the residuals, terms in
continuous time: a `Plan` says what is fitted, the sequence is the same for all.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, ClassVar

from thermaltool.errors import DataError, FitError, ModelError
from thermaltool.fitting.between_rows import BetweenRows, find_between_rows
from thermaltool.fitting.data import Split, TrainingData, even_training_data, training_data
from thermaltool.fitting.document import model_document
from thermaltool.fitting.fit import ChosenOver, Fit
from thermaltool.fitting.linearity import linearity_test
from thermaltool.fitting.missing_inputs import with_missing_inputs
from thermaltool.fitting.output_model import ContinuousTerm, OutputModel
from thermaltool.fitting.residuals import residual_tests
from thermaltool.fitting.rivals import HeldFit, held_fit, joined_fits
from thermaltool.fitting.search_budget import SearchBudget
from thermaltool.fitting.selection import Candidate, Ranked
from thermaltool.fitting.start_state import Initial
from thermaltool.fitting.validation import Span, validate, validate_on
from thermaltool.model import Model
from thermaltool.record import Record
from thermaltool.units import Reference


@dataclass(frozen=True, kw_only=True)
class Plan(ABC):
    """What is to be fitted.

    Attributes
    ----------
    joint : bool
        One fit for all outputs, or one for each.
    initial : {"auto", "rest", "free"}
        State at the first row.
    split : float or None
        Share of the rows that are fitted; the rest validates.
    span : (float or None, float or None) [s]
        The stretch of every log that is fitted and judged; its other rows drive what is simulated.
    budget : SearchBudget
        How long the search for orders and modes may take.
    swings : bool
        Whether it admits oscillations where heat alone acts: blocks held out have to agree.
    """

    joint: ClassVar[bool] = False

    initial: Initial = "auto"
    split: float | None = None
    span: Span = (None, None)
    budget: SearchBudget = field(default_factory=SearchBudget)
    swings: bool = False

    @property
    def label(self) -> str:
        """What its structure is called beside others."""
        return ""

    @property
    def tells_instants(self) -> bool:
        """Whether feedthrough is chosen, which inputs look like that switch between the rows."""
        return True

    @abstractmethod
    def start(self, data: TrainingData) -> TrainingData:
        """The data with what is known of the state at their first rows."""

    @abstractmethod
    def fit(self, data: TrainingData) -> tuple[Sequence[OutputModel], tuple[Candidate[Any], ...]]:
        """A model for each output, and the candidates where the orders were chosen."""

    def beyond(self, fits: Sequence[Fit], reference: Reference | None) -> Sequence[Plan]:
        """What is tried where the fits leave something: taken where blocks held out say so.

        Parameters
        ----------
        fits : sequence of Fit
        reference : "first", float or None
            As for `identify`.
        """
        return ()

    def refitted(self, models: Sequence[OutputModel], data: TrainingData) -> Ranked:
        """What was chosen, fitted to other rows of the same data set.

        Parameters
        ----------
        models : sequence of OutputModel
            Of one data set, as `fit` gives them.
        data : TrainingData

        Raises
        ------
        FitError
            The rows do not carry it.
        """
        raise FitError("it has no rivals")

    def data_sets(
        self, logs: Sequence[Record], inputs: Sequence[str], outputs: Sequence[str]
    ) -> list[TrainingData]:
        """What is fitted together: all outputs on their own clocks, or each on an even one."""
        if self.joint:
            return [training_data(logs, inputs, outputs)]
        return [even_training_data(logs, inputs, (output,)) for output in outputs]


def identify(
    logs: Sequence[Record],
    inputs: Sequence[str],
    outputs: Sequence[str],
    plan: Plan,
    fresh: Sequence[Record] = (),
    reference: Reference | None = None,
    as_read: Sequence[Record] = (),
) -> tuple[Fit, ...]:
    """A fitted and judged model for each output.

    Parameters
    ----------
    logs : sequence of Record
        Each an experiment with an offset of its own.
    inputs, outputs : sequence of str
        Channels that drive, and that follow.
    plan : Plan
    fresh : sequence of Record
        Validation data; without them those of the plan's split, if any.
    reference : "first", float or None
        What counts as no input in the model document, as which the models are validated.
    as_read : sequence of Record, optional
        The logs, and those of `fresh` behind them, with every reading, as ``simulate`` runs them.
        Default: as they are fitted.

    Raises
    ------
    FitError
        Data that the plan's form does not fit, or that are too few to validate.
    """
    as_read = as_read or (*logs, *fresh)
    logs = with_missing_inputs(logs, inputs, outputs, plan.span, plan.split)
    between = _between_rows(logs, inputs, outputs, plan)
    first = _planned(logs, inputs, outputs, plan, fresh, reference, as_read, between)
    best = first = first.with_linearity()
    for rival in plan.beyond(first.fits, reference):
        if plan.budget.is_over:
            break
        try:
            other = _planned(logs, inputs, outputs, rival, fresh, reference, as_read, between)
            if other.held.beats(best.held, rival.swings and not best.plan.swings):
                best = other
        except FitError:
            continue
        except KeyboardInterrupt:
            # There are models.
            plan.budget.interrupt()
            break
    if best is first:
        return first.fits
    best = best.with_linearity()
    pairs = zip(best.held.fit_percent, first.held.fit_percent, strict=True)
    chosen = [ChosenOver(best.plan.label, own, plan.label, other) for own, other in pairs]
    # What was said of the linear models is why there are others.
    linear = all(fit.model.is_linear for fit in best.fits)
    return tuple(
        replace(fit, chosen_over=over, linearity=(fit if linear else before).linearity)
        for fit, before, over in zip(best.fits, first.fits, chosen, strict=True)
    )


def identify_first(
    logs: Sequence[Record],
    inputs: Sequence[str],
    outputs: Sequence[str],
    plans: Sequence[Plan],
    fresh: Sequence[Record] = (),
    reference: Reference | None = None,
    as_read: Sequence[Record] = (),
    warn: Callable[[str], None] = lambda message: None,
) -> tuple[Fit, ...]:
    """Models by the first of the plans that fits these data.

    Where the data are at fault, no other is tried.

    Parameters
    ----------
    logs, inputs, outputs, fresh, reference, as_read
        As `identify`.
    plans : sequence of Plan
    warn : callable
        Takes a sentence on what stands in for a plan that does not fit, and why.

    Raises
    ------
    FitError
        None does; the message is that of the first.
    """
    problem: FitError | None = None
    for plan in plans:
        try:
            fits = identify(logs, inputs, outputs, plan, fresh, reference, as_read)
        except DataError:
            raise
        except FitError as error:
            problem = problem or error
            continue
        if problem is not None:
            warn(f"{problem}: {plan.label} stands in for {plans[0].label}")
        return fits
    raise problem or FitError("there is no plan")


@dataclass(frozen=True)
class _Planned:
    """Fits of one plan, and what was fitted together."""

    plan: Plan
    fits: tuple[Fit, ...]
    sets: tuple[tuple[TrainingData, tuple[OutputModel, ...]], ...]

    def with_linearity(self) -> _Planned:
        """The fits with tests of linearity, where the models are linear."""
        return replace(self, fits=tuple(
            replace(fit, linearity=linearity_test(fit.model, fit.data))
            if fit.model.is_linear else fit for fit in self.fits
        ))  # fmt: skip

    @cached_property
    def held(self) -> HeldFit:
        """How the plan's choice does on blocks held out; FitError where nothing carries it."""
        each = [held_fit(data, partial(self.plan.refitted, models)) for data, models in self.sets]
        return joined_fits(each)


def _between_rows(
    logs: Sequence[Record], inputs: Sequence[str], outputs: Sequence[str], plan: Plan
) -> BetweenRows:
    """Inputs that switch between the rows that are fitted."""
    if not plan.tells_instants:
        return BetweenRows()
    try:
        parts = [log.between(*plan.span) for log in logs]
        data = even_training_data(parts, inputs, outputs, missing="end")
        data = data if plan.split is None else data.split(plan.split).fitted
    except FitError:
        return BetweenRows()
    return find_between_rows(data)


def _planned(
    logs: Sequence[Record],
    inputs: Sequence[str],
    outputs: Sequence[str],
    plan: Plan,
    fresh: Sequence[Record],
    reference: Reference | None,
    as_read: Sequence[Record],
    between: BetweenRows,
) -> _Planned:
    """Fits of one plan."""

    def data_sets(each: Sequence[Record]) -> list[TrainingData]:
        parts = [log.between(*plan.span) for log in each]
        found = plan.data_sets(parts, inputs, outputs)
        return [data.along_lines(between.lines, between.lagging) for data in found]

    sets = data_sets(logs)
    held = data_sets(fresh) if fresh else [None] * len(sets)
    fits: list[Fit] = []
    fitted = []
    for k, (data, own) in enumerate(zip(sets, held, strict=True)):
        plan.budget.begin(len(sets) - k)
        used, found = _judged(
            data, plan, own, reference, outputs, as_read[: len(logs)], as_read[len(logs) :]
        )
        fits += found
        fitted.append((used, tuple(fit.model for fit in found)))
    return _Planned(plan, tuple(fits), tuple(fitted))


def _judged(
    data: TrainingData,
    plan: Plan,
    fresh: TrainingData | None,
    reference: Reference | None,
    outputs: Sequence[str],
    logs: Sequence[Record],
    fresh_logs: Sequence[Record],
) -> tuple[TrainingData, list[Fit]]:
    """What was fitted of one data set, and its fits."""
    split: Split | None = None
    try:
        if plan.split is None:
            data = plan.start(data)
        else:
            # What is known of the start is known of all rows that go on from it.
            split = data.split(plan.split)
            split = split.with_start(plan.start(split.fitted))
            data = split.fitted
        models, candidates = plan.fit(data)
    except FitError as error:
        if plan.joint or error.channel:
            raise
        (output,) = data.outputs
        raise type(error)(f"{output}: {error}", output) from error
    fits = []
    for k, model in enumerate(models):
        # A plan may leave out inputs that never move.
        own = data.only(k).driven_by(model.names)
        fit = Fit(
            model, tuple(_term(model, i) for i in range(len(model.names))), model.fit(own), own,
            residual_tests(model, own), None, None, candidates,
        )  # fmt: skip
        whole = _document(fit, reference)
        if split is not None:
            own_logs = [logs[n] for n in split.data.logs]
            held = validate(model, split.only(k), whole, own_logs, plan.span, outputs)
            fit = replace(fit, validation=held)
        elif fresh is not None:
            own_logs = [fresh_logs[n] for n in fresh.logs]
            held = validate_on(model, fresh.only(k), whole, own_logs, plan.span, outputs)
            fit = replace(fit, validation=held)
        fits.append(fit)
    return data, fits


def _document(fit: Fit, reference: Reference | None) -> Model | None:
    """The document of one fit; None where a term has no form in continuous time."""
    try:
        return model_document([fit], reference, {})
    except ModelError:
        return None


def _term(model: OutputModel, k: int) -> ContinuousTerm | str:
    try:
        return model.sure_term(k)
    except ModelError as error:
        return str(error)
