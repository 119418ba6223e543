"""Relaxation modes behind a dead time, H(s) e^(−Ls).

The delay need not be a whole number of samples: with L = m·dt − h, 0 <= h < dt, the output at
t_k is that of the undelayed modes at t_(k−m) + h, which their own state and the input of one more
sample give exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.responses.modes import Complex, Float, Hold, Modes
from thermaltool.responses.recursion import Recursion
from thermaltool.responses.sample_clock import EQUAL_LENGTHS

# A sample is a number of steps where each is a period to this share.
MAX_JITTER = 0.2


@dataclass(frozen=True)
class DelayedModes(Modes):
    """Modes whose input acts `delay` [s] later.

    Attributes
    ----------
    delay : float [s], above zero
    period : float [s], optional
        The sample period on which inputs of the dead time are kept, so that there are as many of
        them on a clock with gaps and jitter; 0: on that of each sample.
    """

    delay: float = 0.0
    period: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.direct:
            raise ModelError("a response with a delay has no direct feedthrough")
        if not 0 < self.delay < np.inf:
            raise ModelError(f"a delay must be a finite time above zero (delay={self.delay:g})")
        if not 0 <= self.period < np.inf:
            raise ModelError(f"a sample period that cannot be {self.period:g} s")

    def prompt(self) -> Modes:
        """The same modes without the delay."""
        return Modes(self.poles, self.weights, self.double)

    def transfer(self, s: Complex) -> Complex:
        return np.asarray(super().transfer(s) * np.exp(-np.asarray(s, complex) * self.delay))

    def step(self, t: Float) -> Float:
        return super().step(np.asarray(t, float) - self.delay)

    def discretize(self, dt: float, hold: Hold = "zero") -> Recursion:
        """The recursion with the inputs of the dead time as further states.

        States: those of the modes at t_(k−m), then the inputs u_(k−m) ... u_(k−1), and u_k where
        lines join the samples. Before the first sample the input counts as zero. A sample of
        several periods is as many steps: exact over whole ones, near where a clock jitters.

        Parameters
        ----------
        dt : float [s]
        hold : "zero" or "first"
        """
        if self.period:
            ratio = dt / self.period
            nearest = {max(math.floor(ratio), 1), math.ceil(ratio)}
            steps = min(nearest, key=lambda k: abs(ratio / k - 1))
            if abs(ratio / steps - 1) <= MAX_JITTER:
                samples = _samples(self.delay, self.period)
                return _repeated(self._over(dt / steps, samples, hold), steps, hold)
        return self._over(dt, _samples(self.delay, dt), hold)

    def _over(self, dt: float, samples: int, hold: Hold) -> Recursion:
        """The recursion over one step that keeps the inputs of so many."""
        ahead = samples * dt - self.delay
        ahead = 0.0 if abs(ahead) < EQUAL_LENGTHS * dt else ahead
        inner, to_come = self.prompt().discretize(dt, hold), _shifted(self.prompt(), ahead)
        seen = to_come.discretize(dt, hold).C[0]
        d0, d1 = _within(self.prompt(), ahead, dt, hold)
        n, kept = len(inner.F), samples + (hold == "first")
        F, G0, G1 = np.zeros((n + kept,) * 2), np.zeros(n + kept), np.zeros(n + kept)
        F[:n, :n], F[:n, n] = inner.F, inner.G0[:, 0]
        if hold == "first":
            F[:n, n + 1] = inner.G1[:, 0]
            G1[-1] = 1.0
        for k in range(samples - 1):
            F[n + k, n + k + 1] = 1.0
        G0[n + samples - 1] = 1.0
        C = np.concatenate([seen, np.zeros(kept)])
        C[n] += d0
        if hold == "first":
            C[n + 1] += d1
        return Recursion(F, G0[:, None], G1[:, None], C[None, :])

    def run(self, time: Float, u: Float, hold: Hold) -> Float:
        """As `Modes.run`: exact on any clock.

        Parameters
        ----------
        time, u : ndarray, shape (n,)
        hold : "zero" or "first"
        """
        return self.at(time, u, hold, time)

    def at(self, time: Float, u: Float, hold: Hold, moments: Float) -> Float:
        """As `Modes.at`, by the delay later.

        Parameters
        ----------
        time, u : ndarray, shape (n,)
        hold : "zero" or "first"
        moments : ndarray, shape (k,) [s]
        """
        return self.prompt().at(time, u, hold, moments - self.delay)

    def document(self) -> dict[str, Any]:
        """As JSON: the lists of the modes, ``delay`` [s] and, if there is one, ``period`` [s]."""
        period = {"period": self.period} if self.period else {}
        return {**self.prompt().document(), "delay": self.delay, **period}


def load_modes(document: dict[str, Any]) -> Modes:
    """Modes, with a delay where the document has one.

    Parameters
    ----------
    document : dict
        As `Modes.document` gives it.
    """
    lists = {k: values for k, values in document.items() if k not in ("delay", "period")}
    modes = Modes.from_document(lists)
    if "delay" not in document:
        return modes
    times = (float(document["delay"]), float(document.get("period", 0.0)))
    return DelayedModes(modes.poles, modes.weights, modes.double, *times)


def _repeated(one: Recursion, steps: int, hold: Hold) -> Recursion:
    """One recursion so many times over, with the input between as it is held."""
    if steps == 1:
        return one
    n = len(one.F)
    # Beside the state the input, and by how much it moves in a step.
    whole = np.eye(n + 2)
    whole[:n, :n], whole[:n, n], whole[:n, n + 1] = one.F, (one.G0 + one.G1)[:, 0], one.G1[:, 0]
    whole[n, n + 1] = 1.0
    power = np.linalg.matrix_power(whole, steps)
    moves = power[:n, n + 1 :] / steps if hold == "first" else np.zeros((n, 1))
    return Recursion(power[:n, :n], power[:n, n : n + 1] - moves, moves, one.C)


def _samples(delay: float, dt: float) -> int:
    """Samples that hold a delay; a rest below the resolution of a clock takes no further one."""
    return max(1, math.ceil(delay / dt - EQUAL_LENGTHS))


def _shifted(modes: Modes, ahead: float) -> Modes:
    """Modes whose output now is that of `modes` a time `ahead` later without further input."""
    if not ahead:
        return modes
    grown = np.exp(modes.poles * ahead)
    return Modes(
        modes.poles, (modes.weights + modes.double * ahead) * grown, modes.double * grown.real
    )


def _within(modes: Modes, ahead: float, dt: float, hold: Hold) -> tuple[float, float]:
    """What the inputs at both ends of a sample add to the output at `ahead` into it."""
    if ahead <= 0:
        return 0.0, 0.0
    whole = float(modes.step(np.array(ahead)))
    if hold == "zero":
        return whole, 0.0
    ramp = modes.discretize(ahead, "first")
    later = float((ramp.C @ ramp.G1)[0, 0]) * ahead / dt
    return whole - later, later
