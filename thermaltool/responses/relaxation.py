"""Diffusive responses as sums of real exponentials on a logarithmic grid of rates."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import ModelError, ThermalToolWarning
from thermaltool.laplace.contours import hyperbola_rule, windows
from thermaltool.responses import Response
from thermaltool.responses.modes import Complex, Float, Hold, Modes
from thermaltool.responses.sample_clock import uniform_spans

# Rates a decade: eight follow a step response to a part in 10⁶; a response that starts with zero
# slope and curvature needs ten, and one that loses most of its heat on the way (√a·r of 7 and more)
# up to twenty.
RATES_PER_DECADE, DELAYED_RATES_PER_DECADE, FINE_RATES_PER_DECADE = 8, 10, (14, 20)
# The step response is matched at so many times for each rate, from and to these shares of the
# fastest and the slowest time constant.
TIMES_PER_RATE, FIRST_TIME, LAST_TIME = 6, 0.5, 40.0
# Weights of the steady state, by which gains are judged, and of slope and curvature at the start
# [weight of one time].
STEADY_STATE_WEIGHT, START_WEIGHT = 10.0, 1e3
# Singular values below this share of the largest are rounding.
SINGULAR_TOLERANCE = 1e-14
# A clock of more stretches of one length than this is uneven.
MAX_SPANS = 50
# Below this the first terms of a series are exact to rounding.
SERIES_BELOW = 1e-4
# Largest error of a step response, relative to its largest value.
STEP_TOLERANCE = 3e-5
# Nodes of a contour: good to 1e-11 of the steady state.
CONTOUR_NODES = 28
# Exponentials of so many times at most are kept for the next response: 400 kB.
MAX_KEPT_TIMES = 1000
# The spectrum is fitted from this share of the slowest rate, below which there is nothing, to rates
# of so many samples, of the slowest rate, and of the delay of diffusion; at most to these.
SLOWEST_SHARE = 0.9
FASTEST_OF_SAMPLE, FASTEST_OF_SLOWEST, FASTEST_OF_DELAY = 8.0, 1000.0, 30.0
LIMIT_OF_SAMPLE, LIMIT_OF_SLOWEST = 800.0, 30000.0
# Rates over more decades are those of no machine, and of no matrix of a size to work with.
MAX_DECADES = 30


@dataclass(frozen=True, eq=False)
class RelaxationGrid:
    """Exponentials on a logarithmic grid of rates, and the map from step responses to weights.

    The relaxation spectrum of a diffusive response lies on the negative real axis (for the ring
    source below −aα, Fraser 1997 (5.8)); weights on a grid of rates by least squares follow it to
    a part in 10⁶ at eight rates per decade, and stay of the order of the gain.

    Attributes
    ----------
    rates : ndarray, shape (n,) [1/s]
    times : ndarray, shape (m,) [s]
        Where a step response has to be known.
    """

    rates: Float
    times: Float
    _inverse: Float

    @staticmethod
    @lru_cache(maxsize=64)
    def between(
        slow: float, fast: float, delayed: bool = False, per_decade: int | None = None
    ) -> RelaxationGrid:
        """For rates from `slow` to `fast` [1/s].

        `delayed`: the responses start with zero slope and curvature, as all do that reach the
        probe by diffusion. An inverse amplifies what is left of either.

        Parameters
        ----------
        slow, fast : float [1/s]
        delayed : bool
        per_decade : int, optional
            Rates a decade; those of `delayed` by default.
        """
        per_decade = per_decade or (DELAYED_RATES_PER_DECADE if delayed else RATES_PER_DECADE)
        rates = np.geomspace(slow, fast, int(np.ceil(np.log10(fast / slow) * per_decade)) + 1)
        times = np.geomspace(FIRST_TIME / fast, LAST_TIME / slow, TIMES_PER_RATE * len(rates))
        # The steady state is a row of its own, with weight: gains are judged by it.
        rows = [-np.expm1(-np.outer(times, rates)), np.full((1, len(rates)), STEADY_STATE_WEIGHT)]
        if delayed:
            rows += [START_WEIGHT * (rates[None, :] / fast) ** k for k in (1, 2)]
        inverse = np.linalg.pinv(np.vstack(rows), rcond=SINGULAR_TOLERANCE)
        return RelaxationGrid(rates, times, inverse[:, : len(times) + 1])

    def weights(self, response: Response) -> Float:
        """Σ w (1 − e^(−rate·t)) ≈ step response; shape (n,).

        Parameters
        ----------
        response : Response
        """
        return self.weights_of(response.step(self.times), np.array(response.dc_gain()))

    def weights_of(self, steps: Float, steady: Float) -> Float:
        """`weights` of step responses that are known at `times`; shape (n, ...).

        Parameters
        ----------
        steps : ndarray, shape (m, ...)
        steady : ndarray, shape (...)
            What they end at.
        """
        rows = np.concatenate([steps, STEADY_STATE_WEIGHT * steady[None]])
        return np.asarray(self._inverse @ rows)

    def states(self, time: Float, u: Float, hold: Hold, cooling: Float | None = None) -> Float:
        """Responses of rate/(s + rate), for every rate, to one input from rest.

        Parameters
        ----------
        time, u : ndarray, shape (n_samples,)
        hold : "zero" or "first"
        cooling : ndarray, shape (n_samples,), optional
            Integral Γ of a rate by which all decay faster: x' = rate·(u − x) − Γ'·x.

        Returns
        -------
        ndarray, shape (n_samples, n)
        """
        spans = list(uniform_spans(time))
        if len(spans) > MAX_SPANS or (cooling is not None and np.any(np.diff(cooling))):
            return self._states_uneven(time, u, hold, cooling)
        x = np.zeros((len(time), len(self.rates)))
        bank = Modes((-self.rates).astype(complex), np.ones(len(self.rates), complex))
        for rows, dt in spans:
            one = bank.discretize(dt, hold)
            phi, g0, g1 = np.diag(one.F), one.G0[:, 0] * self.rates, one.G1[:, 0] * self.rates
            for k in range(rows.start, rows.stop - 1):
                x[k + 1] = phi * x[k] + g0 * u[k] + g1 * u[k + 1]
        return x

    def _states_uneven(
        self, time: Float, u: Float, hold: Hold, cooling: Float | None = None
    ) -> Float:
        """`states` where nearly every sample has a length or a decay of its own, all at once."""
        z = np.outer(np.diff(time), self.rates)
        more = np.zeros(len(time) - 1) if cooling is None else np.diff(cooling)
        phi, before = np.exp(-z - more[:, None]), u[:-1]
        if cooling is not None:
            # As `run_with_loss`: what is held acts, on the mean, half a sample later.
            before = before * np.exp(-more / 2 if hold == "zero" else -more)
        if hold == "zero":
            added = -np.expm1(-z) * before[:, None]
        else:
            # Means of e^(−z) over the sample, from a ramp up and a ramp down; by series where the
            # difference would be rounding.
            up = np.where(z > SERIES_BELOW, 1 + np.expm1(-z) / np.maximum(z, SERIES_BELOW),
                          z / 2 - z**2 / 6 + z**3 / 24)  # fmt: skip
            added = (-np.expm1(-z) - up) * before[:, None] + up * u[1:, None]
        x = np.zeros((len(time), len(self.rates)))
        for k in range(len(time) - 1):
            x[k + 1] = phi[k] * x[k] + added[k]
        return x

    def delayed(
        self,
        states: Float,
        time: Float,
        u: Float,
        hold: Hold,
        delay: float,
        cooling: Float | None = None,
    ) -> Float:
        """States as they were `delay` before each row; at rest before the first.

        Parameters
        ----------
        states : ndarray, shape (n_samples, n)
            What `states` gives.
        time, u : ndarray, shape (n_samples,)
        hold : "zero" or "first"
        delay : float [s]
        cooling : ndarray, shape (n_samples,), optional
            As of `states`: what is on its way decays with the rest.

        Returns
        -------
        ndarray, shape (n_samples, n)
        """
        at = time - delay
        row = np.searchsorted(time, at, side="right") - 1
        there = row >= 0
        k = row[there]
        since = (at[there] - time[k])[:, None]
        kept = np.exp(-since * self.rates)
        found = np.zeros_like(states)
        found[there] = kept * states[k] + (1 - kept) * u[k][:, None]
        if hold == "first":
            n = np.minimum(k + 1, len(time) - 1)
            slope = ((u[n] - u[k]) / np.where(n > k, time[n] - time[k], 1.0))[:, None]
            found[there] += slope * (since - (1 - kept) / self.rates)
        if cooling is not None:
            found[there] *= np.exp(cooling[k] - cooling[there])[:, None]
        return found


def diffusive_step(transfer: Callable[[Complex], Complex], t: Float) -> Float:
    """Unit-step response of what comes by diffusion; zero for t ≤ 0.

    H(s)/s is inverted on one contour per window of times. All its singularities lie on the
    negative real axis, so the contour needs no audit.

    Parameters
    ----------
    transfer : callable
        H, of complex frequencies [rad/s].
    t : ndarray, any shape [s]
    """
    t = np.asarray(t, float)
    positive = t[t > 0]
    if positive.size > MAX_KEPT_TIMES:
        inverses, back = _inverses(positive)
    else:
        inverses, back = _kept_inverses(positive.tobytes())
    values = np.empty(positive.shape)
    for window, frequencies, nodes, weights, kernel in inverses:
        terms = transfer(frequencies) / nodes * weights
        values[window] = (kernel @ terms).real
    step = np.zeros(t.shape)
    step[t > 0] = values[back]
    return step


Inverse = tuple[slice, Complex, Complex, Complex, Complex]


def _inverses(t: Float) -> tuple[Iterable[Inverse], NDArray[np.intp]]:
    """Per window of the ascending times: its slice, frequencies, nodes, weights and exponentials.

    And where each of the times stands among them.
    """
    times, back = np.unique(t, return_inverse=True)
    nodes, weights = hyperbola_rule(CONTOUR_NODES)

    def of(window: slice) -> Inverse:
        own = times[window] / (last := times[window][-1])
        return window, nodes / last, nodes, weights, np.exp(np.outer(own, nodes))

    return map(of, windows(times)), back


@lru_cache(maxsize=32)
def _kept_inverses(t: bytes) -> tuple[tuple[Inverse, ...], NDArray[np.intp]]:
    """`_inverses` of a few times: a fit asks many responses for the same ones."""
    inverses, back = _inverses(np.frombuffer(t))
    return tuple(inverses), back


def diffusive_modes(response: Response, slowest: float, delay: float, dt: float) -> Modes:
    """A response by diffusion as exponentials, for samples of `dt` or longer; see `fit_relaxation`.

    Parameters
    ----------
    response : Response
    slowest : float [1/s]
        Its slowest rate.
    delay : float [s]
        Distance² over diffusivity.
    dt : float [s]

    Raises
    ------
    ModelError
        Rates over more than `MAX_DECADES`.
    """
    slow = SLOWEST_SHARE * slowest
    # Fast enough for the sample, and for the delay of diffusion where that is shorter.
    fastest = max(LIMIT_OF_SAMPLE / dt, LIMIT_OF_SLOWEST * slow)
    of_delay = min(FASTEST_OF_DELAY / delay if delay else np.inf, fastest)
    fast = max(FASTEST_OF_SAMPLE / dt, FASTEST_OF_SLOWEST * slow, of_delay)
    if not fast < slow * 10.0**MAX_DECADES:
        raise ModelError(
            f"{response.kind}: rates from {slow:.2g} to {fast:.2g} 1/s are those of no machine"
        )
    return fit_relaxation(response, slow, fast, dt)


def fit_relaxation(response: Response, slow: float, fast: float, dt: float) -> Modes:
    """A response by diffusion as a sum of real exponentials.

    Parameters
    ----------
    response : Response
    slow, fast : float [1/s]
        Ends of the spectrum: below `slow` there is nothing, above `fast` nothing is wanted.
    dt : float [s]
        Shortest sample: what the response does within half of it is not judged.

    Returns
    -------
    Modes
        What is off by more than `STEP_TOLERANCE` is told as a `ThermalToolWarning`: a model that
        was calibrated can always be run.
    """
    # A probe beside the source answers within the sample: there is no delay to keep.
    grids = [(True, None), (False, None), *((True, fine) for fine in FINE_RATES_PER_DECADE)]
    best: tuple[float, Modes] | None = None
    for delayed, per_decade in grids:
        modes, error = _fitted(
            response, RelaxationGrid.between(slow, fast, delayed, per_decade), dt
        )
        if error <= STEP_TOLERANCE:
            return modes
        if best is None or error < best[0]:
            best = error, modes
    assert best is not None
    warnings.warn(
        f"{response.kind}: its exponentials follow it to {best[0]:.1e} of its largest value only: "
        "hardly any of the heat arrives, so that its parameters mean little",
        ThermalToolWarning,
        stacklevel=2,
    )
    return best[1]


def _fitted(response: Response, grid: RelaxationGrid, dt: float) -> tuple[Modes, float]:
    """Exponentials on a grid, and their largest error as a share of the largest value."""
    target = response.step(grid.times)
    weights = grid.rates * grid.weights(response)
    modes = Modes((-grid.rates).astype(complex), weights.astype(complex))
    judged = np.abs(modes.step(grid.times) - target)[grid.times >= min(dt / 2, grid.times[-1])]
    largest = float(np.max(np.abs(target)))
    return modes, float(np.max(judged)) / largest if largest else 0.0
