"""Fitted networks as a document, a table and sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from thermaltool.documents import jsonable
from thermaltool.fitting.rc.compare import SIGNIFICANCE, RcComparison
from thermaltool.fitting.rc.document import time_constants
from thermaltool.fitting.rc.fit import RcFit
from thermaltool.fitting.rc.validation import InnovationTests, RcAgreement
from thermaltool.report.orders import aligned
from thermaltool.signals.intervals import Estimate

Tests = Mapping[str, Mapping[str, InnovationTests]]
# Tests of the one-step errors speak against a network below this p-value.
MIN_P_VALUE = 0.01
# By so much more of −2 log L a log that begins at rest would be unlikely.
MIN_UNREST = 20.0
# Points of fit between what is predicted from row to row and what a free run reaches, which are
# named [%].
MAX_LOST_FIT = 10.0


def rc_document(
    comparison: RcComparison, tests: Tests, agreements: Sequence[RcAgreement]
) -> dict[str, Any]:
    """All fits and the tests between them as plain data."""
    return {
        "networks": [_document(fit, tests[fit.network.name], agreements)
                     for fit in comparison.fits],
        "likelihood_ratio_tests": [
            {"smaller": t.smaller, "larger": t.larger, "statistic": t.statistic, "dof": t.dof,
             "p": t.p_value}
            for t in comparison.tests
        ],
        "sufficient": comparison.sufficient.network.name,
    }  # fmt: skip


def _document(
    fit: RcFit, tests: Mapping[str, InnovationTests], agreements: Sequence[RcAgreement]
) -> dict[str, Any]:
    unknown = fit.unidentified
    return {
        "name": fit.network.name,
        "rows": sum(map(len, fit.likelihood.pieces)),
        "readings": fit.likelihood.readings,
        "log_likelihood": fit.log_likelihood,
        "criteria": {"aic": fit.criteria.aic, "bic": fit.criteria.bic},
        "estimated": fit.parameters,
        "converged": fit.converged,
        "time_constants_s": time_constants(fit).tolist(),
        "parameters": {
            name: _parameter(e, name not in unknown) for name, e in fit.estimates.items()
        },
        "resistances": {
            name: _parameter(_resistance(e), name not in unknown)
            for name, e in fit.estimates.items() if name.endswith(".conductance")
        },
        "fixed": {p.name: p.start for p in fit.network.parameters if p.fixed},
        "innovations": {
            channel: {"lags": t.lags, "white_p": jsonable(t.white_p),
                      "periodogram_p": jsonable(t.periodogram.p_value)}
            for channel, t in tests.items()
        },
        "agreements": [
            {"log": a.log, "output": a.output, "rows": a.rows,
             "simulated": a.simulated.document(), "one_step": a.one_step.document(),
             "carried_on": None if a.carried_on is None else a.carried_on.document()}
            for a in agreements if a.network == fit.network.name
        ],
    }  # fmt: skip


def _parameter(e: Estimate, identified: bool) -> dict[str, Any]:
    return {"value": e.value, "interval": [e.low, e.high] if identified else None,
            "unit": e.unit}  # fmt: skip


def _resistance(e: Estimate) -> Estimate:
    """The reciprocal of a conductance [K/W]."""
    with np.errstate(divide="ignore"):
        low, high = (float(1.0 / np.float64(x)) for x in (e.high, e.low))
    return Estimate(1.0 / e.value, low, high, "K/W")


def rc_table(comparison: RcComparison, tests: Tests, agreements: Sequence[RcAgreement]) -> str:
    """Each network with its parameters and fits, then the networks beside each other."""
    parts = []
    for fit in comparison.fits:
        own = [a for a in agreements if a.network == fit.network.name]
        parts += [_head(fit), _parameters(fit), _fits(own), _innovations(tests[fit.network.name])]
    if len(comparison.fits) > 1:
        parts += [_networks(comparison), *_tests(comparison)]
        parts.append(f"sufficient: {comparison.sufficient.network.name}")
    return "\n\n".join(parts)


def _head(fit: RcFit) -> str:
    n, m = len(fit.network.nodes), len(fit.network.outputs)
    times = ", ".join(f"{tau:.4g}" for tau in time_constants(fit))
    rows = sum(map(len, fit.likelihood.pieces))
    return (
        f"{fit.network.name}: {n} node{'s' * (n > 1)}, {m} measured, {rows} rows; time constants "
        f"{times} s"
    )


def _parameters(fit: RcFit) -> str:
    rows = [["parameter", "value", "95 % interval", "unit"]]
    for name, e in fit.estimates.items():
        known, zero = name not in fit.unidentified, name in fit.vanished
        rows.append([name, "0" if zero else f"{e.value:.5g}", _interval(e, known, zero), e.unit])
        if name.endswith(".conductance"):
            inverse = _resistance(e)
            rows.append(["", f"{inverse.value:.5g}", _interval(inverse, known, zero), "K/W"])
    return aligned(rows)


def _interval(e: Estimate, known: bool, zero: bool) -> str:
    if zero:
        return "none found"
    return f"{e.low:.4g} to {e.high:.4g}" if known else "not identified"


def _fits(agreements: Sequence[RcAgreement]) -> str:
    carried = any(a.carried_on is not None for a in agreements)
    head = ["log", "output", "rows", "simulated %", "one step %"]
    rows = [[*head, "carried on %"] if carried else head]
    for a in agreements:
        cells = [a.log, a.output, a.rows, f"{a.simulated.fit_percent:.2f}",
                 f"{a.one_step.fit_percent:.2f}"]  # fmt: skip
        last = "" if a.carried_on is None else f"{a.carried_on.fit_percent:.2f}"
        rows.append([*cells, last] if carried else cells)
    return aligned(rows)


def _innovations(tests: Mapping[str, InnovationTests]) -> str:
    lines = []
    for channel, t in tests.items():
        white = "white" if t.white_p >= MIN_P_VALUE else "not white"
        lines.append(
            f"one-step errors of {channel}: {white} over {t.lags} lags (p = {t.white_p:.2g}), "
            f"cumulated periodogram p = {t.periodogram.p_value:.2g}"
        )
    return "\n".join(lines)


def _networks(comparison: RcComparison) -> str:
    rows = [["network", "parameters", "log likelihood", "AIC", "BIC"]]
    for fit in comparison.fits:
        c = fit.criteria
        rows.append([fit.network.name, str(fit.parameters), f"{fit.log_likelihood:.2f}",
                     f"{c.aic:.1f}", f"{c.bic:.1f}"])  # fmt: skip
    return aligned(rows)


def _tests(comparison: RcComparison) -> list[str]:
    if not comparison.tests:
        return ["no network is nested in another: AIC and BIC compare them"]
    rows = [["smaller", "larger", "likelihood ratio", "dof", "p", "larger is"]]
    for t in comparison.tests:
        better = "better" if t.p_value < SIGNIFICANCE else "no better"
        rows.append([t.smaller, t.larger, f"{t.statistic:.2f}", str(t.dof), f"{t.p_value:.2g}",
                     better])  # fmt: skip
    return [aligned(rows)]


def rc_warnings(comparison: RcComparison, agreements: Sequence[RcAgreement]) -> list[str]:
    """What a user should know before using the networks, each a sentence."""
    sentences = []
    for fit in comparison.fits:
        name = fit.network.name
        if not fit.converged:
            sentences.append(f"{name}: the search did not converge")
        unknown = [each for each in fit.unidentified if each not in fit.vanished]
        if unknown:
            sentences.append(f"{name}: the data do not identify {', '.join(unknown)}: fix them, or "
                             "take a smaller network")  # fmt: skip
    fit = comparison.sufficient
    if begins_elsewhere(fit):
        sentences.append(
            f"{fit.network.name}: a log does not begin at rest, where the model file was run from"
        )
    for a in agreements:
        lost = a.one_step.fit_percent - a.simulated.fit_percent
        if a.network == fit.network.name and a.rows == "held out" and lost > MAX_LOST_FIT:
            sentences.append(
                f"{a.output}: held-out rows are predicted to {a.one_step.fit_percent:.3g} % from "
                f"row to row, and to {a.simulated.fit_percent:.3g} % by the model file alone"
            )
    return sentences


def begins_elsewhere(fit: RcFit) -> bool:
    """Whether a start that stands still under the first inputs is much less likely."""
    return fit.unrest() > MIN_UNREST
