"""Responses of a machine that has come to lose heat at another rate than at its calibration."""

from __future__ import annotations

from dataclasses import fields, make_dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.responses import Response, response_class
from thermaltool.responses.modes import Complex, Float, Modes

# What is behind the name of the kind that has changed.
SUFFIX = "_loss"
# Of a response without a clock of its own, samples in the time constant that has changed.
FINE = 500.0
# A mode, be it slower than the time constant that is told, keeps this part of its rate.
LEAST_RATE = 0.1


class LosingHeat:
    """A response whose modes decay faster by r = (f − 1)/τ, as where x' = A x + B u − r x.

    What enters as heat enters as before: residues stay, and the gain falls. Where what is lost goes
    to the drive, a room, the gain stays and residues rise. Of bodies that lose heat by other rates
    than they store it, to first order, rates change by r of the slow modes and by q·r of the fast
    ones, and weights by a share each. A mode of the rate λ is as fast as 1 − 1/(λτ) says: what
    cancels between modes that are near each other still does.

    Attributes
    ----------
    loss_factor : float
        f, by what factor heat is lost faster; below 1 slower.
    loss_time_constant : float [s]
        τ, the slowest one that mattered before.
    loss_ratio : float
        q, by how much more the rates of fast modes change.
    loss_slow, loss_fast : float
        By which share slow and fast modes have come to weigh more.
    loss_to_drive : float
        1 where the drive is what heat is lost to, and 0 where it is not.
    """

    kind: ClassVar[str]
    before: ClassVar[Any]  # class of the response before
    searched: ClassVar[tuple[str, ...]]
    gains: ClassVar[tuple[str, ...]]
    fixed: ClassVar[dict[str, float]]
    loss_factor: float
    loss_time_constant: float
    loss_ratio: float
    loss_slow: float
    loss_fast: float
    loss_to_drive: float

    def __post_init__(self) -> None:
        if not (0 < self.loss_factor < np.inf and 0 < self.loss_time_constant < np.inf):
            raise ModelError(f"{self.kind} needs a factor and a time constant above zero")
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
        share = self.loss_slow + (self.loss_fast - self.loss_slow) * self._fast(rates)
        changed = replace(
            modes, poles=modes.poles - self._rise(rates), weights=(1.0 + share) * modes.weights
        )
        gain = changed.dc_gain() - changed.direct
        if not self.loss_to_drive or not gain:
            return changed
        kept = (modes.dc_gain() - modes.direct) / gain
        return replace(changed, weights=kept * changed.weights, double=kept * changed.double)

    def _fast(self, rates: Float) -> Float:
        """How fast modes of these rates are: 0 at the slowest that mattered, 1 far above it."""
        return np.maximum(1.0 - 1.0 / np.maximum(rates * self.loss_time_constant, 1.0), 0.0)

    def _rise(self, rates: Float) -> Float:
        """By how much modes of these rates decay faster [1/s]."""
        rate = (self.loss_factor - 1.0) / self.loss_time_constant
        rises = rate * (1.0 + (self.loss_ratio - 1.0) * self._fast(rates))
        return np.maximum(rises, (LEAST_RATE - 1.0) * rates)

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
        rate = np.array([1.0 / time_constant])
        return float(1.0 / (rate + self._rise(rate))[0])

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


@lru_cache
def losing_kind(before: Any) -> Any:
    """The class of a kind of response where heat has come to be lost otherwise.

    Parameters
    ----------
    before : class of a response
    """
    fixed = {
        **before.fixed,
        "loss_factor": 1.0,
        "loss_time_constant": 1.0,
        "loss_ratio": 1.0,
        "loss_slow": 0.0,
        "loss_fast": 0.0,
        "loss_to_drive": 0.0,
    }
    names = dict.fromkeys((*(each.name for each in fields(before)), *fixed))
    return make_dataclass(
        before.kind + SUFFIX,
        [(name, Any) for name in names],
        bases=(LosingHeat,),
        frozen=True,
        namespace={
            "__doc__": f"{before.kind} of a machine that loses heat otherwise; see `LosingHeat`.",
            "__module__": __name__,
            "kind": before.kind + SUFFIX,
            "before": before,
            "searched": before.searched,
            "gains": before.gains,
            "fixed": fixed,
        },
    )


def losing(
    response: Response,
    factor: float,
    time_constant: float,
    ratio: float,
    shares: tuple[float, float],
    to_drive: bool,
) -> Response:
    """A response where heat has come to be lost otherwise; see `LosingHeat`.

    Parameters
    ----------
    response : Response
        One that has changed before has both changes.
    factor : float
    time_constant : float [s]
    ratio : float
    shares : (float, float)
        Of slow and of fast modes.
    to_drive : bool
    """
    before: Any = response
    slow, fast = shares
    if isinstance(response, LosingHeat):
        before, first = response.before_loss, response
        rises = first.loss_factor - 1.0, (factor - 1.0) * first.loss_time_constant / time_constant
        factor, time_constant = 1.0 + sum(rises), first.loss_time_constant
        ratio = (rises[0] * first.loss_ratio + rises[1] * ratio) / (sum(rises) or 1.0)
        slow = (1.0 + first.loss_slow) * (1.0 + slow) - 1.0
        fast = (1.0 + first.loss_fast) * (1.0 + fast) - 1.0
    kind = losing_kind(before.__class__)
    known = {each.name: getattr(before, each.name) for each in fields(before)}
    found: Response = kind(
        **known,
        loss_factor=factor,
        loss_time_constant=time_constant,
        loss_ratio=ratio,
        loss_slow=slow,
        loss_fast=fast,
        loss_to_drive=float(to_drive),
    )
    return found


def __getattr__(name: str) -> Any:
    """Classes by their name, as pickle asks for them."""
    if not name.endswith(SUFFIX):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return response_class(name)
