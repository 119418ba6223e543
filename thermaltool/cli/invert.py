"""``thermaltool invert``: the time-domain kernel of the regularized inverse."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from thermaltool.api.inputs import read_model
from thermaltool.cli.messages import warn
from thermaltool.cli.options import (
    NUMBER,
    POSITIVE,
    json_option,
    keep_inputs,
    model_argument,
    output_option,
    to_option,
)
from thermaltool.documents import write_json
from thermaltool.errors import ModelError

if TYPE_CHECKING:
    from thermaltool.responses.modes import Complex


@click.command(epilog="Example: thermaltool invert model.json --dt 0.5 --window 1200 -o kernel.csv")
@model_argument
@click.option(
    "--dt",
    type=POSITIVE,
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
@click.option("--filter", "filter_time", type=POSITIVE, metavar="SECONDS",
              help="Inverse transfer function in place of a kernel: a model file for simulate, "
              "behind a filter with this slowest lag [s].")  # fmt: skip
@click.option("--drive", metavar="CHANNEL",
              help="Which drive --filter gives.  [default: the only one]")  # fmt: skip
@output_option
@to_option
@json_option
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
        _rational(model, filter_time, sensor, drive, output)
        return
    if drive is not None:
        raise click.UsageError("--drive goes with --filter")
    import numpy as np

    from thermaltool.estimation.cascade import lagged_modes
    from thermaltool.estimation.kernel import Regularization, invert_modes, kernel_table
    from thermaltool.estimation.permanent_effects import (
        check_supported,
        permanent_effects,
        reading_columns,
        reading_maps,
        sensor_time_constants,
    )
    from thermaltool.estimation.variable_cooling import cooling_effects
    from thermaltool.logs import write_table
    from thermaltool.responses.delay import DelayedModes

    document = read_model(model)
    keep_inputs(output, model)
    names = [o.channel for o in document.sensors]
    if not names:
        raise ModelError("the model has no sensor: a kernel goes from a sensor to its drive")
    if sensor is None and len(names) != 1:
        raise ModelError(f"the model has the sensors {', '.join(names)}: choose one with --sensor")
    chosen = sensor or names[0]
    read = document.design.get("known", {}).get("columns", ()) if document.design else ()
    measured = {known["channel"] for known in read}
    terms = [t for t in document.terms if t.output == chosen and t.drive not in measured]
    if any(term.band is not None for term in terms):
        raise ModelError(f"{chosen}: a schedule has no kernel")
    if chosen not in names or len(terms) != 1:
        raise ModelError(f"{chosen} is not a sensor with one drive; there are {', '.join(names)}")
    settings: dict[str, float] = {}
    if regularization is not None:
        settings = dict(zip("ABc", regularization, strict=True))
    elif document.design is not None:
        design = document.estimator_design()
        settings = dict(design.get("settings", {})) if design.get("sensors") == [chosen] else {}
    if not {"A", "B", "c"} <= settings.keys():
        raise ModelError(
            "no regularization: run thermaltool regularize --form kernel, or give --regularization"
        )
    shape = Regularization(settings["A"], settings["B"], settings["c"])
    response, lags = terms[0].response, sensor_time_constants(document, chosen)
    period = dt or document.sample_period
    for effect in cooling_effects(document):
        raise ModelError(f"a kernel cannot follow the model's effect {effect.name}")
    check_supported(document, sorted(measured))
    modes = response.modes(period)
    if isinstance(modes, DelayedModes):
        raise ModelError(f"{chosen}: a response with a delay has no causal inverse")
    for time_constant in lags:
        modes = lagged_modes(modes, time_constant)
    invert_modes(modes, shape)  # raises where the inverse is unstable

    def transfer(s: Complex) -> Complex:
        late = np.prod([1 + s * time_constant for time_constant in lags], axis=0)
        return np.asarray(response.transfer(s) / late)

    kernel = kernel_table(transfer, shape, period, window)
    kept = float((kernel.weight.sum() + kernel.A0) * response.dc_gain())
    if as_json:
        write_json(
            {
                "A0": kernel.A0,
                "A1_s": kernel.A1,
                "error": kernel.error,
                "steady_state_kept": kept,
                "time_s": kernel.time.tolist(),
                "weight": kernel.weight.tolist(),
            },
            output,
        )
    else:
        columns = {
            "time_s": kernel.time,
            "weight_1": kernel.weight,
            "A0_1": np.full(window, kernel.A0),
            "A1_s": np.full(window, kernel.A1),
        }
        write_table(columns, output, to_format)
    if reading_maps(document, chosen) or reading_columns(document)[chosen] != chosen:
        warn(f"{chosen}: ΔT is the truth behind the reading, as the model's effects have it")
    if measured or any(e.path(chosen) for e in permanent_effects(document)):
        warn(f"{chosen}: ΔT is without what known columns add to it")
    warn(
        f"A0 = {kernel.A0:.6g}, A1 = {kernel.A1:.6g} s, error of a weight below "
        f"{kernel.error:.1e}; a window of {window} keeps {100 * kept:.2f} % of the steady state"
    )


def _rational(
    model: str, filter_time: float, sensor: str | None, drive: str | None, output: str
) -> None:
    from thermaltool.documents import atomic_output
    from thermaltool.estimation.rational import inverse_model
    from thermaltool.model import dumps

    document = read_model(model)
    keep_inputs(output, model)
    found = inverse_model(document, filter_time, sensor, drive)
    with atomic_output(output) as stream:
        stream.write(dumps(found.model).encode())
    lags = ", ".join(f"{lag:.4g}" for lag in found.inverse.filter_lags)
    zeros = ", ".join(f"{z:.3g}" if z.imag else f"{z.real:.3g}" for z in found.inverse.zeros)
    warn(f"filter of {lags} s; zeros at {zeros or 'none'} 1/s; steady gain "
         f"{found.inverse.response.dc_gain():.4g}")  # fmt: skip
