"""Modes that decay faster by a rate that changes from sample to sample."""

from __future__ import annotations

import itertools

import numpy as np

from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.modes import Float, Hold, Modes

# How far Γ [1] goes among inputs that are weighed at once, how far e^Γ goes, and the exponent from
# which on nothing of them is left.
MAX_SPAN, MAX_EXPONENT, GONE = 100.0, 600.0, 60.0


def run_with_loss(modes: Modes, time: Float, u: Float, hold: Hold, cooling: Float) -> Float:
    """Response from rest at the first row, without direct feedthrough, shape (n,).

    Each mode z' = −(λ + Γ')z + u is that of e^Γ u without Γ, times e^(−Γ); what is in a dead time
    has had its weight when it entered. A held input acts, on the mean, half a sample later than
    its first moment. However far Γ goes in the record: of inputs in turn between which it goes no
    farther than `MAX_SPAN`, one after another.

    Parameters
    ----------
    modes : Modes
    time, u : ndarray, shape (n,)
    hold : "zero" or "first"
    cooling : ndarray, shape (n,)
        Γ, the integral of the rate.
    """
    modes = modes.proper
    delay = modes.delay if isinstance(modes, DelayedModes) else 0.0
    inside = np.append((cooling[1:] + cooling[:-1]) / 2, cooling[-1])
    entered = inside if hold == "zero" else cooling
    slowest = float(np.min(-modes.poles.real))
    part = np.append(0.0, np.cumsum(np.abs(np.diff(cooling)))) // MAX_SPAN
    y = np.zeros(len(u))
    for first, stop in itertools.pairwise([0, *np.flatnonzero(np.diff(part)) + 1, len(u)]):
        own, last, most = cooling[first], stop - 1, np.max(entered[first:stop])
        decayed = slowest * (time[last:] - time[last] - delay) + cooling[last:] - most
        end = last + int(np.argmax(np.append(decayed > GONE, True)))
        # A line to its first input begins a row before.
        rest = slice(max(first - 1, 0), max(end, stop))
        weighted = np.zeros(len(u))
        weighted[first:stop] = u[first:stop] * np.exp(entered[first:stop] - own)
        gone = np.exp(np.clip(own - cooling[rest], -MAX_EXPONENT, MAX_EXPONENT))
        y[rest] += modes.run(time[rest], weighted[rest], hold) * gone
    return y
