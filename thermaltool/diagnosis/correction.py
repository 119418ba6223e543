"""The model as its calibration knows it: with what its kinds of response leave out.

A diagnosis compares a log with this model, so that the error of a response's shape, which the
calibration has seen, is not taken for a cause. The extended model that a user gets is without it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.model import Model, Term
from thermaltool.responses.losing import before_loss, losing_alike
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
        """Modes of the bank.

        Parameters
        ----------
        dt : float [s]
            Sample period; the modes do not depend on it.
        """
        rates = 1 / np.array(self.time_constants)
        return Modes((-rates).astype(complex), (np.array(self.weights) * rates).astype(complex))

    def transfer(self, s: Complex) -> Complex:
        """Transfer function H(s).

        Parameters
        ----------
        s : ndarray of complex [1/s]
        """
        return self.modes(0.0).transfer(s)

    def step(self, t: Float) -> Float:
        """Step response.

        Parameters
        ----------
        t : ndarray [s]
        """
        return self.modes(0.0).step(t)

    def dc_gain(self) -> float:
        """Steady gain."""
        return float(sum(self.weights))

    def slowest(self) -> float:
        """No time constant of its own: the response that it corrects has it [s]."""
        return 0.0

    @classmethod
    def search_box(cls, period: float, duration: float, **fixed: float) -> dict[str, Range]:
        """Bounds of a search: nothing is searched.

        Parameters
        ----------
        period, duration : float [s]
        """
        return {}

    @classmethod
    def starts(cls, period: float, duration: float, **fixed: float) -> list[tuple[float, ...]]:
        """Starts of a search: nothing is searched.

        Parameters
        ----------
        period, duration : float [s]
        """
        return [()]


def is_bank(term: Term) -> bool:
    """Whether a term stands for what the kind of another one leaves out.

    Parameters
    ----------
    term : Term
    """
    return isinstance(before_loss(term.response), LagBank)


def known_discrepancy(model: Model, output: str) -> Mapping[str, Any]:
    """What the calibration knows of an output beyond its kind of response; may be empty.

    Parameters
    ----------
    model : Model
    output : str
    """
    found = next(o for o in model.outputs if o.channel == output)
    kept: Mapping[str, Any] = found.fit.get("discrepancy") or {}
    return kept


def corrected(model: Model) -> Model:
    """The model moved to the mean of what its calibration knows, lags added.

    Parameters
    ----------
    model : Model
    """
    terms = list(model.terms)
    for output in model.outputs:
        known = known_discrepancy(model, output.channel)
        if not known:
            continue
        mean, covariance = np.array(known["mean"]), np.array(known["covariance"])
        p = len(known["parameters"])
        # Where a kind does not allow the move, the lags are what they are without it.
        spread = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        scaled = covariance / np.outer(spread, spread)
        slope = scaled[p:, :p] @ np.linalg.pinv(scaled[:p, :p], hermitian=True)
        for share in (1.0, 0.5, 0.0):
            own = share * mean[:p]
            lost = slope @ ((own - mean[:p]) / spread[:p]) * spread[p:]
            weights = (mean[p:] + lost).tolist()
            moves = dict(zip(map(tuple, known["parameters"]), own.tolist(), strict=True))
            try:
                moved = {
                    k: replace(term, response=_moved(term, moves))
                    for k, term in enumerate(model.terms)
                    if term.output == output.channel
                }
            except ModelError:
                continue
            break
        for k, term in moved.items():
            terms[k] = term
        for drive in dict.fromkeys(drive for drive, _ in known["lags"]):
            chosen = [k for k, (d, _) in enumerate(known["lags"]) if d == drive]
            bank = LagBank(
                tuple(weights[k] for k in chosen), tuple(known["lags"][k][1] for k in chosen)
            )
            beside = [t.response for t in moved.values() if t.drive == drive]
            changed = losing_alike(bank, beside[0]) if beside else bank
            terms.append(Term(drive, output.channel, changed))
    return replace(model, terms=tuple(terms))


def _moved(term: Term, moves: Mapping[tuple[str, str], float]) -> Any:
    """The response of a term with its parameters moved, searched ones by logarithms."""
    response: Any = term.response
    values = {}
    for name in (*response.searched, *response.gains):
        value, move = getattr(response, name), moves.get((term.drive, name), 0.0)
        values[name] = value * np.exp(move) if name in response.searched else value + move
    return replace(response, **values)


def uncorrected(model: Model, calibrated: Model, moved: bool) -> Model:
    """The model without lags; its parameters as calibrated unless these logs have `moved` them.

    Parameters
    ----------
    model : Model
    calibrated : Model
        As the calibration left it.
    moved : bool
        Whether these logs have moved the parameters.
    """
    if not moved:
        return replace(model, terms=calibrated.terms)
    # What the calibration knew belongs to the parameters that it found.
    outputs = tuple(
        replace(o, fit={k: v for k, v in o.fit.items() if k != "discrepancy"})
        for o in model.outputs
    )
    return replace(without_lags(model), outputs=outputs)


def without_lags(model: Model) -> Model:
    """The model without what stands for what its kinds of response leave out.

    Parameters
    ----------
    model : Model
    """
    terms = tuple(t for t in model.terms if not is_bank(t))
    return replace(model, terms=terms)
