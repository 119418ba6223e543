"""What is asked of `diagnose` on hidden effects and what was measured: tables and figures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from as_simulated import MAX_DIFFERENCE
from hidden_scoring import SEEN, Score, law_of
from machines.hidden import EFFECTS
from scipy.stats import binom

from thermaltool.report.style import COMPUTED, CYCLE, MARK, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Effects without a strength: they have the size that they have.
NATURAL = ("sensors_swapped", "sensor_frozen", "record_too_short")
SIZED = tuple(name for name in EFFECTS if name not in NATURAL)
SIZES = (1.0, 2.0, 3.0, 5.0, 8.0)
# A log counts for a size that its effect reaches this share of.
REACHED = 0.95
NONE = "none"

HOW_COUNTED = f"""\
- *Size*: RMS over the log of what the effect changes, noise-free, over the noise (white and slow
  together) of that output, where it is largest; means are taken out of displacements.
- {", ".join(NATURAL)} have no strength, only a natural size (of
  record_too_short zero: it is the calibration that is cut): they have a line of their own and
  count for no size. They are in no pair, nor are other forms of an effect. A log whose effect
  cannot become so large counts for no size either.
- *Inside the group*: or in a group of at most three names that the tool declares indistinguishable
  from its first cause; where it names none, in the group that it suspects. Of two effects, first
  may be either of them.
- *Parameter error*: where the first cause has the right name and place, the largest relative error
  of its parameters; of what departs from no effect (a gain of 1.05 taken for 1.06 is 20 % off).
  Times are not compared. *Equivalent*: plant and tool have different laws, and the truth is the
  nearest number of the tool's (steady gain, rate of the slowest mode, leading term).
- *Held out*: a diagnosis of the first {100 * SEEN:.0f} % of a log against a fit that was told the
  effect, both free running on the rest; RMS of all outputs, each over its noise.
- *A test that is told all* of the effect, to the row, and errs on 3 % of clean logs: what the
  model's calibration leaves open looks like some effects, and nothing can tell them from it.
- A log on which the tool fails counts as answered wrong, a clean one as a false alarm."""


# ---------------------------------------------------------------- asked and measured


@dataclass(frozen=True)
class Line:
    """A row of the table.

    Attributes
    ----------
    what : str
    asked : float or None
        None where it is for information.
    at_most : bool
    value, low, high : float
        With its 95 % interval.
    count : int
        Logs.
    share : bool
        A share, else a number.
    """

    what: str
    asked: float | None
    at_most: bool
    value: float
    low: float
    high: float
    count: int
    share: bool = True

    @property
    def reached(self) -> bool:
        if self.asked is None or not self.count:
            return True
        return self.value <= self.asked if self.at_most else self.value >= self.asked

    def cells(self) -> list[str]:
        def say(value: float) -> str:
            return f"{100 * value:.1f} %" if self.share else f"{value:.3g}"

        asked = "–" if self.asked is None else f"{'≤' if self.at_most else '≥'} {say(self.asked)}"
        verdict = "" if self.asked is None else ("yes" if self.reached else "**no**")
        if not self.count:
            return [self.what, asked, "–", "–", "0", "not measured" if self.asked else ""]
        interval = f"{say(self.low)} to {say(self.high)}"
        return [self.what, asked, say(self.value), interval, str(self.count), verdict]


def wilson(hits: int, count: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927)."""
    z, share = 1.96, hits / count
    middle, whole = share + z**2 / (2 * count), 1 + z**2 / count
    reach = z * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    # At no hit and at all hits rounding would leave the unit interval.
    return max(float(middle - reach) / whole, 0.0), min(float(middle + reach) / whole, 1.0)


def share_of(
    what: str, hits: Sequence[bool], asked: float | None = None, at_most: bool = False
) -> Line:
    if not hits:
        return Line(what, asked, at_most, np.nan, np.nan, np.nan, 0)
    share = sum(hits) / len(hits)
    return Line(what, asked, at_most, share, *wilson(sum(hits), len(hits)), len(hits))


def most_of(what: str, scores: Sequence[Score]) -> Line:
    """Mean power of the test that is told all: a bound of what can be found in these logs."""
    powers = [s.power for s in scores if np.isfinite(s.power)]
    if not powers:
        return Line(what, None, False, np.nan, np.nan, np.nan, 0)
    mean, error = float(np.mean(powers)), 1.96 * float(np.std(powers)) / np.sqrt(len(powers))
    return Line(what, None, False, mean, mean - error, min(mean + error, 1.0), len(powers))


def median_of(
    what: str, values: Sequence[float], asked: float | None = None, share: bool = True
) -> Line:
    """A median, to be at most `asked`, with the order statistics that enclose it."""
    if not values:
        return Line(what, asked, True, np.nan, np.nan, np.nan, 0, share)
    ordered, count = np.sort(values), len(values)
    below = int(binom.ppf(0.025, count, 0.5))
    low, high = ordered[max(below - 1, 0)], ordered[min(count - below, count - 1)]
    return Line(what, asked, True, float(np.median(values)), low, high, count, share)


