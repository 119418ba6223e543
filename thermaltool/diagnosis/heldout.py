"""What a cause is worth on data that its fit has not seen.

Each log is cut into blocks of time; every block is predicted, free running, by a fit to all other
rows: the model's own parameters within their prior and the parameters of its effects, around the
full fit. Places that were found by scanning (the instant of a step) stay where they are. The
interval of the gain is that of a bootstrap over shorter blocks, so that slow errors count in full.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from thermaltool.diagnosis.result import Gain
from thermaltool.diagnosis.workbench import Series, Workbench
from thermaltool.effects.effect import Float
from thermaltool.signals.agreement import agreement
from thermaltool.signals.likelihood import ColouredNoise
from thermaltool.units import is_displacement

FOLDS = 6
# Blocks of the bootstrap, and draws.
BLOCKS, DRAWS = 36, 2000


def gains(
    before: Workbench,
    after: Workbench,
    simulated: tuple[Workbench, Workbench] | None = None,
    seed: int = 0,
) -> dict[str, Gain]:
    """Gain of every output by blocked cross-validation.

    Parameters
    ----------
    before, after : Workbench
        On the same logs; `after` has one cause more.
    simulated : (Workbench, Workbench), optional
        The same with the models as a user simulates them, without what the calibration knows of a
        response beyond its kind: gains of these are told.
    seed : int
        Of the bootstrap.
    """
    result = {}
    # Where nothing says how large a slow discrepancy may be, it would bridge short stretches.
    events = "tight" in after.state and any(e.event for e in after.model.effects)
    for output, seen in before.observed.items():
        measured = seen.whole([m.get(output, np.zeros(0)) for m in before.measured])
        errors = []
        for k, bench in enumerate((before, after)):
            error = _predicted(bench, output, events, simulated is not None)
            if simulated is not None:
                known = seen.whole([y[output] for y in bench.outputs])
                plain = seen.whole([y[output] for y in simulated[k].outputs])
                error = _centred(bench, output, error + known - plain)
            errors.append(error)
        result[output] = compare(measured, errors[0], errors[1], seed)
    return result


def _centred(bench: Workbench, output: str, error: Float) -> Float:
    """Without its mean in every log, as an offset is free in every log."""
    lengths = [len(rows) for rows in bench.observed[output].rows]
    parts = np.split(error, np.cumsum(lengths)[:-1])
    return np.concatenate([part - part.mean() if len(part) else part for part in parts])


def transferred(before: Workbench, after: Workbench, seed: int = 0) -> dict[str, Gain]:
    """Gain of every output on logs that no fit has seen: both models as they stand."""
    result = {}
    for output, seen in before.observed.items():
        measured = seen.whole([m.get(output, np.zeros(0)) for m in before.measured])
        old, new = (
            seen.whole(_levelled(bench.residual(output), output)) for bench in (before, after)
        )
        result[output] = compare(measured, old, new, seed)
    return result


def _levelled(residual: Series, output: str) -> Series:
    """The zero of a displacement is arbitrary in every log."""
    if not is_displacement(output):
        return residual
    return [r - np.nanmean(r) if np.isfinite(r).any() else r for r in residual]


def compare(measured: Float, before: Float, after: Float, seed: int) -> Gain:
    """Gain of errors `after` over errors `before`, shape (n,), with its bootstrap interval."""
    blocks = min(BLOCKS, len(measured))
    edges = np.arange(blocks) * len(measured) // blocks
    counts = np.diff(np.append(edges, len(measured)))
    squares = np.add.reduceat(np.column_stack([before**2, after**2]), edges)
    draws = np.random.default_rng(seed).integers(0, blocks, (DRAWS, blocks))
    means = np.sqrt(squares[draws].sum(1) / counts[draws].sum(1)[:, None])
    low, high = np.quantile(means[:, 0] - means[:, 1], [0.025, 0.975])
    a, b = agreement(measured, measured - before), agreement(measured, measured - after)
    return Gain(
        a.rmse,
        b.rmse,
        a.max_error,
        b.max_error,
        a.fit_percent,
        b.fit_percent,
        (float(low), float(high)),
    )


def _predicted(bench: Workbench, output: str, events: bool, told: bool) -> Float:
    """Error of every row, predicted from the other blocks; shape (rows,).

    What is `told` is what the extended model predicts. Whether a cause helps is judged beside what
    the calibration leaves open, which the other blocks say.
    """
    seen, evidence = bench.observed[output], bench.evidence[output]
    columns, prior, centre = _columns(bench, output)
    kept = _kept(bench, output) if told else _all
    table = [np.column_stack(pair) for pair in zip(bench.residual(output), columns, strict=True)]
    base = evidence.base(bench.state)
    level = evidence.levels[base.level]
    prior = prior * base.white**2
    coarse, fine = seen.gather(table), seen.whole(table)
    error = np.empty(len(fine))
    group = np.repeat(np.arange(seen.size), np.diff(np.append(seen.first, len(fine))))
    for k in range(len(bench.logs)):
        blocks = _blocks(np.flatnonzero(seen.owner == k), events)
        for fold in _folds(blocks):
            # Nothing but the first block says what the start was like: it stays in the fit.
            held = np.setdiff1d(fold, blocks[0]) if "initial" in bench.state else fold
            rest = np.setdiff1d(np.arange(seen.size), held)
            shift = _fit(bench, output, coarse, rest, (level.ratio, level.tau), prior, centre)
            rows = np.isin(group, fold)
            error[rows] = fine[rows, 0] - fine[rows, 1:] @ kept(shift)
    return error


def _blocks(rows: np.ndarray, events: bool) -> list[np.ndarray]:
    """Stretches of one log, shorter ones where something happened at an instant.

    What happened late would else have all that it changed in one block.
    """
    count = min(FOLDS * FOLDS if events else FOLDS, len(rows))
    return np.array_split(rows, count) if count else []


def _folds(blocks: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Rows that are held out together: every so many-th block."""
    return [np.concatenate(blocks[k::FOLDS]) for k in range(min(FOLDS, len(blocks)))]


