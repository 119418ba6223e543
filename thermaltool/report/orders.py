"""Orders and fits of ARMA models as text tables and JSON documents."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from thermaltool.record import Record
from thermaltool.report.text import aligned
from thermaltool.signals.intervals import NORMAL_95, Estimate
from thermaltool.timeseries.cancellation import NeedlessPair, needless_pairs
from thermaltool.timeseries.criteria import CRITERIA, OrderCriteria
from thermaltool.timeseries.likelihood import ArmaLikelihood
from thermaltool.timeseries.model import ArmaModel
from thermaltool.timeseries.order import OrderTable
from thermaltool.timeseries.roots import Mode, modes, near_unit
from thermaltool.timeseries.screening import DICKEY_FULLER, unit_root_statistic

_LISTED = 6  # entries of the text table for each criterion


def order_document(series: str, table: OrderTable, names: Sequence[str]) -> dict[str, Any]:
    """The orders of a series as plain data."""
    best = {name: table.best(name) for name in names}
    return {
        "series": series,
        "best": {
            name: {"p": e.p, "q": e.q, "value": CRITERIA[name](e)} for name, e in best.items()
        },
        "table": [_row(entry, names) for entry in table.entries],
    }


def _row(entry: OrderCriteria, names: Sequence[str]) -> dict[str, Any]:
    wanted = dict.fromkeys(("aic", "aicc", "bic", *names))
    values = {name: CRITERIA[name](entry) for name in wanted}
    return {"p": entry.p, "q": entry.q, **values, "exact": entry.exact}


def order_table(table: OrderTable, names: Sequence[str]) -> str:
    """The best orders by each criterion, side by side; ~ marks what is not exact."""
    rows = [[cell for name in names for cell in (name, "value", "above best")]]
    ranked = {name: sorted(table.entries, key=CRITERIA[name]) for name in names}
    exact = {name: [e for e in entries if e.exact] for name, entries in ranked.items()}
    for k in range(min(_LISTED, *(len(entries) for entries in exact.values()))):
        row = []
        for name in names:
            value, least = CRITERIA[name](exact[name][k]), CRITERIA[name](exact[name][0])
            pair = f"{exact[name][k].p},{exact[name][k].q}"
            row += [pair, f"{value:.3f}", f"{value - least:.3f}"]
        rows.append(row)
    refined = sum(e.exact for e in table.entries)
    first = table.entries[0]
    more = "; --effort above 1 looks at more" if table.cut_short else ""
    return (
        f"{aligned(rows)}\n\n{len(table.entries)} orders of {first.size} samples, "
        f"{refined} by exact likelihood{more}"
    )


def order_warnings(
    table: OrderTable, names: Sequence[str], record: Record, degree: int, difference: int
) -> list[str]:
    """What a user must know before believing the best orders."""
    messages = []
    likelihood = ArmaLikelihood(record, degree)
    judged: set[tuple[int, int]] = set()
    for name in names:
        best = table.best(name)
        if table.at_edge(best):
            messages.append(
                f"the best order {best.p},{best.q} by {name} is at the edge of the grid: a larger "
                "--max-p or --max-q may be better"
            )
        fit = table.fits[best.p, best.q]
        if (best.p, best.q) not in judged:
            judged.add((best.p, best.q))
            of = f"the model {best.p},{best.q} (best by {name}): "
            pairs = needless_pairs(likelihood, fit.ar, fit.ma, best.deviance)
            messages += [of + _needless(pair) for pair in pairs]
    messages += _stationarity(record, degree, difference)
    return messages


def _stationarity(record: Record, degree: int, difference: int) -> list[str]:
    statistic = unit_root_statistic(record, degree)
    if not np.isfinite(statistic) or statistic < DICKEY_FULLER[degree]:
        return []
    return [
        f"the series is not told from one with a unit root (Dickey-Fuller {statistic:.2f}, below "
        f"{DICKEY_FULLER[degree]} is stationary): try --difference {difference + 1}"
    ]


def _needless(pair: NeedlessPair) -> str:
    return (
        f"AR root {_root(pair.ar_root)} and MA root {_root(pair.ma_root)} nearly cancel; without "
        f"them -2 log L is {pair.rise:.1f} higher, which noise does below {pair.usual:.1f}: a "
        "smaller order may do"
    )


def _root(root: complex) -> str:
    if root.imag == 0.0:
        return f"{root.real:.3f}"
    return f"{root.real:.3f}±{abs(root.imag):.3f}i"


def fit_warnings(model: ArmaModel, record: Record, degree: int) -> list[str]:
    """What is not as it should be in a fit."""
    messages = []
    likelihood = ArmaLikelihood(record, degree)
    if near_unit(model.ar, likelihood.size, degree):
        messages.append(
            "an AR root is as good as 1: not told from a random walk; try --difference "
            f"{model.difference + 1}"
        )
    else:
        messages += _stationarity(record, degree, model.difference)
    messages += map(_needless, needless_pairs(likelihood, model.ar, model.ma, model.entry.deviance))
    if model.covariance is None:
        messages.append("the likelihood is flat: no standard errors; a smaller order may do")
    return messages


def fit_table(model: ArmaModel, level: float = 0.95) -> str:
    """Coefficients, criteria and roots."""
    errors = iter(model.errors.tolist())
    rows = [["coefficient", "value", "± standard error"]]
    for name, values in (("ar", model.ar), ("ma", model.ma)):
        for k, value in enumerate(values.tolist(), 1):
            rows.append([f"{name}{k}", f"{value:.6f}", _error(next(errors))])
    spread = np.sqrt(np.diagonal(model.trend_covariance)).tolist()
    names = ("mean", "slope per sample")
    for name, value, error in zip(names, model.trend, spread, strict=False):
        rows.append([name, f"{value:.8g}", _error(error)])
    entry, criteria = model.entry, model.entry.criteria
    head = f"ARMA({entry.p},{entry.q}) of {model.channel}"
    if model.difference:
        head += f", difference {model.difference}"
    lines = [
        f"{head}, {entry.size} samples at {model.period_s:g} s, {model.method}",
        "",
        aligned(rows),
        "",
        f"sigma2 {model.sigma2:.7g}   loglik {-0.5 * entry.deviance:.4f}   "
        f"aic {criteria.aic:.4f}   aicc {criteria.aicc:.4f}   bic {criteria.bic:.4f}",
        "stationary and invertible",
    ]
    found = modes(model, level)
    if found:
        lines += ["", aligned([_MODE_HEAD, *(_mode_row(mode) for mode in found)])]
    return "\n".join(lines)


def arma_document(model: ArmaModel) -> dict[str, Any]:
    """What a person asks of a model: coefficients and modes with their intervals."""
    errors = iter((NORMAL_95 * model.errors).tolist())
    coefficients = {
        name: [[v, v - half, v + half] for v in values.tolist() for half in [next(errors)]]
        for name, values in (("ar", model.ar), ("ma", model.ma))
    }
    return {
        "channel": model.channel,
        "sample_period_s": model.period_s,
        "difference": model.difference,
        **coefficients,
        "trend": list(model.trend),
        "sigma": float(np.sqrt(model.sigma2)),
        "bic": model.entry.criteria.bic,
        "modes": [
            {
                "root_size": abs(mode.root),
                "natural_frequency_Hz": _ends(mode.natural, 0.5 / np.pi),
                "damping": _ends(mode.damping),
                "time_constant_s": _ends(mode.time_constant),
            }
            for mode in modes(model)
        ],
    }


def _ends(estimate: Estimate | None, scale: float = 1.0) -> list[float] | None:
    if estimate is None:
        return None
    return [scale * each for each in (estimate.value, estimate.low, estimate.high)]


_MODE_HEAD = ["AR root", "|root|", "omega_n [rad/s]", "f_n [Hz]", "damping", "time constant [s]"]


def _mode_row(mode: Mode) -> list[str]:
    return [
        _root(mode.root),
        f"{abs(mode.root):.4f}",
        _interval(mode.natural),
        _interval(mode.natural, 0.5 / np.pi),
        _interval(mode.damping),
        _interval(mode.time_constant) + (" alternating" if mode.alternates else ""),
    ]


def _interval(estimate: Estimate | None, scale: float = 1.0) -> str:
    if estimate is None:
        return "-"
    value, low, high = (scale * each for each in (estimate.value, estimate.low, estimate.high))
    return f"{value:.5g} ({low:.4g}..{high:.4g})"


def _error(value: float) -> str:
    return f"± {value:.6f}" if value >= 1e-4 else f"± {value:.3g}"
