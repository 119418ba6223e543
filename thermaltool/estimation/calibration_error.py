"""What a calibration leaves open of an output, as changes that it may have in a record.

The model file keeps a posterior of each output: moves of the parameters, and weights of lags of all
its drives, which stand for what a kind of response leaves out of its shape; and by what lags other
kinds differ that came as near (`thermaltool.fitting.discrepancy`). It holds for all drives
together, estimated or measured. A model without it has the covariance of each term's parameters.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from thermaltool.effects.dynamics import lagged
from thermaltool.errors import ModelError
from thermaltool.estimation.cascade import lagged_modes
from thermaltool.estimation.estimator import Estimator
from thermaltool.estimation.known_inputs import KnownInputEstimator
from thermaltool.estimation.permanent_effects import sensor_time_constants
from thermaltool.estimation.start import Initial
from thermaltool.model import Model, Output, Term
from thermaltool.responses.modes import Float, Hold, Modes

# Of a standard deviation of the parameters so much is tried, and the difference scaled up: along
# a direction that no log tells, a whole one leaves the parameters' range.
TRIAL_SHARE = 0.05
# Directions that move a response by less than this share of its steady state are left out.
MIN_EFFECT = 1e-4
# Relative move of a parameter from which its slope is taken.
OWN_MOVE = 1e-3
# Directions of a posterior that change a whole record by less, over the noise of a reading (a root
# of a sum of squares), are left out: one row is off by less than a hundredth of the noise.
MIN_CHANGE = 0.1


@dataclass(frozen=True)
class ActingDrive:
    """A drive as it acts in a record.

    Attributes
    ----------
    values : ndarray, shape (n,) [unit of the drive]
        Relative to its reference.
    hold : "zero" or "first"
    start : float
        At which the machine has stood before the first row.
    """

    values: Float
    hold: Hold = "zero"
    start: float = 0.0

    def through(self, modes: Modes, time: Float) -> Float:
        """What a response makes of it, shape (n,).

        Parameters
        ----------
        modes : Modes
        time : ndarray, shape (n,) [s]
        """
        found = modes.run(time, self.values - self.start, self.hold)
        return found + modes.dc_gain() * self.start if self.start else found


def acting_drives(estimator: Estimator, columns: Float, initial: Initial) -> dict[str, ActingDrive]:
    """The measured drives of a record, but those that act by their level.

    Parameters
    ----------
    estimator : Estimator
    columns : ndarray, shape (n, n_columns)
        What it takes.
    initial : {"rest", "settled", "free"}
    """
    if not isinstance(estimator, KnownInputEstimator) or not len(columns):
        return {}
    behind = columns[:, len(estimator.inner.sensors) :].T
    found = {}
    for each, values, follows in zip(estimator.known, behind, estimator.measured, strict=True):
        if each.role == "drive" and each.band is None:
            stood = follows or initial == "settled"
            found[each.channel] = ActingDrive(values, each.hold, float(values[0]) if stood else 0.0)
    return found


def output_changes(
    model: Model, output: Output, time: Float, acting: Mapping[str, ActingDrive]
) -> Float:
    """Changes of an output, independent of each other, by one standard deviation, shape (k, n).

    Parameters
    ----------
    model : Model
    output : Output
        Of the model.
    time : ndarray, shape (n,) [s], increasing
    acting : mapping of drive to ActingDrive
        Drives that are not there count for nothing.
    """
    lags = sensor_time_constants(model, output.channel)
    terms = [t for t in model.terms if t.output == output.channel and t.drive in acting]
    known = output.fit.get("discrepancy")
    if output.role == "deflection" and known and all(t.band is None for t in terms):
        return _by_posterior(model, known, terms, lags, time, acting)
    changes = [
        (acting[term.drive].through(other, time) - acting[term.drive].through(own, time))
        / TRIAL_SHARE
        for term in terms
        for own, other in _directions(model, term, lags)
    ]
    return np.array(changes).reshape(len(changes), len(time))


def _by_posterior(
    model: Model,
    known: Mapping[str, Any],
    terms: list[Term],
    lags: list[float],
    time: Float,
    acting: Mapping[str, ActingDrive],
) -> Float:
    covariance = np.array(known["covariance"], float)
    of_drive = {term.drive: term for term in terms}
    columns = []
    for drive, name in known["parameters"]:
        there = drive in of_drive
        columns.append(_slope(model, of_drive[drive], name, lags, time, acting[drive])
                       if there else np.zeros(len(time)))  # fmt: skip
    for drive, tau in known["lags"]:
        each = acting.get(drive)
        columns.append(np.zeros(len(time)) if each is None
                       else lagged(time, each.values, tau, each.hold, each.start))  # fmt: skip
    if spread := known.get("spread"):
        # Which of several kinds of response is true the calibration could not tell.
        own = len(known["parameters"])
        differ = np.array(spread, float)
        covariance[own:, own:] += differ.T @ differ / len(differ)
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scale[scale == 0] = 1.0
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    changes = np.array(columns).T @ root
    # What they do together in few directions, the largest first.
    left, sizes, _ = np.linalg.svd(changes, full_matrices=False)
    kept = sizes > MIN_CHANGE * float(known["white_sigma"])
    return np.asarray((left[:, kept] * sizes[kept]).T)


def _slope(
    model: Model, term: Term, name: str, lags: list[float], time: Float, acting: ActingDrive
) -> Float:
    """Change of an output per unit of a parameter: of its logarithm where it is searched so."""
    response: Any = term.response
    value = getattr(response, name)
    size = max((abs(getattr(response, each)) for each in response.gains), default=1.0) or 1.0
    own = acting.through(lagged_modes(response.modes(model.sample_period), *lags), time)
    for step in (OWN_MOVE, -OWN_MOVE):
        is_log = name in response.searched
        moved = value * np.exp(step) if is_log else value + step * size
        try:
            other = replace(response, **{name: moved}).modes(model.sample_period)
        except (ModelError, ValueError):  # at the end of its range: the other way
            continue
        by = step if is_log else step * size
        return np.asarray((acting.through(lagged_modes(other, *lags), time) - own) / by)
    return np.zeros(len(time))


def _directions(model: Model, term: Term, lags: list[float]) -> Iterator[tuple[Modes, Modes]]:
    """A term's response, and what it is a little along each direction of its covariance."""
    if term.covariance is None:
        return
    own = lagged_modes(term.response.modes(model.sample_period), *lags)
    sizes, vectors = np.linalg.eigh(np.asarray(term.covariance))
    t = np.geomspace(model.sample_period, 10 * term.response.slowest(), 200)
    steady = max(float(np.max(np.abs(own.step(t)))), 1e-300)
    for size, vector in zip(sizes, vectors.T, strict=True):
        if not size > 0:
            continue
        step = TRIAL_SHARE * np.sqrt(size) * vector
        values = dict(zip(term.covariance_names, step.tolist(), strict=True))
        moved = {name: getattr(term.response, name) + by for name, by in values.items()}
        try:
            response = replace(term.response, **moved)  # type: ignore[type-var]
        except (ModelError, ValueError):
            continue
        other = lagged_modes(response.modes(model.sample_period), *lags)
        moved_by = float(np.max(np.abs(other.step(t) - own.step(t)))) / TRIAL_SHARE
        if moved_by > MIN_EFFECT * steady:
            yield own, other
