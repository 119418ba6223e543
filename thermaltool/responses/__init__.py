"""Responses: every linear block, each with three faces derived from the same parameters.

``transfer(s)``, ``step(t)``, and ``modes(dt)`` whose `Modes.discretize` is the recursion. A new
physical model is one file that provides them and a line in `KINDS`; ``tests/responses`` runs the
shared checks on every kind listed here.
"""

from __future__ import annotations

import importlib
from typing import Any, ClassVar, Protocol

from thermaltool.errors import ModelError
from thermaltool.responses.modes import Complex, Float, Modes, Range

# kind -> module:class; imported on use, so that the stream needs no Bessel functions.
KINDS: dict[str, str] = {
    "conduction": "thermaltool.responses.conduction:Conduction",
    "slab": "thermaltool.responses.slab:Slab",
    "rod": "thermaltool.responses.rod:Rod",
    "deflection": "thermaltool.responses.deflection:Deflection",
    "joint_deflection": "thermaltool.responses.deflection:JointDeflection",
    "rational1": "thermaltool.responses.rational:Rational1",
    "rational2": "thermaltool.responses.rational:Rational2",
    "rational3": "thermaltool.responses.rational:Rational3",
    "rational4": "thermaltool.responses.rational:Rational4",
    "rational5": "thermaltool.responses.rational:Rational5",
    "rational6": "thermaltool.responses.rational:Rational6",
    "oscillation": "thermaltool.responses.rational:Oscillation",
    "oscillation1": "thermaltool.responses.rational:Oscillation1",
    "oscillation2": "thermaltool.responses.rational:Oscillation2",
}
# Behind the name of a kind, of one that has come to lose heat otherwise.
CHANGED = "_loss"
# Of the family of rational kinds with more poles, or with feedthrough, those that the shared checks
# run on: `response_class` knows all.
MORE_RATIONAL = ("rational9", "rational1_direct", "rational4_direct", "oscillation_direct",
                 "oscillations2_0", "oscillations3_2_direct")  # fmt: skip


class Response(Protocol):
    """One linear block. Parameters are attributes; see `Conduction` for the conventions.

    `searched` are the parameters that enter nonlinearly (all positive: searched as logarithms),
    `gains` those that enter linearly, `fixed` those that a fit leaves alone, with their defaults.
    A kind may have `unit_steps`, the steps of all gains at once (see `Rational`): a search is
    several times as fast.
    """

    kind: ClassVar[str]
    searched: ClassVar[tuple[str, ...]]
    gains: ClassVar[tuple[str, ...]]
    fixed: ClassVar[dict[str, float]]

    def transfer(self, s: Complex) -> Complex:
        """H at complex frequencies [rad/s]."""

    def step(self, t: Float) -> Float:
        """Unit-step response at times [s]."""

    def dc_gain(self) -> float:
        """H(0)."""

    def slowest(self) -> float:
        """Slowest time constant [s]."""

    def modes(self, dt: float) -> Modes:
        """The response as modes, for samples of `dt` [s] or longer."""

    @classmethod
    def search_box(cls, period: float, duration: float, **fixed: float) -> dict[str, Range]:
        """Where a fit looks for each of `searched`."""

    @classmethod
    def starts(cls, period: float, duration: float, **fixed: float) -> list[tuple[float, ...]]:
        """Where a fit starts, each a value for each of `searched`."""


def response_class(kind: str) -> Any:
    """The class of a kind by name.

    Parameters
    ----------
    kind : str

    Raises
    ------
    ModelError
        Unknown kind; the message lists the known ones.
    """
    if kind not in KINDS:
        from thermaltool.responses.rational import rational_by_name

        found = rational_by_name(kind)
        if found is not None:
            return found
        before = kind.removesuffix(CHANGED)
        if before != kind and not before.endswith(CHANGED):
            from thermaltool.responses.losing import losing_kind

            return losing_kind(response_class(before))
        raise ModelError(f"unknown response {kind!r}; known: {', '.join(KINDS)}")
    module, _, name = KINDS[kind].partition(":")
    return getattr(importlib.import_module(module), name)


def parameter_names(kind: str) -> tuple[str, ...]:
    """All parameters of a kind: searched, gains, fixed.

    Parameters
    ----------
    kind : str
    """
    cls = response_class(kind)
    return (*cls.searched, *cls.gains, *cls.fixed)
