"""One output of an identified machine, fitted: what documents, tables and frames take of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.linearity import LinearityTest
from thermaltool.fitting.output_model import ContinuousTerm, OutputModel
from thermaltool.fitting.residuals import ResidualTests
from thermaltool.fitting.selection import Candidate
from thermaltool.fitting.validation import Validation
from thermaltool.signals.agreement import Agreement
from thermaltool.signals.criteria import Criteria
from thermaltool.signals.intervals import Estimate


@dataclass(frozen=True)
class ChosenOver:
    """A structure that predicts blocks held out decisively better than the usual one.

    Attributes
    ----------
    structure : str
    fit_percent : float [%]
        Of the blocks.
    usual : str
    usual_percent : float [%]
    """

    structure: str
    fit_percent: float
    usual: str
    usual_percent: float


@dataclass(frozen=True)
class Fit:
    """A model of one output, and how it does on the data that it was fitted to.

    Attributes
    ----------
    model : OutputModel
        A `TransferModel` or a `NetworkOutput`.
    terms : tuple of ContinuousTerm or str
        The response to each input in continuous time, or why there is none.
    training : Agreement
        Of the free run over the training data.
    data : TrainingData
        What it was fitted to, with this output alone.
    tests : ResidualTests or None
        Are the residuals white, and independent of the inputs.
    linearity : LinearityTest or None
        Do products and powers of inputs and output explain the errors; None: too few rows.
    validation : Validation or None
        On data that were kept for it.
    candidates : tuple of Candidate
        Where the orders were chosen, the best first.
    chosen_over : ChosenOver or None
        Where its structure was taken in place of the usual one.
    """

    model: OutputModel
    terms: tuple[ContinuousTerm | str, ...]
    training: Agreement
    data: TrainingData
    tests: ResidualTests | None = None
    linearity: LinearityTest | None = None
    validation: Validation | None = None
    candidates: tuple[Candidate[Any], ...] = ()
    chosen_over: ChosenOver | None = None

    @property
    def parameters(self) -> dict[str, Estimate]:
        """Every fitted parameter by name, with its 95 % interval."""
        return dict(self.model.named())

    @property
    def covariance(self) -> Array:
        """Covariance in the parameters of the model's own search, shape (p, p)."""
        return self.model.covariance

    @property
    def criteria(self) -> Criteria:
        """What the fit is worth beside the parameters that it takes."""
        return self.model.criteria
