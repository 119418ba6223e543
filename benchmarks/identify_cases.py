"""Random systems and records for the benchmarks of `identify`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from identify_peers import Array, Delays
from scipy.signal import lfilter

from thermaltool.record import Record

NOISE = 0.1
# Rows without input at the start of each record.
IDLE = 20
Truth = tuple[Array, Array, int]


def sampled(
    inputs: Sequence[str], u: Array, outputs: Sequence[str], y: Array, period: float,
    at_rest: bool = False,
) -> Record:  # fmt: skip
    """A record of plain arrays (m, n) and (p, n), or (n,) for one, on an even clock [s]."""
    u, y = np.atleast_2d(u), np.atleast_2d(y)
    columns = dict(zip((*inputs, *outputs), (*u, *y), strict=True))
    return Record(period * np.arange(float(y.shape[1])), columns, at_rest=at_rest)


def system(rng: np.random.Generator, k: int) -> Truth:
    """B, F, nk; every fourth is stiff (time constants 2.5 and 500 to 2000 samples)."""
    nk = int(rng.choice([1, 4, 7]))
    if k % 4 == 3:
        poles = np.exp(-1 / np.array([2.5, rng.uniform(500, 2000)]))
    elif k % 4 == 2:
        poles = np.exp(-1 / np.exp(rng.uniform(np.log(2), np.log(60), 2)))
    else:
        radius, angle = rng.uniform(0.6, 0.97), rng.uniform(0.05, 1.2)
        poles = radius * np.exp(1j * angle * np.array([1, -1]))
    F, B = np.poly(poles).real, rng.standard_normal(2)
    return B * rng.uniform(0.5, 3) * F.sum() / B.sum(), F, nk


def driven(rng: np.random.Generator, k: int, rows: int) -> Array:
    held = 50 if k % 4 == 3 else int(rng.choice([1, 5]))
    return np.repeat(rng.standard_normal(rows // held + 1), held)[:rows]


def response(truth: Truth, u: Array) -> Array:
    B, F, nk = truth
    return np.asarray(lfilter(np.concatenate([np.zeros(nk), B]), F, u))


def fit_percent(truth: Array, computed: Array) -> float:
    left = np.linalg.norm(truth - computed) / np.linalg.norm(truth - truth.mean())
    return 100 * (1 - float(left))


@dataclass(frozen=True)
class Case:
    """One record to fit and a fresh one without noise, both idle at first.

    Attributes
    ----------
    u, fresh : ndarray, shape (m, n)
    y : ndarray, shape (n,)
        With noise.
    answer : ndarray
        Of the true system to `fresh`.
    nk : tuple of int
    F : tuple of ndarray
        True denominators.
    bound : float [%]
        What the best unbiased estimate lacks to a fit of 100 % on the fresh record (root mean
        square over noise; Cramér and Rao).
    """

    u: Array
    y: Array
    fresh: Array
    answer: Array
    nk: Delays
    F: tuple[Array, ...]
    bound: float


def case(seed: int, k: int, rows: int, inputs: int = 1) -> Case:
    """Case k of a run: systems k, k + 1, ..., one for each input."""
    rng = np.random.default_rng([seed, k])
    truths = [system(rng, k + i) for i in range(inputs)]

    records = []
    for _ in range(2):
        u = np.array([driven(rng, k + i, rows) for i in range(inputs)])
        u[:, :IDLE] = 0.0
        parts = [response(t, each) for t, each in zip(truths, u, strict=True)]
        records.append((u, np.sum(parts, axis=0)))
    (u, x), (fresh, answer) = records
    y = x + NOISE * x.std() * rng.standard_normal(rows)
    bound = NOISE * x.std() * spread(truths, u, fresh) / np.linalg.norm(answer - answer.mean())
    _, F, nk = zip(*truths, strict=True)
    return Case(u, y, fresh, answer, nk, F, 100 * float(bound))


def spread(truths: list[Truth], u: Array, fresh: Array) -> float:
    """Root of the expected squared error on `fresh` after a fit to `u` in noise of one."""
    grams = []
    for inputs in (u, fresh):
        slopes = []
        for (B, F, nk), row in zip(truths, inputs, strict=True):
            by_b, by_f = lfilter([1.0], F, row), lfilter([-1.0], F, response((B, F, nk), row))
            slopes += [np.r_[np.zeros(nk + j), by_b][: len(row)] for j in range(len(B))]
            slopes += [np.r_[np.zeros(j), by_f][: len(row)] for j in range(1, len(F))]
        grams.append(np.array(slopes) @ np.array(slopes).T)
    return float(np.sqrt(np.trace(np.linalg.solve(*grams))))
