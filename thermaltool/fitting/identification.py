"""From logs to identified models of every output, whatever the structure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from thermaltool.fitting.data import TrainingData, even_training_data, training_data
from thermaltool.fitting.network.run import IdentifiedNetwork, NetworkPlan, run_network
from thermaltool.fitting.transfer.continuation import Continued
from thermaltool.fitting.transfer.machine import Identity, in_use, machine
from thermaltool.fitting.transfer.run import Identified, Plan, run
from thermaltool.model import Model
from thermaltool.record import Record
from thermaltool.signals.agreement import Agreement
from thermaltool.units import Reference


@dataclass(frozen=True)
class OutputIdentity:
    """One identified output, as a model document takes it.

    Attributes
    ----------
    model : TransferModel or NetworkOutput
    terms : tuple of Continued or str
        The response to each input in continuous time, or why there is none.
    training : Agreement
        Of the free run over the training data.
    data : TrainingData
        What it was fitted to.
    """

    model: Identity
    terms: tuple[Continued | str, ...]
    training: Agreement
    data: TrainingData

    @property
    def estimates(self) -> Mapping[str, Any]:
        """Every fitted parameter by name, each an `Estimate`."""
        return dict(self.model.named())


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


def identities(found: tuple[Identified, ...] | IdentifiedNetwork) -> list[OutputIdentity]:
    """Every output of a result."""
    if isinstance(found, tuple):
        return [OutputIdentity(e.model, e.continued, e.training, e.data) for e in found]
    return [
        OutputIdentity(output, found.continuous_terms(k), found.training[k], found.data.measured(k))
        for k, output in enumerate(found.network.outputs)
    ]


def document(
    found: Sequence[OutputIdentity], reference: Reference | None, provenance: Mapping[str, Any]
) -> Model:
    """The model document of all outputs; see `machine`."""
    parts = [(each.model, each.terms, each.training, each.data) for each in found]
    return machine(parts, reference, provenance)


def from_rest(found: Sequence[OutputIdentity], model: Model) -> list[Agreement]:
    """How the document fits the training data of each output from rest; see `in_use`."""
    return [in_use(model, each.data) for each in found]
