"""What `identify` fits: the plans of a structure, and what logs have to be for them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from thermaltool.api.identification_arguments import (
    BILINEAR,
    COMPONENTS,
    LPV,
    NETWORK,
    SUBSPACE,
    USUAL,
    Orders,
)
from thermaltool.api.result import Notice
from thermaltool.errors import counted
from thermaltool.units import is_overdamped

if TYPE_CHECKING:
    from thermaltool.fitting.identification import Plan
    from thermaltool.fitting.output_model import OutputModel
    from thermaltool.logs import Log
    from thermaltool.record import Record
    from thermaltool.units import Reference

# Above so many responses they share their poles: to search each by itself takes minutes.
MAX_SEPARATE = 2
# As long as this share of the rows with any output has all of them: no other row counts there.
MIN_COMPLETE = 0.8
# What missing readings of an output mean to the structures that do not simulate over them.
REGRESSED = "a reading counts only where all those before it that the equation takes are there"
PARTED = "more than three in a row part the record, and each part begins in a state of its own"
WHOLE_ROWS = "a row counts where no output is missing"
HOLES = {"arx": REGRESSED, "armax": REGRESSED, SUBSPACE: WHOLE_ROWS, COMPONENTS: PARTED}


def plans_of(
    parts: Sequence[Log],
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    structure: str,
    usual: bool,
    reduce: str | None,
    modes: int | None,
    delay: float | Literal["auto"] | None,
    orders: Sequence[Orders | None],
    noise_orders: tuple[int, int] | None,
    continuous: bool,
    real_poles: bool | None,
    reference: Reference | None,
    rough: bool,
    **common: Any,
) -> tuple[Plan, ...]:
    """Plans of a structure; where none was asked for, those that stand in where one does not fit.

    Parameters
    ----------
    parts : sequence of Log
        What is fitted.
    usual : bool
        Whether no option of a structure was given.
    rough : bool
        Whether orders are chosen with less effort.
    **common
        What all plans have.
    """
    from thermaltool.fitting.components.plan import ComponentPlan
    from thermaltool.fitting.components.reduction import Reduction, parse_reduction
    from thermaltool.fitting.lpv.choose import LEVEL_COUNTS
    from thermaltool.fitting.lpv.plan import LpvPlan
    from thermaltool.fitting.network.plan import NetworkPlan
    from thermaltool.fitting.subspace.plan import SubspacePlan
    from thermaltool.fitting.transfer.plan import TransferPlan
    from thermaltool.fitting.transfer.registry import structure_of

    if structure == NETWORK:
        return (NetworkPlan(modes=modes, delay=delay or 0.0, **common),)
    if structure == SUBSPACE:
        return (SubspacePlan(modes=modes, **common),)
    if structure in (LPV, BILINEAR):
        counts = (2,) if structure == BILINEAR else LEVEL_COUNTS
        return (LpvPlan(modes=modes, level_counts=counts, reference=reference, **common),)
    if structure == COMPONENTS:
        reduction = Reduction() if reduce is None else parse_reduction(reduce)
        return (ComponentPlan(reduction=reduction, **common),)
    heat = all(is_overdamped(inputs, output) for output in outputs)
    if real_poles is None:
        real_poles = structure == USUAL and heat and (not orders or None in orders)
    form = structure_of(structure, noise_orders or (1, 1), real_poles, continuous)
    separate = TransferPlan(structure=form, orders=tuple(orders), linear=not usual, rough=rough,
                            **common)  # fmt: skip
    if not usual:
        return (separate,)
    shared = SubspacePlan(linear=False, real=bool(real_poles), **common)
    if len(inputs) * len(outputs) > MAX_SEPARATE and _complete(parts, outputs):
        return shared, separate
    return separate, shared


def _complete(parts: Sequence[Log], outputs: Sequence[str]) -> bool:
    """Whether most rows with a reading of any output have one of all."""
    each = np.hstack([np.isfinite(part.matrix(outputs)) for part in parts])
    return bool(each.all(axis=0).sum() >= MIN_COMPLETE * each.any(axis=0).sum())


def structure_name(model: OutputModel) -> str:
    """What the structure of a fitted model is called."""
    from thermaltool.fitting.components.model import ComponentOutput
    from thermaltool.fitting.subspace.model import SubspaceOutput
    from thermaltool.fitting.transfer.model import TransferModel

    if isinstance(model, TransferModel):
        return model.structure.name
    kinds = {SubspaceOutput: SUBSPACE, ComponentOutput: COMPONENTS}
    return kinds.get(type(model), "")


def without_bursts(log: Log, warn: Notice) -> Log:
    """A log with a row for each burst of readings, which an even clock would part; says so."""
    from thermaltool.logs.duplicates import burst_means

    means = burst_means(log)
    if len(means) < len(log):
        warn(f"{log.name}: in bursts of readings: the mean of each is one row, {len(means)} in all "
             "(--structure network takes every reading)")  # fmt: skip
    return means


def warn_holes(
    log: Log, inputs: Sequence[str], outputs: Sequence[str], structure: str, warn: Notice
) -> None:
    """Say what missing readings of an output cost where a structure does not simulate over them."""
    if structure not in HOLES or (HOLES[structure] == WHOLE_ROWS and len(outputs) == 1):
        return
    known = log.known(inputs)
    for name in outputs:
        if missing := int((known & ~log.known([name])).sum()):
            warn(
                f"{log.name}: {name}: {counted(missing, 'reading')} missing: {HOLES[structure]}; "
                "--structure oe and network go on through holes"
            )


def check_clock(log: Record, period: float, warn: Notice) -> None:
    """Refuse another period than that of the first log; say where steps are uneven."""
    from thermaltool.fitting.even_clock import check_period, uneven_steps

    check_period(log, period)
    uneven, steps, rows_alone = uneven_steps(log, period)
    if not uneven:
        return
    if rows_alone:
        why = "rows are missing: the record goes on over three in a row, more of them part it"
    else:
        why = ("straight lines between the readings are taken on an even clock, longer steps part "
               "the record")  # fmt: skip
    warn(f"{log.name}: {uneven} of {steps} steps are not {period:g} s: {why}")
