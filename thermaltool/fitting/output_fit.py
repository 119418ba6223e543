"""One output calibrated over all records, with any known input."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from thermaltool.errors import FitError, counted
from thermaltool.fitting.covariance import block_covariance
from thermaltool.fitting.discrepancy import Discrepancy, discrepancy, spread
from thermaltool.fitting.instants import Instants, fitted_instants
from thermaltool.fitting.parametrization import Parametrization
from thermaltool.fitting.possible import CANCELLING_LOSS
from thermaltool.fitting.projection import (
    CalibrationProblem,
    GridStates,
    Triangle,
)
from thermaltool.fitting.start_search import StartSearch, shared_otherwise
from thermaltool.fitting.unidentified import cancelling, unidentified, unsettled
from thermaltool.model import Drive, relative
from thermaltool.record import Record
from thermaltool.responses import Response, response_class
from thermaltool.responses.modes import Float
from thermaltool.signals.robust import robust_std

Loss = Literal["linear", "huber"]

# Of the logarithm of a rate or shape that no row says anything of: a factor of 400 either way, at
# 95 %.
RATE_DEVIATION = 3.0
# Residuals beyond this many robust standard deviations count linearly (Huber); their weights are
# found anew at most so often, until none changes by more than this.
HUBER_THRESHOLD, MAX_REWEIGHTINGS, WEIGHT_TOLERANCE = 2.5, 8, 1e-3


@dataclass(frozen=True)
class OutputFit:
    """One output, calibrated.

    Attributes
    ----------
    responses : tuple of Response, one for each drive
    names : tuple of str
        The fitted parameters: of each response its searched ones, then all gains, then offsets.
    covariance : ndarray, shape (len(names), len(names))
        From sums of scores over blocks of time, so that slow noise counts.
    offsets : tuple of float, one for each record
    rmse, max_error : float [unit of the output]
    fit_percent : float
        (1 − ‖y − ŷ‖/‖y − ȳ‖)·100.
    unidentified : tuple of str
        What these records do not settle, each a sentence.
    starts : tuple of float
        RMSE that each refined start reached, the best first, be it sound or not [unit of the
        output].
    covered : float
        Slowest time constants that the longest record covers.
    discrepancy : Discrepancy
        Of the searched parameters (by logarithm) and gains, in the order of `names`, then of
        first-order lags with these `time_constants` for every drive.
    time_constants : tuple of float [s]
    instants : int
        Switches between rows whose instants are part of the noise.
    rmse_instants : float or None [unit of the output]
        Beside what the likeliest of them explain; None without.
    """

    responses: tuple[Response, ...]
    names: tuple[str, ...]
    covariance: Float
    offsets: tuple[float, ...]
    rmse: float
    max_error: float
    fit_percent: float
    unidentified: tuple[str, ...]
    starts: tuple[float, ...]
    covered: float
    discrepancy: Discrepancy
    time_constants: tuple[float, ...]
    instants: int = 0
    rmse_instants: float | None = None

    def response_covariance(self, drive: int) -> tuple[Float, tuple[str, ...]]:
        """Covariance of the parameters of one drive's response, and their names."""
        own = [
            k
            for k, name in enumerate(self.names)
            if not name.startswith("offset") and (len(self.responses) == 1 or f"[{drive}]" in name)
        ]
        names = tuple(self.names[k].partition("[")[0] for k in own)
        return self.covariance[np.ix_(own, own)], names


def check_records(records: Sequence[Record], drives: Sequence[Drive], output: str) -> None:
    """Refuse records that say nothing of a response.

    Parameters
    ----------
    records : sequence of Record
    drives : sequence of Drive
    output : str
        Channel.

    Raises
    ------
    FitError
        Fewer than two rows; a drive, or an output, that never moves.
    LogError
        A channel that a record does not have.
    """
    for record in records:
        if len(record) < 2:
            raise FitError(f"a log of {counted(len(record), 'row')} says nothing of a response")
    for drive in drives:
        if not any(np.any(u) for u in _inputs(records, drive)):
            others = "; leave it out" if len(drives) > 1 else ""
            raise FitError(f"{drive.channel} never leaves its reference: nothing to fit{others}")
    readings = [y[np.isfinite(y)] for y in (record.column(output) for record in records)]
    if not any(len(y) for y in readings):
        raise FitError(f"{output} has no values: there is nothing to fit")
    if not any(np.any(y != y[0]) for y in readings if len(y)):
        raise FitError(f"{output} is constant: there is nothing to fit")


