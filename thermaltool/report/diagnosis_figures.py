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
from thermaltool.report.clock_axis import record_axis
from thermaltool.report.diagnosis_words import DECISIVE_EVIDENCE, Document, called, names_of, number
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
    trace_record,
    with_unit,
)
from thermaltool.units import parse_channel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
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
    unit = channel_unit(output)
    measured = record.column("measured")
    figure, (top, bottom) = panels(f"{output} in {Path(record.name).name}", (3.0, 2.0), 6.5)
    top.set(title="Measured and computed, the zero fitted",
            ylabel=quantity_label(parse_channel(output).unit))  # fmt: skip
    trace_record(top, record, measured, color=MEASURED, lw=3.0, label="measured")
    models = [("before", "model as it is", record.column("simulated"), ERROR)]
    if "extended" in record.columns:
        names = dict.fromkeys(cause["name"] for cause in document["causes"])
        names.pop("unknown", None)  # is no part of a model
        name = "\n".join(["model with", *names])
        models.append(("after", name, record.column("extended"), COMPUTED))
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
               ylabel=f"residual [{unit}]")  # fmt: skip
    record_axis(record).mark(bottom)
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
    shown = len(document["tried"][:MAX_BARS])
    figure = new_figure("Evidence of each cause, tried alone", 9.0, 1.6 + 0.34 * shown)
    _draw_evidence_bars(figure.subplots(), document)
    return figure


def draw_diagnosis(document: Document) -> Figure:
    """What a model leaves of each output beside its noise, before and after; the evidence.

    Parameters
    ----------
    document : mapping
        The diagnosis as JSON.
    """
    shown, outputs = len(document["tried"][:MAX_BARS]), list(document["residuals"])
    heights = [0.9 + 0.5 * len(outputs), *([1.2 + 0.3 * shown] if shown else [])]
    logs = names_of(document["logs"])
    figure = new_figure(f"The model is {document['verdict']} for {logs}", 11.0, 1.0 + sum(heights))
    top, *below = figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    _draw_residuals(top, document, outputs)
    for ax in below:
        ax.set(title="Evidence of each cause, tried alone")
        _draw_evidence_bars(ax, document)
    return figure


def _draw_residuals(ax: Axes, document: Document, outputs: Sequence[str]) -> None:
    """RMS of the residuals in units of the noise of a reading."""
    diagnosed = {log["sha256"] for log in document["logs"]}
    chains: dict[str, dict[int, list[tuple[float, int]]]] = {output: {} for output in outputs}
    for row in document["written"]:
        if row["log"] in diagnosed and row["output"] in chains:
            steps = chains[row["output"]].setdefault(row["step"], [])
            steps.append((row["rmse_zero_free"], row["rows"]))
    places = np.arange(len(outputs))[::-1].tolist()
    causes = [cause["name"] for cause in document["causes"] if cause["location"] is None]
    for place, output in zip(places, outputs, strict=True):
        report = document["residuals"][output]
        noise = report["noise"]["white"] or float("nan")
        last = max(chains[output], default=0)
        before, after = (_pooled(chains[output].get(k, ())) for k in (0, last))
        sizes = [("model as it is", report["spread"] if before is None else before, ERROR)]
        if after is not None and last:
            sizes.append((f"with {', '.join(dict.fromkeys(causes))}", after, COMPUTED))
        for k, (label, size, color) in enumerate(sizes):
            middle = place + 0.18 * (len(sizes) - 1) - 0.36 * k
            ax.barh(middle, size / noise, height=0.32, color=color,
                    label="" if place < len(outputs) - 1 else label)  # fmt: skip
            ax.annotate(with_unit(size, channel_unit(output)), (size / noise, middle), (4, 0),
                        textcoords="offset points", va="center", fontsize=9)  # fmt: skip
    ax.axvline(1.0, color=MARK, lw=0.9, ls="--", label="noise of a reading")
    ax.set_yticks(places, [plain(output) for output in outputs])
    ax.tick_params(axis="y", length=0)
    ax.grid(visible=False, axis="y")
    ax.margins(x=0.12)
    ax.set_xlim(left=0.0)
    ax.set(title="What the model leaves of each output, the zero free",
           xlabel="RMS of the residual / noise of a reading")  # fmt: skip
    legend_beside(ax)


def _pooled(parts: Sequence[tuple[float, int]]) -> float | None:
    """RMS over several stretches of so many rows; None where there is none."""
    rows = sum(count for _, count in parts)
    return float(np.sqrt(sum(rms**2 * count for rms, count in parts) / rows)) if rows else None


def _draw_evidence_bars(ax: Axes, document: Document) -> None:
    decisive = DECISIVE_EVIDENCE
    tried = document["tried"][:MAX_BARS]
    accepted = {(cause["name"], cause["channel"]) for cause in document["causes"]}
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
