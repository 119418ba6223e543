"""Poles that outputs share, real or complex, as a JSON document and as text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from thermaltool.documents import jsonable
from thermaltool.fitting.fit import Fit
from thermaltool.fitting.selection import Candidate
from thermaltool.fitting.subspace.model import Subspace, SubspaceOutput
from thermaltool.fitting.subspace.search import LONGEST_IN_RECORDS
from thermaltool.report.network import agreement_rows
from thermaltool.report.orders import aligned
from thermaltool.report.transfer import (
    LISTED_CANDIDATES,
    continuous_document,
    estimate_document,
    gain_unit,
    interval_text,
    longer_than_record,
    one_or_all,
    with_interval,
)
from thermaltool.responses import response_class
from thermaltool.signals.intervals import Estimate
from thermaltool.units import printed

UNITS = {"tau": "s", "omega": "rad/s", "zeta": "1"}


def _outputs(fits: Sequence[Fit]) -> list[SubspaceOutput]:
    return [fit.model for fit in fits if isinstance(fit.model, SubspaceOutput)]


def subspace_warnings(fits: Sequence[Fit]) -> list[str]:
    """What a user should know before using the model, each a sentence."""
    sentences, first, span = [], _outputs(fits)[0], fits[0].data.duration
    if not first.converged:
        sentences.append("the search for the poles did not converge")
    for e in dict.fromkeys(first.undetermined()):
        sentences.append(
            f"the data do not identify the time constant of {e.value:.3g} s ({interval_text(e)}): "
            "take fewer modes"
        )
    slowest = first.time_constant_estimates()[0].value
    if slowest > span:
        endless = slowest > 0.99 * LONGEST_IN_RECORDS * span
        sentences.append(longer_than_record(slowest, span, endless))
    return sentences


def subspace_fields(fits: Sequence[Fit], k: int) -> dict[str, Any]:
    """What the document of output k has beside that of any model."""
    fit, output = fits[k], fits[k].model
    assert isinstance(output, SubspaceOutput)
    delays = [samples * output.dt for samples in output.sample_delays]
    fields: dict[str, Any] = {
        "shared_with": [other.model.target for other in fits if other is not fit],
        "structure": "subspace",
        "orders": {"modes": output.order, "feedthrough": output.has_direct},
        "delay_s": one_or_all(delays),
        "dead_time_s": one_or_all([0.0] * len(output.names)),
        "time_constants_s": [e.value for e in output.time_constant_estimates()],
        "units": {name: _unit(output, name) for name in fit.parameters},
        "noise": {"variance": output.sigma2},
        "criteria": {"aic": output.criteria.aic, "bic": output.criteria.bic},
        "terms": [_term(output, i) for i in range(len(output.names))],
    }
    if output.participations is not None:
        fields["participations"] = jsonable(output.participations)
    if fit.candidates:
        fields["candidates"] = [
            {"modes": c.model.order, "feedthrough": c.model.has_direct,
             "combinations": c.model.participations is not None,
             "fit_percent": jsonable(c.fit_percent[k]), "bic": c.model.criteria.bic}
            for c in fit.candidates
        ]  # fmt: skip
    return fields


def _unit(output: SubspaceOutput, name: str) -> str:
    """Of a parameter by its name, with its input in brackets where there are several."""
    label, _, source = name.partition("[")
    known = UNITS.get(label.rstrip("0123456789"))
    return known or gain_unit(output.target, source.rstrip("]") or output.names[0])


def _term(output: SubspaceOutput, i: int) -> dict[str, Any]:
    unit = gain_unit(output.target, output.names[i])
    response, gains = output.term(i).response, output.gain_estimates(i)
    return {
        "input": output.names[i],
        "delay_s": output.sample_delays[i] * output.dt,
        "dead_time_s": 0.0,
        "gain": {**estimate_document(output.gain(i)), "unit": unit},
        "time_constants_s": [estimate_document(e) for e in output.time_constant_estimates()],
        "oscillations": [
            {"omega_rad_s": omega, "zeta": zeta} for omega, zeta in output.oscillations
        ],
        "weights": [
            {"name": name, **estimate_document(gains[name]), "unit": unit}
            for name in response_class(response.kind).gains
        ],
        "continuous": continuous_document(output.term(i)),
    }


def subspace_table(fits: Sequence[Fit]) -> str:
    """The shared poles, the weights of every output, fits and what is left."""
    outputs = _outputs(fits)
    first, rows = outputs[0], max(output.rows for output in outputs)
    n = first.order
    head = (
        f"{', '.join(o.target for o in outputs)}: {n} shared mode{'s' * (n > 1)}"
        f"{' and feedthrough' * first.has_direct} by {first.method}, {rows} rows at {first.dt:g} s"
    )
    poles = [["", "time constant s"]]
    poles += [[name, with_interval(e)] for name, e in _named_poles(first)]
    gains = response_class(first.term(0).response.kind).gains
    weights = [["output", "input", "gain", "unit", *(f"weight {name}" for name in gains)]]
    for output in outputs:
        for i, name in enumerate(output.names):
            own = output.gain_estimates(i)
            weights.append([
                output.target, name, with_interval(output.gain(i)),
                printed(gain_unit(output.target, name)),
                *(f"{own[gain].value:.4g}" for gain in gains),
            ])  # fmt: skip
    parts = [head, aligned(poles), aligned(weights), aligned(agreement_rows(fits))]
    if fits[0].candidates:
        parts.append(_candidates(fits[0].candidates))
    return "\n\n".join(parts)


def _named_poles(output: SubspaceOutput) -> list[tuple[str, Estimate]]:
    """Each time constant by name; of a pair the decay, with its period and damping."""
    found: list[tuple[str, Estimate]] = []
    lags = 0
    for p, e in zip(output.poles, output.time_constant_estimates(), strict=True):
        if p.imag < 0:
            continue
        if p.imag:
            period, damping = 2 * math.pi / p.imag, -p.real / abs(p)
            found.append((f"pair: period {period:.5g} s, damping {damping:.3g}", e))
        else:
            lags += 1
            found.append((f"tau{lags}", e))
    return found


def _candidates(candidates: Sequence[Candidate[Subspace]]) -> str:
    rows = [["modes", "of inputs", "feedthrough", "held-out fit %", "BIC"]]
    for c in candidates[:LISTED_CANDIDATES]:
        fits = " ".join(f"{fit:.2f}" for fit in c.fit_percent)
        kind = "each" if c.model.participations is None else "one combination"
        rows.append([str(c.model.order), kind, "yes" if c.model.has_direct else "no", fits,
                     f"{c.model.criteria.bic:.1f}"])  # fmt: skip
    return f"of {len(candidates)} candidates the best first:\n{aligned(rows)}"