def fit_output(
    records: Sequence[Record],
    drives: Sequence[Drive],
    output: str,
    kinds: Sequence[str],
    fixed: Mapping[str, float] | None = None,
    loss: Loss = "huber",
    starts: int = 6,
    free_start: bool = False,
    progress: Callable[[str], None] = lambda message: None,
    delays: Sequence[float] | None = None,
    states: GridStates | None = None,
    between: Sequence[str] = (),
    equilibrium: bool = False,
    others: Sequence[Float] = (),
    near: Float | None = None,
    common: bool = False,
    without: Sequence[Drive] = (),
) -> OutputFit:
    """Fit one output to its drives over all records at once.

    Parameters
    ----------
    records : sequence of Record
        With the drives (no NaN) and the output (NaN where missing: left out of the fit); at rest
        at their first row, unless `free_start`.
    drives : sequence of Drive
        Channels, what counts as no drive, and how they go on between samples.
    output : str
        Channel.
    kinds : sequence of str
        Kind of response for each drive.
    fixed : mapping of parameter name to value, optional
        Overrides the defaults of parameters that are not fitted (``r0``).
    loss : "linear" or "huber"
        Huber by iterated reweighting.
    starts : int
        How many of the best points of a coarse grid are refined.
    free_start : bool
        The machine came from another level: each gain gets a decay per record.
    progress : callable
    delays : sequence of float, optional [s]
        Of each drive's response; default: the fixed ``delay``, else none.
    states : dict, optional
        See `CalibrationProblem.assemble`.
    between : sequence of str
        Drives that switch at unknown instants between the rows: where evidence asks for it, these
        are part of the noise.
    equilibrium : bool
        See `CalibrationProblem.assemble`.
    others : sequence of ndarray, shape (drives, rates)
        Grid weights of other kinds that come as near: what they differ by is not known. Those of
        `without` come last.
    near : ndarray, shape (searched,), optional
        Logarithms of rates and shapes from which the search starts, too.
    common : bool
        One kind whose rates all drives share.
    without : sequence of Drive
        Others that move, without a response: what they may do is part of the discrepancy.

    Raises
    ------
    FitError
        A drive or an output that never moves, fewer rows than parameters, no start with a finite
        error.
    LogError
        A channel that a record does not have.
    """
    check_records(records, drives, output)
    classes = tuple(response_class(kind) for kind in kinds)
    constants = tuple({k: (fixed or {}).get(k, v) for k, v in c.fixed.items()} for c in classes)
    if delays is not None:
        constants = tuple(
            {**own, "delay": delay} if "delay" in own else own
            for own, delay in zip(constants, delays, strict=True)
        )
    parametrization = Parametrization(classes, constants, common)
    delays = [own.get("delay", 0.0) for own in constants]
    problem = CalibrationProblem.assemble(
        records, drives, output, free_start, delays, states, equilibrium
    )
    rows = len(problem.measured)
    unknowns = problem.unknowns(parametrization)
    if rows <= unknowns:
        raise FitError(
            f"{output}: {counted(rows, 'row')} for {counted(unknowns, 'parameter')}: too few"
        )

    duration = max(record.duration for record in records)
    period = min(record.period for record in records)
    limits = parametrization.limits(period, duration, free_start, problem.longest)
    search = StartSearch(problem, parametrization, limits)
    weights = np.ones(rows)
    triangle = problem.compress(weights)
    reached = search.best(parametrization.starts(period, duration), triangle, starts, progress)
    if near is not None:
        reached = sorted([*reached, search.refine(near, triangle)], key=lambda result: result[0])

    def is_sound(theta: Float) -> bool:
        linear = search.fitted(theta, triangle)[1]
        return not search.soundness(theta, linear, drives, output, duration).breaks

    def refined(theta: Float) -> Float:
        """Where the search goes on to, unless that is no machine any more."""
        further = search.refine(theta, triangle)[1]
        return further if is_sound(further) or not is_sound(theta) else theta

    places = list(reached)
    if near is not None:
        places.append((float(np.linalg.norm(search.errors(near, triangle))), near))
    within = [theta for size, theta in places if size <= CANCELLING_LOSS * reached[0][0]]
    theta = next(filter(is_sound, within), reached[0][1])
    for _ in range(MAX_REWEIGHTINGS if loss == "huber" else 0):
        new = _huber_weights(search.fitted(theta, triangle)[0])
        if new is None or np.max(np.abs(new - weights)) < WEIGHT_TOLERANCE:
            break
        weights, triangle = new, problem.compress(new)
        theta = refined(theta)
    rmses = tuple(size * search.scale / np.sqrt(rows) for size, _ in reached)
    instants = None
    for _ in range(MAX_REWEIGHTINGS if between else 0):
        residual, linear = search.fitted(theta, triangle)
        responses = parametrization.responses(theta, linear[: parametrization.gains])
        found = fitted_instants(problem, records, drives, between, responses, residual)
        if found is None:
            # Nothing in the last fit asks for what the one before has in it.
            if instants is not None:
                instants, triangle = None, problem.compress(weights)
                theta = refined(theta)
            break
        if instants is None:
            # Rows behind a switch are no outliers beside its instant.
            weights = np.ones(rows)
        instants, before = found, theta
        if loss == "huber":
            new = _huber_weights(instants.left(residual, weights))
            weights = weights if new is None else new
        triangle = problem.compress(weights, (instants.columns, instants.noise))
        theta = refined(theta)
        if np.max(np.abs(theta - before), initial=0.0) < WEIGHT_TOLERANCE:
            break
    moving = [*drives, *without]
    levels = [max(float(np.max(np.abs(u))) for u in _inputs(records, d)) for d in moving]
    lags = problem
    if any(delays) or without:
        # What a calibration knows beyond its kind is told of the drives as they are.
        lags = CalibrationProblem.assemble(records, moving, output, free_start, (), states)
    if len(drives) > 1 and not without:
        ends = [each for each in within if is_sound(each)]
        others = [*others, *shared_otherwise(search, theta, ends, triangle)]
    return _described(
        search, theta, triangle, weights, duration, rmses, lags, np.array(levels), instants, others
    )


