"""The model as its calibration knows it: with what its kinds of response leave out.

A diagnosis compares a log with this model, so that the error of a response's shape, which the
calibration has seen, is not taken for a cause. The extended model that a user gets is without it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from thermaltool.model import Model, Term
from thermaltool.responses import response_class
from thermaltool.responses.modes import Complex, Float, Modes, Range


@dataclass(frozen=True)
class LagBank:
    """Σ w/(τs + 1): what a response's kind leaves out of its shape.

    Attributes
    ----------
    weights : tuple of float [unit of the output per unit of the drive]
    time_constants : tuple of float [s]
    """

    weights: tuple[float, ...]
    time_constants: tuple[float, ...]

    kind: ClassVar[str] = "lag_bank"
    searched: ClassVar[tuple[str, ...]] = ()
    gains: ClassVar[tuple[str, ...]] = ()
    fixed: ClassVar[dict[str, float]] = {}

    def modes(self, dt: float) -> Modes:
        rates = 1 / np.array(self.time_constants)
        return Modes((-rates).astype(complex), (np.array(self.weights) * rates).astype(complex))

    def transfer(self, s: Complex) -> Complex:
        return self.modes(0.0).transfer(s)

    def step(self, t: Float) -> Float:
        return self.modes(0.0).step(t)

    def dc_gain(self) -> float:
        return float(sum(self.weights))

    def slowest(self) -> float:
        """No time constant of its own: the response that it corrects has it [s]."""
        return 0.0

    @classmethod
    def search_box(cls, period: float, duration: float, **fixed: float) -> dict[str, Range]:
        return {}

    @classmethod
    def starts(cls, period: float, duration: float, **fixed: float) -> list[tuple[float, ...]]:
        return [()]


def known_discrepancy(model: Model, output: str) -> Mapping[str, Any]:
    """What the calibration knows of an output beyond its kind of response; may be empty."""
    found = next(o for o in model.outputs if o.channel == output)
    kept: Mapping[str, Any] = found.fit.get("discrepancy") or {}
    return kept


def corrected(model: Model) -> Model:
    """The model moved to the mean of what its calibration knows, lags added."""
    terms = list(model.terms)
    for output in model.outputs:
        known = known_discrepancy(model, output.channel)
        if not known:
            continue
        moves = dict(zip(map(tuple, known["parameters"]), known["mean"], strict=False))
        for k, term in enumerate(model.terms):
            if term.output != output.channel:
                continue
            cls, values = response_class(term.response.kind), {}
            for name in (*cls.searched, *cls.gains):
                value, move = getattr(term.response, name), moves.get((term.drive, name), 0.0)
                values[name] = value * np.exp(move) if name in cls.searched else value + move
            terms[k] = replace(term, response=replace(term.response, **values))  # type: ignore[type-var]
        weights = known["mean"][len(known["parameters"]) :]
        for drive in dict.fromkeys(drive for drive, _ in known["lags"]):
            chosen = [k for k, (d, _) in enumerate(known["lags"]) if d == drive]
            bank = LagBank(
                tuple(weights[k] for k in chosen), tuple(known["lags"][k][1] for k in chosen)
            )
            terms.append(Term(drive, output.channel, bank))
    return replace(model, terms=tuple(terms))


def uncorrected(model: Model, calibrated: Model, moved: bool) -> Model:
    """The model without lags; its parameters as calibrated unless these logs have `moved` them."""
    terms = tuple(t for t in model.terms if t.response.kind != LagBank.kind)
    return replace(model, terms=terms if moved else calibrated.terms)
