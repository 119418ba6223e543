"""Relaxation modes: the common form of every linear response in this package.

A response is a sum of exponential modes, H(s) = Σ w_j/(s − p_j) + Σ v_j/(s − p_j)² + d, with
poles in the left half-plane. Rational responses have this form exactly; diffusive ones reach it to
a stated tolerance (`relaxation.fit_relaxation`). The recursion over a sample of any length follows
in closed form, with work that does not depend on the past.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import ModelError
from thermaltool.responses.propagation import propagate, propagate_double, recursion_of
from thermaltool.responses.recursion import Float, Recursion
from thermaltool.responses.sample_clock import clock_step
from thermaltool.responses.uneven import UnevenClock
from thermaltool.units import Hold

Complex = NDArray[np.complex128]
Range = tuple[float, float]

# States of several modes that are kept at once on an uneven clock (8 MB).
MAX_STATES = 2**20
# Rows that are stepped through at once on an uneven clock; a longer record goes on from the state.
MAX_STRETCH = 2**17
# States up to which what hangs on an uneven clock is kept (3 MB), and for how many clocks.
MAX_CLOCK_STATES, MAX_CLOCKS = 2**17, 48


@dataclass(frozen=True)
class Modes:
    """H(s) = Σ w/(s − p) + Σ v/(s − p)² + d.

    Attributes
    ----------
    poles : ndarray, shape (n,), complex [1/s]
        Real poles, and of each complex pair the one with positive imaginary part.
    weights : ndarray, shape (n,), complex
        Residues w [unit of the response per s]; the conjugate pole's residue is implied.
    double : ndarray, shape (n,), float
        v, the weight of the double pole [unit/s²]; real poles only.
    direct : float
        d, direct feedthrough: the output follows the input of the same row [unit of the response].
    """

    poles: Complex
    weights: Complex
    double: Float = field(default_factory=lambda: np.zeros(0))
    direct: float = field(default=0.0, kw_only=True)
    # The recursion of the last even clock that was run: many records have the same one.
    _last: dict[tuple[float, Hold], Recursion] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        if not len(self.double):
            object.__setattr__(self, "double", np.zeros(len(self.poles)))
        shapes = {self.poles.shape, self.weights.shape, self.double.shape}
        if len(shapes) > 1 or not all(
            np.isfinite(part).all() for part in (self.poles, self.weights, self.double, self.direct)
        ):
            raise ModelError("modes need as many weights as poles, all of them finite")
        if np.any(self.poles.real > 0):
            raise ModelError("a response with a pole in the right half-plane is unstable")

    @property
    def states(self) -> int:
        """Number of states of the recursion."""
        pairs, twice = np.sum(self.poles.imag != 0), np.sum(self.double != 0)
        return int(len(self.poles) + pairs + twice) + (self.direct != 0)

    @cached_property
    def proper(self) -> Modes:
        """The same modes without direct feedthrough."""
        return replace(self, direct=0.0) if self.direct else self

    @cached_property
    def _output_weights(self) -> Any:
        """Weights of the states in the output, of pairs for both; real where all poles are."""
        weights: Any = self.weights * np.where(self.poles.imag == 0, 1, 2)
        return weights if np.any(self.poles.imag) else weights.real

    def transfer(self, s: Complex) -> Complex:
        """H at complex frequencies.

        Parameters
        ----------
        s : ndarray, any shape, complex [rad/s]
        """
        s = np.asarray(s, complex)[..., None]
        simple = self.weights / (s - self.poles) + self.double / (s - self.poles) ** 2
        pair = np.where(
            self.poles.imag != 0, np.conj(self.weights) / (s - np.conj(self.poles)), 0.0
        )
        return np.asarray((simple + pair).sum(-1) + self.direct)

    def step(self, t: Float) -> Float:
        """Response to a unit step at t = 0.

        Parameters
        ----------
        t : ndarray, any shape [s]
            Zero before t = 0.
        """
        begun = np.asarray(t) >= 0
        t = np.maximum(np.asarray(t, float), 0.0)[..., None]
        # Complex exponentials cost several times as much as real ones.
        pairs = np.any(self.poles.imag)
        p: Any = self.poles if pairs else self.poles.real
        weights: Any = self.weights if pairs else self.weights.real
        moves = p != 0
        rate = np.where(moves, p, 1)
        grown = np.where(moves, np.expm1(p * t) / rate, t)
        value = (weights * grown).real * np.where(self.poles.imag != 0, 2, 1)
        if np.any(self.double):
            # ∫ τ e^(pτ) dτ
            ramp = np.where(moves, (t * np.exp(p * t) - grown) / rate, t**2 / 2)
            value = value + self.double * ramp.real
        return np.asarray(value.sum(-1) + self.direct * begun)

    def dc_gain(self) -> float:
        """H(0)."""
        return float(self.transfer(np.zeros(1, complex))[0].real)

    def discretize(self, dt: float, hold: Hold = "zero") -> Recursion:
        """The exact recursion over one sample of length `dt`; the last state is the feedthrough's.

        Parameters
        ----------
        dt : float [s]
        hold : "zero" or "first"
            The input between samples: constant at the earlier value, or a straight line.
        """
        phi, g0, g1 = propagate(self.poles, dt, hold)
        d0, d1 = propagate_double(self.poles.real, dt, hold)
        single = (self.poles.imag == 0) & (self.double == 0)
        n, at = self.states, int(single.sum())
        F, G0, G1, C = np.zeros((n, n)), np.zeros(n), np.zeros(n), np.zeros(n)
        F[np.arange(at), np.arange(at)] = phi[single].real
        G0[:at], G1[:at] = g0[single].real, g1[single].real
        C[:at] = self.weights[single].real
        for k in np.flatnonzero(~single):
            to = slice(at, at + 2)
            if self.poles[k].imag:
                F[to, to] = [[phi[k].real, -phi[k].imag], [phi[k].imag, phi[k].real]]
                G0[to], G1[to] = (g0[k].real, g0[k].imag), (g1[k].real, g1[k].imag)
                C[to] = 2 * self.weights[k].real, -2 * self.weights[k].imag
            else:
                F[to, to] = [[phi[k].real, 0.0], [dt * phi[k].real, phi[k].real]]
                G0[to], G1[to] = (g0[k].real, d0[k]), (g1[k].real, d1[k])
                C[to] = self.weights[k].real, self.double[k]
            at += 2
        if self.direct:
            G1[-1], C[-1] = 1.0, self.direct
        return Recursion(F, G0[:, None], G1[:, None], C[None, :])

    def run(self, time: Float, u: Float, hold: Hold) -> Float:
        """Response to any input at any increasing times, from rest at the first.

        Parameters
        ----------
        time, u : ndarray, shape (n,)

        Returns
        -------
        y : ndarray, shape (n,)
        """
        if self.direct:
            return self.proper.run(time, u, hold) + self.direct * u
        steps, step = np.diff(time), clock_step(time)
        if len(steps) and np.ptp(steps) < step:
            clock = float(np.mean(steps)), hold
            if clock not in self._last:
                self._last.clear()
                self._last[clock] = self.discretize(*clock)
            return self._last[clock].run(u[:, None])[0][:, 0]
        states = len(steps) * len(self.poles)
        if states > MAX_CLOCK_STATES or len(steps) < 2 or np.any(self.double):
            return self._stepped(steps, step, u, hold)
        uneven = _uneven_clock(self.poles.tobytes(), steps.tobytes(), step, hold)
        y = np.zeros(len(u))
        for each in uneven.sums:
            y += each.run(self._output_weights, u)
        if len(fast := uneven.fast):
            y += Modes(self.poles[fast], self.weights[fast])._stepped(steps, step, u, hold)
        return y

    def at(self, time: Float, u: Float, hold: Hold, moments: Float) -> Float:
        """Response at any moments to any input at increasing times, from rest at the first.

        Exact on every clock: the state of the row before a moment, and what the input has done
        since.

        Parameters
        ----------
        time, u : ndarray, shape (n,)
        hold : "zero" or "first"
        moments : ndarray, shape (k,) [s]
            Before the first row all is at rest; after the last one its input stays.

        Returns
        -------
        y : ndarray, shape (k,)
        """
        row = np.clip(np.searchsorted(time, moments, side="right") - 1, 0, len(time) - 1)
        ahead = np.maximum(moments - time[row], 0.0)
        before, now = u[row], u[row] if hold == "zero" else np.interp(moments, time, u)
        step = clock_step(time)
        y = self.direct * now
        for rows, some, first, second in self._states(np.diff(time), step, u, hold):
            own = np.flatnonzero((row >= rows.start) & (row < rows.stop))
            phi, g0, g1, d0, d1 = self._coefficients(ahead[own], step, hold, some)
            first, second = first[:, row[own] - rows.start], second[:, row[own] - rows.start]
            passed = phi * first + g0 * before[own] + g1 * now[own]
            y[own] += (self._output_weights[some] @ passed).real
            if np.any(self.double[some]):
                second = phi.real * (second + ahead[own] * first.real)
                y[own] += self.double[some] @ (second + d0 * before[own] + d1 * now[own])
        return np.where(moments < time[0], 0.0, y)

    def _stepped(self, steps: Float, step: float, u: Float, hold: Hold) -> Float:
        """One recursion for each mode, its coefficients anew at every row: any clock."""
        y = np.zeros(len(u))
        for rows, some, first, second in self._states(steps, step, u, hold):
            y[rows] += (self._output_weights[some] @ first).real
            y[rows] += self.double[some] @ second
        return y

    def _states(
        self, steps: Float, step: float, u: Float, hold: Hold
    ) -> Iterator[tuple[slice, slice, Any, Float]]:
        """Rows, some modes, their state at each of the rows, and that of their double poles.

        Stretches of rows one after another, so that a long record takes no more than a short one;
        states of shape (modes, rows).
        """
        last = len(u) - 1
        count = max(1, MAX_STATES // min(len(u), MAX_STRETCH + 1))
        for start in range(0, len(self.poles), count):
            some = slice(start, start + count)
            begun, begun_second = cast(Any, 0.0), cast(Any, 0.0)
            for low in range(0, max(last, 1), MAX_STRETCH):
                high = min(low + MAX_STRETCH, last)
                own, now, then = steps[low:high], u[low:high], u[low + 1 : high + 1]
                phi, g0, g1, d0, d1 = self._coefficients(own, step, hold, some)
                added = g0 * now + g1 * then
                if low:
                    added[:, 0] += phi[:, 0] * begun
                first = recursion_of(phi, added)
                if low:
                    first[:, 0] = begun
                second = np.zeros(first.shape)
                if np.any(self.double[some]):
                    passed = own * phi.real * first[:, :-1].real + d0 * now + d1 * then
                    if low:
                        passed[:, 0] += phi[:, 0].real * begun_second
                    second = recursion_of(phi.real, passed)
                    if low:
                        second[:, 0] = begun_second
                begun, begun_second = first[:, -1].copy(), second[:, -1].copy()
                stop = high if high < last else len(u)  # the row that two share is the later one's
                yield slice(low, stop), some, first[:, : stop - low], second[:, : stop - low]

    def _coefficients(self, lengths: Float, step: float, hold: Hold, some: slice) -> list[Any]:
        """Decay of some modes over stretches of any length, weights of the inputs at their ends.

        Lengths that are equal to within `step` are computed once. Those of the second state of a
        double pole follow; each of shape (modes, n).
        """
        _, first, which = np.unique(
            np.round(lengths / step), return_index=True, return_inverse=True
        )
        dt = lengths[first][:, None]
        poles: Any = (self.poles if np.any(self.poles.imag) else self.poles.real)[some]
        found: list[Any] = [*propagate(poles[None, :], dt, hold)]
        if np.any(self.double):
            found += propagate_double(self.poles.real[None, some], dt, hold)
        else:
            found += [np.zeros((len(dt), 0))] * 2
        return [c[which].T for c in found]

    def document(self) -> dict[str, Any]:
        """As JSON: parallel lists, imaginary, double and direct parts only where there are any."""
        lists: dict[str, Any] = {
            "pole": self.poles.real.tolist(),
            "weight": self.weights.real.tolist(),
        }
        if np.any(self.poles.imag):
            lists["pole_imag"] = self.poles.imag.tolist()
            lists["weight_imag"] = self.weights.imag.tolist()
        if np.any(self.double):
            lists["double"] = self.double.tolist()
        if self.direct:
            lists["direct"] = self.direct
        return lists

    @staticmethod
    def from_document(lists: dict[str, Any]) -> Modes:
        """What `document` has written."""
        lists = {**lists}
        zero, direct = [0.0] * len(lists["pole"]), float(lists.pop("direct", 0.0))
        imag, weight = lists.get("pole_imag", zero), lists.get("weight_imag", zero)
        if any(len(each) != len(zero) for each in lists.values()):
            raise ModelError("modes need lists of one length")
        return Modes(
            np.array(lists["pole"]) + 1j * np.array(imag),
            np.array(lists["weight"]) + 1j * np.array(weight),
            np.array(lists.get("double", zero), float),
            direct=direct,
        )


@lru_cache(maxsize=MAX_CLOCKS)
def _uneven_clock(poles: bytes, steps: bytes, step: float, hold: Hold) -> UnevenClock:
    """What an uneven clock makes of single poles: one log goes through many models."""
    modes = Modes(np.frombuffer(poles, complex), np.ones(len(poles) // 16, complex))
    lengths = np.frombuffer(steps)
    phi, before, now, *_ = modes._coefficients(lengths, step, hold, slice(None))
    return UnevenClock.of(-modes.poles.real, lengths, phi, before, now)