def _inputs(records: Sequence[Record], drive: Drive) -> list[Float]:
    """A drive in every record, relative to its reference."""
    return [relative(r.column(drive.channel), drive.reference, drive.hold) for r in records]


def _huber_weights(residual: Float) -> Float | None:
    """Weights of the squares; None where most of the residual is zero."""
    spread = robust_std(residual)
    if spread == 0:
        return None
    return np.minimum(1.0, HUBER_THRESHOLD * spread / np.maximum(np.abs(residual), 1e-300))


def _within(covariance: Float, known: Float | None) -> Float:
    """What of a covariance leaves sums of parameters as they are known, shape (f, f)."""
    if known is None:
        return covariance
    sums = known[:, : len(covariance)]
    free = np.eye(len(covariance)) - np.linalg.pinv(sums) @ sums
    return np.asarray(free @ covariance @ free)


def _described(
    search: StartSearch,
    theta: Float,
    triangle: Triangle,
    weights: Float,
    duration: float,
    starts: tuple[float, ...],
    undelayed: CalibrationProblem,
    levels: Float,
    instants: Instants | None,
    others: Sequence[Float],
) -> OutputFit:
    problem, parametrization = search.problem, search.parametrization
    residual, linear = search.fitted(theta, triangle)
    gains, fitted = parametrization.gains, parametrization.searched + parametrization.gains
    responses = parametrization.responses(theta, linear[:gains])
    names = parametrization.names()
    jacobian = problem.jacobian(parametrization, theta, linear)
    prior = np.append(np.full(len(theta), RATE_DEVIATION), np.full(len(linear), np.inf))
    rows = (jacobian, residual)
    if instants is not None:
        rows = (instants.whitened(jacobian), instants.whitened(residual))
    known = None
    if len(problem.known):
        known = problem.known_jacobian(parametrization, theta, linear)
    covariance = block_covariance(*rows, problem.record, weights, prior, known)
    # From here on every drive has rates of its own, though they be the same.
    apart = parametrization.apart
    shared = np.concatenate(parametrization.parts(np.arange(len(theta))))
    keep = [*shared, *range(len(theta), fitted), *range(-problem.records, 0)]
    rates, p = theta[shared], len(shared) + gains
    if parametrization.common:
        jacobian = problem.jacobian(apart, rates, linear)
    n = len(problem.grid.rates)
    # Slower than the record is no shape: it would pass for any drift.
    lags = np.flatnonzero(problem.grid.rates >= 1 / duration)
    bank = undelayed.design[:, np.concatenate([d * n + lags for d in range(undelayed.drives)])]
    own = np.zeros(undelayed.drives * n)
    own[: problem.drives * n] = parametrization.unit_weights(theta, problem.grid) @ linear[:gains]
    variation = float(np.linalg.norm(problem.measured - np.mean(problem.measured)))
    share = float(np.linalg.norm(residual)) / variation if variation else 1.0
    slack = discrepancy(
        problem.time,
        problem.record,
        residual,
        jacobian[:, :p],
        jacobian[:, p:],
        bank,
        instants,
        linear[:gains],
        np.append(
            np.repeat(levels[: problem.drives], [len(c.gains) for c in parametrization.classes]),
            np.repeat(levels, len(lags)),
        ),
        spread(problem.grid.rates, lags, duration, others, own),
        np.eye(fitted)[keep[:p]],
    )
    covariance[:fitted, :fitted] += _within(slack.confounded, known)
    # From logarithms to the parameters themselves.
    factor = np.concatenate([np.exp(theta), np.ones(len(linear))])
    covariance = covariance * np.outer(factor, factor)
    weak = unidentified(names, np.exp(theta), np.sqrt(np.diag(covariance)))
    covariance = covariance[np.ix_(keep, keep)]
    beside = residual if instants is None else residual - instants.columns @ slack.instants
    return OutputFit(
        responses=responses,
        names=(*apart.names(), *(f"offset[{k}]" for k in range(problem.records))),
        covariance=covariance,
        offsets=tuple(linear[-problem.records :].tolist()),
        rmse=float(np.sqrt(np.mean(residual**2))),
        max_error=float(np.max(np.abs(residual))),
        fit_percent=100 * (1 - share),
        unidentified=(
            *weak,
            *cancelling(search, theta, linear[:gains]),
            *unsettled(responses, apart, covariance, duration),
        ),
        starts=starts,
        covered=duration / max(response.slowest() for response in responses),
        discrepancy=slack,
        time_constants=tuple((1 / problem.grid.rates[lags]).tolist()),
        instants=0 if instants is None else instants.columns.shape[1],
        rmse_instants=None if instants is None else float(np.sqrt(np.mean(beside**2))),
    )
