"""Modes that decay faster by a rate that changes from sample to sample."""

from __future__ import annotations

from typing import Any

import numpy as np

from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.modes import Float, Hold, Modes
from thermaltool.responses.propagation import propagate, propagate_double, recursion_of
from thermaltool.responses.sample_clock import clock_step

# Rows whose coefficients are held at once.
MAX_ROWS = 2**16
# How far Γ [1] goes among inputs of which a response with a delay is followed by e^Γ, how far e^Γ
# goes, and the exponent from which on nothing of them is left.
MAX_SPAN, MAX_EXPONENT, GONE = 100.0, 600.0, 60.0


def run_with_loss(modes: Modes, time: Float, u: Float, hold: Hold, cooling: Float) -> Float:
    """Response from rest at the first row, without direct feedthrough, shape (n,).

    Each mode z' = −(λ + Γ')z + u is that of e^Γ u without Γ, times e^(−Γ): in a sample e^(−λ dt)
    becomes e^(−λ dt − ΔΓ), however far Γ goes in the record. A held input acts, on the mean, half
    a sample later than its first moment.

    Parameters
    ----------
    modes : Modes
    time, u : ndarray, shape (n,)
    hold : "zero" or "first"
    cooling : ndarray, shape (n,)
        Γ, the integral of the rate.
    """
    if isinstance(modes, DelayedModes):
        return _weighted(modes, time, u, hold, cooling)
    poles: Any = modes.poles if np.any(modes.poles.imag) else modes.poles.real
    weights = modes.weights * np.where(modes.poles.imag == 0, 1, 2)
    step, steps, rises = clock_step(time), np.diff(time), np.diff(cooling)
    y, first, second = np.zeros(len(u)), 0.0 * poles, 0.0 * modes.poles.real
    for low in range(0, len(steps), MAX_ROWS):
        part = slice(low, min(low + MAX_ROWS, len(steps)))
        dt, inverse = _different(steps[part], step)
        now, then = u[part], u[part.start + 1 : part.stop + 1]
        kept = np.exp(-rises[part])
        of_now = kept if hold == "first" else np.exp(-rises[part] / 2)
        phi, g0, g1 = (each[inverse].T for each in propagate(poles[None, :], dt[:, None], hold))
        added = g0 * (of_now * now) + g1 * then
        added[:, 0] += phi[:, 0] * kept[0] * first
        states = recursion_of(phi * kept, added)
        states[:, 0] = first
        rows = slice(part.start, part.stop + 1)
        y[rows] = (weights @ states).real
        if np.any(modes.double):
            real = modes.poles.real
            d0, d1 = (
                each[inverse].T for each in propagate_double(real[None, :], dt[:, None], hold)
            )
            passed = steps[part] * states[:, :-1].real * phi.real * kept
            passed += d0 * (of_now * now) + d1 * then
            passed[:, 0] += phi[:, 0].real * kept[0] * second
            doubles = recursion_of(phi.real * kept, passed)
            doubles[:, 0] = second
            y[rows] += modes.double @ doubles
            second = doubles[:, -1].copy()
        first = states[:, -1].copy()
    return y


def _weighted(modes: DelayedModes, time: Float, u: Float, hold: Hold, cooling: Float) -> Float:
    """By e^Γ itself: what is in the dead time has had its weight when it entered.

    Of inputs in turn between which Γ goes no farther than `MAX_SPAN`, one after another.
    """
    inside = np.append((cooling[1:] + cooling[:-1]) / 2, cooling[-1])
    entered = inside if hold == "zero" else cooling
    slowest = float(np.min(-modes.poles.real))
    part = np.cumsum(np.abs(np.diff(cooling, prepend=cooling[0]))) // MAX_SPAN
    y = np.zeros(len(u))
    for k in np.unique(part):
        rows = np.flatnonzero(part == k)
        # A line to its first input begins a row before.
        own, last = cooling[rows[0]], rows[-1]
        decayed = slowest * (time[last:] - time[last] - modes.delay) + cooling[last:] - own
        end = last + int(np.argmax(np.append(decayed > GONE, True)))
        rest = slice(max(rows[0] - 1, 0), max(end, last + 1))
        weighted = np.zeros(len(u))
        weighted[rows] = u[rows] * np.exp(entered[rows] - own)
        gone = np.exp(np.clip(own - cooling[rest], -MAX_EXPONENT, MAX_EXPONENT))
        y[rest] += modes.run(time[rest], weighted[rest], hold) * gone
    return y


def _different(steps: Float, step: float) -> tuple[Float, Any]:
    """Lengths that differ, and which of them each sample has."""
    _, first, inverse = np.unique(np.round(steps / step), return_index=True, return_inverse=True)
    return steps[first], inverse
