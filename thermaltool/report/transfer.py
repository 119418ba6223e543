"""Identified transfer functions as a JSON document and as text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from thermaltool.documents import jsonable
from thermaltool.fitting.fit import Fit
from thermaltool.fitting.output_model import ContinuousTerm
from thermaltool.fitting.residuals import ResidualTests
from thermaltool.fitting.selection import Candidate
from thermaltool.fitting.transfer.continuous_term import MAX_MISMATCH, feedthrough, oscillates
from thermaltool.fitting.transfer.model import TransferModel
from thermaltool.fitting.transfer.polynomials import MAX_POLE_RADIUS
from thermaltool.fitting.transfer.search import FALLBACK, SEPARATE
from thermaltool.report.orders import aligned
from thermaltool.responses import parameter_names
from thermaltool.signals.agreement import Agreement
from thermaltool.signals.intervals import Estimate
from thermaltool.units import Hold, parse_channel, per, printed

# Residual tests speak against a model below this p-value.
MIN_P_VALUE = 0.01
# Points of fit that the model file loses from rest are named above this number [%].
MAX_LOST_FIT = 10.0
# An interval over more than this factor says nothing of a time constant.
MAX_INTERVAL_RATIO = 1e6
# A time constant this many times the record, or as slow as a pole may be, is one of an integrator.
INTEGRATOR_RECORDS = 100.0
# Candidates of the choice of orders that a table lists.
LISTED_CANDIDATES = 5


def transfer_warnings(fit: Fit) -> list[str]:
    """What a user should know before using the model, each a sentence."""
    m, sentences = fit.model, []
    assert isinstance(m, TransferModel)
    target = m.target
    if not m.converged:
        sentences.append(f"{target}: the search did not converge ({m.method})")
    if m.structure.name == "oe" and FALLBACK in m.method and SEPARATE not in m.method:
        sentences.append(f"{target}: refined instrumental variables did not settle: {m.method}")
    for term in fit.terms:
        if isinstance(term, str):
            sentences.append(term)
        elif term.mismatch > MAX_MISMATCH:
            sentences.append(
                f"{target}: in continuous time the step differs by up to "
                f"{100 * term.mismatch:.2g} % from the discrete model"
            )
    span = fit.data.longest * m.dt
    # What grows is named above: it has no continuous form.
    settling = [
        e.value
        for g in range(len(m.F))
        for z, e in zip(m.poles(g), m.time_constants(g), strict=True)
        if abs(z) < 1
    ]
    slowest = max(settling, default=0.0)
    if slowest > span:
        limit = 0.99 * m.dt / (1 - MAX_POLE_RADIUS)
        endless = slowest > min(INTEGRATOR_RECORDS * span, limit)
        sentences.append(f"{target}: {longer_than_record(slowest, span, endless)}")
    return sentences


def longer_than_record(tau: float, span: float, endless: bool) -> str:
    """What a time constant above the record means; `endless`: as far as the search goes."""
    if endless:
        return (
            f"a time constant of {tau:.3g} s is {tau / span:.2g} times the record: the data look "
            "unstable or integrating"
        )
    return (
        f"a time constant of {tau:.3g} s is longer than the record ({span:.3g} s): the gain is "
        "not settled by it"
    )


def lost_from_rest(found: Sequence[tuple[str, Agreement, Agreement]]) -> list[str]:
    """Sentences where models fit much worse from rest than with the state at the start.

    Parameters
    ----------
    found : sequence of (output, fit with the state estimated, fit of the model file from rest)
    """
    return [
        f"{target}: the model file fits the training data to "
        f"{from_rest.fit_percent:.3g} % with simulate --initial rest, and to "
        f"{training.fit_percent:.3g} % with the state at the start estimated: if the "
        "machine was at rest there, use --initial rest"
        for target, training, from_rest in found
        if training.fit_percent - from_rest.fit_percent > MAX_LOST_FIT
    ]


def _per_second(unit: str, power: int) -> str:
    return f"{unit}/s^{power}" if power > 1 else f"{unit}/s" if power else unit


def transfer_fields(fits: Sequence[Fit], k: int) -> dict[str, Any]:
    """What the document of transfer function k has beside that of any model."""
    fit, m = fits[k], fits[k].model
    assert isinstance(m, TransferModel)
    delays = [nk * m.dt for nk in m.orders.nk]
    gains = [gain_unit(m.target, name) for name in m.names]
    units = ["1"] * sum(m.orders.nf)
    units += [unit for unit, nb in zip(gains, m.orders.nb, strict=True) for _ in range(nb)]
    units = [_per_second(unit, -int(power)) for unit, power in zip(units, m.seconds, strict=True)]
    fields: dict[str, Any] = {
        "structure": m.structure.name,
        "orders": {
            "nb": list(m.orders.nb),
            "nf": [len(m.denominator(k)) - 1 for k in range(len(m.names))],
            "nk": list(m.orders.nk),
            "nc": len(m.C) - 1,
            "nd": len(m.D) - 1,
        },
        "delay_s": one_or_all(delays),
        "dead_time_s": one_or_all([_dead_time(m, k) for k in range(len(m.names))]),
        "time_constants_s": [e.value for g in range(len(m.F)) for e in m.time_constants(g)],
        "units": dict(zip(fit.parameters, units, strict=True)),
        "noise": {"C": m.C.tolist(), "D": m.D.tolist(), "variance": m.sigma2},
        "criteria": {"aic": m.criteria.aic, "bic": m.criteria.bic, "yic": jsonable(m.yic)},
        "terms": [_term(m, k, term) for k, term in enumerate(fit.terms)],
    }
    if fit.candidates:
        fields["candidates"] = [_candidate(c) for c in fit.candidates[:20]]
    return fields


def _candidate(c: Candidate[TransferModel]) -> dict[str, Any]:
    o, criteria = c.model.orders, c.model.criteria
    return {"nb": max(o.nb), "nf": o.nf[0], "nk": list(o.nk),
            "fit_percent": jsonable(c.fit_percent[0]), "aic": criteria.aic, "bic": criteria.bic,
            "yic": jsonable(c.model.yic)}  # fmt: skip


def _term(m: TransferModel, k: int, found: ContinuousTerm | str) -> dict[str, Any]:
    term: dict[str, Any] = {
        "input": m.names[k],
        "delay_s": m.orders.nk[k] * m.dt,
        "dead_time_s": _dead_time(m, k),
        "feedthrough": not isinstance(found, str) and is_direct(found),
        "gain": {**estimate_document(m.gain(k)), "unit": gain_unit(m.target, m.names[k])},
        "time_constants_s": [estimate_document(e) for e in m.time_constants(m.group_of(k))],
        "oscillations": [
            {"omega_rad_s": float(abs(s)), "zeta": float(-s.real / abs(s))}
            for z in m.poles(m.group_of(k))
            if z.imag > 0 and oscillates(z)
            for s in [np.log(z) / m.dt]
        ],
        "numerator": m.B[k].tolist(),
        "denominator": m.denominator(k).tolist(),
    }
    if isinstance(found, str):
        return {**term, "continuous": None, "why_not_continuous": found}
    return {**term, "continuous": continuous_document(found)}


def continuous_document(term: ContinuousTerm) -> dict[str, Any]:
    """A response in continuous time as JSON."""
    names = parameter_names(term.response.kind)
    return {
        "kind": term.response.kind,
        "parameters": {name: getattr(term.response, name) for name in names},
        "mismatch": term.mismatch,
    }


def _dead_time(m: TransferModel, k: int) -> float:
    """Between an input and the first of its effect: a held one reaches the next sample [s]."""
    return max(m.orders.nk[k] - held_samples(m.holds[k]), 0) * m.dt


def is_direct(term: ContinuousTerm) -> bool:
    """Whether an output follows the input of the same row."""
    return term.response.kind.endswith("_direct")


def _feedthrough(term: ContinuousTerm | str) -> str:
    """What the table says beside the dead time of an input that acts at once."""
    if isinstance(term, str) or not is_direct(term):
        return ""
    return f", direct {feedthrough(term.response):.4g}"


def held_samples(hold: Hold) -> int:
    """Samples of delay that are the sampling's own."""
    return 1 if hold == "zero" else 0


