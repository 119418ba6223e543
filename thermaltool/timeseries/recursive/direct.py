"""One horizon forecast directly, with a part that repeats each revolution."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from thermaltool.timeseries.recursive.arma import BETA, MAX_READING, START_SAMPLES
from thermaltool.timeseries.recursive.least_squares import RecursiveLeastSquares


@dataclass
class DirectForecast:
    """x̂_t(h) = x_t + Σ c_i (x_{t−is} − x_{t−(i+1)s}) + Σ a_k cos kθ_t + b_k sin kθ_t.

    The coefficients are those that forecast h steps best in the least squares, found recursively:
    where the series is no ARMA process of low order (a sum of sinusoids and filtered noise is
    none), this beats the iterated forecast of a fitted one. As only differences enter, a constant
    error is forecast exactly.

    Attributes
    ----------
    horizon : int
        h.
    lags : int
        Number of differences.
    spacing : int
        s; 0 for half the horizon: the series is not expected to be forecast over the time in
        which it turns.
    harmonics : int
        Largest k; 0 for nothing that repeats.
    forgetting : float
    turn : float [rad]
        Angle of the spindle per sample; may change.
    """

    horizon: int
    lags: int = 5
    spacing: int = 0
    harmonics: int = 0
    forgetting: float = 0.999
    turn: float = 0.0
    _angle: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        if self.horizon < 1 or min(self.lags, self.spacing, self.harmonics) < 0:
            raise ValueError("a horizon is at least 1, lags, spacing and harmonics at least 0")
        self.spacing = self.spacing or max(self.horizon // 2, 1)
        self._size = self.lags + 2 * self.harmonics
        if not self._size:
            raise ValueError("nothing to forecast from: no lags and no harmonics")
        self._rls: RecursiveLeastSquares | None = None
        self._one = 1.0  # amplitude of the harmonics, of the size of the differences
        self._squares = 0.0
        self._learnt = 0
        self.forget_lags()

    def forget_lags(self) -> None:
        self._x: deque[float] = deque(maxlen=self.lags * self.spacing + 1)
        # what was known h samples ago, with its x
        self._past: deque[tuple[list[float], float] | None] = deque(
            [None] * self.horizon, self.horizon
        )
        self._now: tuple[list[float], float] | None = None

    @property
    def theta(self) -> list[float]:
        """Coefficients of the regression."""
        return self._rls.theta if self._rls else [0.0] * self._size

    def update(self, x: float) -> None:
        """Take a sample; one beyond `MAX_READING` counts as missing."""
        if not -MAX_READING < x < MAX_READING:
            self.miss()
            return
        self._turn()
        self._x.appendleft(x)
        before = self._past[0]
        if before is not None:
            self._learn(*before, x)
        self._remember(x)

    def miss(self) -> None:
        """A sample that did not come: the last one stands in, and nothing is learnt from it."""
        self._turn()
        if self._x:
            self._x.appendleft(self._x[0])
        self._past.append(None)
        if len(self._x) == self._x.maxlen:
            self._now = self._regressors(), self._x[0]

    def ahead(self, steps: int) -> float | None:
        """x̂(h); `steps` has to be h. None until there is enough learnt."""
        if steps != self.horizon:
            raise ValueError(f"forecasts {self.horizon} steps, not {steps}")
        if self._now is None or self._rls is None or self._learnt < 2 * self._size:
            return None
        phi, x = self._now
        return x + sum(t * value for t, value in zip(self._rls.theta, phi, strict=True))

    def _turn(self) -> None:
        self._angle = (self._angle + self.turn) % (2 * math.pi)

    def _regressors(self) -> list[float]:
        x, s = self._x, self.spacing
        phi = [x[i * s] - x[(i + 1) * s] for i in range(self.lags)]
        for k in range(1, self.harmonics + 1):
            phi += [self._one * math.cos(k * self._angle), self._one * math.sin(k * self._angle)]
        return phi

    def _remember(self, x: float) -> None:
        self._now = (self._regressors(), x) if len(self._x) == self._x.maxlen else None
        self._past.append(self._now)

    def _learn(self, phi: list[float], base: float, x: float) -> None:
        if self._rls is None:
            self._squares += (x - base) ** 2
            self._learnt += 1
            square = self._squares / (self._learnt + 1)
            if self._learnt >= START_SAMPLES and square > MAX_READING**-2:
                self._rls = RecursiveLeastSquares(self._size, BETA / square, self.forgetting)
                self._one = math.sqrt(square)
                self._learnt = 0
                self._past.extend([None] * self.horizon)
            return
        error = x - base - sum(t * v for t, v in zip(self._rls.theta, phi, strict=True))
        self._rls.update(phi, error)
        self._learnt += 1
