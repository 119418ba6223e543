"""Static curves as a search sees them: knots or coefficients, and a straight line to begin with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from thermaltool.effects.curve import MAX_DEGREE, MAX_KNOTS, Curve, DriveCurve, OutputCurve
from thermaltool.effects.effect import Float
from thermaltool.errors import FitError, ModelError
from thermaltool.model import Model, acting_drives
from thermaltool.record import Record

Kind = Literal["polynomial", "spline"]

# Prior deviation of neighbouring steps of a spline from each other, in the logarithm.
STEP_PRIOR = 1.0
# A side of a drive below this share of the other one is noise around zero.
MAX_NOISE_SIDE = 0.02
# Pieces of a spline and degree of a polynomial where none are given.
USUAL_SIZES = {"spline": 6, "polynomial": 2}


@dataclass(frozen=True)
class Form:
    """What a curve is made of.

    Attributes
    ----------
    kind : "polynomial" or "spline"
    size : int
        Degree, or pieces between knots.

    Raises
    ------
    FitError
        A size that the kind does not take.
    """

    kind: Kind
    size: int

    @staticmethod
    def usual(kind: Kind, size: int | None = None) -> Form:
        """A form of the usual size where none is given."""
        return Form(kind, USUAL_SIZES[kind] if size is None else size)

    def __post_init__(self) -> None:
        least, most = (1, MAX_DEGREE) if self.kind == "polynomial" else (2, MAX_KNOTS - 2)
        if not least <= self.size <= most:
            raise FitError(f"a {self.kind} of {self.size}: it takes {least} to {most}")


@dataclass(frozen=True)
class SearchedCurve:
    """Static curve whose numbers are searched.

    Attributes
    ----------
    channel : str
    cls : type of Curve
    form : Form
    low, high : float [unit of the channel]
        What the records hold of it, relative to rest.
    pinned : bool
        The curve agrees with the channel at its largest level.
    """

    channel: str
    cls: type[Curve]
    form: Form
    low: float
    high: float
    pinned: bool

    @property
    def level(self) -> float:
        """Largest distance from rest [unit of the channel]."""
        return max(-self.low, self.high)

    @property
    def size(self) -> int:
        """How many numbers are searched."""
        return self.form.size - self.pinned

    def start(self) -> Float:
        """A straight line."""
        first = np.zeros(self.size)
        if self.form.kind == "polynomial" and not self.pinned:
            first[0] = 1.0
        return first

    def curve(self, p: Float) -> Curve:
        """The curve of a vector; pinned, it has one number less.

        Parameters
        ----------
        p : ndarray, shape (size,)
            Coefficients, or logarithms of a spline's slopes, which are positive.
        """
        if self.form.kind == "polynomial":
            c = np.concatenate([[1 - np.sum(p)], p]) if self.pinned else p
            named = {f"c{k + 1}": float(value) for k, value in enumerate(c)}
            return self.cls(self.channel, {"level": self.level, **named})
        x = self._knots()
        steps = np.diff(x) * np.exp(np.append(p, 0.0) if self.pinned else p)
        y = np.concatenate([[0.0], np.cumsum(steps)])
        y -= y[int(np.argmin(np.abs(x)))]
        if self.pinned:
            end = int(np.argmax(np.abs(x)))
            y *= x[end] / y[end]
        named = {f"x{k}": float(value) for k, value in enumerate(x)}
        return self.cls(self.channel, named | {f"y{k}": float(v) for k, v in enumerate(y)})

    def _knots(self) -> Float:
        """Even from the lowest to the highest level; zero is one of them."""
        low, high, pieces = min(self.low, 0.0), max(self.high, 0.0), self.form.size
        if low > -MAX_NOISE_SIDE * high:
            below = 0
        elif high < -MAX_NOISE_SIDE * low:
            below = pieces
        else:
            below = min(max(1, round(pieces * low / (low - high))), pieces - 1)
        left = np.linspace(low, 0.0, below + 1)[:-1] if below else np.empty(0)
        right = np.linspace(0.0, high, pieces - below + 1) if below < pieces else np.zeros(1)
        return np.concatenate([left, right])

    def roughness(self, p: Float) -> Float:
        """Rows that keep what the data leave open from going anywhere."""
        if self.form.kind == "polynomial":
            return np.empty(0)
        return np.diff(np.append(p, 0.0) if self.pinned else p) / STEP_PRIOR


def searched_curve(
    model: Model, records: Sequence[Record], channel: str, form: Form, refit: bool
) -> SearchedCurve:
    """A curve for a search: in front of a drive, or behind an output.

    Parameters
    ----------
    model : Model
    records : sequence of Record
    channel : str
    form : Form
    refit : bool
        The dynamics are searched too: the curve is pinned, and only in front of a drive.

    Raises
    ------
    FitError
        The channel never moves.
    ModelError
        No channel of the model, or one that has a curve.
    """
    drives, outputs = ([each.channel for each in ends] for ends in (model.drives, model.outputs))
    if any(isinstance(e, Curve) and e.channel == channel for e in model.effects):
        raise ModelError(f"{channel} has a curve already: start from the model without it")
    if channel in drives:
        inputs = [acting_drives(model, model.effects, record)[channel] for record in records]
        seen = np.concatenate(inputs)
        cls: type[Curve] = DriveCurve
    elif channel in outputs:
        if refit:
            raise ModelError(f"{channel}: the dynamics are searched again with curves of drives")
        seen = np.concatenate([model.simulate(record)[channel] for record in records])
        cls = OutputCurve
    else:
        there = ", ".join((*drives, *outputs))
        raise ModelError(f"no drive or output {channel} in the model; there are: {there}")
    low, high = float(np.min(seen)), float(np.max(seen))
    if not high > low:
        raise FitError(f"{channel} never moves within the logs: they say nothing of a curve")
    return SearchedCurve(channel, cls, form, low, high, refit)
