"""Responses of a machine that has come to lose heat at another rate than at its calibration."""

from __future__ import annotations

from dataclasses import fields, make_dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.responses import CHANGED, Response, response_class
from thermaltool.responses.modes import Complex, Float, Modes

# Of a response without a clock of its own, samples in the time constant that has changed.
FINE = 500.0
# A mode, be it slower than the time constant that is told, keeps this part of its rate.
LEAST_RATE = 0.1


class LosingHeat:
    """A response whose modes decay faster by a rate r, as where x' = A x + B u − r x.

    What enters as heat enters as before: residues stay, and the gain falls. Where what is lost goes
    to the drive, a room, the gain of each mode stays. Of bodies that lose heat by other rates than
    they store it, to first order, fast modes decay faster by another rate than slow ones, and both
    come to weigh more or less. A mode of the rate λ is as fast as 1 − 1/(λτ) says: what cancels
    between modes that are near each other still does.

    Attributes
    ----------
    loss_rate, loss_fast_rate : float [1/s]
        By which slow and fast modes decay faster; below 0 slower.
    loss_time_constant : float [s]
        τ, the slowest one that mattered before.
    loss_slow, loss_fast : float
        By which part slow and fast modes have come to weigh more; not of a room.
    loss_to_drive : float
        1 where the drive is what heat is lost to, and 0 where it is not.
    """

    kind: ClassVar[str]
    before: ClassVar[Any]  # class of the response before
    searched: ClassVar[tuple[str, ...]]
    gains: ClassVar[tuple[str, ...]]
    fixed: ClassVar[dict[str, float]]
    loss_rate: float
    loss_fast_rate: float
    loss_time_constant: float
    loss_slow: float
    loss_fast: float
    loss_to_drive: float

    def __post_init__(self) -> None:
        if not 0 < self.loss_time_constant < np.inf:
            raise ModelError(f"{self.kind} needs a time constant above zero")
        _ = self.before_loss

    @cached_property
    def before_loss(self) -> Any:
        """The response before the change."""
        return self.before(**{each.name: getattr(self, each.name) for each in fields(self.before)})

    @cached_property
    def _fine(self) -> Modes:
        return self.modes(self.loss_time_constant / FINE)

    def modes(self, dt: float) -> Modes:
        """Those from before, which decay otherwise.

        Parameters
        ----------
        dt : float [s]
        """
        modes: Modes = self.before_loss.modes(dt)
        rates = -modes.poles.real
        rises, slope = self._rises(rates)
        poles = modes.poles - rises
        fast, faster = self._fast(rates)
        weight: Any = 1.0 + self.loss_slow + (self.loss_fast - self.loss_slow) * fast
        by_rate = (self.loss_fast - self.loss_slow) * faster
        if self.loss_to_drive:
            moves = modes.poles != 0
            before = np.where(moves, modes.poles, 1.0)
            weight = np.where(moves, poles / before, 1.0)
            by_rate = np.where(moves, (slope * rates - rises) / before.real**2, 0.0)
        # A double pole is two that are near each other.
        weights = weight * modes.weights - modes.double * by_rate
        double = weight.real * modes.double * (1.0 + slope)
        return replace(modes, poles=poles, weights=weights, double=double)

    def _fast(self, rates: Float) -> tuple[Float, Float]:
        """How fast modes are, 0 at the slowest that mattered and 1 far above, and its slope."""
        times = np.maximum(rates * self.loss_time_constant, 1.0)
        return 1.0 - 1.0 / times, np.where(times > 1.0, self.loss_time_constant / times**2, 0.0)

    def _rises(self, rates: Float) -> tuple[Float, Float]:
        """By how much modes of these rates decay faster [1/s], and its slope."""
        # No mode comes to be slower than one that was.
        most = max(self.loss_fast_rate - self.loss_rate, -1.0 / self.loss_time_constant)
        fast, slope = self._fast(rates)
        rises, least = self.loss_rate + most * fast, (LEAST_RATE - 1.0) * rates
        held = rises < least
        return np.where(held, least, rises), np.where(held, LEAST_RATE - 1.0, most * slope)

    def transfer(self, s: Complex) -> Complex:
        """H at complex frequencies, of its modes.

        Parameters
        ----------
        s : ndarray, any shape, complex [rad/s]
        """
        return self._fine.transfer(s)

    def step(self, t: Float) -> Float:
        """Unit-step response, of its modes; zero before t = 0.

        Parameters
        ----------
        t : ndarray, any shape [s]
        """
        return self._fine.step(t)

    def dc_gain(self) -> float:
        """H(0)."""
        return self._fine.dc_gain()

    def slowest(self) -> float:
        """Slowest time constant [s]."""
        return self.changed(self.before_loss.slowest())

    def changed(self, time_constant: float) -> float:
        """What a time constant from before has become [s].

        Parameters
        ----------
        time_constant : float [s]
        """
        if not time_constant:  # of what stands for no body
            return 0.0
        rates = np.array([1.0 / time_constant])
        return float(1.0 / (rates + self._rises(rates)[0])[0])

    @classmethod
    def search_box(cls, period: float, duration: float, **fixed: float) -> dict[str, Any]:
        """Where a fit of the kind from before looks.

        Parameters
        ----------
        period, duration : float [s]
        **fixed : float
        """
        return dict(cls.before.search_box(period, duration, **cls._known(fixed)))

    @classmethod
    def starts(cls, period: float, duration: float, **fixed: float) -> list[tuple[float, ...]]:
        """Where a fit of the kind from before starts.

        Parameters
        ----------
        period, duration : float [s]
        **fixed : float
        """
        return list(cls.before.starts(period, duration, **cls._known(fixed)))

    @classmethod
    def _known(cls, fixed: dict[str, float]) -> dict[str, float]:
        return {name: value for name, value in fixed.items() if name in cls.before.fixed}


