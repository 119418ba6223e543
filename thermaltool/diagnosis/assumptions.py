"""What a model may say for itself beside a cause, by name."""

from __future__ import annotations

# What is left free: groups of nuisance in use ("offset", "accepted", "effects", "tight" or
# "released", "uniform", "modes" or "initial", "instants", "earlier"), and "white" where what is
# left over is taken for white noise.
Assumptions = frozenset[str]
# How a log may begin away from rest, the plainest first: as a whole warmer than its surroundings,
# in any state of the modes of its model, anyhow.
WAYS_TO_BEGIN = ("uniform", "modes", "initial")
STARTS: Assumptions = frozenset(WAYS_TO_BEGIN)


def start_rank(assumptions: Assumptions) -> int:
    """Place of a start among the `WAYS_TO_BEGIN`; -1 for rest.

    Parameters
    ----------
    assumptions : frozenset of str
    """
    return max((k for k, way in enumerate(WAYS_TO_BEGIN) if way in assumptions), default=-1)


def started(assumptions: Assumptions) -> list[Assumptions]:
    """The assumptions with each way to begin away from rest that is less plain than theirs.

    A model whose parameters are free has no modes of its own: these bend to what a cause does.

    Parameters
    ----------
    assumptions : frozenset of str
    """
    further = WAYS_TO_BEGIN[start_rank(assumptions) + 1 :]
    known = [way for way in further if way != "modes" or "released" not in assumptions]
    return [(assumptions - STARTS) | {way} for way in known]


def is_plainer(assumptions: Assumptions, others: Assumptions) -> bool:
    """Whether assumptions differ from others by a plainer start, or none, alone.

    Parameters
    ----------
    assumptions, others : frozenset of str
    """
    same = assumptions - STARTS == others - STARTS
    return same and start_rank(assumptions) < start_rank(others)


def released(assumptions: Assumptions) -> Assumptions:
    """The assumptions with the model's own parameters free.

    Parameters
    ----------
    assumptions : frozenset of str
    """
    return (assumptions - {"tight"}) | {"released"}
