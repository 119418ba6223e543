"""Curves that ``thermaltool correct`` fits: in front of a linear block (Hammerstein) or behind it
(Wiener).

They describe what was measured and name no cause; the diagnosis does not look for them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Side
from thermaltool.errors import ModelError
from thermaltool.record import Record

# Bisections by which a curve is inverted: to rounding.
BISECTIONS = 60
# A curve is inverted within this many of its own widths.
INVERSION_WIDTHS = 4.0
# Of a polynomial, and of a curve by points.
MAX_DEGREE, MAX_KNOTS = 5, 24


def slopes(x: Float, y: Float) -> Float:
    """Slopes of the monotone cubic interpolation at its knots (Fritsch and Butland 1984).

    Those of `scipy.interpolate.PchipInterpolator`; own, because a stream bends by them on numpy
    alone.

    Parameters
    ----------
    x, y : ndarray, shape (n,), n >= 2, x increasing

    Returns
    -------
    ndarray, shape (n,)
    """
    h, d = np.diff(x), np.diff(y) / np.diff(x)
    if len(d) == 1:
        return np.repeat(d, 2)
    inner = np.zeros(len(d) - 1)
    rising = d[:-1] * d[1:] > 0
    w1, w2 = 2 * h[1:] + h[:-1], h[1:] + 2 * h[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (w1 + w2) / (w1 / d[:-1] + w2 / d[1:])
    inner[rising] = mean[rising]
    return np.concatenate(
        [[_end(h[0], h[1], d[0], d[1])], inner, [_end(h[-1], h[-2], d[-1], d[-2])]]
    )


def _end(h0: float, h1: float, d0: float, d1: float) -> float:
    """Three-point slope at an end, kept from overshooting."""
    slope = ((2 * h0 + h1) * d0 - h0 * d1) / (h0 + h1)
    if slope * d0 <= 0:
        return 0.0
    return 3 * d0 if d0 * d1 < 0 and abs(slope) > 3 * abs(d0) else float(slope)


@dataclass(frozen=True, eq=False)
class Polynomial:
    """``level · Σ c_k (u/level)^k``, k from 1: nothing at rest."""

    level: float
    c: Float

    def __post_init__(self) -> None:
        if not self.level > 0 or not len(self.c):
            raise ModelError("a polynomial needs a level above 0 and a coefficient")

    def at(self, u: Float) -> Float:
        """Values of the polynomial.

        Parameters
        ----------
        u : ndarray
        """
        share, value = u / self.level, np.zeros_like(u)
        for c in self.c[::-1]:
            value = (value + c) * share
        return np.asarray(self.level * value)

    def rising(self) -> tuple[float, float]:
        """Between which values around rest there is no turning point."""
        turns = np.roots((self.c * np.arange(1, len(self.c) + 1))[::-1])
        real = turns.real[np.abs(turns.imag) < 1e-9]
        low = max(real[real <= 0], default=-INVERSION_WIDTHS)
        high = min(real[real > 0], default=INVERSION_WIDTHS)
        return self.level * max(low, -INVERSION_WIDTHS), self.level * high


@dataclass(frozen=True, eq=False)
class Spline:
    """Monotone cubic through knots; straight on with the slope of the chord beyond them."""

    x: Float
    y: Float

    def __post_init__(self) -> None:
        if len(self.x) < 2 or np.any(np.diff(self.x) <= 0):
            raise ModelError("a spline needs two or more knots in rising order")
        object.__setattr__(self, "_slopes", slopes(self.x, self.y))

    def at(self, u: Float) -> Float:
        """Values of the spline.

        Parameters
        ----------
        u : ndarray
        """
        x, y, m = self.x, self.y, self._slopes  # type: ignore[attr-defined]
        k = np.clip(np.searchsorted(x, u, side="right") - 1, 0, len(x) - 2)
        h = x[k + 1] - x[k]
        t = (np.clip(u, x[0], x[-1]) - x[k]) / h
        s = 1 - t
        value = s * s * ((1 + 2 * t) * y[k] + t * h * m[k])
        value = value + t * t * ((1 + 2 * s) * y[k + 1] - s * h * m[k + 1])
        below, above = np.minimum(u - x[0], 0.0), np.maximum(u - x[-1], 0.0)
        chords = (y[1] - y[0]) / (x[1] - x[0]), (y[-1] - y[-2]) / (x[-1] - x[-2])
        return np.asarray(value + chords[0] * below + chords[1] * above)

    def rising(self) -> tuple[float, float]:
        """A few of its widths."""
        width = INVERSION_WIDTHS * float(np.max(np.abs(self.x)))
        return -width, width


@dataclass(frozen=True)
class Curve(Effect):
    """A polynomial (`level`, `c1`, `c2`, ...) or a monotone spline (`x0`, `y0`, `x1`, `y1`, ...).

    Of a drive or an output relative to rest. Spline knots are in the unit of the channel;
    polynomials count in shares of `level`.
    """

    memoryless: ClassVar[bool] = True
    bends: ClassVar[bool] = True
    known: ClassVar = {
        "level": Parameter("{channel}", fixed=True),
        **{f"c{k}": Parameter("1", linear=True) for k in range(1, MAX_DEGREE + 1)},
        **{f"x{k}": Parameter("{channel}", fixed=True) for k in range(MAX_KNOTS)},
        **{f"y{k}": Parameter("{channel}") for k in range(MAX_KNOTS)},
    }

    def __post_init__(self) -> None:
        _shape(tuple(self.parameters.items()))

    @property
    def _form(self) -> Polynomial | Spline:
        return _shape(tuple(self.parameters.items()))

    def bent(self, u: Float) -> Float:
        """The curve at `u`."""
        return self._form.at(np.asarray(u, float))

    def undone(self, values: Float) -> Float:
        """By halving where it rises around rest; NaN where nothing gives the value."""
        values, span = np.asarray(values, float), np.array(self._form.rising())
        ends = self.bent(span)
        low, high = np.full(values.shape, span[0]), np.full(values.shape, span[1])
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            above = self.bent(middle) > values
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        inside = (values >= ends[0]) & (values <= ends[1])
        return np.where(inside, (low + high) / 2, np.nan)


@lru_cache(maxsize=64)
def _shape(parameters: tuple[tuple[str, float], ...]) -> Polynomial | Spline:
    """The form that the parameters of a curve name."""
    named = dict(parameters)
    try:
        if "level" in named:
            c = np.array([named[f"c{k + 1}"] for k in range(len(named) - 1)])
            return Polynomial(named["level"], c)
        knots = range(len(named) // 2)
        x, y = (np.array([named[f"{letter}{k}"] for k in knots]) for letter in "xy")
        return Spline(x, y)
    except KeyError as error:
        raise ModelError(f"a curve without its {error.args[0]}") from error


class DriveCurve(Curve):
    """In front of the responses: what acts is the curve of the drive."""

    name: ClassVar[str] = "drive_curve"
    side: ClassVar[Side] = "drive"
    explanation: ClassVar[str] = "what acts is a curve of what is commanded"
    signature: ClassVar[str] = "steady outputs are a bent function of the drive's level"
    source: ClassVar[str] = "Hammerstein; Mareš et al., section 3.1 (correction polynomial)"

    def drive(self, record: Record, u: Float, memory: Memory = None) -> Float:
        return self.bent(u)


class OutputCurve(Curve):
    """Behind the responses: what is there is the curve of their sum."""

    name: ClassVar[str] = "output_curve"
    side: ClassVar[Side] = "structure"
    explanation: ClassVar[str] = "the output is a curve of what a linear model gives"
    signature: ClassVar[str] = "residuals are a bent function of the output, at every rate alike"
    source: ClassVar[str] = "Wiener (static nonlinearity behind a linear block)"

    def reading(self, y: Float, record: Record, memory: Memory = None) -> Float:
        return self.bent(y)
