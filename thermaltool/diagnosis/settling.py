"""The model's own parameters, moved to where the logs want them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from thermaltool.diagnosis.workbench import Workbench
from thermaltool.model import Model

Ready = Callable[[Model], Workbench]

# Steps of the search.
STEPS = 6


def settled(model: Model, ready: Ready) -> Model:
    """The model with its own parameters searched, beside the effects that it holds.

    Parameters
    ----------
    model : Model
    ready : callable
        The weighed workbench of a model, its parameters free.
    """
    bench = ready(model)
    for _ in range(STEPS):
        steps = {output: _own_steps(bench, output) for output in bench.evidence}
        if not any(np.any(np.abs(step) > 1e-3) for step in steps.values()):
            break
        for share in (1.0, 0.3, 0.1):
            moved = _moved(bench, steps, share, ready)
            if moved is not None and _unexplained(moved) < _unexplained(bench) - 0.1:
                bench = moved
                break
        else:
            break
    return bench.model


def _own_steps(bench: Workbench, output: str) -> np.ndarray:
    """Moves of an output's own parameters that its residual asks for, none too long."""
    evidence, own = bench.evidence[output], bench.own(output)
    base = evidence.base(bench.state)
    names = np.array(evidence.names)[base.active]
    root = bench.prior(output, True).root[: len(own)]
    steps = root @ base.fitted[base.level][names == "released"]
    logs = [abs(s) for s, each in zip(steps, own, strict=True) if each.log]
    return np.asarray(steps * min(1.0, 0.7 / max([*logs, 1e-12])))


def _moved(
    bench: Workbench, steps: Mapping[str, np.ndarray], share: float, ready: Ready
) -> Workbench | None:
    """The workbench with own parameters moved; None where a response does not allow it."""
    model = bench.model
    try:
        for output, step in steps.items():
            own = bench.own(output)
            moved = bench.moved(own, share * step)
            terms = {each.term for each in own}
            model = replace(
                model,
                terms=tuple(
                    moved.terms[k] if k in terms else term for k, term in enumerate(model.terms)
                ),
            )
        return ready(model)
    except (ValueError, np.linalg.LinAlgError):
        return None


def _unexplained(bench: Workbench) -> float:
    """Negative log likelihood with the model's own parameters where they stand."""
    fixed = bench.state - {"released"}
    return sum(e.base(fixed).best for e in bench.evidence.values())
