"""AR and ARMA models followed sample by sample, and their forecasts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from thermaltool.timeseries.recursive.least_squares import RecursiveLeastSquares
from thermaltool.timeseries.recursive.straight import forecast_function

if TYPE_CHECKING:
    from thermaltool.timeseries.model import ArmaModel

# The source's P(0) = βI has β = 10 Σx²/(N + 1) for "large N". That has the unit of x², where P
# has that of 1/x²: it is taken for a series of mean square 1 and scaled to the one at hand.
BETA = 10.0
# Samples whose mean square (with an intercept: variance) sets that scale; then learning begins.
START_SAMPLES = 20
# Beyond this, squares of products would overflow: no reading of anything.
MAX_READING = 1e60
MIN_SQUARE = MAX_READING**-2
# Work and memory grow with the square of the order.
MAX_COEFFICIENTS = 200
# After so many refused samples in a row the level has changed, and is followed.
MAX_REFUSED = 3
# A moving average that is not invertible is drawn in by this factor per lag until it is.
SHRINK_PER_LAG = 0.95


class RecursiveForecast(NamedTuple):
    """Means x̂(1..steps) and the variances of their errors."""

    mean: list[float]
    variance: list[float]


def is_invertible(ma: Sequence[float]) -> bool:
    """Whether 1 + Σ ma_j z^j has no root on or inside the unit circle (step-down recursion)."""
    row = list(ma)
    while row:
        k = row.pop()
        if not -1 < k < 1:
            return False
        row = [(c - k * r) / (1 - k * k) for c, r in zip(row, reversed(row), strict=True)]
    return True


@dataclass
class RecursiveArma:
    """x_t = c + Σ ar_i x_{t−i} + a_t + Σ ma_j a_{t−j} by extended least squares.

    The unknown a's among the regressors are the errors a posteriori (Ljung and Söderström, Theory
    and Practice of Recursive Identification, 1983, sec. 2.2.3 and 3.7), which are computed with an
    invertible moving average always: one that is not is drawn in.

    Attributes
    ----------
    p, q : int
        At least one above 0.
    intercept : bool
        Whether c is estimated, about the mean of the first samples; else it is 0.
    forgetting : float
        λ; memory of 1/(1 − λ) samples.
    gate : float
        A sample whose error is above this many standard deviations counts as missing, up to
        `MAX_REFUSED` in a row.
    refused : int
        Samples in a row that the gate has kept out.
    """

    p: int
    q: int = 0
    intercept: bool = True
    forgetting: float = 0.999
    gate: float = math.inf
    refused: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        if self.p < 0 or self.q < 0 or not self.p + self.q:
            raise ValueError(f"no model of order {self.p},{self.q}")
        if not 0 < self.forgetting <= 1:
            raise ValueError(f"forgetting factor {self.forgetting:g} is not above 0 and at most 1")
        if self.p + self.q > MAX_COEFFICIENTS:
            raise ValueError(
                f"a model of order {self.p},{self.q} is followed in no reasonable time: "
                f"at most {MAX_COEFFICIENTS} coefficients"
            )
        self._forecast = forecast_function(self.p, self.q)
        self._size = self.p + self.q + self.intercept
        self._start: list[float] = []
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._rls: RecursiveLeastSquares | None = None
        self._origin = 0.0  # lags count from here
        self._one = 0.0  # the regressor of c, of the size of the lags
        self._heard = 0
        self._squares = 0.0
        self._loss = self._weight = 0.0  # Σ λ^(t−k) a², Σ λ^(t−k)
        self.forget_lags()

    def begin(self, model: ArmaModel, samples: float) -> None:
        """Start from a model that was fitted to so many samples, with orders p and q.

        Raises ValueError where the orders differ.
        """
        ar, ma = list(map(float, model.ar)), list(map(float, model.ma))
        if (len(ar), len(ma)) != (self.p, self.q):
            raise ValueError(
                f"model of order {len(ar)},{len(ma)} for a recursion of {self.p},{self.q}"
            )
        self._origin = float(model.mean)
        self._one = math.sqrt(model.sigma2) or 1.0
        self._start = [*ar, *ma, *([0.0] if self.intercept else [])]
        # a model fitted to n samples knows its parameters as well as the last 1/(1−λ) would tell
        samples = min(samples, 1 / (1 - self.forgetting)) if self.forgetting < 1 else samples
        beta = 1 / (samples * self._one**2)
        self._rls = RecursiveLeastSquares(self._size, beta, self.forgetting, self._start)
        self._weight, self._loss = samples, samples * model.sigma2

    def forget_lags(self) -> None:
        """Start anew with the lags, after a gap; what was learnt stays."""
        self._x: list[float] = []
        self._a = [0.0] * self.q

    @property
    def ready(self) -> bool:
        """Whether there is a forecast."""
        if self._rls is None:
            return self._heard >= START_SAMPLES
        return len(self._x) >= self.p and self._weight > self._size + 1

    @property
    def ar(self) -> list[float]:
        """AR coefficients."""
        return self._theta[: self.p]

    @property
    def ma(self) -> list[float]:
        """MA coefficients."""
        return self._theta[self.p : self.p + self.q]

    @property
    def constant(self) -> float:
        """c [unit of x]."""
        c = self._theta[-1] * self._one if self.intercept else 0.0
        return c + self._origin * (1 - sum(self.ar))

    @property
    def sigma2(self) -> float:
        """Variance of a, with the degrees of freedom that the parameters take [unit of x²]."""
        return self._loss / (self._weight - self._size) if self._weight > self._size else 0.0

    @property
    def _theta(self) -> list[float]:
        return self._rls.theta if self._rls else [0.0] * self._size

    def update(self, x: float) -> float:
        """Take a sample; returns its error against the forecast (x itself where there is none).

        A sample that is not finite, or beyond `MAX_READING`, counts as missing and gives 0.
        """
        if not -MAX_READING < x < MAX_READING:
            self.miss()
            return 0.0
        rls, lags = self._rls, self._x
        if rls is None:
            self._learn_scale(x)
            return x
        x -= self._origin
        if len(lags) < self.p:
            self._push(x, 0.0)
            return x
        phi = [*lags, *self._a, self._one] if self.intercept else lags + self._a
        error = x
        for t, value in zip(rls.theta, phi, strict=True):
            error -= t * value
        if error * error > self.gate * self.gate * self.sigma2 and self._refuse():
            return error
        self.refused = 0
        after = rls.update(phi, error)
        self._loss = self.forgetting * self._loss + error * after
        self._weight = self.forgetting * self._weight + 1.0
        if self.q:
            after = self._invertible(rls, phi, x, after)
            self._a.insert(0, after)
            self._a.pop()
        if self.p:
            lags.insert(0, x)
            lags.pop()
        return error

    def miss(self) -> None:
        """A sample that did not come: its forecast stands in for it, and nothing is learnt."""
        if self._rls is None or len(self._x) < self.p:
            self.forget_lags()
            return
        mean, _ = self._forecast(self._x, self._a, self._full(), self._one, 0.0, 1)
        if -MAX_READING < mean[0] < MAX_READING:
            self._push(mean[0], 0.0)
        else:
            self.forget_lags()

    def forecast(self, steps: int) -> RecursiveForecast:
        """x̂(1) to x̂(steps) by conditional expectation; to be asked for when `ready`.

        The variances hold for known parameters. Of a series that has never changed, its value.
        """
        origin = self._origin
        if self._rls is None:
            return RecursiveForecast([origin] * steps, [0.0] * steps)
        mean, variance = self._forecast(
            self._x, self._a, self._full(), self._one, self.sigma2, steps
        )
        return RecursiveForecast([origin + value for value in mean] if origin else mean, variance)

    def ahead(self, steps: int) -> float | None:
        """x̂(steps); None where there is no forecast."""
        return self.forecast(steps).mean[-1] if self.ready else None

    def _full(self) -> list[float]:
        return self._theta if self.intercept else [*self._theta, 0.0]

    def _learn_scale(self, x: float) -> None:
        """Take one of the first samples; learning begins when enough of them have changed."""
        self._heard += 1
        step = x - self._origin
        if self.intercept:
            self._origin += step / self._heard
        self._squares += step * (x - self._origin)
        if self._heard < START_SAMPLES or not self._squares:
            return
        square = self._squares / (self._heard + 1)
        if square > MIN_SQUARE:
            self._one = math.sqrt(square)
            self._rls = RecursiveLeastSquares(
                self._size, BETA / square, self.forgetting, list(self._start)
            )

    def _push(self, x: float, a: float) -> None:
        self._x = [x, *self._x][: self.p]
        self._a = [a, *self._a][: self.q]

    def _refuse(self) -> bool:
        """Keep a sample out; after too many in a row learn anew, from the dynamics known so far."""
        if self._weight < START_SAMPLES:
            return False
        self.refused += 1
        if self.refused > MAX_REFUSED:
            self.refused = 0
            self._start = [*self.ar, *self.ma, *([0.0] if self.intercept else [])]
            self._begin_anew()
        else:
            self.miss()
        return True

    def _invertible(
        self, rls: RecursiveLeastSquares, phi: Sequence[float], x: float, after: float
    ) -> float:
        """The error a posteriori, of a moving average that has been drawn in where need be."""
        ma = rls.theta[self.p : self.p + self.q]
        if is_invertible(ma):
            return after
        while not is_invertible(ma):
            ma = [m * SHRINK_PER_LAG ** (j + 1) for j, m in enumerate(ma)]
        rls.theta[self.p : self.p + self.q] = ma
        return x - sum(t * value for t, value in zip(rls.theta, phi, strict=True))
