"""From logs to identified models of every output, whatever the structure."""

from __future__ import annotations

from collections.abc import Sequence

from thermaltool.fitting.data import even_training_data, training_data
from thermaltool.fitting.fit import Fit
from thermaltool.fitting.network.run import IdentifiedNetwork, NetworkPlan, run_network
from thermaltool.fitting.transfer.run import Identified, Plan, run
from thermaltool.record import Record


def identify(
    logs: Sequence[Record],
    inputs: Sequence[str],
    outputs: Sequence[str],
    plan: Plan | NetworkPlan,
    fresh: Sequence[Record] = (),
) -> tuple[Identified, ...] | IdentifiedNetwork:
    """A model for each output, or one network for all.

    Parameters
    ----------
    logs : sequence of Record
        Each an experiment with an offset of its own.
    inputs, outputs : sequence of str
        Channels that drive, and that follow.
    plan : Plan or NetworkPlan
        What is wanted of every output, or of the network.
    fresh : sequence of Record
        Validation data; without them those of the plan's split, if any.

    Raises
    ------
    FitError
        As `run` and `run_network`.
    """
    if isinstance(plan, NetworkPlan):
        held = training_data(fresh, inputs, outputs) if fresh else None
        return run_network(training_data(logs, inputs, outputs), plan, held)
    found = []
    for output in outputs:
        held = even_training_data(fresh, inputs, output) if fresh else None
        found.append(run(even_training_data(logs, inputs, output), plan, held))
    return tuple(found)


def fits_of(found: tuple[Identified, ...] | IdentifiedNetwork) -> list[Fit]:
    """Every output of a result."""
    if isinstance(found, tuple):
        return [Fit(e.model, e.continued, e.training, e.data, e.tests) for e in found]
    return [
        Fit(output, found.continuous_terms(k), found.training[k], found.data.measured(k),
            found.tests[k])
        for k, output in enumerate(found.network.outputs)
    ]  # fmt: skip
