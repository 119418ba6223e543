"""``thermaltool present``: what is in model files."""

from __future__ import annotations

import click

from thermaltool.cli import shared
from thermaltool.cli.types import InputPath


@click.command(epilog="Example: thermaltool calibrate run.csv --drive Q_main_W --deflection d_z_um "
               "-q | thermaltool present -")  # fmt: skip
@click.argument("models", type=InputPath(), nargs=-1, default=("-",), metavar="[MODEL]...")
@shared.json_option
def command(models: tuple[str, ...], as_json: bool) -> None:
    """What is in models: gains, time constants, delays, effects, estimator.

    MODEL is any file that calibrate, identify, rc, spectrum, correct, schedule, superpose,
    regularize, diagnose or fit writes. Gains and times have 95 % intervals in brackets where the
    model has a covariance. --json has the same, each model by its name, with six digits.
    """
    from thermaltool import api
    from thermaltool.report.presentation import to_compact_json

    shared.check_files(None, *models)
    result = api.present(models)
    click.echo(to_compact_json(result.document()) if as_json else result.table())
