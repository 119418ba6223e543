"""``thermaltool noise``: what each channel's noise is made of."""

from __future__ import annotations

import click

from thermaltool.cli.options import (
    NUMBER,
    columns_option,
    from_option,
    gap_option,
    json_option,
    keep_inputs,
    log_argument,
    output_option,
)


@click.command(epilog="Example: thermaltool noise idle.csv -o noise.json --plot noise.png")
@log_argument
@columns_option
@from_option
@gap_option
@click.option(
    "--channel", "names", multiple=True, metavar="NAME", help="Only this one; repeat for more."
)
@click.option(
    "--start", type=NUMBER, metavar="SECONDS", help="Take the log from this time on as idle [s]."
)
@click.option("--stop", type=NUMBER, metavar="SECONDS", help="Take it as idle up to this time [s].")
@click.option("--plot", metavar="FILE", help="Figure, .png, .svg or .pdf.")
@output_option
@json_option
def command(
    log: str,
    columns: str | None,
    from_format: str | None,
    max_gap: float | None,
    names: tuple[str, ...],
    start: float | None,
    stop: float | None,
    plot: str | None,
    output: str,
    as_json: bool,
) -> None:
    """Noise of every channel: resolution, white, drift, lines, outliers.

    White level and drift come from the longest stretch on which a channel stays level; --start and
    --stop name a stretch without signal instead. Where there is none, the drift is an upper bound.
    Missing readings are left out. -o takes the JSON for the next stage, stdout a table.
    """

    from thermaltool.documents import atomic_output
    from thermaltool.errors import LogError
    from thermaltool.logs import read_log
    from thermaltool.report.noise import (
        draw_figure,
        noise_document,
        noise_table,
        to_json,
    )
    from thermaltool.report.style import figure_format, render
    from thermaltool.signals.noise import NoiseEstimate, estimate_noise

    kind = figure_format(plot) if plot is not None else None
    keep_inputs(output, log)
    whole = read_log(log, columns=columns, from_format=from_format, max_gap=max_gap)
    table = whole.between(start, stop)
    idle = start is not None or stop is not None
    results: dict[str, NoiseEstimate | str] = {}
    for name in names or table.columns:
        values = table.column(name)
        try:
            results[name] = estimate_noise(table.time, values, idle=idle, max_gap=max_gap)
        except ValueError as error:
            results[name] = str(error)
            click.echo(f"{table.name}: {name}: {error}", err=True)
    if all(isinstance(result, str) for result in results.values()):
        raise LogError("no channel has a usable record", table.name)

    units = {name: table.channels[name].unit for name in results}
    document = to_json(noise_document(whole.name, whole.period, units, results))
    if output != "-":
        with atomic_output(output) as stream:
            stream.write(document)
    if plot is not None and kind is not None:
        picture = render(lambda: draw_figure(table.name, units, results), kind)
        with atomic_output(plot) as stream:
            stream.write(picture)
    if as_json:
        with atomic_output("-") as stream:
            stream.write(document)
    else:
        click.echo(noise_table(units, results))