def of_size(scores: Sequence[Score], size: float) -> list[Score]:
    """Logs of one effect that has this size."""
    chosen = [s for s in scores if s.trial.group == f"size {size:g}"]
    return [s for s in chosen if s.failure or s.sizes[0] >= REACHED * size]


def requirements(scores: Sequence[Score]) -> list[Line]:
    lines = []
    for size, first, grouped in ((5.0, 0.85, 0.95), (2.0, 0.65, 0.85)):
        here = of_size(scores, size)
        name = f"{size:g} × noise: right cause first"
        lines.append(share_of(name, [s.first for s in here], first))
        lines.append(share_of(f"{name}, or inside the group", [s.grouped for s in here], grouped))
        lines.append(most_of(f"{size:g} × noise: seen by a test that is told all of it", here))
        channel = [s.channel for s in here if s.channel is not None]
        lines.append(share_of(f"{size:g} × noise: right channel, of those named right", channel))
    five = of_size(scores, 5.0)
    more = [len(s.named) > int(s.first) for s in five]
    lines.append(share_of("5 × noise: a cause named that was not hidden", more))
    errors: dict[str, list[float]] = {"same": [], "equivalent": [], "none": []}
    for s in five:
        if s.error is not None:
            errors[law_of(s.trial.effects[0], s.trial.variant)].append(s.error)
    name = "5 × noise: parameter error"
    lines.append(median_of(f"{name}, median", errors["same"], 0.2))
    lines.append(share_of(f"{name} within 20 %", [e <= 0.2 for e in errors["same"]]))
    lines.append(median_of(f"{name}, equivalent, median", errors["equivalent"]))
    ratios = [s.ratio for s in five if s.ratio is not None]
    name = "5 × noise: held-out RMS over that of a fit that was told"
    lines.append(median_of(f"{name}, median", ratios, 1.2, share=False))
    lines.append(share_of(f"{name}, within 1.2", [r <= 1.2 for r in ratios]))
    clean, pairs, natural = (
        [s for s in scores if s.trial.group == group] for group in ("clean", "pair", "natural")
    )
    lines.append(share_of("clean: false alarms", [s.alarm for s in clean], 0.03, at_most=True))
    lines.append(share_of("clean: a cause named", [bool(s.named) for s in clean]))
    # A pair counts where each effect has the size that was wanted.
    whole = [s for s in pairs if s.failure or min(s.sizes) >= REACHED * s.trial.size]
    lines.append(share_of("two at 5 × noise: both named", [s.all_named for s in whole], 0.75))
    lines.append(share_of("two at 5 × noise: first named right", [first_of(s) for s in whole]))
    lines.append(share_of("natural size: right cause first", [s.first for s in natural]))
    off = [s.difference >= MAX_DIFFERENCE for s in scores if not s.failure]
    lines.append(share_of("report and simulate differ by 1 % or more", off, 0.0, at_most=True))
    return lines


def first_of(score: Score) -> bool:
    """Whether the first cause is one of those that are hidden."""
    return bool(score.named) and score.named[0][0] in score.trial.effects


def by_effect(scores: Sequence[Score]) -> Iterator[list[str]]:
    """Named first at every size, errors and held-out ratios at 5, a row for each effect."""

    def told(values: Sequence[float]) -> str:
        return f"{np.median(values):.2g}" if values else "–"

    for effect in EFFECTS:
        row = [effect]
        for size in SIZES:
            here = [s for s in of_size(scores, size) if s.trial.effects[0] == effect]
            row.append(f"{sum(s.first for s in here)}/{len(here)}" if here else "–")
        here = [s for s in scores if s.trial.group == "natural" and s.trial.effects[0] == effect]
        row.append(f"{sum(s.first for s in here)}/{len(here)}" if here else "–")
        here = [s for s in of_size(scores, 5.0) if s.trial.effects[0] == effect]
        errors = [s.error for s in here if s.error is not None]
        row.append(told(errors) + (" (equivalent)" * any(_equivalent(s) for s in here)))
        row.append(told([s.ratio for s in here if s.ratio is not None]))
        wrong = [s.named[0][0] if s.named else NONE for s in here if not s.first]
        row.append(", ".join(f"{n} {wrong.count(n)}" for n in dict.fromkeys(wrong)) or "–")
        yield row


def _equivalent(score: Score) -> bool:
    known = score.error is not None
    return known and law_of(score.trial.effects[0], score.trial.variant) == "equivalent"


