"""Figures of a diagnosis: measured against both models, residual before and after, evidence."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from thermaltool.files import file_words
from thermaltool.record import Record
from thermaltool.report.diagnosis_words import DECISIVE_EVIDENCE, Document, called, number
from thermaltool.report.style import (
    COMPUTED,
    ERROR,
    MARK,
    MEASURED,
    Array,
    channel_unit,
    legend_beside,
    new_figure,
    panels,
    plain,
    quantity_label,
    render,
    span_of,
    time_unit,
    trace_record,
    with_unit,
)
from thermaltool.units import parse_channel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Figures of curves in a report, those of the largest residuals, and bars of the evidence chart.
MAX_FIGURES, MAX_BARS = 6, 12


@dataclass(frozen=True)
class Picture:
    """A figure as PNG: what its file's name ends in (`file_words`), and what it shows."""

    name: str
    what: str
    png: bytes


def pictures(curves: Sequence[tuple[str, Record]], document: Document) -> Iterator[Picture]:
    """The figures of a report, as many as a reader looks at.

    Parameters
    ----------
    curves : sequence of (output, Record)
        Of every output in every log what was ``measured``, ``simulated`` and, where there are
        causes, ``extended`` by them.
    document : mapping
        The diagnosis as JSON.
    """
    several = len({record.name for _, record in curves}) > 1
    by_misfit = sorted(range(len(curves)), key=lambda k: -_misfit(curves[k][1]))
    kept = [curves[k] for k in sorted(by_misfit[:MAX_FIGURES])]
    names = [f"{o}_{Path(record.name).stem}" if several else o for o, record in kept]
    *words, evidence = file_words([*names, "evidence"])
    for word, (output, record) in zip(words, kept, strict=True):
        what = f"{output} in {Path(record.name).name}: measured, computed, residual"
        yield Picture(word, what, render(partial(draw_curves, output, record, document), "png"))
    if document["tried"]:
        png = render(lambda: draw_evidence(document), "png")
        yield Picture(evidence, "Evidence of every cause that was tried", png)


def worst(curves: Sequence[tuple[str, Record]]) -> tuple[str, Record]:
    """The output and record with the largest residual relative to what was measured.

    Parameters
    ----------
    curves : sequence of (output, Record)
        As in `pictures`.
    """
    return max(curves, key=lambda each: _misfit(each[1]))


def _misfit(record: Record) -> float:
    """Residual relative to what was measured."""
    measured = record.column("measured")
    return _rms(measured - record.column("simulated")) / (_rms(measured) or 1.0)


def draw_curves(output: str, record: Record, document: Document) -> Figure:
    """Measured, simulated and extended above; the residual before and after below.

    The zero of a log is free: each model is shifted by the median of its residual.

    Parameters
    ----------
    output : str
    record : Record
        With the columns ``measured``, ``simulated`` and, where there are causes, ``extended``.
    document : mapping
        The diagnosis as JSON.
    """
    unit, label = channel_unit(output), time_unit(span_of(record.time))[0]
    measured = record.column("measured")
    figure, (top, bottom) = panels(f"{output} in {Path(record.name).name}", (3.0, 2.0), 6.5)
    top.set(title="Measured and computed, the zero fitted",
            ylabel=quantity_label(parse_channel(output).unit))  # fmt: skip
    trace_record(top, record, measured, color=MEASURED, lw=3.0, label="measured")
    models = [("before", "model as it is", record.column("simulated"), ERROR)]
    if "extended" in record.columns:
        names = "\n".join(dict.fromkeys(cause["name"] for cause in document["causes"]))
        models.append(("after", f"model with\n{names}", record.column("extended"), COMPUTED))
    spreads = []
    for when, name, values, color in models:
        residual = measured - values
        shift = float(np.nanmedian(residual))
        spreads.append(f"{when} {with_unit(float(np.nanstd(residual)), unit)}")
        for ax, curve, what, width in ((top, values + shift, name, 1.2),
                                       (bottom, residual - shift, when, 0.9)):  # fmt: skip
            trace_record(ax, record, curve, color=color, lw=width, label=what)
    legend_beside(top)
    bottom.set(title=f"Residual, measured − computed.  RMS about the mean: {', '.join(spreads)}",
               ylabel=f"residual [{unit}]", xlabel=f"time [{label}]")  # fmt: skip
    report = document["residuals"].get(output)
    if report is not None:
        noise = 2 * report["noise"]["white"]
        bottom.axhspan(-noise, noise, color="0.8", lw=0, zorder=0,
                       label=f"noise, ±2 σ\n= ±{with_unit(noise, unit)}")  # fmt: skip
    bottom.axhline(0.0, color=MARK, lw=0.6)
    legend_beside(bottom)
    return figure


def _rms(error: Array) -> float:
    there = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(there**2))) if len(there) else float("nan")


def draw_evidence(document: Document) -> Figure:
    """Evidence of every cause that was tried, alone, the strongest on top.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    """
    decisive = DECISIVE_EVIDENCE
    tried = document["tried"][:MAX_BARS]
    accepted = {(cause["name"], cause["channel"]) for cause in document["causes"]}
    figure = new_figure("Evidence of each cause, tried alone", 9.0, 1.6 + 0.34 * len(tried))
    ax = figure.subplots()
    values = np.array([each["evidence"] for each in tried], float)
    rows = np.arange(len(tried))[::-1]
    inside = np.array([(each["name"], each["channel"]) in accepted for each in tried], bool)
    for chosen, color, label in ((inside, COMPUTED, "accepted"), (~inside, "0.65", "not accepted")):
        if chosen.any():
            ax.barh(rows[chosen], values[chosen], color=color, height=0.65, label=label)
    for row, value in zip(rows.tolist(), values.tolist(), strict=True):
        ax.annotate(number(value), (value, row), (4 if value >= 0 else -4, 0), fontsize=9,
                    textcoords="offset points", va="center",
                    ha="left" if value >= 0 else "right")  # fmt: skip
    ax.axvline(decisive, color=MARK, lw=0.9, ls="--", label=f"decisive from {decisive:g}")
    ax.axvline(0.0, color=MARK, lw=0.6)
    ax.set_xscale("symlog", linthresh=decisive)
    ax.xaxis.set_major_formatter("{x:g}")
    ax.margins(x=0.12)
    ax.set_yticks(rows, [plain(called(each["name"], each["channel"])) for each in tried])
    ax.tick_params(axis="y", length=0)
    ax.grid(visible=False, axis="y")
    ax.set(xlabel="evidence (fall of BIC), linear below the dashed line, logarithmic above")
    legend_beside(ax)
    return figure
