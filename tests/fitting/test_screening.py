"""Screening on a plant of sixteen heaters and their copies, of numpy alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from thermaltool.errors import FitError
from thermaltool.fitting.data import even_training_data
from thermaltool.fitting.screening import MIN_EVIDENCE, screen, screen_all
from thermaltool.record import Record

ROWS, NAMES = 2000, [f"Q_h{k}_W" for k in range(16)]
FOLLOWED = (3, 7, 12)


def heaters(rng, inputs=16):
    """Powers that change every 10 to 100 rows."""
    steps = [np.repeat(rng.uniform(0, 1, 400), rng.integers(10, 100, 400))[:ROWS]
             for _ in range(inputs)]  # fmt: skip
    return np.array(steps)


def answer(rng, u, gains=(1.0, -0.6, 0.3), taus=(80.0, 12.0, 40.0), colour=0.0):
    y = np.zeros(ROWS)
    for k, gain, tau in zip(FOLLOWED, gains, taus, strict=True):
        a = np.exp(-1 / tau)
        y += gain * lfilter([0, 1 - a], [1, -a], u[k] - u[k, 0])
    noise = lfilter([np.sqrt(1 - colour**2)], [1, -colour], rng.standard_normal(ROWS))
    return y + 0.1 * y.std() * noise


def data_of(u, *outputs, names=None):
    names = names or NAMES[: len(u)]
    targets = [f"T_{k}_degC" for k in range(len(outputs))]
    columns = dict(zip([*names, *targets], [*u, *outputs], strict=True))
    record = Record(np.arange(float(ROWS)), columns)
    return [even_training_data([record], names, (target,)) for target in targets]


@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_what_matters_is_kept(colour):
    rng = np.random.default_rng(1795573001)
    u = heaters(rng)
    kept, left_out = screen(data_of(u, answer(rng, u, colour=colour))[0])
    assert {NAMES[k] for k in FOLLOWED} <= set(kept)
    assert len(kept) <= 5
    assert all(each.evidence < MIN_EVIDENCE and not each.same_as for each in left_out)
    assert {*kept, *(each.name for each in left_out)} == set(NAMES)


def test_one_of_two_copies_is_kept():
    rng = np.random.default_rng(1795573002)
    u = heaters(rng)
    u[5] = 2 * u[3] + 0.01 * rng.standard_normal(ROWS)
    kept, left_out = screen(data_of(u, answer(rng, u))[0])
    assert len({NAMES[3], NAMES[5]} & set(kept)) == 1
    (copy,) = [each for each in left_out if each.same_as]
    assert {copy.name, copy.same_as} == {NAMES[3], NAMES[5]}


def test_all_are_kept_where_all_matter():
    rng = np.random.default_rng(1795573003)
    u = heaters(rng, 8)
    y = sum(lfilter([0, 0.1], [1, -0.9], row - row[0]) for row in u[4:])
    y = y + answer(rng, np.vstack([u[:4], u[:4], u, u])) + 0.3 * (u[0] + u[1] + u[2])
    assert screen(data_of(u, y)[0]) == (tuple(NAMES[:8]), ())


def test_an_input_that_stands_still_is_left_out_without_evidence():
    rng = np.random.default_rng(1795573004)
    u = heaters(rng)
    u[9] = 0.7
    _, left_out = screen(data_of(u, answer(rng, u))[0])
    assert [each.name for each in left_out if each.evidence is None] == [NAMES[9]]
    with pytest.raises(FitError, match="no input excites"):
        screen(data_of(np.ones((8, ROWS)), answer(rng, u))[0])


def test_few_rows_leave_all_and_slow_errors_what_matters():
    rng = np.random.default_rng(1795573005)
    u = heaters(rng)
    y = answer(rng, u)
    short = data_of(u, y)[0]
    short = short.split(0.1).fitted
    assert screen(short)[0] == tuple(NAMES)
    slow = lfilter([1.0], [1, -0.998], rng.standard_normal(ROWS))
    drifting = y + y.std() * slow / slow.std()
    assert {NAMES[k] for k in FOLLOWED} <= set(screen(data_of(u, drifting)[0])[0])


def test_holes_of_the_output_and_two_outputs():
    """What one output follows stays for both."""
    rng = np.random.default_rng(1795573006)
    u = heaters(rng)
    first, second = answer(rng, u), lfilter([0, 0.05], [1, -0.95], u[0] - u[0, 0])
    second = second + 0.05 * rng.standard_normal(ROWS)
    first[700:760] = np.nan
    kept, left_out = screen_all(data_of(u, first, second))
    assert {NAMES[0], *(NAMES[k] for k in FOLLOWED)} <= set(kept)
    assert len(kept) + len(left_out) == 16