def tables(scores: Sequence[Score], lines: Sequence[Line], seed: int) -> Iterator[str]:
    yield from table_lines(["what", "asked", "measured", "95 % interval", "logs", "reached"],
                      [line.cells() for line in lines])  # fmt: skip
    singles = [s for s in scores if s.trial.group.startswith("size") and not s.failure]
    short = sum(s.sizes[0] < REACHED * s.trial.size for s in singles)
    seconds = [s.seconds for s in scores if np.isfinite(s.seconds)]
    failed = sum(bool(s.failure) for s in scores)
    yield (
        f"\nSeed {seed}, {len(scores)} logs; {short} could not reach their size; the tool failed "
        f"on {failed}; {np.median(seconds) if seconds else np.nan:.1f} s of CPU time each "
        "(median).\n"
    )
    yield HOW_COUNTED + "\n"
    sizes = [f"{size:g} ×" for size in SIZES]
    yield from table_lines(
        [
            "right cause first",
            *sizes,
            "natural",
            "error at 5 ×",
            "held out at 5 ×",
            "else named at 5 ×",
        ],
        by_effect(scores),
    )


def table_lines(
    heading: Sequence[str], rows: Iterator[list[str]] | list[list[str]]
) -> Iterator[str]:
    yield f"| {' | '.join(heading)} |"
    yield "|---" * len(heading) + "|"
    yield from (f"| {' | '.join(row)} |" for row in rows)


# ---------------------------------------------------------------- figures


def draw_confusion(scores: Sequence[Score]) -> Figure:
    """What was hidden (rows) against what was named first (columns), logs."""
    hidden, named = [*EFFECTS, "clean"], [*EFFECTS, NONE]
    counts = np.zeros((len(hidden), len(named)))
    single = [s for s in scores if s.trial.group in ("natural", "clean")]
    for s in [*of_size(scores, 5.0), *single]:
        row = hidden.index(s.trial.effects[0] if s.trial.effects else "clean")
        counts[row, named.index(s.named[0][0] if s.named else NONE)] += 1
    figure = new_figure("First cause named, effects of 5 × noise and clean logs", 11.0, 9.5)
    ax = figure.subplots()
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
    ax.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.2, aspect="auto")
    for row, column in np.argwhere(counts):
        ax.text(column, row, f"{counts[row, column]:.0f}", ha="center", va="center", fontsize=9,
                color="white" if shares[row, column] > 0.6 else MARK)  # fmt: skip
    labels = [f"{name} (natural size)" if name in NATURAL else name for name in hidden]
    ax.set_xticks(range(len(named)), named, rotation=60, ha="right", rotation_mode="anchor")
    ax.set_yticks(range(len(hidden)), labels)
    ax.set_xticks(np.arange(len(named)) - 0.5, minor=True)
    ax.set_yticks(np.arange(len(hidden)) - 0.5, minor=True)
    ax.grid(visible=False, which="major")
    ax.grid(visible=True, which="minor", color="0.92", lw=0.6)
    ax.tick_params(which="both", length=0)
    ax.set(xlabel="named first", ylabel="hidden")
    return figure


def draw_power(scores: Sequence[Score]) -> Figure:
    """Share of the logs by size of the effect, with Wilson's intervals."""
    curves: tuple[tuple[str, Callable[[Score], bool]], ...] = (
        ("any cause named, or not adequate", lambda s: s.alarm),
        ("right cause first or inside the group", lambda s: s.grouped),
        ("right cause first", lambda s: s.first),
    )
    figure = new_figure("Hidden effects found, by their size", 9.0, 5.0)
    ax = figure.subplots()
    for k, (label, hit) in enumerate(curves):
        found = [(size, share_of(label, [hit(s) for s in of_size(scores, size)])) for size in SIZES]
        at = np.array([(size, 100 * f.value, 100 * f.low, 100 * f.high)
                       for size, f in found if f.count])  # fmt: skip
        if not len(at):
            continue
        x = at[:, 0] * (1 + 0.02 * (k - 1))
        reach = np.maximum((at[:, 1] - at[:, 2], at[:, 3] - at[:, 1]), 0.0)  # rounding at all hits
        ax.errorbar(x, at[:, 1], reach, marker="o", ms=5,
                    capsize=3, color=CYCLE[2 - k], label=label)  # fmt: skip
    for size, first in ((2.0, 65.0), (5.0, 85.0)):
        ax.plot(size, first, marker="_", ms=26, mew=2.0, ls="", color=MARK,
                label="asked of the right cause first" if size == 2.0 else None)  # fmt: skip
    clean = share_of("", [s.alarm for s in scores if s.trial.group == "clean"])
    if clean.count:
        ax.axhline(100 * clean.value, color=COMPUTED, lw=0.9, ls=":",
                   label=f"alarms on clean logs ({100 * clean.value:.1f} %)")  # fmt: skip
    ax.set_xscale("log")
    ax.set_xticks(SIZES, [f"{size:g}" for size in SIZES])
    ax.set_xticks([], minor=True)
    ax.set(
        xlim=(0.92 * SIZES[0], 1.08 * SIZES[-1]),
        ylim=(-3, 103),
        xlabel="size of the effect over noise",
        ylabel="share of the logs [%]",
    )
    ax.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 0.02),
        frameon=True,
        framealpha=1.0,
        edgecolor="none",
    )
    return figure
