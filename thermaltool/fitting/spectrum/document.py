"""A spectrum as a model document: one power through the sum of its lags."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from thermaltool.fitting.spectrum.find import ThermalSpectrum
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.rational import rational_kind
from thermaltool.signals.agreement import agreement
from thermaltool.units import UNITS, Reference, parse_channel

METHOD = "variable projection after non-negative least squares"


def spectrum_model(
    found: ThermalSpectrum,
    record: Record,
    drive: str,
    output: str,
    reference: Reference,
    provenance: Mapping[str, Any],
) -> Model:
    """Model of the lines, in the units of the channels.

    Parameters
    ----------
    found : ThermalSpectrum
    record : Record
        Whose spectrum it is.
    drive, output : str
    reference : "first" or float
        What counts as no power.
    provenance : mapping
    """
    watt, kelvin = (UNITS[parse_channel(name).unit][1] for name in (drive, output))
    scale, n = watt / kelvin, len(found.lines)
    taus, gains = found.time_constants, scale * found.fit.resistances
    values = {f"tau{k + 1}": float(tau) for k, tau in enumerate(taus)}
    values |= {f"K{k + 1}": float(gain) for k, gain in enumerate(gains)}
    turn = np.concatenate([taus, np.full(n, scale)])
    term = Term(drive, output, rational_kind(n, 0)(**values),
                found.fit.covariance() * np.outer(turn, turn), tuple(values))  # fmt: skip
    u, y = record.column(drive), record.column(output)
    y = y[np.isfinite(y)]
    rest = float(u[0]) if reference == "first" else reference
    level = found.fit.offset / kelvin + float(gains.sum()) * rest
    fit = agreement(y, found.fitted / kelvin)
    statistics = {"rmse": fit.rmse, "max_error": fit.max_error, "fit_percent": fit.fit_percent,
                  "rows": len(y), "method": METHOD}  # fmt: skip
    return Model(
        (Drive(drive, "zero", reference, _range(u - rest)),),
        (Output(output, "sensor", "first" if reference == "first" else level,
                _range(y - level), statistics),),
        (term,), record.period, provenance,
    )  # fmt: skip


def _range(values: np.ndarray) -> tuple[float, float]:
    return float(values.min()), float(values.max())
