"""Shared modes as a JSON document and as text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from thermaltool.documents import jsonable
from thermaltool.fitting.fit import Fit
from thermaltool.fitting.network.model import Network, NetworkOutput
from thermaltool.fitting.network.search import LONGEST_IN_RECORDS
from thermaltool.fitting.selection import Candidate
from thermaltool.report.orders import aligned
from thermaltool.report.transfer import (
    continuous_document,
    estimate_document,
    gain_unit,
    held_samples,
    interval_text,
    longer_than_record,
    one_or_all,
    residuals_line,
    with_interval,
)
from thermaltool.units import printed


def _outputs(fits: Sequence[Fit]) -> list[NetworkOutput]:
    return [fit.model for fit in fits if isinstance(fit.model, NetworkOutput)]


def network_warnings(fits: Sequence[Fit]) -> list[str]:
    """What a user should know before using the model, each a sentence."""
    return mode_warnings(_outputs(fits)[0], fits[0].data.duration)


def mode_warnings(first: NetworkOutput, span: float) -> list[str]:
    """What the time constants of a network leave open, each a sentence.

    Parameters
    ----------
    first : NetworkOutput
        Any of its outputs.
    span : float
        Of the record [s].
    """
    sentences = []
    if not first.converged:
        sentences.append("the search for the time constants did not converge")
    undetermined = first.undetermined()
    for e in first.time_constant_estimates():
        if e in undetermined:
            sentences.append(
                f"the data do not identify the time constant of {e.value:.3g} s "
                f"({interval_text(e)}): take fewer modes"
            )
        elif e.value > span:
            endless = e.value > 0.99 * LONGEST_IN_RECORDS * span
            sentences.append(longer_than_record(e.value, span, endless))
    return sentences


def network_fields(fits: Sequence[Fit], k: int) -> dict[str, Any]:
    """What the document of output k of a network has beside that of any model."""
    fit, output = fits[k], fits[k].model
    assert isinstance(output, NetworkOutput)
    units = ["s"] * output.modes
    each = output.modes + output.has_direct
    units += [gain_unit(output.target, name) for name in output.names for _ in range(each)]
    fields: dict[str, Any] = {
        "shared_with": [other.model.target for other in fits if other is not fit],
        "structure": "network",
        "orders": {"modes": output.modes, "feedthrough": output.has_direct},
        "delay_s": one_or_all([_delay(output, i) for i in range(len(output.names))]),
        "dead_time_s": one_or_all(output.delays),
        "time_constants_s": output.time_constants.tolist(),
        "units": dict(zip(fit.parameters, units, strict=True)),
        "noise": {"variance": output.sigma2},
        "criteria": {"aic": output.criteria.aic, "bic": output.criteria.bic},
        "terms": [_term(output, i) for i in range(len(output.names))],
    }
    if fit.candidates:
        fields["candidates"] = [
            {"modes": c.model.modes, "feedthrough": c.model.has_direct,
             "fit_percent": jsonable(c.fit_percent[k]), "bic": c.model.criteria.bic}
            for c in fit.candidates
        ]  # fmt: skip
    return fields


def _term(output: NetworkOutput, i: int) -> dict[str, Any]:
    unit = gain_unit(output.target, output.names[i])
    return {
        "input": output.names[i],
        "delay_s": _delay(output, i),
        "dead_time_s": output.delays[i],
        "gain": {**estimate_document(output.gain(i)), "unit": unit},
        "time_constants_s": [estimate_document(e) for e in output.time_constant_estimates()],
        "oscillations": [],
        "weights": [{**estimate_document(e), "unit": unit} for e in output.weight_estimates(i)],
        "direct": {**estimate_document(output.direct_estimate(i)), "unit": unit}
        if output.has_direct
        else None,
        "continuous": continuous_document(output.term(i)),
    }


def _delay(output: NetworkOutput, i: int) -> float:
    """Dead time with what the sampling itself adds, as of the other structures [s]."""
    own = 0 if output.has_direct else held_samples(output.holds[i])
    return output.delays[i] + own * output.dt


def network_table(fits: Sequence[Fit]) -> str:
    """The shared time constants, the weights of every output, fits and what is left."""
    outputs = _outputs(fits)
    first, n, rows = outputs[0], outputs[0].modes, max(output.rows for output in outputs)
    head = (
        f"{', '.join(o.target for o in outputs)}: {n} shared mode{'s' * (n > 1)} by "
        f"{first.method}, {rows} rows at {first.dt:g} s"
    )
    names = [f"tau{j + 1}" for j in range(n)]
    modes = [["", "time constant s"]]
    modes += [
        [name, with_interval(e)]
        for name, e in zip(names, first.time_constant_estimates(), strict=True)
    ]
    weights = [["output", "input", "dead time s", "gain", "unit",
                *(f"weight {t}" for t in names), *(["direct"] * first.has_direct)]]  # fmt: skip
    for output in outputs:
        for i, name in enumerate(output.names):
            weights.append([
                output.target, name, f"{output.delays[i]:g}", with_interval(output.gain(i)),
                printed(gain_unit(output.target, name)),
                *(with_interval(e) for e in output.weight_estimates(i)),
                *([with_interval(output.direct_estimate(i))] if output.has_direct else []),
            ])  # fmt: skip
    parts = [head, aligned(modes), aligned(weights), aligned(agreement_rows(fits))]
    if fits[0].candidates:
        parts.append(_candidates(fits[0].candidates))
    return "\n\n".join(parts)


def agreement_rows(fits: Sequence[Fit]) -> list[list[str]]:
    """Fits of every output and what is left, as rows of a table."""
    held = ["validation %", "state estimated %", "improvement %"] if fits[0].validation else []
    rows = [["output", "fit %", *held, "residuals"]]
    for fit in fits:
        held = []
        if (v := fit.validation) is not None:
            held = [
                f"{v.carried_on.fit_percent:.2f}",
                f"{v.estimated_state.fit_percent:.2f}",
                f"{v.improvement:.1f}" if v.predicts else "-",
            ]
        rows.append([fit.model.target, f"{fit.training.fit_percent:.2f}", *held,
                     residuals_line(fit.tests)])  # fmt: skip
    return rows


def _candidates(candidates: Sequence[Candidate[Network]]) -> str:
    rows = [["modes", "held-out fit %", "BIC"]]
    for c in candidates:
        fits = " ".join(f"{fit:.2f}" for fit in c.fit_percent)
        modes = f"{c.model.modes}{', direct' * c.model.has_direct}"
        rows.append([modes, fits, f"{c.model.criteria.bic:.1f}"])
    return f"of {len(candidates)} candidates the best first:\n{aligned(rows)}"
