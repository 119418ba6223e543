"""Choices of kinds of response side by side, with what each is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from thermaltool.fitting.candidate_data import MIN_EXCESS
from thermaltool.fitting.projection import surroundings
from thermaltool.fitting.sound_kinds import DECISIVE
from thermaltool.model import Drive
from thermaltool.responses.modes import Float

# Diffusion through a plate without ends; and through one with two faces, which is tried for one
# drive beside it, or where none of the others follows the output with as few parameters.
PLATE, SLAB = "conduction", "slab"
# Diffusion along a bar with insulated ends: for a temperature that is that of no slab.
ROD = "rod"
# In place of a kind: these records show no response to the drive.
LEFT_OUT = "none"
# What is said of the one that is taken.
WHY_ALONE = "chosen: no other is as good"
WHY_SIMPLEST = "chosen: the fewest parameters among those that are as good"
WHY_FEWEST = "chosen: the fewest time constants among those that are as good"
WHY_ALIKE = "chosen: as good, and another output needs it"
WORSE_UNSEEN = "predicts held-out rows worse"
WHY_KEPT = "chosen: what else is sound predicts held-out rows worse"
MORE_PARAMETERS = "more parameters"
MORE_TIME_CONSTANTS = "more time constants"


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
    theta : ndarray, shape (searched,), optional
        Logarithms of the rates and shapes of the drives that act.
    common : bool
        Whether these drives share their rates.
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
    theta: Float | None = field(default=None, compare=False, repr=False)
    common: bool = False

    def document(self) -> dict[str, Any]:
        """As JSON."""
        own = asdict(replace(self, weights=None, theta=None))
        del own["weights"], own["theta"]
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
        label = parts[0] if len(set(parts)) == 1 else " + ".join(parts)
        return f"{label}, common" if self.common else label


def complexity(kinds: Sequence[str], theta: Float | None, parameters: int) -> tuple[int, int]:
    """Time constants and shapes of several drives, then parameters: what is simpler comes first.

    Parts of one body have its time constants, whatever moves it: few of them for all drives.

    Parameters
    ----------
    kinds : sequence of str, one for each drive
    theta : ndarray, shape (searched,), optional
    parameters : int
    """
    return 0 if theta is None or len(kinds) < 2 else len(theta), parameters


def with_kept(
    found: Sequence[KindCandidate], kinds: Sequence[str], delays: Sequence[float], common: bool
) -> tuple[KindCandidate, ...]:
    """The same with some kinds as the chosen ones; as it is where they were not tried.

    Parameters
    ----------
    found : sequence of KindCandidate
    kinds, delays
        Of every drive; where there is a delay it may be another one now.
    common : bool
    """

    def form(kinds: Sequence[str], delays: Sequence[float], common: bool) -> tuple[object, ...]:
        return (*kinds, *(delay > 0 for delay in delays), common)

    own = form(kinds, delays, common)
    same = [form(each.kinds, each.delays, each.common) == own for each in found]
    if not any(same):
        return tuple(found)
    return tuple(
        replace(each, chosen=True, note=WHY_KEPT)
        if is_kept
        else replace(each, chosen=False, note=WORSE_UNSEEN if each.chosen else each.note)
        for each, is_kept in zip(found, same, strict=True)
    )


def is_as_good(
    found: Sequence[KindCandidate], others: Sequence[KindCandidate], noise: float
) -> bool:
    """Whether what is chosen is no less simple than what is chosen of others, nor has more error.

    Parameters
    ----------
    found, others : sequence of KindCandidate
    noise : float [unit of the output]
        Of a reading.
    """
    own, other = (next(each for each in tried if each.chosen) for tried in (found, others))
    excess = own.rmse**2 - other.rmse**2
    simple, usual = (complexity(each.kinds, each.theta, each.parameters) for each in (own, other))
    return simple <= usual and excess <= (MIN_EXCESS * noise) ** 2


def denies_equilibrium(
    found: Sequence[KindCandidate], drives: Sequence[Drive], output: str
) -> bool:
    """Whether an output was found not to take the temperature of its surroundings.

    Parameters
    ----------
    found : sequence of KindCandidate
    drives : sequence of Drive
    output : str
    """
    around = surroundings(drives, output)
    return any(
        each.chosen and not each.equilibrium and any(each.kinds[d] != LEFT_OUT for d in around)
        for each in found
    )


def near_weights(tried: Sequence[KindCandidate], drives: Sequence[int]) -> list[Float]:
    """Grid weights of what comes near; none where one drive moves alone.

    What several drives do together may be shared in other ways. A response to one is seen itself.
    Those of the chosen kinds are among them, where a coarse search left them. Where these leave a
    drive out, kinds of more parameters may give it anything: only those count that are not
    decisively less likely.

    Parameters
    ----------
    tried : sequence of KindCandidate
    drives : sequence of int
        By number, in the order of the weights.
    """
    taken = next((each for each in tried if each.chosen), None)
    if taken is None or len(drives) < 2:
        return []
    most = taken.criterion + DECISIVE if LEFT_OUT in taken.kinds else np.inf
    return [
        each.weights[drives]
        for each in tried
        if each.weights is not None and each.delays == taken.delays and each.criterion <= most
    ]


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
