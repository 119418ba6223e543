"""What all figures share: palette, axes, thinning, and bytes that are the same every time."""

from __future__ import annotations

import io
import itertools
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thermaltool.documents import write_whole
from thermaltool.errors import LogError, OutputError
from thermaltool.record import Record, hint
from thermaltool.report.clock_axis import ClockAxis, record_axis
from thermaltool.units import UNITS, parse_channel, symbol

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

FORMATS = ("png", "svg", "pdf")

# P. Tol's high-contrast and medium-contrast colours: told apart by the colour-blind and in grey.
MEASURED, COMPUTED, ERROR, MARK = "#DDAA33", "#004488", "#BB5566", "#222222"
CYCLE = (COMPUTED, "#DDAA33", "#BB5566", "#6699CC", "#997700", "#000000", "#994455")

STYLE: dict[str, Any] = {
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.xmargin": 0.01,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 11,
    "axes.titlelocation": "left",
    "figure.titlesize": 13,
    "grid.color": "0.88",
    "legend.fontsize": 9,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "svg.hashsalt": "thermaltool",
}

# Points per trace: above four per bin only the extremes of each bin are drawn.
MAX_BINS = 1500
# Missing readings break a trace where they last longer than this many of its periods.
OUTAGE_PERIODS = 10.0

_QUANTITIES = {"length": "displacement", "ratio": "relative value"}


def figure_format(path: str) -> str:
    """Format by suffix.

    Raises
    ------
    OutputError
        Where the suffix is none of .png, .svg, .pdf.
    """
    suffix = Path(path).suffix.lower().lstrip(".")
    if suffix not in FORMATS:
        raise OutputError(f"{path}: a figure's name ends in .png, .svg or .pdf")
    return suffix


def render(draw: Callable[[], Figure], kind: str) -> bytes:
    """The bytes of the figure that `draw` makes, in the common style; no clock time in them.

    Parameters
    ----------
    draw : callable
    kind : {"png", "svg", "pdf"}
    """
    undated = {"png": None, "svg": {"Date": None}, "pdf": {"CreationDate": None}}
    buffer = io.BytesIO()
    with common_style():
        draw().savefig(buffer, format=kind, dpi=120, metadata=undated[kind])
    return buffer.getvalue()


def write_figure(draw: Callable[[], Figure], target: str) -> None:
    """Write the figure that `draw` makes, whole; its format by suffix, PNG on stdout (``-``).

    Raises
    ------
    OutputError
        As `figure_format`, and where it cannot be written.
    """
    write_whole(render(draw, "png" if target == "-" else figure_format(target)), target)


def common_style() -> AbstractContextManager[None]:
    """The style of all figures, whatever the user's own settings are."""
    from matplotlib import style

    context: AbstractContextManager[None] = style.context(["default", STYLE])
    return context


