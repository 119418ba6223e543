"""Choices of kinds of response side by side, with what each is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from thermaltool.responses.modes import Float

# Diffusion through a plate without ends; and through one with two faces, which is tried for one
# drive beside it, or where none of the others follows the output with as few parameters.
PLATE, SLAB = "conduction", "slab"
# Diffusion along a bar with insulated ends: for a temperature that is that of no slab.
ROD = "rod"
# What is said of the one that is taken.
WHY_ALONE = "chosen: no other is as good"
WHY_SIMPLEST = "chosen: the fewest parameters among those that are as good"
WHY_ALIKE = "chosen: as good, and another output needs it"
MORE_PARAMETERS = "more parameters"


@dataclass(frozen=True)
class KindCandidate:
    """One choice of kinds, and what it is worth.

    Attributes
    ----------
    kinds : tuple of str, one for each drive
    delays : tuple of float [s]
    parameters : int
        Fitted ones, without offsets.
    rmse : float [unit of the output]
        Of the means over groups of rows.
    held_out : float or None [unit of the output]
        The same of rows that the fit has not seen; None where evidence has ruled it out before.
    criterion : float
        Above the least of all candidates.
    cancellation : float
        Size of the largest term over that of the output.
    note : str
        Why it is not taken, or why it is.
    chosen : bool
    equilibrium : bool
        Whether gains to all temperatures among the drives add up to one.
    weights : ndarray, shape (drives, rates), optional
        Of every rate of the calibration's grid, of one that comes as near as a reading's noise to
        the nearest.
    """

    kinds: tuple[str, ...]
    delays: tuple[float, ...]
    parameters: int
    rmse: float
    held_out: float | None
    criterion: float
    cancellation: float
    note: str = ""
    chosen: bool = False
    equilibrium: bool = False
    weights: Float | None = field(default=None, compare=False, repr=False)

    def document(self) -> dict[str, Any]:
        """As JSON."""
        own = asdict(replace(self, weights=None))
        del own["weights"]
        return {
            **own,
            "label": self.label,
            "kinds": list(self.kinds),
            "delays": list(self.delays),
        }

    @property
    def label(self) -> str:
        """The kinds, with their delays."""
        parts = [
            f"{kind} delay={delay:.4g}" if delay else kind
            for kind, delay in zip(self.kinds, self.delays, strict=True)
        ]
        return parts[0] if len(set(parts)) == 1 else " + ".join(parts)


def of_one_body(
    choices: Sequence[tuple[KindCandidate, ...]],
) -> list[tuple[KindCandidate, ...]]:
    """Choices of several outputs; where one of them needs a slab, it is no plate for another.

    What a slab and a plate without ends differ by is slow, and shows on other logs.

    Parameters
    ----------
    choices : sequence of tuple of KindCandidate
        What `choose_response` gives for each output.
    """
    if not any(
        each.chosen and each.kinds == (SLAB,) and each.note == WHY_ALONE
        for own in choices
        for each in own
    ):
        return list(choices)
    return [_with_slab(own) for own in choices]


def _with_slab(own: tuple[KindCandidate, ...]) -> tuple[KindCandidate, ...]:
    """The slab in place of the plate where it is as good."""
    good = [each for each in own if each.kinds == (SLAB,) and each.note == MORE_PARAMETERS]
    plate = [each for each in own if each.chosen and each.kinds == (PLATE,)]
    if not good or not plate:
        return own
    swapped = {
        good[0]: replace(good[0], note=WHY_ALIKE, chosen=True),
        plate[0]: replace(plate[0], note="another output needs a slab", chosen=False),
    }
    return tuple(swapped.get(each, each) for each in own)
