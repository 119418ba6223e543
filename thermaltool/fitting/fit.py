"""One output of an identified machine, fitted: what documents, tables and frames take of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.transfer.continuation import Continued
from thermaltool.fitting.transfer.residuals import ResidualTests
from thermaltool.signals.agreement import Agreement
from thermaltool.signals.criteria import Criteria
from thermaltool.signals.intervals import Estimate


class FittedModel(Protocol):
    """An identified model of one output: a `TransferModel` or a `NetworkOutput`."""

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def target(self) -> str: ...
    @property
    def dt(self) -> float: ...
    @property
    def offsets(self) -> tuple[float, ...]: ...
    @property
    def method(self) -> str: ...
    @property
    def covariance(self) -> Array: ...
    @property
    def criteria(self) -> Criteria: ...
    def gain(self, k: int) -> Estimate: ...
    def named(self) -> Iterator[tuple[str, Estimate]]: ...


@dataclass(frozen=True)
class Fit:
    """A model of one output, and how it does on the data that it was fitted to.

    Attributes
    ----------
    model : FittedModel
    terms : tuple of Continued or str
        The response to each input in continuous time, or why there is none.
    training : Agreement
        Of the free run over the training data.
    data : TrainingData
        What it was fitted to.
    tests : ResidualTests or None
        Are the residuals white, and independent of the inputs.
    """

    model: FittedModel
    terms: tuple[Continued | str, ...]
    training: Agreement
    data: TrainingData
    tests: ResidualTests | None = None

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
