"""Options of ``fcc`` that describe the actuator, or the log of a trial that tells what it does."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from thermaltool.cli import shared
from thermaltool.cli.types import DELAY, POSITIVE, PairsType

if TYPE_CHECKING:
    from thermaltool.control.fcc import ActuatorModel

# Plays that are fitted to a trial: enough for the loop of a piezo, few enough to be told apart.
IDENTIFIED_PLAYS = 5
# A trial's clock may differ from the period by this share.
SAME_PERIOD = 0.01
# Damping [1] of a low-pass at infinity, which does nothing: any will do.
USUAL_DAMPING = 0.707


# From command to reading.
actuator_options = shared.together(
    click.option("--delay", type=DELAY, metavar="S",
                 help="Of measuring, computing and acting, low-pass aside [s]."),
    click.option("--gain", type=POSITIVE, help="Error per unit of the command.  [default: 1]"),
    click.option("--low-pass", type=PairsType("OMEGA:DAMPING", single=True),
                 metavar="OMEGA:DAMPING", help="Second-order low-pass between command and "
                 "reading [rad/s].  [default: none]"),
    click.option("--hysteresis", type=PairsType("R:W,R:W,..."), metavar="R:W,R:W,...",
                 help="Plays of the actuator in place of --gain: thresholds from 0 up, in "
                 "units of the command, and their weights."),
    click.option("--identify", type=click.Path(exists=True, dir_okay=False), metavar="LOG",
                 help="Log of a trial with the columns of error and command: gives --delay and "
                 "--hysteresis."),
)  # fmt: skip


def actuator_of(
    channel: str, options: dict[str, Any], emit: Callable[[str], None]
) -> ActuatorModel:
    """The model from options; parts that they leave open come from a trial, which is reported.

    Raises
    ------
    click.UsageError
        Options that exclude each other, no delay, or a trial of another period.
    """
    from thermaltool.control.fcc import ActuatorModel
    from thermaltool.control.hysteresis import PrandtlIshlinskii

    natural, damping = options["low_pass"] or (float("inf"), USUAL_DAMPING)
    plays, gain, delay = options["hysteresis"], options["gain"], options["delay"]
    if plays and gain:
        raise click.UsageError("--hysteresis has its gain in its weights: leave --gain out")
    plays = plays or ([(0.0, gain)] if gain else None)
    trial = options["identify"]
    if trial is not None and (plays is None or delay is None):
        import numpy as np

        from thermaltool.api.inputs import read
        from thermaltool.cli.messages import warn
        from thermaltool.fitting.actuator import identify_actuator

        table = read(trial, (options["command"], channel), warn=warn)
        step = float(np.median(np.diff(table.time))) if len(table) > 1 else options["period"]
        if abs(step / options["period"] - 1) > SAME_PERIOD:
            raise click.UsageError(
                f"{trial} has a sample each {step:.4g} s, --period says {options['period']:.4g} s"
            )
        found = identify_actuator(
            table.column(options["command"]),
            table.column(channel),
            options["period"],
            natural,
            damping,
            IDENTIFIED_PLAYS,
        )
        plays = plays or list(zip(found.thresholds, found.weights, strict=True))
        delay = found.delay if delay is None else delay
        text = ",".join(f"{r:.4g}:{w:.4g}" for r, w in plays)
        emit(
            f"{trial}: --delay {delay:.4g} --hysteresis {text} explain {found.explained:.1%} of "
            f"the reading's variance, {found.residual:.3g} RMS are left"
        )
    if delay is None:
        raise click.UsageError("how late does the actuator answer? give --delay or --identify")
    thresholds, weights = zip(*(plays or [(0.0, 1.0)]), strict=True)
    return ActuatorModel(PrandtlIshlinskii(thresholds, weights), delay, natural, damping)
