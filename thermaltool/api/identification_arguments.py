"""Arguments of `identify` that contradict each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from thermaltool.fitting.transfer.registry import CONTINUOUS, MAX_MODES, STRUCTURES

if TYPE_CHECKING:
    from thermaltool.fitting.components.reduction import Reduction

NETWORK, SUBSPACE, COMPONENTS = "network", "subspace", "components"
# Parameter-varying models, and how many levels are tried: None for any.
LPV, BILINEAR = "lpv", "bilinear"
# What is fitted where nothing is said and the inputs do not say much the same.
USUAL = "oe"
# What a form with shared modes is called.
FORMS = {NETWORK: "a network", SUBSPACE: "a subspace model", LPV: "a parameter-varying model",
         BILINEAR: "a bilinear model", COMPONENTS: "a model of components"}  # fmt: skip
Orders = tuple[int, int, int]


def check_arguments(
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    structure: str | None = None,
    reduce: str | None = None,
    orders: Sequence[Orders | None] = (),
    modes: int | None = None,
    delay: float | str | None = None,
    noise_orders: tuple[int, int] | None = None,
    continuous: bool = False,
    real_poles: bool | None = None,
    initial: str = "auto",
    split: float | None = None,
    validate: Any = None,
    **others: Any,
) -> None:
    """Refuse arguments of `identify` that contradict each other; named as options of the command.

    Raises
    ------
    ValueError
    """
    if reduce is not None:
        if structure not in (None, COMPONENTS):
            raise ValueError(f"--reduce goes with --structure components, not {structure}")
        check_reduction(reduce, len(inputs))
    if structure is None:
        structure = USUAL if reduce is None else COMPONENTS
    network, shared = structure == NETWORK, structure in (*MAX_MODES, COMPONENTS)
    if split is not None and validate is not None:
        raise ValueError("--split and --validate both name the validation data: take one")
    for name in (*inputs, *outputs):
        if (*inputs, *outputs).count(name) > 1:
            raise ValueError(f"{name} is named twice: a channel has one role")
    if len(orders) > 1 and len(orders) != len(inputs):
        raise ValueError("--orders: once for all inputs, or once for each")
    if continuous and structure not in CONTINUOUS:
        raise ValueError(f"--continuous goes with --structure {' and '.join(CONTINUOUS)}")
    if structure == COMPONENTS and orders:
        raise ValueError("--orders: components take --reduce")
    form = FORMS.get(structure, structure)
    if shared and orders:
        raise ValueError(f"--orders: {form} takes --modes{' and --delay' * network}")
    if structure not in MAX_MODES and modes is not None:
        *first, last = MAX_MODES
        raise ValueError(f"--modes goes with --structure {', '.join(first)} and {last}")
    if modes is not None and modes > MAX_MODES[structure]:
        raise ValueError(f"--modes: {form} has up to {MAX_MODES[structure]}")
    if not network and delay is not None:
        raise ValueError("--delay goes with --structure network")
    if noise_orders is not None and (shared or not STRUCTURES[structure].load().noise_orders):
        having = sorted(n for n, entry in STRUCTURES.items() if entry.load().noise_orders)
        raise ValueError(f"--noise-orders go with --structure {' and '.join(having)}")
    if real_poles is not None and shared:
        raise ValueError(
            f"--{'real' if real_poles else 'any'}-poles: those of a network, of components, of lpv "
            "and bilinear are always real, of a subspace any"
        )
    if initial != "auto" and not shared and not STRUCTURES[structure].load().estimates_start:
        raise ValueError(f"--initial: {structure} takes its first rows as they are, from any state")


def check_reduction(text: str, inputs: int, called: str = "inputs") -> Reduction:
    """A reduction of so many inputs, named as an option of the command.

    Parameters
    ----------
    text : str
    inputs : int
    called : str
        What the command calls them.

    Raises
    ------
    ValueError
        It is none, or keeps more components than there are inputs.
    """
    # Imported on use: most calls reduce nothing.
    from thermaltool.fitting.components.reduction import parse_reduction

    try:
        reduction = parse_reduction(text)
    except ValueError as error:
        raise ValueError(f"--reduce: {error}") from error
    if (reduction.components or 0) > inputs:
        raise ValueError(f"--reduce {text}: there are {inputs} {called}")
    return reduction
