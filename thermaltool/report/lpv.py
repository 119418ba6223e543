"""Parameter-varying models as a JSON document and as text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from thermaltool.documents import jsonable
from thermaltool.fitting.fit import Fit
from thermaltool.fitting.lpv.form import EXPONENTS, LpvForm
from thermaltool.fitting.lpv.model import Lpv, LpvOutput
from thermaltool.fitting.selection import Candidate
from thermaltool.report.network import agreement_rows
from thermaltool.report.text import aligned
from thermaltool.report.transfer import (
    LISTED_CANDIDATES,
    continuous_document,
    estimate_document,
    gain_unit,
    longer_than_record,
    one_or_all,
    with_interval,
)
from thermaltool.units import parse_channel, printed

# An exponent nearer to the end of what is searched than this share is one of the search.
END_SHARE = 0.01


def _output(fit: Fit) -> LpvOutput:
    assert isinstance(fit.model, LpvOutput)
    return fit.model


def lpv_warnings(fits: Sequence[Fit]) -> list[str]:
    """What a user should know before using the models, each a sentence."""
    sentences, model, span = [], _output(fits[0]), fits[0].data.duration
    if not model.converged:
        sentences.append("the search for time constants, rates and powers did not converge")
    slowest = float(model.time_constants.max())
    if slowest > span:
        sentences.append(longer_than_record(slowest, span, False))
    for name, e in model.exponent_estimates().items():
        if not EXPONENTS[0] * (1 + END_SHARE) < e.value < EXPONENTS[1] * (1 - END_SHARE):
            sentences.append(
                f"the exponent of {name} is at the end of what is searched ({e.value:.3g}): "
                "the machine wants another law than a power"
            )
    return sentences


def described(form: LpvForm) -> str:
    """What goes by what.

    Parameters
    ----------
    form : LpvForm
    """
    parts = []
    if form.channel:
        what = " and ".join(["loss rate"] * form.loss + ["gains"] * form.gain)
        parts.append(f"{what} by {len(form.levels)} levels of {form.channel}")
    if form.powers:
        parts.append(f"a power of {' and '.join(form.powers)}")
    return ", ".join(parts) or "nothing by level"


def lpv_fields(fits: Sequence[Fit], k: int) -> dict[str, Any]:
    """What the document of output k has beside that of any model."""
    fit, model = fits[k], _output(fits[k])
    form = model.form
    late = [samples * model.dt for samples in form.delays]
    fields: dict[str, Any] = {
        "shared_with": [other.model.target for other in fits if other is not fit],
        "structure": "lpv",
        "orders": _orders(form),
        "delay_s": one_or_all([samples * model.dt for samples in model.sample_delays]),
        "dead_time_s": one_or_all(late),
        "time_constants_s": model.time_constants.tolist(),
        "rates_per_s": [estimate_document(e) for e in model.rate_estimates()],
        "exponents": {n: estimate_document(e) for n, e in model.exponent_estimates().items()},
        "units": {name: _unit(model, name) for name in fit.parameters},
        "noise": {"variance": model.sigma2},
        "criteria": {"aic": model.criteria.aic, "bic": model.criteria.bic},
        "terms": [_term(model, i) for i in range(len(model.names))],
    }
    if fit.candidates:
        fields["candidates"] = [
            {**_orders(c.model.form), "fit_percent": jsonable(c.fit_percent[k]),
             "bic": c.model.criteria.bic}
            for c in fit.candidates
        ]  # fmt: skip
    return fields


def _orders(form: LpvForm) -> dict[str, Any]:
    return {
        "modes": form.modes,
        "feedthrough": form.direct,
        "scheduled_by": form.channel or None,
        "levels": list(form.levels),
        "loss": form.loss,
        "gain": form.gain,
        "powers": list(form.powers),
    }


def _unit(model: LpvOutput, name: str) -> str:
    label, _, place = name.partition("[")
    if label.startswith("tau"):
        return "s"
    if label.startswith("rate"):
        return "1/s"
    if label == "exponent":
        return "1"
    return gain_unit(model.target, place.rstrip("]").partition(",")[0])


def _term(model: LpvOutput, i: int) -> dict[str, Any]:
    unit, form = gain_unit(model.target, model.names[i]), model.form
    terms = model.level_terms(i)
    delay = form.delays[i] * model.dt
    return {
        "input": model.names[i],
        "delay_s": model.sample_delays[i] * model.dt,
        "dead_time_s": delay,
        "gain": {**estimate_document(model.gain(i)), "unit": unit},
        "gains_by_level": [
            {"level": level, **estimate_document(model.level_gain(i, k)), "unit": unit}
            for k, level in enumerate(form.levels)
        ],
        "time_constants_s": model.time_constants.tolist(),
        "oscillations": [],
        "weights": [
            {"name": name, **estimate_document(e), "unit": unit}
            for name, e in model.weight_estimates(i, 0).items()
        ],
        "continuous": continuous_document(terms[0]),
    }


def lpv_table(fits: Sequence[Fit]) -> str:
    """What goes by what, time constants, rates, exponents and gains, fits and what is left."""
    model = _output(fits[0])
    form = model.form
    targets = ", ".join(fit.model.target for fit in fits)
    head = (
        f"{targets}: {form.modes} mode{'s' * (form.modes > 1)}, {described(form)}; "
        f"{model.method}; {model.rows} rows at {model.dt:g} s"
    )
    first = f" at {form.levels[0]:.4g}" if form.loss else ""
    shared = [["shared", "value", "unit"]]
    shared += [[f"tau{j + 1}{first}", with_interval(e), "s"]
               for j, e in enumerate(model.time_constant_estimates())]  # fmt: skip
    for level, e in list(zip(form.levels, model.rate_estimates(), strict=False))[1:]:
        shared.append([f"faster at {level:.4g} by", with_interval(e), "1/s"])
    shared += [[f"exponent of {name}", with_interval(e), "1"]
               for name, e in model.exponent_estimates().items()]  # fmt: skip
    for name, samples in zip(model.names, form.delays, strict=True):
        if samples:
            shared.append([f"dead time of {name}", f"{samples * model.dt:.4g}", "s"])
    gains = [["output", "input", "level", "gain", "unit"]]
    for fit in fits:
        own = _output(fit)
        for i, name in enumerate(own.names):
            unit = printed(gain_unit(own.target, name))
            for k in range(max(len(form.levels), 1)):
                gain = with_interval(own.level_gain(i, k))
                gains.append([own.target, name, _level(form, k), gain, unit])
    if not form.channel:
        gains = [[*row[:2], *row[3:]] for row in gains]
    parts = [head, aligned(shared), aligned(gains), aligned(agreement_rows(fits))]
    if fits[0].candidates:
        parts.append(_listed(fits[0].candidates))
    return "\n\n".join(parts)


def _level(form: LpvForm, k: int) -> str:
    if not form.channel:
        return ""
    unit = printed(parse_channel(form.channel).unit)
    return " ".join(filter(None, (f"{form.levels[k]:.4g}", unit, f"of {form.channel}")))


def _listed(candidates: Sequence[Candidate[Lpv]]) -> str:
    rows = [["modes", "by level or power", "held-out fit %", "BIC"]]
    for c in candidates[:LISTED_CANDIDATES]:
        fits = " ".join(f"{fit:.2f}" for fit in c.fit_percent)
        rows.append([str(c.model.form.modes), described(c.model.form), fits,
                     f"{c.model.criteria.bic:.1f}"])  # fmt: skip
    return f"of {len(candidates)} candidates the best first:\n{aligned(rows)}"
