"""How the inputs of a log move together, for a model document."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.selection import BLOCKS
from thermaltool.model import rest_level
from thermaltool.model.redundancy import Redundancy
from thermaltool.units import Reference


def redundancy_of(data: TrainingData, rests: list[Reference]) -> Redundancy:
    """Second moments of the inputs about rest, and how far each is from what the others say.

    The latter over blocks of each log that were left out of the moments, in turn.

    Parameters
    ----------
    data : TrainingData
    rests : list of "first" or float
        What counts as no input, of each.
    """
    begins = data.begins
    parts = []
    for record, u in zip(data.records, data.u, strict=True):
        first = data.u[begins[record.origin]]
        levels = [rest_level(v, rest, hold)
                  for v, rest, hold in zip(first, rests, data.holds, strict=True)]  # fmt: skip
        parts.append(u - np.array(levels)[:, None])
    whole = np.hstack(parts)
    m, n = whole.shape
    found = Redundancy(data.inputs, whole @ whole.T / n, (0.0,) * m)
    squares, rows = np.zeros(m), 0
    for part in np.array_split(np.arange(n), BLOCKS):
        rest: Array = np.delete(whole, part, axis=1)
        if not len(part) or not rest.size:
            continue
        trained = replace(found, moments=rest @ rest.T / rest.shape[1])
        held = whole[:, part]
        for k in range(m):
            weights = trained.expectation([k])[0][0]
            squares[k] += np.sum((held[k] - weights @ held) ** 2)
        rows += len(part)
    return replace(found, errors=tuple(np.sqrt(squares / max(rows, 1)).tolist()))
