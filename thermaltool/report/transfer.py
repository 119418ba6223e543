"""Identified transfer functions as a JSON document and as text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from thermaltool.identification.transfer.choose import Choice
from thermaltool.identification.transfer.continuation import Continued
from thermaltool.identification.transfer.data import Data
from thermaltool.identification.transfer.model import Estimate, TransferModel
from thermaltool.identification.transfer.residuals import ResidualTests
from thermaltool.identification.transfer.search import FALLBACK, SEPARATE
from thermaltool.report.orders import aligned
from thermaltool.responses import parameter_names
from thermaltool.signals.agreement import Agreement
from thermaltool.units import parse_channel, printed

# Residual tests speak against a model below this p-value.
DOUBTFUL = 0.01
# Difference of the continuous from the discrete step, as a share, that is told.
MISMATCH = 0.01
# Points of fit that the model file loses from rest, that are told.
LOST = 10.0
# Candidates of the choice of orders that are listed.
_LISTED = 5


@dataclass(frozen=True)
class Identified:
    """One output, identified and judged.

    Attributes
    ----------
    model : TransferModel
    data : Data
        What it was fitted to.
    training, validation : Agreement
        Of free runs; `validation` is None where no data were kept for it.
    improvement : float or None
        Share by which the model would have reduced the mean deviation of the validation data [%]
        (Mareš et al.: imp).
    tests : ResidualTests
    choice : Choice or None
        Where the orders were chosen.
    continued : tuple of Continued or str
        The way of each input in continuous time, or why there is none.
    """

    model: TransferModel
    data: Data
    training: Agreement
    validation: Agreement | None
    improvement: float | None
    tests: ResidualTests
    choice: Choice | None
    continued: tuple[Continued | str, ...]

    @property
    def variance(self) -> float:
        """Of the training output [unit²]."""
        return float(np.var(self.data.output()))

    def warnings(self) -> list[str]:
        """What a user should know before using the model, each a sentence."""
        m, target, told = self.model, self.model.target, []
        if not m.converged:
            told.append(f"{target}: the search did not converge ({m.method})")
        if m.structure == "oe" and FALLBACK in m.method and SEPARATE not in m.method:
            told.append(f"{target}: refined instrumental variables did not settle: {m.method}")
        for way in self.continued:
            if isinstance(way, str):
                told.append(way)
            elif way.mismatch > MISMATCH:
                told.append(
                    f"{target}: in continuous time the step differs by up to "
                    f"{100 * way.mismatch:.2g} % from the discrete model"
                )
        span = max(len(s) for s in self.data.stretches) * m.dt
        slow = [e.value for g in range(len(m.F)) for e in m.time_constants(g) if e.value > span]
        if slow:
            told.append(
                f"{target}: a time constant of {max(slow):.3g} s is longer than the record "
                f"({span:.3g} s): the gain is not settled by it"
            )
        return told

    def in_use(self, from_rest: Agreement) -> str:
        """A sentence where the model file, `from_rest`, fits much worse; else nothing."""
        return lost_from_rest(self.model.target, self.training, from_rest)


def lost_from_rest(target: str, training: Agreement, from_rest: Agreement) -> str:
    """A sentence where a model fits much worse from rest than with the state at the start."""
    if not training.fit_percent - from_rest.fit_percent > LOST:
        return ""
    return (
        f"{target}: the model file fits the training data to "
        f"{from_rest.fit_percent:.3g} % where simulate takes them to begin at rest, and to "
        f"{training.fit_percent:.3g} % with the state at the start estimated: if the "
        "machine was at rest there, use --initial rest"
    )


def transfer_document(found: Sequence[Identified]) -> dict[str, Any]:
    """All models as plain data."""
    return {"models": [_model_document(each) for each in found]}


def _model_document(found: Identified) -> dict[str, Any]:
    m = found.model
    delays = [nk * m.dt for nk in m.orders.nk]
    single = len(m.names) == 1
    document: dict[str, Any] = {
        "inputs": list(m.names),
        "output": m.target,
        "structure": m.structure,
        "orders": {
            "nb": list(m.orders.nb),
            "nf": [len(m.denominator(k)) - 1 for k in range(len(m.names))],
            "nk": list(m.orders.nk),
            "nc": len(m.C) - 1,
            "nd": len(m.D) - 1,
        },
        "sample_period_s": m.dt,
        "delay_s": delays[0] if single else delays,
        "time_constants_s": [e.value for g in range(len(m.F)) for e in m.time_constants(g)],
        "fit_training_percent": finite(found.training.fit_percent),
        "fit_validation_percent": None,
        "improvement_validation_percent": None
        if found.improvement is None
        else finite(found.improvement),
        "parameters": {name: estimate_document(e) for name, e in m.named()},
        "noise": {"C": m.C.tolist(), "D": m.D.tolist(), "variance": m.sigma2},
        "offsets": list(m.offsets),
        "method": m.method,
        "converged": m.converged,
        "criteria": {"aic": m.aic, "bic": m.bic, "yic": finite(m.yic(found.variance))},
        "residuals": residuals_document(found.tests),
        "terms": [_term(found, k) for k in range(len(m.names))],
    }
    if found.validation is not None:
        document["fit_validation_percent"] = finite(found.validation.fit_percent)
    if found.choice is not None:
        document["candidates"] = [
            {"nb": c.nb, "nf": c.nf, "nk": list(c.nk), "fit_percent": finite(c.fit_percent),
             "aic": c.aic, "bic": c.bic, "yic": finite(c.yic)}
            for c in found.choice.candidates[:20]
        ]  # fmt: skip
    return document


def _term(found: Identified, k: int) -> dict[str, Any]:
    m, way = found.model, found.continued[k]
    term: dict[str, Any] = {
        "input": m.names[k],
        "delay_s": m.orders.nk[k] * m.dt,
        "gain": estimate_document(m.gain(k)),
        "time_constants_s": [estimate_document(e) for e in m.time_constants(m.group_of(k))],
        "numerator": m.B[k].tolist(),
        "denominator": m.denominator(k).tolist(),
    }
    if isinstance(way, str):
        return {**term, "continuous": None, "why_not_continuous": way}
    response = way.response
    names = parameter_names(response.kind)
    term["continuous"] = {
        "kind": response.kind,
        "parameters": {name: getattr(response, name) for name in names},
        "mismatch": way.mismatch,
    }
    return term


def residuals_document(tests: ResidualTests) -> dict[str, Any]:
    return {
        "lags": tests.lags,
        "white_p": finite(tests.white_p),
        "independent_p": {name: finite(p) for name, p in tests.independent_p.items()},
    }


def estimate_document(e: Estimate) -> dict[str, Any]:
    sure = bool(np.isfinite([e.low, e.high]).all())
    return {"value": e.value, "interval": [e.low, e.high] if sure else None}


def finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def transfer_table(found: Identified) -> str:
    """One model: what drives what, how fast, how sure; how well it runs free; what is left."""
    m = found.model
    head = f"{m.target}: {m.structure.upper()} by {m.method}, {m.rows} rows at {m.dt:g} s"
    fit = f"fit {found.training.fit_percent:.2f} % in training"
    if found.validation is not None:
        fit += f", {found.validation.fit_percent:.2f} % in validation"
    if found.improvement is not None:
        fit += f" (improvement {found.improvement:.1f} %)"
    unit = parse_channel(m.target).unit
    rows = [["input", "nb,nf,nk", "delay s", "gain", "unit", "time constant s", "weight"]]
    for k, name in enumerate(m.names):
        n = len(m.denominator(k)) - 1
        first = [name, f"{m.orders.nb[k]},{n},{m.orders.nk[k]}", f"{m.orders.nk[k] * m.dt:g}",
                 with_interval(m.gain(k)),
                 printed(f"{unit}/{parse_channel(name).unit}")]  # fmt: skip
        constants = m.time_constants(m.group_of(k))
        weights = _weights(found.continued[k], len(constants))
        for j, (e, weight) in enumerate(zip(constants, weights, strict=True)):
            rows.append([*(first if not j else [""] * 5), with_interval(e), weight])
        if not constants:
            rows.append([*first, "", ""])
    c = f"AIC {m.aic:.1f}  BIC {m.bic:.1f}  YIC {m.yic(found.variance):.2f}"
    lines = [head, fit, "", aligned(rows), "", c, residuals_line(found.tests)]
    if found.choice is not None:
        lines += ["", _candidates(found.choice)]
    return "\n".join(lines)


def _weights(way: Continued | str, count: int) -> list[str]:
    """Weights of real lags, slowest first as the time constants are."""
    if isinstance(way, str) or way.response.kind.startswith("oscillation"):
        return [""] * count
    return [f"{getattr(way.response, f'K{j + 1}'):.4g}" for j in range(count)]


def with_interval(e: Estimate) -> str:
    return f"{e.value:.5g} ({e.low:.4g} to {e.high:.4g})"


def residuals_line(tests: ResidualTests) -> str:
    def verdict(p: float, good: str, bad: str) -> str:
        return f"{bad if p < DOUBTFUL else good} (p {p:.2g})"

    if not tests.lags:
        return "residuals: too few to test"
    parts = [verdict(tests.white_p, "white", "not white")]
    parts += [
        verdict(p, f"independent of {name}", f"still depend on {name}")
        for name, p in tests.independent_p.items()
    ]
    return f"residuals over {tests.lags} lags: " + ", ".join(parts)


def _candidates(choice: Choice) -> str:
    rows = [["nb,nf,nk", "held-out fit %", "BIC", "YIC"]]
    for c in choice.candidates[:_LISTED]:
        rows.append([f"{c.nb},{c.nf},{'/'.join(map(str, c.nk))}", f"{c.fit_percent:.2f}",
                     f"{c.bic:.1f}", f"{c.yic:.2f}"])  # fmt: skip
    return f"of {len(choice.candidates)} candidates the best:\n{aligned(rows)}"