def gain_unit(target: str, name: str) -> str:
    """Of the output per unit of an input, as in channel names."""
    return per(parse_channel(target).unit, parse_channel(name).unit)


def one_or_all(values: Sequence[float]) -> float | list[float]:
    """Of each input; a number where there is one."""
    return values[0] if len(values) == 1 else list(values)


def estimate_document(e: Estimate) -> dict[str, Any]:
    """A value and its interval as JSON; null for an interval that says nothing."""
    return {"value": e.value, "interval": [e.low, e.high] if is_bounded(e) else None}


def is_bounded(e: Estimate) -> bool:
    """Whether an interval says anything."""
    if not np.isfinite([e.low, e.high]).all():
        return False
    # Of a ratio what counts is the ratio of its ends, of what may have either sign its width.
    if e.low > 0:
        return e.high <= MAX_INTERVAL_RATIO * e.low
    return e.high - e.low <= 2 * MAX_INTERVAL_RATIO * abs(e.value)


def transfer_table(fit: Fit) -> str:
    """One model: what drives what, how fast, how sure; how well it runs free; what is left."""
    m = fit.model
    assert isinstance(m, TransferModel)
    head = f"{m.target}: {m.structure.name.upper()} by {m.method}, {m.rows} rows at {m.dt:g} s"
    fits = f"fit {fit.training.fit_percent:.2f} % in training"
    if (held := fit.validation) is not None:
        fits += (
            f", {held.carried_on.fit_percent:.2f} % in validation "
            f"({held.estimated_state.fit_percent:.2f} % with the state estimated there"
        )
        # Of an output that has drifted away even a bad model halves the distance to its start.
        fits += f"; improvement {held.improvement:.1f} %)" if held.predicts else ")"
    rows = [["input", "nb,nf,nk", "dead time s", "gain", "unit", "time constant s", "weight"]]
    for k, name in enumerate(m.names):
        n = len(m.denominator(k)) - 1
        first = [name, f"{m.orders.nb[k]},{n},{m.orders.nk[k]}",
                 f"{_dead_time(m, k):g}{_feedthrough(fit.terms[k])}",
                 with_interval(m.gain(k)), printed(gain_unit(m.target, name))]  # fmt: skip
        constants = _constants(m, m.group_of(k))
        weights = _weights(fit.terms[k], len(constants))
        for j, (constant, weight) in enumerate(zip(constants, weights, strict=True)):
            rows.append([*(first if not j else [""] * 5), constant, weight])
        if not constants:
            rows.append([*first, "", ""])
    c = f"AIC {m.criteria.aic:.1f}  BIC {m.criteria.bic:.1f}  YIC {m.yic:.2f}"
    lines = [head, fits, "", aligned(rows), "", c, residuals_line(fit.tests)]
    if fit.candidates:
        lines += ["", _candidates(fit.candidates)]
    return "\n".join(lines)