def _fit(
    bench: Workbench,
    output: str,
    table: Float,
    kept: np.ndarray,
    noise: tuple[float, float],
    prior: Float,
    centre: Float,
) -> Float:
    """Generalized least squares on some rows."""
    seen = bench.observed[output]
    owners = seen.owner[kept]
    starts = np.flatnonzero(np.diff(owners, prepend=-1))
    coloured = ColouredNoise(seen.time[kept], starts, seen.share[kept], seen.noise.period)
    rows = table[kept]
    gram = rows.T @ coloured.factor(*noise).solve(rows)
    A = gram[1:, 1:] + np.diag(prior)
    size = np.sqrt(np.diag(A))
    size[size == 0] = 1.0
    inner = np.linalg.pinv(A / np.outer(size, size), rcond=1e-12, hermitian=True)
    return np.asarray((inner @ ((gram[0, 1:] - prior * centre) / size)) / size)


def _columns(bench: Workbench, output: str) -> tuple[Series, Float, Float]:
    """Sensitivities (n, c) of each log that a fold may use; precision and centre of their priors.

    Of the offsets, of the effects, of what the calibration leaves open, of the start.
    """
    seen = bench.observed[output]
    present = [k for k, rows in enumerate(seen.rows) if len(rows)]
    offsets = bench.offsets()
    flat = [*(offsets[k] for k in present), *bench.accepted(output).values()]
    prior = bench.prior(output, "released" in bench.state)
    extra = bench.decays(output) if "initial" in bench.state else []
    columns = [
        np.column_stack([*(c[k] for c in flat), own @ prior.root, *(c[k] for c in extra)])
        for k, own in enumerate(bench.movements(output))
    ]
    free, known = np.zeros(len(flat)), np.zeros(len(extra))
    precision = np.concatenate([free, np.ones_like(prior.centre), np.ones(len(extra))])
    return columns, precision, np.concatenate([free, prior.centre, known])


def _all(shift: Float) -> Float:
    return shift


def _kept(bench: Workbench, output: str) -> Callable[[Float], Float]:
    """Takes out of a fit what the extended model does not hold."""
    present = sum(1 for rows in bench.observed[output].rows if len(rows))
    flat = present + len(bench.accepted(output))
    prior = bench.prior(output, "released" in bench.state)
    p = len(bench.own(output))

    def only(shift: Float) -> Float:
        result = shift.copy()
        mixed = slice(flat, flat + len(prior.centre))
        moves = prior.root @ shift[mixed]
        # Where they are free, the parameters of the model move; the lags beside them never do.
        moves[p if "released" in bench.state else 0 :] = 0.0
        result[mixed] = prior.inverse @ moves
        return result

    return only
