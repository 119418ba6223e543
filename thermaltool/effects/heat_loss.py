"""Heat that is lost faster in some state: everywhere alike, or at one place of the machine."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from thermaltool.effects.channels import MAX_TEMPERATURE_GAIN, is_air
from thermaltool.effects.dynamics import from_rest, lagged, time_constants
from thermaltool.effects.effect import Effect, Float, Memory, Outputs, Parameter, Side, needed
from thermaltool.effects.scene import Scene
from thermaltool.record import Record
from thermaltool.units import hold_of, is_absolute, is_temperature

# A loss at one place is told from another gain where its state is there, and is not, for this share
# of the rows at least.
MIN_IN_STATE = 0.03
# In the long run no place cools more than the one that loses the heat; errors may add this.
MOST_ELSEWHERE = 1.1
# Heat that leaves at a place cools it from then on (a driving-point response): it never warms it by
# more than this part of what comes in the end, and after half of the slowest time constant it has
# cooled by this part at least; the slowest mode alone by twice as much.
MAX_AGAINST, MIN_AT_ONCE = 0.2, 0.2
# Rows of a log that a quick look takes.
LOOKED_AT = 2000
# Gains behind each lag of a loss at one place.
GAINS = ("fast", "middle", "slow")
# Parameters of a loss at one place.
LOCAL: Mapping[str, Parameter] = {
    **{gain: Parameter("{output}/K", linear=True) for gain in GAINS},
    "time_constant": Parameter("s", low=0.0, high=1e6, log=True),
    "slowest": Parameter("s", fixed=True),
}


@dataclass(frozen=True)
class HeatLoss(Effect, ABC):
    """A film coefficient rises with a state, everywhere or at one place, `partner`.

    A uniform rise raises the rate of every thermal mode alike: the subclass's `loss`. At one place,
    a temperature T that is read, it takes the heat Δh·A·s·(T − T_air) out of the machine, s the
    state between 0 and 1. What that does to an output is the sum of ``fast``, ``middle`` and
    ``slow`` times s·(T − T_air) behind lags of `time_constant`, of the geometric mean of both, and
    of the slowest mode, `slowest`: one lag for all outputs is the place's or a far one's.

    Attributes
    ----------
    air : str or None
        Temperature of the air at the place; without one T counts from its first value.
    """

    air: str | None = None

    causal: ClassVar[bool] = True
    further: ClassVar[tuple[str, ...]] = ("air",)

    @property
    def side(self) -> Side:  # type: ignore[override]
        """Heat that leaves at one place is a source below zero there."""
        return "state" if self.partner is None else "source"

    @property
    def joins(self) -> bool:
        """All outputs go by the state, or by what is read at the place."""
        return True

    def needs(self) -> tuple[str, ...]:
        named = (self.channel, self.partner, self.air)
        return tuple(dict.fromkeys(c for c in named if c is not None))

    def without(self, names: tuple[str, ...]) -> Effect:
        """As `Effect.without`; its state and its place stay what they are."""
        return replace(super().without(names), channel=self.channel)

    @abstractmethod
    def state(self, record: Record, memory: Memory = None) -> Float:
        """Share of the rise that there is in each row, shape (n,).

        Parameters
        ----------
        record : Record
        memory : dict, optional
            As in `drive`.
        """

    def output(self, name: str, outputs: Outputs, record: Record, memory: Memory = None) -> Float:
        gains = self._gains(name)
        if not any(gains):
            return outputs[name]
        return outputs[name] + np.dot(gains, self._felt(record, {} if memory is None else memory))

    def read(self, outputs: Outputs, record: Record) -> Outputs:
        # What is lost is the same for all of them.
        gains = {name: own for name in outputs if any(own := self._gains(name))}
        if not gains:
            return outputs
        felt = self._felt(record, {})
        return {
            **outputs,
            **{name: outputs[name] + np.dot(own, felt) for name, own in gains.items()},
        }

    def _gains(self, name: str) -> list[float]:
        """What an output is moved by behind each lag, for each degree of the place."""
        if self.partner is None:
            return [0.0] * len(GAINS)
        return [self.parameters.get(f"{base}[{name}]", 0.0) for base in GAINS]

    def lags(self, output: str) -> tuple[float, ...]:
        return self._lags() if self.partner is not None and any(self._gains(output)) else ()

    def _lags(self) -> tuple[float, float, float]:
        """Time constants behind which what is lost at the place is felt [s]."""
        short, long = self.parameters["time_constant"], self.parameters["slowest"]
        return short, float(np.sqrt(short * long)), long

    def _felt(self, record: Record, memory: dict[str, Any]) -> Float:
        """What is lost at the place behind each lag, shape (3, n)."""
        assert self.partner is not None
        excess, known = self._above(record, self.partner, memory)
        if self.air is not None:
            air, air_known = self._above(record, self.air, memory)
            excess, known = excess - air, known & air_known
        # Until both are read nothing is known to leave.
        excess = np.where(known, excess, 0.0)
        lost, hold = self.state(record, memory) * excess, hold_of(self.channel)
        lags = zip(GAINS, self._lags(), strict=True)
        return np.array(
            [
                lagged(record.time, lost, tau, hold, memory=memory.setdefault(gain, {}))
                for gain, tau in lags
            ]
        )

    def explained(self, scene: Scene) -> float:
        """Sum of squares that a loss at one place takes off that output's residual; a quick look.

        Parameters
        ----------
        scene : Scene

        Returns
        -------
        float
            0 where heat would have to enter, or the state never changes.
        """
        assert self.partner is not None
        pairs = []
        for log, residual in zip(scene.logs, scene.residual, strict=True):
            thin = slice(None, None, -(-len(log.time) // LOOKED_AT))
            columns = {c: log.columns[c][thin] for c in self.needs()}
            felt, left = (
                self._felt(Record(log.time[thin], columns), {}),
                residual[self.partner][thin],
            )
            rows = np.isfinite(left)
            if not rows.any():
                continue
            felt, left = felt[:, rows], left[rows]
            pairs.append((felt - felt.mean(axis=1, keepdims=True), left - left.mean()))
        if not pairs:
            return 0.0
        x, y = (np.concatenate(each, axis=-1) for each in zip(*pairs, strict=True))
        gains = np.linalg.lstsq(x.T, y, rcond=None)[0]
        return float(gains @ (x @ y)) if gains.sum() < 0 else 0.0

    def _above(
        self, record: Record, channel: str, memory: dict[str, Any]
    ) -> tuple[Float, NDArray[np.bool_]]:
        """A temperature as read beside one of the air, else from its first value; and from when."""
        kept = memory.setdefault(channel, {})
        before = "reading" in kept
        rise = from_rest(record, channel, kept)
        values = rise if self.air is None else rise + kept.get("reading", [0.0])[0]
        there = np.isfinite(needed(record, channel))
        return values, np.logical_or.accumulate(there) | before

    def plausible(self, scene: Scene) -> bool:
        if not super().plausible(scene):
            return False
        if self.partner is None:
            return True
        # In the long run heat that leaves cools everything that it moves, the place itself first.
        moved = [total for o in scene.outputs if is_temperature(o) and (total := self.total(o))]
        here = self.total(self.partner)
        same = here != 0 and all(total * here > 0 for total in moved)
        same = same and max(map(abs, moved), default=0.0) <= MOST_ELSEWHERE * abs(here)
        same = same and self._acts_at_once()
        states = np.concatenate([self.state(log) for log in scene.logs])
        both = MIN_IN_STATE < float(np.mean(states)) < 1 - MIN_IN_STATE
        return same and both and all(abs(total) <= MAX_TEMPERATURE_GAIN for total in moved)

    def _acts_at_once(self) -> bool:
        """Whether the place goes its way from when heat leaves it, and no other way before."""
        assert self.partner is not None
        tau = np.array(self._lags())
        elapsed = max(tau) * np.append(0.5, np.geomspace(1e-3, 5.0, 100))
        moved = (1 - np.exp(-elapsed[:, None] / tau)) @ self._gains(self.partner)
        moved /= self.total(self.partner)
        return bool(moved[0] >= MIN_AT_ONCE and np.min(moved) >= -MAX_AGAINST)

    def total(self, output: str) -> float:
        """What an output is moved by in the long run for each degree of the place.

        Parameters
        ----------
        output : str
        """
        return sum(self._gains(output))


def places(scene: Scene, trials: int) -> Iterator[tuple[str, str | None, dict[str, float]]]:
    """Every temperature of the model that all logs read, and what a loss there is tried with.

    Parameters
    ----------
    scene : Scene
    trials : int
        Lags at each place.

    Yields
    ------
    place, air, parameters
        No air for a place that reads a difference of temperatures.
    """
    logged = set.intersection(*(set(log.columns) for log in scene.logs))
    air = next((c for c in sorted(logged) if is_air(c) and is_absolute(c)), None)
    gains = {f"{base}[{o}]": 1.0 for base in GAINS for o in scene.outputs}
    for place in scene.sensors():
        if place not in logged or not is_temperature(place):
            continue
        slowest = float(scene.slowest[place])
        for tau in time_constants(10 * scene.period, slowest, trials):
            given = {"time_constant": tau, "slowest": slowest}
            yield place, air if is_absolute(place) else None, {**gains, **given}