def _constants(m: TransferModel, group: int) -> list[str]:
    """What the table says of each pole; of a pair the envelope, then what swings."""
    cells = []
    for z, e in zip(m.poles(group), m.time_constants(group), strict=True):
        if z.imag < 0 and oscillates(z):
            cells.append(_pair(z.conjugate(), m.dt))
        elif abs(z) >= 1:
            cells.append(f"none, |z| = {abs(z):.6g} does not settle")
        else:
            cells.append(with_interval(e))
    return cells


def _pair(z: complex, dt: float) -> str:
    s = np.log(z) / dt
    return f"pair: period {2 * np.pi / s.imag:.5g} s, damping {-s.real / abs(s):.3g}"


def _weights(term: ContinuousTerm | str, count: int) -> list[str]:
    """Weights of real lags, slowest first as the time constants are."""
    if isinstance(term, str) or term.response.kind.startswith("oscillation"):
        return [""] * count
    return [f"{getattr(term.response, f'K{j + 1}'):.4g}" for j in range(count)]


def with_interval(e: Estimate) -> str:
    """A value and its interval."""
    return f"{e.value:.5g} ({interval_text(e)})"


def interval_text(e: Estimate) -> str:
    """An interval, where it says anything."""
    return f"{e.low:.4g} to {e.high:.4g}" if is_bounded(e) else "not identified"


def residuals_line(tests: ResidualTests | None) -> str:
    """Whether the residuals are white, and free of the inputs."""

    def verdict(p: float, good: str, bad: str) -> str:
        return f"{bad if p < MIN_P_VALUE else good} (p {p:.2g})"

    if tests is None or not tests.lags:
        return "residuals: too few to test"
    parts = [verdict(tests.white_p, "white", "not white")]
    parts += [
        verdict(p, f"independent of {name}", f"still depend on {name}")
        for name, p in tests.independent_p.items()
    ]
    return f"residuals over {tests.lags} lags: " + ", ".join(parts)


def _candidates(candidates: Sequence[Candidate[TransferModel]]) -> str:
    rows = [["nb,nf,nk", "held-out fit %", "BIC", "YIC"]]
    for c in candidates[:LISTED_CANDIDATES]:
        o = c.model.orders
        rows.append([f"{max(o.nb)},{o.nf[0]},{'/'.join(map(str, o.nk))}", f"{c.fit_percent[0]:.2f}",
                     f"{c.model.criteria.bic:.1f}", f"{c.model.yic:.2f}"])  # fmt: skip
    return f"of {len(candidates)} candidates the best:\n{aligned(rows)}"
