"""From what files are to the figure that shows them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from thermaltool.errors import LogError, ThermalToolError
from thermaltool.files import file_names
from thermaltool.report.comparison import draw_models_on_log
from thermaltool.report.content import Content
from thermaltool.report.control import draw_control
from thermaltool.report.diagnosis_figures import draw_diagnosis
from thermaltool.report.kernels import draw_inversion, draw_kernel
from thermaltool.report.noise import draw_document
from thermaltool.report.pairs import (
    draw_compensation,
    draw_estimate,
    draw_simulation,
)
from thermaltool.report.records import draw_log, draw_setpoints
from thermaltool.report.residuals import draw_comparison
from thermaltool.report.responses import draw_model, draw_step_responses
from thermaltool.report.series_figures import draw_arma, draw_forecast_table, draw_orders
from thermaltool.report.trade_off import draw_trade_off
from thermaltool.timeseries.model import ArmaModel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from thermaltool.model import Model

# What a figure is made of, in this order, and what draws it.
FIGURES: dict[tuple[str, ...], Callable[..., Figure]] = {
    ("log",): lambda log, channels: draw_log(log.data, channels),
    ("simulation",): lambda log, channels: draw_simulation(log.data, channels),
    ("setpoints",): lambda log, channels: draw_setpoints(log.data, channels),
    ("log", "reference"): lambda log, ref, channels: draw_estimate(log.data, ref.data, channels),
    ("setpoints", "reference"): (
        lambda log, ref, channels: draw_compensation(log.data, ref.data, channels)
    ),
    ("noise",): lambda noise, channels: draw_document(noise.data, noise.name, channels),
    ("model",): lambda model, channels: draw_model(model.data, model.name, channels),
    ("log", "model"): lambda log, model, channels: draw_comparison(model.data, log.data, channels),
    ("trade-off",): lambda report, channels: draw_trade_off(
        report.data, report.name, channels=channels
    ),
    ("model", "trade-off"): lambda model, report, channels: draw_trade_off(
        report.data, report.name, model.data, channels
    ),
    ("kernel",): lambda kernel, channels: draw_kernel(kernel.data, kernel.name, channels=channels),
    ("kernel", "model"): lambda kernel, model, channels: draw_kernel(
        kernel.data, kernel.name, model.data, channels
    ),
    ("inversion",): lambda result, channels: draw_inversion(result.data, result.name, channels),
    ("arma",): lambda model, channels: draw_arma(model.data),
    ("controller",): lambda tried, channels: draw_control(tried.data, channels),
    ("orders",): lambda orders, channels: draw_orders(orders.data),
    ("diagnosis",): lambda found, channels: draw_diagnosis(found.data),
    ("forecast",): lambda ahead, channels: draw_forecast_table(ahead.data, None, channels),
    ("forecast", "log"): lambda ahead, log, channels: draw_forecast_table(
        ahead.data, log.data, channels
    ),
    ("models",): lambda models, channels: draw_step_responses(models.data, channels),
    ("log", "models"): lambda log, models, channels: draw_models_on_log(
        models.data, log.data, channels
    ),
}


def draw_models(models: Mapping[str, Model | ArmaModel]) -> Figure:
    """One model from all sides, or the step responses of several.

    Parameters
    ----------
    models : mapping of name to Model or ArmaModel

    Raises
    ------
    LogError
        Several models, not all of machines.
    """
    return draw([
        Content("arma" if isinstance(model, ArmaModel) else "model", name, model)
        for name, model in models.items()
    ])  # fmt: skip


def draw(contents: Sequence[Content], channels: Sequence[str] = ()) -> Figure:
    """The figure of one content, or of two that belong together, in any order.

    Raises
    ------
    LogError
        Contents that make no figure together, a part of a document missing, and what the figure
        itself raises.
    """
    models = [content for content in contents if content.kind == "model"]
    ordered = list(contents)
    if len(models) > 1:
        rest = [content for content in contents if content.kind != "model"]
        names = file_names([model.name for model in models])
        data = dict(zip(names, (model.data for model in models), strict=True))
        ordered = [*rest, Content("models", ", ".join(names), data)]
    ordered = sorted(ordered, key=lambda content: (content.kind == "reference", content.kind))
    kinds = tuple(content.kind for content in ordered)
    if kinds not in FIGURES:
        given = " and ".join(f"{content.name} ({content.kind})" for content in contents)
        raise LogError(
            f"no figure of {given}: draw one file, models with a log, a model with a kernel or a "
            "trade-off, a forecast with its log, or a result of estimate or compensate --against a "
            "log"
        )
    try:
        return FIGURES[kinds](*ordered, channels)
    except ThermalToolError:
        raise
    except KeyError as error:
        raise LogError(f"{error.args[0]!r} is missing", ordered[0].name) from error
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        # A document of a report has no format and no readers: its figure finds what is wrong.
        documents = [each for each in ordered if isinstance(each.data, Mapping)]
        if not documents:
            raise
        message = f"not what the command wrote: no figure of these numbers ({error})"
        raise LogError(message, documents[0].name) from error
