"""Columns that are read beside the sensors: measured drives, and sources that a channel tells.

What they do to a sensor is subtracted from its reading before the estimator, what they do to a
deflection is added behind it; each way has its own state, so that the whole is again one linear
recursion. Where every drive is measured nothing is left to estimate: that is feedforward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from thermaltool.effects.band import Band, load_band
from thermaltool.errors import ModelError
from thermaltool.responses.delay import load_modes
from thermaltool.responses.modes import CLOCK_STEP, Float, Hold, Modes, Recursion

if TYPE_CHECKING:
    from thermaltool.estimation.estimator import Estimator

Role = Literal["drive", "source", "state"]


@dataclass(frozen=True)
class Known:
    """A column beside the sensors.

    Attributes
    ----------
    channel : str
    hold : "zero" or "first"
    role : "drive", "source" or "state"
        A drive of the model, relative to its reference; the channel of a source, relative to its
        first value; a state on which the loss of heat or a schedule depends, as it is.
    band : Band or None
        Of a drive: only this level's share of it.
    """

    channel: str
    hold: Hold
    role: Role
    band: Band | None = None

    def document(self) -> dict[str, Any]:
        """As JSON."""
        band = {} if self.band is None else {"band": self.band.document()}
        return {"channel": self.channel, "hold": self.hold, "role": self.role, **band}


# (target, known column, response), or a gain where it acts at once.
Way = tuple[int, int, Modes | float]


@dataclass(frozen=True, eq=False)
class Feedforward:
    """Nothing to estimate: deflections follow from known columns alone."""

    outputs: tuple[str, ...]
    sensors: tuple[str, ...] = ()

    @property
    def estimates(self) -> tuple[str, ...]:
        return self.outputs

    def recursion(self, dt: float) -> Recursion:
        none = np.zeros((0, 0))
        return Recursion(none, none, none, np.zeros((len(self.outputs), 0)))

    def document(self) -> dict[str, Any]:
        outputs = list(self.outputs)
        return {"form": "feedforward", "sensors": [], "drives": [], "outputs": outputs}


@dataclass(frozen=True, eq=False)
class WithKnown:
    """An estimator that is told known columns too.

    Attributes
    ----------
    inner : Estimator
    known : tuple of Known
    to_sensors, to_outputs : tuple of (int, int, Modes or float)
    """

    inner: Estimator
    known: tuple[Known, ...]
    to_sensors: tuple[Way, ...]
    to_outputs: tuple[Way, ...]

    @property
    def sensors(self) -> tuple[str, ...]:
        """All columns that are read, the sensors first."""
        return (*self.inner.sensors, *(k.channel for k in self.known))

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.inner.outputs

    @property
    def estimates(self) -> tuple[str, ...]:
        return self.inner.estimates

    def __post_init__(self) -> None:
        object.__setattr__(self, "_recursion", lru_cache(maxsize=64)(self._build))

    def recursion(self, dt: float) -> Recursion:
        recursion: Recursion = self._recursion(round(dt / CLOCK_STEP))  # type: ignore[attr-defined]
        return recursion

    def _build(self, ticks: int) -> Recursion:
        """With ξ the states of the ways: x ← F x + G0 (r − S ξ) + G1 (r⁺ − S ξ⁺), y = C x + D ξ."""
        dt = ticks * CLOCK_STEP
        inner = self.inner.recursion(dt)
        bank, S, D = self._bank(dt)
        F, below = inner.F, np.zeros((len(bank.F), inner.G0.shape[1]))
        side = -inner.G0 @ S - inner.G1 @ S @ bank.F
        passed = inner.G1 @ S
        return Recursion(
            np.block([[F, side], [np.zeros((len(bank.F), len(F))), bank.F]]),
            np.block([[inner.G0, -passed @ bank.G0], [below, bank.G0]]),
            np.block([[inner.G1, -passed @ bank.G1], [below, bank.G1]]),
            np.hstack([inner.C, D]),
        )

    def _bank(self, dt: float) -> tuple[Recursion, Float, Float]:
        """Recursion of all ways side by side, and what sensors and estimates see of it."""
        ways = [*self.to_sensors, *self.to_outputs]
        parts = [_one_sample(way, dt, self.known[source].hold) for _, source, way in ways]
        n, m = sum(len(part.F) for part in parts), len(self.known)
        F, G0, G1 = np.zeros((n, n)), np.zeros((n, m)), np.zeros((n, m))
        S, D = np.zeros((len(self.inner.sensors), n)), np.zeros((len(self.estimates), n))
        first_output = len(self.estimates) - len(self.outputs)
        at = 0
        for k, ((target, source, _), part) in enumerate(zip(ways, parts, strict=True)):
            to = slice(at, at + len(part.F))
            F[to, to], G0[to, source], G1[to, source] = part.F, part.G0[:, 0], part.G1[:, 0]
            row = S[target] if k < len(self.to_sensors) else D[first_output + target]
            row[to] = part.C[0]
            at = to.stop
        return Recursion(F, G0, G1, np.vstack([S, D])), S, D

    def document(self) -> dict[str, Any]:
        return {
            **self.inner.document(),
            "known": {
                "columns": [k.document() for k in self.known],
                "to_sensors": [_way_document(way) for way in self.to_sensors],
                "to_outputs": [_way_document(way) for way in self.to_outputs],
            },
        }  # fmt: skip


def _one_sample(way: Modes | float, dt: float, hold: Hold) -> Recursion:
    if isinstance(way, Modes):
        return way.discretize(dt, hold)
    one = np.ones((1, 1))
    return Recursion(0 * one, 0 * one, one, way * one)


def _way_document(way: Way) -> dict[str, Any]:
    target, source, response = way
    how = {"modes": response.document()} if isinstance(response, Modes) else {"gain": response}
    return {"to": target, "from": source, **how}


def load_known(inner: Estimator, document: dict[str, Any]) -> WithKnown:
    """`inner` with the known columns that its design lists.

    Raises
    ------
    ModelError, KeyError, TypeError, ValueError
        A part missing or not sound.
    """
    known = tuple(
        Known(k["channel"], k["hold"], k["role"], load_band(k.get("band")))
        for k in document["columns"]
    )
    for k in known:
        if k.hold not in get_args(Hold) or k.role not in get_args(Role):
            raise ModelError(f"a known column {k.channel} of hold {k.hold!r}, role {k.role!r}")

    def ways(documents: list[dict[str, Any]], targets: Sequence[str]) -> tuple[Way, ...]:
        found: list[Way] = []
        for d in documents:
            if d["to"] not in range(len(targets)) or d["from"] not in range(len(known)):
                raise ModelError(f"a way from {d['from']!r} to {d['to']!r}, which are not there")
            gain = None if "modes" in d else float(d["gain"])
            if gain is not None and not np.isfinite(gain):
                raise ModelError(f"a gain that cannot be {gain:g}")
            response = load_modes(d["modes"]) if gain is None else gain
            found.append((d["to"], d["from"], response))
        return tuple(found)

    to_sensors = ways(document["to_sensors"], inner.sensors)
    return WithKnown(inner, known, to_sensors, ways(document["to_outputs"], inner.outputs))
