"""Figure of several models on one log: measured, each model, the residuals of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.logs import Log
from thermaltool.model import Model, started_outputs
from thermaltool.report.clock_axis import record_axis
from thermaltool.report.style import (
    CYCLE,
    MARK,
    MEASURED,
    Array,
    channel_unit,
    choose,
    legend_beside,
    panels,
    plain,
    quantity_label,
    trace_record,
    with_unit,
)
from thermaltool.signals.agreement import Agreement, agreement
from thermaltool.units import parse_channel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLORS = tuple(color for color in CYCLE if color != MEASURED)


@dataclass(frozen=True)
class ModelCurve:
    """What a model makes of one output.

    Attributes
    ----------
    name : str
        Of the model.
    log : Log
        Its clock, and what was measured.
    computed : ndarray, shape (n,) [unit of the output]
        In the readings of the log.
    zero : float [unit of the output]
        The reading at rest.
    residual : ndarray, shape (n,) [unit of the output]
        Measured minus computed.
    agreement : Agreement
    """

    name: str
    log: Log
    computed: Array
    zero: float
    residual: Array
    agreement: Agreement


def common_outputs(outputs: Mapping[str, Sequence[str]]) -> list[str]:
    """Channels that all models compute.

    Parameters
    ----------
    outputs : mapping of the model's name to its outputs

    Raises
    ------
    ModelError
        There is none.
    """
    first, *others = outputs.values()
    common = [channel for channel in first if all(channel in other for other in others)]
    if not common:
        each = "; ".join(f"{name}: {', '.join(found)}" for name, found in outputs.items())
        raise ModelError(f"no output that all models have ({each})")
    return common


def model_curves(model: Model, name: str, log: Log) -> dict[str, ModelCurve]:
    """The measured outputs of a model for the drives in a log, as `simulate` has them.

    Parameters
    ----------
    model : Model
    name : str
    log : Log

    Raises
    ------
    ModelError
        A drive of the model is not in the log; the message names the model.
    """
    try:
        simulated = model.simulate(log)
    except ModelError as error:
        raise ModelError(f"{name}: {error}") from error
    found = {}
    for channel, started in started_outputs(model, log, simulated).items():
        level, zero = started.computed, started.zero.value
        from_zero = log.columns[channel] - zero
        found[channel] = ModelCurve(
            name, log, level + zero, zero, from_zero - level, agreement(from_zero, level)
        )
    return found


def draw_models_on_log(
    models: Mapping[str, Model], log: Log, channels: Sequence[str] = ()
) -> Figure:
    """Several models for the drives in a log, as `simulate` has them.

    Raises
    ------
    ModelError
        No output that all have; a drive that is not in the log.
    LogError
        A channel that is no such output, or was not measured.
    """
    curves = [model_curves(model, name, log) for name, model in models.items()]
    outputs = common_outputs({n: [o.channel for o in m.outputs] for n, m in models.items()})
    wanted = choose([o for o in outputs if o in log.columns], channels, log.name)
    return draw_curves_of_models({o: [each[o] for each in curves] for o in wanted})


def draw_curves_of_models(outputs: Mapping[str, Sequence[ModelCurve]]) -> Figure:
    """Per output: measured and every model above, the residuals below.

    Displacements and temperatures without a zero count from that of the first model.

    Parameters
    ----------
    outputs : mapping of output to sequence of ModelCurve
    """
    log = next(iter(outputs.values()))[0].log
    names = [curve.name for curve in next(iter(outputs.values()))]
    title = f"{' and '.join(names) if len(names) < 3 else f'{len(names)} models'} on "
    figure, axes = panels(
        title + Path(log.name).name, [2.0, 1.2] * len(outputs), 0.8 + 4.0 * len(outputs)
    )
    following = iter(axes)
    for output, curves in outputs.items():
        unit, rest = channel_unit(output), curves[0].zero
        top, bottom = next(following), next(following)
        top.set(title=plain(f"{output}, from rest"),
                ylabel=quantity_label(parse_channel(output).unit))  # fmt: skip
        trace_record(top, log, log.columns[output] - rest, color=MEASURED, lw=3.0,
                     label="measured")  # fmt: skip
        # What is further off lies below.
        order = np.argsort([-curve.agreement.rmse for curve in curves]).argsort().tolist()
        for k, (curve, above) in enumerate(zip(curves, order, strict=True)):
            color, line = COLORS[k % len(COLORS)], ("-", "--", ":")[k // len(COLORS) % 3]
            found, z = curve.agreement, 3.0 + above / len(curves)
            figures = f"RMSE {with_unit(found.rmse, unit)}"
            if np.isfinite(found.fit_percent):
                figures += f", fit {found.fit_percent:.1f} %"
            trace_record(top, curve.log, curve.computed - rest, color=color, ls=line, zorder=z,
                         label=curve.name)  # fmt: skip
            trace_record(bottom, curve.log, curve.residual, color=color, ls=line, zorder=z, lw=0.8,
                         label=f"{curve.name}\n{figures}")  # fmt: skip
        bottom.axhline(0.0, color=MARK, lw=0.6, zorder=2.5)
        bottom.set(title="Residual, measured − simulated", ylabel=f"residual [{unit}]")
        legend_beside(top)
        legend_beside(bottom)
    record_axis(log).mark(axes[-1])
    return figure
