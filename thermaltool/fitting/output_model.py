"""An identified model of one output: what every form of it has, and its free run."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermaltool.effects.band import ScheduleBand
from thermaltool.effects.effect import Effect
from thermaltool.fitting.data import Array, Split, TrainingData, Zero
from thermaltool.record import Record
from thermaltool.responses import Response
from thermaltool.signals.agreement import Agreement, agreement
from thermaltool.signals.criteria import Criteria
from thermaltool.signals.gauss_newton import solve
from thermaltool.signals.intervals import Estimate


@dataclass(frozen=True)
class ContinuousTerm:
    """One input's response in continuous time, as a model document has it.

    Attributes
    ----------
    response : Response
    mismatch : float
        Largest difference of the step responses at the samples, as a share of the largest value.
        Zero to rounding where the discrete form is a sampled continuous one.
    covariance : ndarray, or None
        Of the response's parameters, in the order of `names`, where it was found in this form.
    names : tuple of str
    band : ScheduleBand, optional
        Which share of the input it takes, where terms go by level.
    """

    response: Response
    mismatch: float = 0.0
    covariance: Array | None = None
    names: tuple[str, ...] = ()
    band: ScheduleBand | None = None


@dataclass(frozen=True, kw_only=True)
class OutputModel(ABC):
    """One output's model with m inputs, about the levels at which each experiment begins.

    Attributes
    ----------
    names : tuple of str
        Inputs.
    target : str
        Output.
    dt : float [s]
    levels : ndarray, shape (experiments, m)
        Inputs about which each experiment was fitted, and
    zeros : tuple of float
        the output where they stand for ever.
    sigma2 : float [unit²]
        Variance of the noise.
    covariance : ndarray, shape (p, p)
        Of the parameters of the model's own search.
    method : str
    converged : bool
    rows : int
        Samples that count.
    loss : float [unit²]
        Sum of the squared errors.
    """

    names: tuple[str, ...]
    target: str
    dt: float
    levels: Array
    zeros: tuple[float, ...]
    sigma2: float
    covariance: Array
    method: str
    converged: bool
    rows: int
    loss: float

    @property
    def is_linear(self) -> bool:
        """Whether the response to the sum of two inputs is the sum of those to each."""
        return True

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Effects of the model document, of all outputs that were fitted together."""
        return ()

    def level_terms(self, k: int) -> tuple[ContinuousTerm, ...]:
        """Responses to input k, one for each level by which they go; `term` where there is none.

        Parameters
        ----------
        k : int
        """
        return (self.term(k),)

    @property
    def redundant(self) -> bool:
        """Whether the inputs say so much the same that others can stand in for a lost one."""
        return False

    @property
    @abstractmethod
    def parameters(self) -> int:
        """Number of fitted parameters, the offsets among them."""

    @property
    @abstractmethod
    def order(self) -> int:
        """Number of states, each of which a record may begin with unknown."""

    @property
    @abstractmethod
    def sample_delays(self) -> tuple[int, ...]:
        """Samples before which each input acts on nothing."""

    @property
    def offsets(self) -> tuple[float, ...]:
        """Output at inputs of zero, of each experiment [unit of the output]."""
        gains = [self.gain(k).value for k in range(len(self.names))]
        return tuple((np.array(self.zeros) - self.levels @ gains).tolist())

    @property
    def residual_parameters(self) -> int:
        """Parameters that were fitted to the course of the `residuals`."""
        return 0

    @property
    def criteria(self) -> Criteria:
        """Information criteria of the fit."""
        return Criteria.of_squares(self.loss, self.rows, self.parameters)

    @abstractmethod
    def gain(self, k: int) -> Estimate:
        """Steady state of the output per unit of input k."""

    @abstractmethod
    def named(self) -> Iterator[tuple[str, Estimate]]:
        """Every parameter by name, with its 95 % interval."""

    @abstractmethod
    def term(self, k: int) -> ContinuousTerm:
        """Response to input k in continuous time; ModelError where it has no such form."""

    def sure_term(self, k: int) -> ContinuousTerm:
        """The same with the covariance of its parameters, where `term` leaves it to this."""
        return self.term(k)

    @abstractmethod
    def residuals(self, data: TrainingData) -> Iterator[tuple[Array, Array]]:
        """One-step errors of each run (n,), and its inputs (m, at least n), which end with them."""

    @abstractmethod
    def _from_rest(self, record: Record, levels: Array) -> Array:
        """Noise-free output, shape (n,), of inputs relative to `levels`, shape (m,)."""

    @abstractmethod
    def _free_responses(self, record: Record) -> Array:
        """What an unknown state at the first row leaves behind, shape (order, n)."""

    @abstractmethod
    def _known(self, record: Record) -> NDArray[np.bool_]:
        """Rows whose delayed inputs are known, shape (n,); none where the start takes them all."""

    def simulate(self, record: Record, zero: Zero = "fitted", stop: int | None = None) -> Array:
        """Free run over a record; the state at its start is estimated from it.

        Parameters
        ----------
        record : Record
            With the inputs and the output.
        zero : Zero
        stop : int, optional
            Row from which on the output counts for nothing: the state is estimated from those
            before it. Default: all count.

        Returns
        -------
        y : ndarray, shape (n,)
            NaN on the first rows, whose delayed inputs are not in the record.
        """
        # About the levels of the fit: slow poles make gains too large to be taken off again.
        at = record.origin if zero == "fitted" else 0
        y = self._from_rest(record, self.levels[at]) + self.zeros[at]
        if zero == "mean":
            y += np.mean(self.offsets) - self.offsets[at]
        known, left = self._known(record), record.column(self.target) - y
        columns = np.ones((int(zero == "free"), len(record)))
        if not record.at_rest:
            columns = np.vstack([self._free_responses(record), columns])
        counted = known & np.isfinite(left)
        counted[stop:] &= stop is None
        if len(columns) and int(counted.sum()) > len(columns):
            own = columns[:, counted]
            y = y + solve(own @ own.T, own @ left[counted]) @ columns
        return np.where(known, y, np.nan)

    def response_to(self, record: Record) -> Array:
        """Noise-free output from rest at inputs of zero, shape (n,), about its level there."""
        return self._from_rest(record, np.zeros(len(self.names)))

    def run(self, data: TrainingData, zero: Zero = "fitted") -> Array:
        """Free runs over all records in a row."""
        return np.concatenate([self.simulate(record, zero) for record in data.records])

    def carried_on(self, split: Split) -> Array:
        """Free runs over what is held out, its state carried on from what is fitted, in a row.

        Behind a pause, where nothing carries it on, it is estimated from the held rows themselves.
        """
        return np.concatenate(
            [
                self.simulate(record.rows(slice(0, stop)), stop=start or None)[start:]
                for record, start, stop in split.parts
                if stop > start
            ]
        )

    def fit(self, data: TrainingData) -> Agreement:
        """Agreement of the free run with the one output of the data, over all records."""
        return agreement(*data.about_means(data.output(), self.run(data)))
