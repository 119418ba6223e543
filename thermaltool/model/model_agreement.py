"""How a model agrees with logs, as `simulate` runs it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from thermaltool.model.initial_state import Start, started_outputs
from thermaltool.record import Record
from thermaltool.signals.agreement import Agreement, agreement

if TYPE_CHECKING:
    from thermaltool.model.document import Model, Output


def agreements(
    model: Model,
    records: Sequence[Record],
    outputs: Sequence[Output] | None = None,
    initial: Start = "auto",
) -> dict[str, Agreement]:
    """Agreement of every output over all records, as `simulate` has it.

    Parameters
    ----------
    model : Model
    records : sequence of Record
        With the drives, what the effects need, and the outputs.
    outputs : sequence of Output, optional
        Default: all of the model.
    initial : {"auto", "rest", "free"}
        See `started_outputs`.
    """
    runs = [
        (record, started_outputs(model, record, model.simulate(record), initial))
        for record in records
    ]
    return {
        o.channel: agreement(
            np.concatenate(
                [record.column(o.channel) - run[o.channel].zero.value for record, run in runs]
            ),
            np.concatenate([run[o.channel].computed for _, run in runs]),
        )
        for o in (model.outputs if outputs is None else outputs)
    }
