"""``thermaltool invert``: the time-domain kernel of the regularized inverse."""

from __future__ import annotations

import click

from thermaltool.api.inputs import read_model, write_model
from thermaltool.cli import shared
from thermaltool.cli.messages import warn
from thermaltool.cli.types import DURATION, NUMBER
from thermaltool.documents import write_json


@click.command(
    epilog="Example: thermaltool regularize model.json --form kernel | "
    "thermaltool invert - -o kernel.csv"
)
@shared.model_argument
@click.option(
    "--dt",
    type=DURATION,
    metavar="SECONDS",
    help="Sample period [s].  [default: that of the model]",
)
@click.option(
    "--window", type=click.IntRange(2, 10_000_000), default=1200, help="Number of weights."
)
@click.option("--sensor", metavar="CHANNEL", help="Which sensor.  [default: the only one]")
@click.option(
    "--regularization",
    nargs=3,
    type=NUMBER,
    metavar="A B C",
    help="f_R = (At + Bt²)e^(−ct).  [default: that of the model's design]",
)
@click.option("--filter", "filter_time", type=DURATION, metavar="SECONDS",
              help="Inverse transfer function in place of a kernel: a model file for simulate, "
              "behind a filter with this slowest lag [s].")  # fmt: skip
@click.option("--drive", metavar="CHANNEL",
              help="Which drive --filter gives.  [default: the only one]")  # fmt: skip
@shared.output_option
@shared.to_option
@shared.json_option
def command(
    model: str,
    dt: float | None,
    window: int,
    sensor: str | None,
    regularization: tuple[float, float, float] | None,
    filter_time: float | None,
    drive: str | None,
    output: str,
    to_format: str | None,
    as_json: bool,
) -> None:
    """Time-domain kernel of the inverse model, with its singular weights.

    Q(n) = Σ weight(k)·ΔT(n−k) + A0·ΔT(n) + A1·(ΔT(n) − ΔT(n−1))/dt. Each weight is the exact
    integral of the kernel over a sample, with ΔT a straight line between samples. The lag of a
    sensor, an effect of the model, is part of what is inverted. A0, A1, the
    estimated error and the share of the steady state that the window keeps go to stderr.

    With --filter the inverse of a rational response (identify) as a model: the output drives it,
    and the power follows that would have caused it, behind first-order lags of SECONDS, SECONDS/2,
    ..., one more than the response falls off with. Zeros in the right half-plane, delays, effects
    and schedules are refused.
    """
    if filter_time is not None:
        if regularization or dt or to_format or as_json:
            raise click.UsageError("--filter goes with MODEL, --sensor, --drive and -o alone")
        _invert_rational(model, filter_time, sensor, drive, output)
        return
    if drive is not None:
        raise click.UsageError("--drive goes with --filter")
    from thermaltool.estimation.kernel import Regularization
    from thermaltool.estimation.sensor_kernel import sensor_kernel
    from thermaltool.logs import write_table

    document = read_model(model)
    shared.keep_inputs(output, model)
    shape = None if regularization is None else Regularization(*regularization)
    found = sensor_kernel(document, sensor, shape, dt, window)
    kernel, kept = found.kernel, found.steady_state_kept
    summary = (
        f"A0 = {kernel.A0:.6g}, A1 = {kernel.A1:.6g} s, error of a weight below "
        f"{kernel.error:.1e}; a window of {window} keeps {100 * kept:.2f} % of the steady state"
    )
    # The file last: where anything before it fails, the old one stays.
    if as_json:
        write_json(found.document(), output)
    else:
        write_table(found.columns(), output, to_format)
    for note in (*found.notes, summary):
        warn(note)


def _invert_rational(
    model: str, filter_time: float, sensor: str | None, drive: str | None, output: str
) -> None:
    from thermaltool.estimation.rational import inverse_model

    document = read_model(model)
    shared.keep_inputs(output, model)
    found = inverse_model(document, filter_time, sensor, drive)
    lags = ", ".join(f"{lag:.4g}" for lag in found.inverse.filter_lags)
    zeros = ", ".join(f"{z:.3g}" if z.imag else f"{z.real:.3g}" for z in found.inverse.zeros)
    gain = found.inverse.response.dc_gain()
    summary = f"filter of {lags} s; zeros at {zeros or 'none'} 1/s; steady gain {gain:.4g}"
    write_model(found.model, output)
    warn(summary)
