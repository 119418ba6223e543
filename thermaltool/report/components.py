"""Components of many inputs as a JSON document and as text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from thermaltool.documents import jsonable
from thermaltool.fitting.components.choose import Weighed
from thermaltool.fitting.components.model import ComponentOutput
from thermaltool.fitting.fit import Fit
from thermaltool.report.network import agreement_rows
from thermaltool.report.text import aligned
from thermaltool.report.transfer import (
    LISTED_CANDIDATES,
    continuous_document,
    estimate_document,
    gain_unit,
    one_or_all,
    with_interval,
)
from thermaltool.units import printed


def _output(fit: Fit) -> ComponentOutput:
    assert isinstance(fit.model, ComponentOutput)
    return fit.model


def component_warnings(fits: Sequence[Fit]) -> list[str]:
    """What a user should know before using the models, each a sentence."""
    sentences = []
    for fit in fits:
        model = _output(fit)
        for name in model.idle:
            sentences.append(f"{name} never moves within the rows that are fitted: it is left out")
        for group in model.same:
            sentences.append(f"{' and '.join(group)} say the same: one of them would do")
    return list(dict.fromkeys(sentences))


def component_fields(fits: Sequence[Fit], k: int) -> dict[str, Any]:
    """What the document of output k has beside that of any model."""
    fit, model = fits[k], _output(fits[k])
    unit = {name: gain_unit(model.target, name) for name in model.names}
    fields: dict[str, Any] = {
        "structure": "components",
        "orders": {"lags": model.order, "feedthrough": True},
        "reduction": model.reduction,
        "free_weights": model.freedom,
        "choices": [_choice(each) for each in model.choices],
        "left_out": list(model.idle),
        "same_inputs": [list(group) for group in model.same],
        "delay_s": one_or_all([0.0] * len(model.names)),
        "dead_time_s": one_or_all([0.0] * len(model.names)),
        "time_constants_s": model.time_constants.tolist(),
        "units": {name: unit[_source(name, model)] for name in fit.parameters},
        "noise": {"variance": model.sigma2},
        "criteria": {"aic": model.criteria.aic, "bic": model.criteria.bic},
        "terms": [_term(model, i) for i in range(len(model.names))],
    }
    return fields


def _choice(each: Weighed) -> dict[str, Any]:
    return {
        "components": each.choice.components,
        "lags": len(each.choice.lags),
        "direct": each.choice.direct,
        "ridge": each.choice.ridge,
        "error_time_s": each.choice.error_time,
        "held_out_rmse": jsonable(each.error),
        "weight": each.weight,
    }


def _source(parameter: str, model: ComponentOutput) -> str:
    return parameter.partition("[")[2].rstrip("]") or model.names[0]


def _term(model: ComponentOutput, i: int) -> dict[str, Any]:
    unit = gain_unit(model.target, model.names[i])
    return {
        "input": model.names[i],
        "delay_s": 0.0,
        "dead_time_s": 0.0,
        "gain": {**estimate_document(model.gain(i)), "unit": unit},
        "time_constants_s": model.time_constants.tolist(),
        "oscillations": [],
        "weights": [
            {"name": name, **estimate_document(e), "unit": unit}
            for name, e in model.weight_estimates(i).items()
        ],
        "continuous": continuous_document(model.term(i)),
    }


def component_table(fits: Sequence[Fit]) -> str:
    """What each model is made of, the gain of every input, fits and what is left."""
    parts = []
    for fit in fits:
        model = _output(fit)
        m, taus = len(model.names), model.time_constants
        lags = ", ".join(f"{tau:.4g}" for tau in taus)
        parts.append(
            f"{model.target}: {m} input{'s' * (m > 1)}, directly and through lags of {lags} s; "
            f"{model.method} "
            f"over {len(model.choices)} choices; {model.freedom:.1f} of {model.weights.size} "
            f"weights are free; {model.rows} rows at {model.dt:g} s"
        )
        rows = [["input", "gain", "unit", "weight K0", *(f"K{j + 1}" for j in range(len(taus)))]]
        for i, name in enumerate(model.names):
            rows.append([
                name, with_interval(model.gain(i)), printed(gain_unit(model.target, name)),
                *(f"{e.value:.4g}" for e in model.weight_estimates(i).values()),
            ])  # fmt: skip
        parts.append(aligned(rows))
        parts.append(_choices(model))
    parts.append(aligned(agreement_rows(fits)))
    return "\n\n".join(parts)


def given_components(fits: Sequence[Fit]) -> str:
    """What the intervals of fits by components leave out, one sentence."""
    told = []
    for fit in fits:
        model = _output(fit)
        first = model.choices[0]
        told.append(
            f"{model.target}: {first.choice.components} of {len(model.names)} components, ridge "
            f"{first.choice.ridge:.3g}, which counts {100 * first.weight:.0f} % of "
            f"{len(model.choices)} choices"
        )
    return f"intervals hold given the components and the ridge ({'; '.join(told)})"


def _choices(model: ComponentOutput) -> str:
    rows = [["components", "direct", "lags", "ridge", "errors", "held-out RMS", "counts"]]
    for each in model.choices[:LISTED_CANDIDATES]:
        c = each.choice
        rows.append([str(c.components), "yes" if c.direct else "no", str(len(c.lags)),
                     f"{c.ridge:.3g}", f"over {c.error_time:.4g} s" if c.error_time else "white",
                     f"{each.error:.4g}",
                     f"{100 * each.weight:.1f} %"])  # fmt: skip
    return f"of {len(model.choices)} choices those that count most:\n{aligned(rows)}"
