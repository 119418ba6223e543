"""Training data from plain arrays on an even clock."""

from __future__ import annotations

import numpy as np

from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.transfer.registry import structure_of
from thermaltool.record import Record


def sampled(inputs, u, outputs, y, period, **options):
    """A record of plain arrays (m, n) and (p, n), or (n,) for one, on an even clock."""
    u, y = np.atleast_2d(u), np.atleast_2d(y)
    columns = dict(zip((*inputs, *outputs), (*u, *y), strict=True))
    return Record(period * np.arange(float(y.shape[1])), columns, **options)


def training(*pieces, period=1.0, inputs=None, outputs=("y",), holds=()):
    """Of pieces (u, y), (u, y, experiment) or (u, y, experiment, at rest)."""
    first = np.atleast_2d(pieces[0][0])
    names = inputs or tuple(f"u{k}" for k in range(len(first)))
    records = []
    for u, y, *more in pieces:
        origin, at_rest = (*more, 0, False)[:2] if len(more) < 2 else more
        records.append(
            sampled(names, u, outputs, y, period, origin=int(origin), at_rest=bool(at_rest))
        )
    return TrainingData(tuple(records), names, outputs, period, holds)


def fitted(data, name, nb, nf, nk, **options):
    """The model of a structure by its name and orders; options as of `structure_of`."""
    structure = structure_of(name, **options)
    return structure.fit(data, structure.orders(nb, nf, nk))
