"""What a calibration leaves open of an output, in a record.

Of a deflection the model file keeps a posterior: moves of the parameters, and weights of lags of
all its drives, which stand for what a kind of response leaves out of its shape; and by what lags
other kinds differ that came as near (`thermaltool.fitting.discrepancy`). It holds for all drives
together, estimated or measured. Of a sensor, and without a posterior, the covariance of each term's
parameters counts.
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
from thermaltool.signals.covariance_root import covariance_root
from thermaltool.signals.symmetric import eigh

# Of a standard deviation of the parameters so much is tried, and the difference scaled up: along
# a direction that no log tells, a whole one leaves the parameters' range.
TRIAL_SHARE = 0.05
# Directions that move a response by less than this share of its steady state are left out.
MIN_EFFECT = 1e-4
# Rows whose variance is worked out at a time: a bound of memory.
ROWS_TOGETHER = 50_000
# Relative move of a parameter from which its slope is taken.
OWN_MOVE = 1e-3


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


def sensor_changes(
    model: Model, output: Output, time: Float, acting: Mapping[str, ActingDrive]
) -> Float:
    """Changes of a sensor, independent of each other, by one standard deviation, shape (k, n).

    By the covariance of the parameters of each term.

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
    changes = [
        (acting[term.drive].through(other, time) - acting[term.drive].through(own, time))
        / TRIAL_SHARE
        for term in model.terms
        if term.output == output.channel and term.drive in acting
        for own, other in _directions(model, term, lags)
    ]
    return np.array(changes).reshape(len(changes), len(time))


def deflection_variance(
    model: Model, output: Output, time: Float, acting: Mapping[str, ActingDrive]
) -> Float:
    """Variance of a deflection that is foretold from its drives, shape (n,).

    Where its zero is free, of its change since the first row.

    Parameters
    ----------
    model, output, time, acting
        As for `sensor_changes`.
    """
    if output.offset == "first":
        acting = {k: replace(a, values=a.values - a.start, start=0.0) for k, a in acting.items()}
    known = output.fit.get("discrepancy")
    terms = {t.drive: t for t in model.terms if t.output == output.channel}
    single = sum(t.output == output.channel for t in model.terms) == len(terms)
    names = {drive for drive, _ in known["parameters"]} if known else set()
    if not known or not single or not names <= set(terms):
        return np.asarray(np.sum(sensor_changes(model, output, time, acting) ** 2, axis=0))
    none = np.zeros(len(time))
    own = [
        _slope(model, terms[drive], name, time, acting[drive]) if drive in acting else none
        for drive, name in known["parameters"]
    ]
    lags = [
        lagged(time, each.values, tau, each.hold, each.start) if (each := acting.get(drive))
        else none
        for drive, tau in known["lags"]
    ]  # fmt: skip
    root = covariance_root(known["covariance"])
    columns, variance = np.array([*own, *lags]), np.empty(len(time))
    for first in range(0, len(time), ROWS_TOGETHER):
        rows = slice(first, first + ROWS_TOGETHER)
        variance[rows] = np.sum(np.square(columns[:, rows].T @ root), axis=1)
    if spread := known.get("spread"):
        # Which of several fits is true the calibration could not tell. Their median:
        # one of them may go anywhere beyond what the calibration has seen.
        variance = variance + np.median(np.square(np.array(spread) @ columns[len(own) :]), axis=0)
    return np.asarray(variance)


def _slope(model: Model, term: Term, name: str, time: Float, acting: ActingDrive) -> Float:
    """Change of an output per unit of a parameter: of its logarithm where it is searched so."""
    response: Any = term.response
    value = getattr(response, name)
    size = max((abs(getattr(response, each)) for each in response.gains), default=1.0) or 1.0
    own = acting.through(response.modes(model.sample_period), time)
    for step in (OWN_MOVE, -OWN_MOVE):
        is_log = name in response.searched
        moved = value * np.exp(step) if is_log else value + step * size
        try:
            other = replace(response, **{name: moved}).modes(model.sample_period)
        except (ModelError, ValueError):  # at the end of its range: the other way
            continue
        by = step if is_log else step * size
        return np.asarray((acting.through(other, time) - own) / by)
    return np.zeros(len(time))


def _directions(model: Model, term: Term, lags: list[float]) -> Iterator[tuple[Modes, Modes]]:
    """A term's response, and what it is a little along each direction of its covariance."""
    if term.covariance is None:
        return
    own = lagged_modes(term.response.modes(model.sample_period), *lags)
    sizes, vectors = eigh(np.asarray(term.covariance))
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
