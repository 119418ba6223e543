"""Shared modes as a JSON document and as text."""

from __future__ import annotations

from typing import Any

from thermaltool.fitting.network.choose import Candidate
from thermaltool.fitting.network.model import Share
from thermaltool.fitting.network.run import Shared
from thermaltool.fitting.transfer.search import SLOWEST
from thermaltool.report.orders import aligned
from thermaltool.report.transfer import (
    estimate_document,
    finite,
    gain_unit,
    held_samples,
    interval_told,
    longer_than_record,
    one_or_all,
    residuals_document,
    residuals_line,
    with_interval,
)
from thermaltool.responses import parameter_names
from thermaltool.units import printed


def network_warnings(found: Shared) -> list[str]:
    """What a user should know before using the model, each a sentence."""
    told, span = [], found.data.duration
    if not found.network.converged:
        told.append("the search for the time constants did not converge")
    untold = found.network.untold()
    for e in found.network.shares[0].time_constants():
        if e in untold:
            told.append(
                f"the data do not tell the time constant of {e.value:.3g} s "
                f"({interval_told(e)}): take fewer modes"
            )
        elif e.value > span:
            endless = e.value > 0.99 * SLOWEST * span
            told.append(longer_than_record(e.value, span, endless))
    return told


def network_document(found: Shared) -> dict[str, Any]:
    """One model for each output, with the time constants that they share."""
    return {"models": [_output(found, k) for k in range(len(found.network.shares))]}


def _output(found: Shared, k: int) -> dict[str, Any]:
    share = found.network.shares[k]
    units = ["s"] * share.modes
    units += [gain_unit(share.target, name) for name in share.names for _ in range(share.modes)]
    document: dict[str, Any] = {
        "inputs": list(share.names),
        "output": share.target,
        "shared_with": [s.target for s in found.network.shares if s is not share],
        "structure": "network",
        "orders": {"modes": share.modes},
        "sample_period_s": share.dt,
        "delay_s": one_or_all([_delay(share, i) for i in range(len(share.names))]),
        "dead_time_s": one_or_all(share.delays),
        "time_constants_s": share.lags.tolist(),
        "fit_training_percent": finite(found.training[k].fit_percent),
        "fit_validation_percent": None,
        "improvement_validation_percent": None,
        "parameters": {name: estimate_document(e) for name, e in share.named()},
        "units": dict(zip((name for name, _ in share.named()), units, strict=True)),
        "noise": {"variance": share.sigma2},
        "offsets": list(share.offsets),
        "method": share.method,
        "converged": found.network.converged,
        "criteria": {"aic": share.criteria.aic, "bic": share.criteria.bic},
        "residuals": residuals_document(found.tests[k]),
        "terms": [_term(share, i) for i in range(len(share.names))],
    }
    if found.validation is not None and found.improvement is not None:
        document["fit_validation_percent"] = finite(found.validation[k].fit_percent)
        document["improvement_validation_percent"] = finite(found.improvement[k])
    if found.candidates is not None:
        document["candidates"] = [
            {"modes": c.modes, "fit_percent": finite(c.fit_percent[k]), "bic": c.bic}
            for c in found.candidates
        ]
    return document


def _term(share: Share, i: int) -> dict[str, Any]:
    response, unit = share.response(i), gain_unit(share.target, share.names[i])
    return {
        "input": share.names[i],
        "delay_s": _delay(share, i),
        "dead_time_s": share.delays[i],
        "gain": {**estimate_document(share.gain(i)), "unit": unit},
        "time_constants_s": [estimate_document(e) for e in share.time_constants()],
        "oscillations": [],
        "weights": [{**estimate_document(e), "unit": unit} for e in share.weight(i)],
        "continuous": {
            "kind": response.kind,
            "parameters": {n: getattr(response, n) for n in parameter_names(response.kind)},
            "mismatch": 0.0,
        },
    }


def _delay(share: Share, i: int) -> float:
    """Dead time with what the sampling itself adds, as of the other structures [s]."""
    return share.delays[i] + held_samples(share.names[i]) * share.dt


def network_table(found: Shared) -> str:
    """The shared time constants, the weights of every output, fits and what is left."""
    network = found.network
    first, n = network.shares[0], len(network.lags)
    rows = max(s.rows for s in network.shares)
    head = (
        f"{', '.join(s.target for s in network.shares)}: {n} shared mode{'s' * (n > 1)} by "
        f"{first.method}, {rows} rows at {first.dt:g} s"
    )
    names = [f"tau{j + 1}" for j in range(n)]
    modes = [["", "time constant s"]]
    modes += [[f"tau{j + 1}", with_interval(e)] for j, e in enumerate(first.time_constants())]
    weights = [["output", "input", "dead time s", "gain", "unit", *(f"weight {t}" for t in names)]]
    fits = [["output", "fit %", *(["validation %", "improvement %"] if found.validation else []),
             "residuals"]]  # fmt: skip
    for k, share in enumerate(network.shares):
        for i, name in enumerate(share.names):
            weights.append([
                share.target, name, f"{share.delays[i]:g}", with_interval(share.gain(i)),
                printed(gain_unit(share.target, name)),
                *(with_interval(e) for e in share.weight(i)),
            ])  # fmt: skip
        held = []
        if found.validation is not None and found.improvement is not None:
            held = [f"{found.validation[k].fit_percent:.2f}", f"{found.improvement[k]:.1f}"]
        fits.append([share.target, f"{found.training[k].fit_percent:.2f}", *held,
                     residuals_line(found.tests[k])])  # fmt: skip
    parts = [head, aligned(modes), aligned(weights), aligned(fits)]
    if found.candidates is not None:
        parts.append(_candidates(found.candidates))
    return "\n\n".join(parts)


def _candidates(candidates: tuple[Candidate, ...]) -> str:
    rows = [["modes", "held-out fit %", "BIC"]]
    for c in candidates:
        fits = " ".join(f"{fit:.2f}" for fit in c.fit_percent)
        rows.append([str(c.modes), fits, f"{c.bic:.1f}"])
    return f"of {len(candidates)} candidates the best first:\n{aligned(rows)}"