def new_figure(title: str, width: float, height: float) -> Figure:
    """An empty figure [inch] with a canvas of its own."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(plain(title), x=0.01, ha="left")
    return figure


def plain(text: str) -> str:
    """Text as it stands: a dollar sign in a name starts no formula."""
    return text.replace("$", r"\$")


def shortened(name: str, size: int) -> str:
    """A name of so many letters at most, without its middle: both ends tell channels apart."""
    if len(name) <= size:
        return name
    end = (size - 1) // 2
    return f"{name[: size - 1 - end]}…{name[-end:]}"


def quantity(unit: str) -> str:
    """What a channel of this unit measures."""
    dimension = UNITS[unit][0]
    return _QUANTITIES.get(dimension, dimension)


def quantity_label(unit: str) -> str:
    """Label of an axis: ``temperature [°C]``."""
    return f"{quantity(unit)} [{symbol(unit)}]"


def with_unit(value: float, unit: str) -> str:
    """A number of three digits and its printed unit; a ratio has none."""
    told = f"{float(f'{value:.3g}'):g}"  # 8000 rather than 8e+03
    return told if unit == "1" else f"{told} {unit}"


def channel_unit(channel: str) -> str:
    """The printed unit of a channel, off its name."""
    return symbol(parse_channel(channel).unit)


def choose(known: Iterable[str], wanted: Sequence[str], name: str) -> list[str]:
    """The channels that are wanted, all of `known` where none is named.

    Raises
    ------
    LogError
        A channel that is not there; the message names the near ones.
    """
    known = list(known)
    for channel in wanted:
        if channel not in known:
            raise LogError(f"no channel {channel}{hint(channel, known)}", name)
    return list(dict.fromkeys(wanted)) or known


def envelope(time: Array, values: Array, bins: int = MAX_BINS) -> tuple[Array, Array]:
    """The least and the largest value of every bin, and both ends, so that no peak is lost.

    Parameters
    ----------
    time, values : ndarray, shape (n,), no NaN
    bins : int
        Bins of equally many samples; up to four samples per bin nothing changes.
    """
    size = -(-len(values) // bins)
    if size <= 4:
        return time, values
    whole = len(values) // size * size
    rows = values[:whole].reshape(-1, size)
    first = size * np.arange(len(rows))
    ends = np.append(np.arange(whole, len(values)), [0, len(values) - 1])
    keep = np.unique(
        np.concatenate([first + rows.argmin(axis=1), first + rows.argmax(axis=1), ends])
    )
    return time[keep], values[keep]


def visible(time: Array, values: Array, segments: Sequence[slice] = ()) -> tuple[Array, Array]:
    """What of a channel is drawn: thinned, with a NaN where the line breaks.

    It breaks between `segments` of the log and over long outages; short ones (a slow channel in
    a fast log) are bridged.
    """
    rows = np.flatnonzero(np.isfinite(values) & np.isfinite(time))
    if not len(rows):
        return np.empty(0), np.empty(0)
    t, v = time[rows], values[rows]
    steps = np.diff(t)
    starts = np.array([s.start for s in segments], int)
    broken = np.diff(np.searchsorted(starts, rows, side="right")) != 0
    if len(steps):
        broken |= (np.diff(rows) > 1) & (steps > OUTAGE_PERIODS * np.median(steps))
    edges = [0, *(np.flatnonzero(broken) + 1).tolist(), len(rows)]
    pieces = [
        envelope(t[a:b], v[a:b], max(1, MAX_BINS * (b - a) // len(rows)))
        for a, b in itertools.pairwise(edges)
    ]
    gap = np.array([np.nan])
    joined = [[part for piece in pieces for part in (piece[k], gap)][:-1] for k in (0, 1)]
    return np.concatenate(joined[0]), np.concatenate(joined[1])


def trace(
    ax: Axes,
    time: Array,
    values: Array,
    segments: Sequence[slice] = (),
    *,
    axis: ClockAxis | None = None,
    label: str = "",
    **style: Any,
) -> None:
    """Draw a channel against time, in seconds without an `axis`."""
    t, v = visible(time, values, segments)
    if len(t) < 30:
        style = {"marker": ".", **style}
    text = plain(label) if len(t) else f"{plain(label)} (no values)"
    ax.plot(
        t if axis is None else axis.of(t), v, label=text, rasterized=len(t) > 2 * MAX_BINS, **style
    )


def panels(title: str, heights: Sequence[float], height: float) -> tuple[Figure, list[Axes]]:
    """A figure of so many inches, and its panels one below the other against one clock."""
    figure = new_figure(title, 11.0, height)
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)
    return figure, list(axes[:, 0])


def trace_record(ax: Axes, record: Record, values: Array, **style: Any) -> None:
    """Draw values on the clock of a record, in the unit that suits its length, or on dates."""
    trace(ax, record.time, values, record.segments, axis=record_axis(record), **style)


def legend_beside(ax: Axes, title: str | None = None) -> None:
    """The legend to the right of the panel, where it hides nothing."""
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0, title=title)


def say(ax: Axes, text: str) -> None:
    """A sentence in place of curves."""
    ax.text(0.5, 0.5, text, ha="center", va="center", transform=ax.transAxes, color="0.4")
    ax.set_xticks([])
    ax.set_yticks([])
