"""Shared modes as a JSON document and as text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from thermaltool.identification.network.choose import Candidate
from thermaltool.identification.network.data import Records
from thermaltool.identification.network.model import Network, Share
from thermaltool.identification.transfer.continuation import Continued
from thermaltool.identification.transfer.residuals import ResidualTests
from thermaltool.report.orders import aligned
from thermaltool.report.transfer import (
    estimate_document,
    finite,
    lost_from_rest,
    residuals_document,
    residuals_line,
    with_interval,
)
from thermaltool.responses import parameter_names
from thermaltool.signals.agreement import Agreement
from thermaltool.units import parse_channel, printed


@dataclass(frozen=True)
class Shared:
    """A network, identified and judged.

    Attributes
    ----------
    network : Network
    data : Records
        What it was fitted to.
    training, validation : tuple of Agreement, one for each output
        Of free runs; `validation` is None where no data were kept for it.
    improvement : tuple of float, or None
        As in `Identified`, of each output [%].
    tests : tuple of ResidualTests
    candidates : tuple of Candidate, or None
        Where the number of modes was chosen.
    """

    network: Network
    data: Records
    training: tuple[Agreement, ...]
    validation: tuple[Agreement, ...] | None
    improvement: tuple[float, ...] | None
    tests: tuple[ResidualTests, ...]
    candidates: tuple[Candidate, ...] | None

    def ways(self, k: int) -> tuple[Continued, ...]:
        """Of output k, as a model document takes them: they are continuous as they are."""
        share = self.network.shares[k]
        return tuple(
            Continued(share.response(i), 0.0, *share.response_covariance(i))
            for i in range(len(share.names))
        )

    def warnings(self) -> list[str]:
        """What a user should know before using the model, each a sentence."""
        told, span = [], self.data.duration
        if not self.network.converged:
            told.append("the search for the time constants did not converge")
        untold = self.network.untold()
        for e in self.network.shares[0].time_constants():
            if e in untold:
                told.append(
                    f"the data do not tell the time constant of {e.value:.3g} s ({e.low:.2g} to "
                    f"{e.high:.2g} s): take fewer modes"
                )
            elif e.value > span:
                told.append(
                    f"a time constant of {e.value:.3g} s is longer than the record ({span:.3g} s): "
                    "the gain is not settled by it"
                )
        return told

    def in_use(self, from_rest: Mapping[str, Agreement]) -> list[str]:
        """Sentences where the model file, `from_rest`, fits much worse."""
        pairs = zip(self.network.shares, self.training, strict=True)
        told = [lost_from_rest(s.target, fit, from_rest[s.target]) for s, fit in pairs]
        return [sentence for sentence in told if sentence]


def network_document(found: Shared) -> dict[str, Any]:
    """One model for each output, with the time constants that they share."""
    return {"models": [_output(found, k) for k in range(len(found.network.shares))]}


def _output(found: Shared, k: int) -> dict[str, Any]:
    share = found.network.shares[k]
    single = len(share.names) == 1
    document: dict[str, Any] = {
        "inputs": list(share.names),
        "output": share.target,
        "shared_with": [s.target for s in found.network.shares if s is not share],
        "structure": "network",
        "orders": {"modes": share.modes},
        "sample_period_s": share.dt,
        "delay_s": share.delays[0] if single else list(share.delays),
        "time_constants_s": share.lags.tolist(),
        "fit_training_percent": finite(found.training[k].fit_percent),
        "fit_validation_percent": None,
        "improvement_validation_percent": None,
        "parameters": {name: estimate_document(e) for name, e in share.named()},
        "noise": {"variance": share.sigma2},
        "offsets": list(share.offsets),
        "method": share.method,
        "converged": found.network.converged,
        "criteria": {"aic": share.aic, "bic": share.bic},
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
    response = share.response(i)
    return {
        "input": share.names[i],
        "delay_s": share.delays[i],
        "gain": estimate_document(share.gain(i)),
        "time_constants_s": [estimate_document(e) for e in share.time_constants()],
        "weights": [estimate_document(e) for e in share.weight(i)],
        "continuous": {
            "kind": response.kind,
            "parameters": {n: getattr(response, n) for n in parameter_names(response.kind)},
            "mismatch": 0.0,
        },
    }


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
    weights = [["output", "input", "delay s", "gain", "unit", *(f"weight {t}" for t in names)]]
    fits = [["output", "fit %", *(["validation %", "improvement %"] if found.validation else []),
             "residuals"]]  # fmt: skip
    for k, share in enumerate(network.shares):
        unit = parse_channel(share.target).unit
        for i, name in enumerate(share.names):
            weights.append([
                share.target, name, f"{share.delays[i]:g}", with_interval(share.gain(i)),
                printed(f"{unit}/{parse_channel(name).unit}"),
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
