"""Shared modes as a JSON document and as text."""

from __future__ import annotations

from typing import Any

from thermaltool.documents import jsonable
from thermaltool.fitting.network.choose import NetworkCandidate
from thermaltool.fitting.network.model import NetworkOutput
from thermaltool.fitting.network.run import IdentifiedNetwork
from thermaltool.fitting.network.search import LONGEST_IN_RECORDS
from thermaltool.report.orders import aligned
from thermaltool.report.transfer import (
    estimate_document,
    gain_unit,
    held_samples,
    interval_text,
    longer_than_record,
    one_or_all,
    residuals_document,
    residuals_line,
    with_interval,
)
from thermaltool.responses import parameter_names
from thermaltool.units import printed


def network_warnings(found: IdentifiedNetwork) -> list[str]:
    """What a user should know before using the model, each a sentence."""
    sentences, span = [], found.data.duration
    if not found.network.converged:
        sentences.append("the search for the time constants did not converge")
    undetermined = found.network.undetermined()
    for e in found.network.outputs[0].time_constant_estimates():
        if e in undetermined:
            sentences.append(
                f"the data do not tell the time constant of {e.value:.3g} s "
                f"({interval_text(e)}): take fewer modes"
            )
        elif e.value > span:
            endless = e.value > 0.99 * LONGEST_IN_RECORDS * span
            sentences.append(longer_than_record(e.value, span, endless))
    return sentences


def network_document(found: IdentifiedNetwork) -> dict[str, Any]:
    """One model for each output, with the time constants that they share."""
    return {"models": [_output(found, k) for k in range(len(found.network.outputs))]}


def _output(found: IdentifiedNetwork, k: int) -> dict[str, Any]:
    output = found.network.outputs[k]
    units = ["s"] * output.modes
    units += [gain_unit(output.target, name) for name in output.names for _ in range(output.modes)]
    document: dict[str, Any] = {
        "inputs": list(output.names),
        "output": output.target,
        "shared_with": [s.target for s in found.network.outputs if s is not output],
        "structure": "network",
        "orders": {"modes": output.modes},
        "sample_period_s": output.dt,
        "delay_s": one_or_all([_delay(output, i) for i in range(len(output.names))]),
        "dead_time_s": one_or_all(output.delays),
        "time_constants_s": output.time_constants.tolist(),
        "fit_training_percent": jsonable(found.training[k].fit_percent),
        "fit_validation_percent": None,
        "improvement_validation_percent": None,
        "parameters": {name: estimate_document(e) for name, e in output.named()},
        "units": dict(zip((name for name, _ in output.named()), units, strict=True)),
        "noise": {"variance": output.sigma2},
        "offsets": list(output.offsets),
        "method": output.method,
        "converged": found.network.converged,
        "criteria": {"aic": output.criteria.aic, "bic": output.criteria.bic},
        "residuals": residuals_document(found.tests[k]),
        "terms": [_term(output, i) for i in range(len(output.names))],
    }
    if found.validation is not None and found.improvement is not None:
        document["fit_validation_percent"] = jsonable(found.validation[k].fit_percent)
        document["improvement_validation_percent"] = jsonable(found.improvement[k])
    if found.candidates is not None:
        document["candidates"] = [
            {"modes": c.modes, "fit_percent": jsonable(c.fit_percent[k]), "bic": c.bic}
            for c in found.candidates
        ]
    return document


def _term(output: NetworkOutput, i: int) -> dict[str, Any]:
    response, unit = output.response(i), gain_unit(output.target, output.names[i])
    return {
        "input": output.names[i],
        "delay_s": _delay(output, i),
        "dead_time_s": output.delays[i],
        "gain": {**estimate_document(output.gain(i)), "unit": unit},
        "time_constants_s": [estimate_document(e) for e in output.time_constant_estimates()],
        "oscillations": [],
        "weights": [{**estimate_document(e), "unit": unit} for e in output.weight_estimates(i)],
        "continuous": {
            "kind": response.kind,
            "parameters": {n: getattr(response, n) for n in parameter_names(response.kind)},
            "mismatch": 0.0,
        },
    }


def _delay(output: NetworkOutput, i: int) -> float:
    """Dead time with what the sampling itself adds, as of the other structures [s]."""
    return output.delays[i] + held_samples(output.names[i]) * output.dt


def network_table(found: IdentifiedNetwork) -> str:
    """The shared time constants, the weights of every output, fits and what is left."""
    network = found.network
    first, n = network.outputs[0], len(network.time_constants)
    rows = max(s.rows for s in network.outputs)
    head = (
        f"{', '.join(s.target for s in network.outputs)}: {n} shared mode{'s' * (n > 1)} by "
        f"{first.method}, {rows} rows at {first.dt:g} s"
    )
    names = [f"tau{j + 1}" for j in range(n)]
    modes = [["", "time constant s"]]
    modes += [
        [f"tau{j + 1}", with_interval(e)] for j, e in enumerate(first.time_constant_estimates())
    ]
    weights = [["output", "input", "dead time s", "gain", "unit", *(f"weight {t}" for t in names)]]
    fits = [["output", "fit %", *(["validation %", "improvement %"] if found.validation else []),
             "residuals"]]  # fmt: skip
    for k, output in enumerate(network.outputs):
        for i, name in enumerate(output.names):
            weights.append([
                output.target, name, f"{output.delays[i]:g}", with_interval(output.gain(i)),
                printed(gain_unit(output.target, name)),
                *(with_interval(e) for e in output.weight_estimates(i)),
            ])  # fmt: skip
        held = []
        if found.validation is not None and found.improvement is not None:
            held = [f"{found.validation[k].fit_percent:.2f}", f"{found.improvement[k]:.1f}"]
        fits.append([output.target, f"{found.training[k].fit_percent:.2f}", *held,
                     residuals_line(found.tests[k])])  # fmt: skip
    parts = [head, aligned(modes), aligned(weights), aligned(fits)]
    if found.candidates is not None:
        parts.append(_candidates(found.candidates))
    return "\n\n".join(parts)


def _candidates(candidates: tuple[NetworkCandidate, ...]) -> str:
    rows = [["modes", "held-out fit %", "BIC"]]
    for c in candidates:
        fits = " ".join(f"{fit:.2f}" for fit in c.fit_percent)
        rows.append([str(c.modes), fits, f"{c.bic:.1f}"])
    return f"of {len(candidates)} candidates the best first:\n{aligned(rows)}"
