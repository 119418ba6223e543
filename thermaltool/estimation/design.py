"""The estimator of a model, chosen among its forms by the band of the deflection error."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Literal

from thermaltool.errors import FitError, ModelError
from thermaltool.estimation.bands import design_bands
from thermaltool.estimation.design_model import DesignModel
from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.identifiability import identifiability_note
from thermaltool.estimation.known_inputs import Feedforward
from thermaltool.estimation.permanent_effects import reading_columns
from thermaltool.estimation.plausible_change import plausible_changes
from thermaltool.estimation.regularization import (
    Criterion,
    DesignChoice,
    best_choice,
    design_kalman,
    design_kernel,
    relative_heat_error,
)
from thermaltool.model import Model

# A heat that is wrong by more than this share of its level is told.
LARGE_HEAT_ERROR = 0.5


@dataclass(frozen=True)
class DesignPlan:
    """What is asked of a design.

    Attributes
    ----------
    form : "auto", "kalman" or "kernel"
        "auto" takes the one that fares better by the criterion.
    walk : float or None
        The one random-walk rate of the Kalman form [share of the level per √s].
    criterion : "heat", "deflection", "both" or None
        What counts; None for the deflection where the model has one, else the heat.
    pinned : mapping
        What the kernel form does not search: any of ``A``, ``B``, ``c``, ``cutoff_Hz``,
        ``delay_s``.
    """

    form: Literal["auto", "kalman", "kernel"] = "auto"
    walk: float | None = None
    criterion: Criterion | None = None
    pinned: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class EstimatorDesign:
    """A model with its estimator, and the trade-off that it was chosen from.

    Attributes
    ----------
    model : Model
        With its design.
    problem : DesignModel
        What was designed for.
    chosen : "kalman", "kernel" or "feedforward"
    choices : mapping of form to sequence of DesignChoice
        Empty where every drive is measured: nothing is estimated.
    notes : tuple of str
        Why the kernel form is not among the choices, where it was tried; what of the heat is
        hardly known.
    """

    model: Model
    problem: DesignModel
    chosen: str
    choices: Mapping[str, Sequence[DesignChoice]]
    notes: tuple[str, ...] = ()

    @property
    def best(self) -> DesignChoice | None:
        """The choice that was taken; None where nothing is estimated."""
        return best_choice(self.choices[self.chosen]) if self.choices else None


def needs_noise(model: Model, measured: Sequence[str]) -> bool:
    """Whether the sensors' noise has to be known: a drive is estimated from them.

    Parameters
    ----------
    model : Model
    measured : sequence of str
        Drives that are read.
    """
    return bool(model.sensors and {d.channel for d in model.drives} - set(measured))


def design_estimator(
    model: Model,
    problem: DesignModel,
    plan: DesignPlan | None = None,
    progress: Callable[[str], None] = lambda message: None,
) -> EstimatorDesign:
    """Design the estimator of a model.

    Parameters
    ----------
    model : Model
    problem : DesignModel
        Of the same model.
    plan : DesignPlan, optional
    progress : callable
        Gets a word on what is being tried.

    Raises
    ------
    ModelError
        A form that is asked for where nothing is to be estimated.
    FitError
        The form that is asked for has no usable design.
    """
    plan = plan or DesignPlan()
    if not problem.drives:
        if plan.form != "auto":
            raise ModelError(
                f"--form {plan.form}: every drive is measured, nothing is to be estimated"
            )
        estimator = problem.finished(
            Feedforward((*problem.outputs, *problem.states), problem.states)
        )
        document = {
            **estimator.document(),
            "plausible_change": plausible_changes(model, {}, (), problem.dt),
            "sample_period_s": problem.dt,
        }
        model = model.with_design(document)
        return EstimatorDesign(model, problem, "feedforward", {})
    hardly_seen = identifiability_note(problem)
    choices: dict[str, list[DesignChoice]] = {}
    refused = None
    if plan.form != "kernel":
        choices["kalman"] = design_kalman(problem, plan.walk, progress, plan.criterion)
    single = len(problem.sensors) == 1 and len(problem.drives) == 1
    if plan.form == "kernel" or (plan.form == "auto" and single):
        try:
            choices["kernel"] = design_kernel(problem, plan.pinned, progress, plan.criterion)
        except FitError as error:
            if plan.form == "kernel":
                raise
            refused = f"kernel form: {error}"
    chosen = min(choices, key=lambda form: best_choice(choices[form]).objective)
    best = best_choice(choices[chosen])
    columns = reading_columns(model)
    read = {columns[sensor]: sensor for sensor in problem.sensors}
    document = {
        **problem.finished(best.estimator).document(),
        "plausible_change": plausible_changes(model, read, problem.noise, problem.dt),
        "sample_period_s": problem.dt,
        "settings": best.settings,
        "predicted": asdict(best.prediction),
    }
    if isinstance(best.estimator, KalmanEstimator):
        document["left_out"] = problem.truncated.error
        document["bands"] = design_bands(model, problem, best.estimator)
    notes = [hardly_seen, refused, _heat_note(best, problem)]
    return EstimatorDesign(
        model.with_design(document), problem, chosen, choices, tuple(filter(None, notes))
    )


def _heat_note(best: DesignChoice, problem: DesignModel) -> str | None:
    """Where an estimator that is good for the deflection is none for the heat."""
    error = relative_heat_error(best.prediction, problem)
    if error <= LARGE_HEAT_ERROR:
        return None
    return (
        f"the heat is wrong by {error:.2g} of its level (root mean square): this design is for the "
        "deflection alone; --criterion heat or both weighs the heat"
        if problem.outputs
        else f"the heat is wrong by {error:.2g} of its level (root mean square)"
    )
