"""Box-Jenkins: y = Σ B/F u + C/D e."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.transfer.model import TransferModel
from thermaltool.fitting.transfer.oe import plant_model
from thermaltool.fitting.transfer.orders import Orders
from thermaltool.fitting.transfer.output_error import Problem
from thermaltool.fitting.transfer.search import refine, search
from thermaltool.fitting.transfer.structure import Structure
from thermaltool.timeseries.fit import fit_arma
from thermaltool.timeseries.runs import joined

# Plant and noise are estimated in turn at most so often, until the denominators change by less.
MAX_ALTERNATIONS = 8
RELATIVE_CHANGE, ABSOLUTE_CHANGE = 1e-6, 1e-9


@dataclass(frozen=True)
class BjStructure(Structure):
    """Errors with a model of their own."""

    name: ClassVar[str] = "bj"
    noise_orders: ClassVar[bool] = True

    def estimate(self, data: TrainingData, orders: Orders) -> TransferModel:
        """Refined instrumental variables with a noise model (RIV; Young 2011, chapter 7).

        An ARMA model of the errors whitens all rows of the next plant estimate, until the plant
        stands. Errors that BIC takes for white have none: C and D that nearly cancel, on the unit
        circle, would make the steady state look far surer than it is.
        """
        problem = Problem(data.about_levels(orders.first), orders)
        found, (nc, nd) = search(problem, self.rough), self.noise
        C = D = np.ones(1)
        for _ in range(MAX_ALTERNATIONS):
            plain = replace(problem, whitening=None)
            errors = joined([e for e, _ in plain.errors(plain.project(found.F))])
            noise = min((fit_arma(errors, p, q, degree=-1) for p, q in ((nd, nc), (0, 0))),
                        key=lambda model: model.entry.criteria.bic)  # fmt: skip
            C, D = np.concatenate([[1.0], noise.ma]), np.concatenate([[1.0], -noise.ar])
            problem = replace(problem, whitening=(D, C))
            before, found = found.F, refine(problem, found.F)
            if all(np.allclose(a, b, rtol=RELATIVE_CHANGE, atol=ABSOLUTE_CHANGE)
                   for a, b in zip(found.F, before, strict=True)):  # fmt: skip
                break
        return plant_model(self, problem, found, data, coloured=False, C=C, D=D)
