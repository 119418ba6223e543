"""Orders of a transfer function."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property


@dataclass(frozen=True)
class Orders:
    """Orders of one model.

    Attributes
    ----------
    nb, nk : tuple of int
        For each input: coefficients of B, and samples of delay before the first.
    nf : tuple of int
        Order of each denominator: one for each group of inputs.
    groups : tuple of tuple of int
        Inputs that share a denominator.
    """

    nb: tuple[int, ...]
    nf: tuple[int, ...]
    nk: tuple[int, ...]
    groups: tuple[tuple[int, ...], ...]

    @cached_property
    def first(self) -> int:
        """First row whose inputs are all in the record."""
        return max(b + k for b, k in zip(self.nb, self.nk, strict=True)) - 1

    @cached_property
    def shortest(self) -> int:
        """A record of no more rows says nothing: its start takes them."""
        return self.first + sum(self.nf) + 1

    @cached_property
    def parameters(self) -> int:
        return sum(self.nb) + sum(self.nf)
