"""``thermaltool estimate``: heat and deflection from measured temperatures, whole log at once."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import warn
from thermaltool.cli.progress import terminal_progress
from thermaltool.cli.types import DURATION, NUMBER, RateType
from thermaltool.documents import write_json

# As in estimation/deconvolution.py and parameter_rules.py, which a help text does not import.
METHODS = "tikhonov0", "tikhonov1", "tikhonov2", "tv", "beck"
RULES = "likelihood", "gcv", "quasi-optimality", "discrepancy", "l-curve"


@click.command(
    epilog="Example: thermaltool plant frame --input duty | thermaltool estimate model.json - -q"
)
@shared.model_argument
@shared.log_argument
@shared.log_options
@shared.output_option
@shared.to_option
@shared.free_initial_option
@click.option("--smooth", is_flag=True,
              help="Each estimate rests on the whole log, later readings included.")  # fmt: skip
@click.option("--lag", type=DURATION, metavar="SECONDS",
              help="Each estimate rests on the readings up to so long after it [s].")  # fmt: skip
@click.option("--walk", type=RateType(),
              help="How fast the heat changes: as this log tells it, as the design has it, or a "
              "rate [share of the level per √s]. With design, --bands are those of compensate.  "
              "[default: design; with --smooth the likelier of "
              "likelihood and a smaller one beside steps]"
)  # fmt: skip
@click.option("--bands", is_flag=True,
              help="Add a column sigma_... for each: its standard error.")  # fmt: skip
@click.option("--method", type=click.Choice(METHODS),
              help="The heat of one drive from the whole log, by Tikhonov regularization of order "
              "0, 1 or 2, total variation (a heat that steps), or Beck's function specification."
)  # fmt: skip
@click.option("--rule", type=click.Choice(RULES),
              help="What chooses the parameter of --method.  [default: the rule with the least "
              "expected error; of tv the first that is not refused]")  # fmt: skip
@click.option("--at-least", type=NUMBER, metavar="Q",
              help="The heat of --method is no less [unit of the drive].")  # fmt: skip
@click.option("--at-most", type=NUMBER, metavar="Q",
              help="The heat of --method is no more [unit of the drive].")  # fmt: skip
@click.option("--future", type=click.IntRange(min=1), metavar="ROWS",
              help="Future rows of --method beck.  [default: by a rule]")  # fmt: skip
@shared.json_option
@shared.quiet_option
def command(
    model: str,
    log: str,
    output: str,
    to_format: str | None,
    as_json: bool,
    quiet: int,
    **options: Any,
) -> None:
    """Heat and deflection from measured temperatures.

    The numbers are those that thermaltool compensate gives line by line, the effects of the model
    included: readings are put right, what a column tells of other sources is added. Where the log
    holds the true heat or deflection too, the error is judged on stderr: band is its largest minus
    its smallest value, steady its mean over the last tenth. A displacement has no zero of its own:
    it counts from the median of measured minus estimated over the first rows, beside a machine that
    is warm there over all rows, and a line says so.

    --method takes a machine at rest at the first row and an even clock; all rules are told on
    stderr, with the error that each is expected to have.

    --smooth and --lag look back: at a moment's estimate when later readings are there. They take
    the Kalman form (regularize --form kalman). With --smooth and --nan-policy hold a reading that
    is missing counts as none.
    """
    from thermaltool import api
    from thermaltool.logs import write_table

    if problem := _clash(options):
        raise click.UsageError(problem)
    shared.check_files(output, model, log)
    progress = terminal_progress("estimate")
    result = api.estimate(model, log, **options, warn=warn)
    progress("done\n")
    # The file last: where anything before it fails, the old one stays.
    table = result.table()
    if as_json:
        write_json(result.document(), "-")
    if output != "-" or not as_json:
        write_table(result.columns, output, to_format)
    if table and not as_json and not quiet:
        warn(table)


def _clash(options: dict[str, Any]) -> str | None:
    """What is wrong with options that are each right."""
    if options["initial"] == "free" and not options["smooth"]:
        return "--initial free goes with --smooth"
    low, high, future = (options[name] for name in ("at_least", "at_most", "future"))
    if options["method"] is None:
        if any(options[name] is not None for name in ("rule", "at_least", "at_most", "future")):
            return "--rule, --at-least, --at-most and --future go with --method"
        if options["smooth"] and options["lag"] is not None:
            return "--smooth and --lag are two: --smooth takes all later readings"
        return None
    for name in ("smooth", "lag", "walk", "bands"):
        if options[name] not in (None, False):
            why = "has no bands" if name == "bands" else "takes the whole log its own way"
            return f"--method and --{name} are two: --method {why}"
    if future is not None and (options["method"] != "beck" or options["rule"]):
        return "--future goes with --method beck, without --rule"
    if low is not None and high is not None and low >= high:
        return f"--at-least {low:g} --at-most {high:g} leaves no heat"
    return None