def before_loss(response: Response) -> Any:
    """What a response was before its machine came to lose heat otherwise; itself where it did not.

    Parameters
    ----------
    response : Response
    """
    return response.before_loss if isinstance(response, LosingHeat) else response


@lru_cache
def losing_kind(before: Any) -> Any:
    """The class of a kind of response where heat has come to be lost otherwise.

    Parameters
    ----------
    before : class of a response
    """
    fixed = {
        **before.fixed,
        "loss_rate": 0.0,
        "loss_fast_rate": 0.0,
        "loss_time_constant": 1.0,
        "loss_slow": 0.0,
        "loss_fast": 0.0,
        "loss_to_drive": 0.0,
    }
    names = dict.fromkeys((*(each.name for each in fields(before)), *fixed))
    return make_dataclass(
        before.kind + CHANGED,
        [(name, Any) for name in names],
        bases=(LosingHeat,),
        frozen=True,
        namespace={
            "__doc__": f"{before.kind} of a machine that loses heat otherwise; see `LosingHeat`.",
            "__module__": __name__,
            "kind": before.kind + CHANGED,
            "before": before,
            "searched": before.searched,
            "gains": before.gains,
            "fixed": fixed,
        },
    )


def losing(
    response: Response,
    rates: tuple[float, float],
    time_constant: float,
    weights: tuple[float, float] = (0.0, 0.0),
    to_drive: bool = False,
) -> Response:
    """A response where heat has come to be lost otherwise; see `LosingHeat`.

    Parameters
    ----------
    response : Response
        One that has changed before has both changes.
    rates : (float, float) [1/s]
        By which slow and fast modes decay faster.
    time_constant : float [s]
    weights : (float, float)
        By which part slow and fast modes weigh more.
    to_drive : bool
    """
    before = before_loss(response)
    (slow, fast), (slower, faster) = weights, rates
    if isinstance(response, LosingHeat):
        slower, faster = response.loss_rate + slower, response.loss_fast_rate + faster
        slow = (1.0 + response.loss_slow) * (1.0 + slow) - 1.0
        fast = (1.0 + response.loss_fast) * (1.0 + fast) - 1.0
        time_constant = response.loss_time_constant
    kind = losing_kind(before.__class__)
    known = {each.name: getattr(before, each.name) for each in fields(before)}
    found: Response = kind(
        **known,
        loss_rate=slower,
        loss_fast_rate=faster,
        loss_time_constant=time_constant,
        loss_slow=slow,
        loss_fast=fast,
        loss_to_drive=float(to_drive),
    )
    return found


def losing_alike(response: Response, other: Response) -> Response:
    """A response that goes with another one, where that one has changed; else as it is.

    Parameters
    ----------
    response, other : Response
    """
    if not isinstance(other, LosingHeat):
        return response
    rates, weights = (
        (other.loss_rate, other.loss_fast_rate),
        (other.loss_slow, other.loss_fast),
    )
    to_drive = bool(other.loss_to_drive)
    return losing(response, rates, other.loss_time_constant, weights, to_drive)


def __getattr__(name: str) -> Any:
    """Classes by their name, as pickle asks for them."""
    if name.endswith(CHANGED):
        try:
            return response_class(name)
        except ModelError:
            pass
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
