"""What a person asks of a response: gain, time constants, oscillations, delay, with intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermaltool.effects.convection_state import ConvectionState
from thermaltool.errors import ModelError
from thermaltool.model.document import Model, Term
from thermaltool.responses import Response
from thermaltool.responses.losing import LosingHeat, before_loss
from thermaltool.signals.covariance_root import covariance_root
from thermaltool.signals.intervals import Estimate, log_normal_estimate, normal_estimate
from thermaltool.units import parse_channel, per, printed

# Step of a derivative, as a share of the parameter.
STEP = 1e-4


@dataclass(frozen=True)
class OscillatoryMode:
    """A pair of complex poles: 2π/ω [s], and its damping ratio ζ."""

    period: Estimate
    damping: Estimate


@dataclass(frozen=True)
class Characteristics:
    """One drive's effect on one output.

    Attributes
    ----------
    drive, output, kind : str
    gain : Estimate
        Steady state of the output per unit of the drive, with its 95 % interval.
    time_constants : tuple of Estimate [s]
        The slowest first; of a diffusive response the slowest alone, of oscillations none.
    oscillations : tuple of OscillatoryMode
        The slowest first.
    delay : Estimate [s]
    """

    drive: str
    output: str
    kind: str
    gain: Estimate
    time_constants: tuple[Estimate, ...]
    oscillations: tuple[OscillatoryMode, ...]
    delay: Estimate

    @property
    def may_be_zero(self) -> bool:
        """Whether the interval of the gain holds zero."""
        return self.gain.low <= 0 <= self.gain.high

    def document(self) -> dict[str, Any]:
        """As JSON: each number with the ends of its interval."""
        found = {
            "drive": self.drive,
            "output": self.output,
            "kind": self.kind,
            "gain": _ends(self.gain),
            "gain_unit": self.gain.unit,
            "time_constants_s": [_ends(each) for each in self.time_constants],
            "delay_s": self.delay.value,
        }
        if self.delay.high > self.delay.low:
            found["delay_interval_s"] = [self.delay.low, self.delay.high]
        if self.oscillations:
            found["oscillations"] = [
                {"period_s": _ends(each.period), "damping": _ends(each.damping)}
                for each in self.oscillations
            ]
        return found


def characteristics(term: Term, rate: float = 0.0) -> Characteristics:
    """Static gain, time constants, oscillations and delay of a term.

    Parameters
    ----------
    term : Term
        Without a covariance the intervals have no width.
    rate : float, optional [1/s]
        By which all modes decay faster: K becomes K/(1 + r·τ), and τ becomes τ/(1 + r·τ).
    """
    unit = printed(per(parse_channel(term.output).unit, parse_channel(term.drive).unit))
    response: Any = term.response
    delays = hasattr(response, "delay")

    def gain(each: Any) -> float:
        return float(each.transfer(np.array([rate + 0j]))[0].real) if rate else each.dc_gain()

    def faster(of: Callable[[Any], float]) -> Callable[[Any], float]:
        return (lambda each: 1 / (1 / of(each) + rate)) if rate else of

    return Characteristics(
        term.drive,
        term.output,
        response.kind,
        normal_estimate(gain(response), _error(term, gain), unit),
        _slowest_first(_positive(term, faster(of), "s") for of in _time_constants(response)),
        tuple(_oscillations(term)),
        normal_estimate(
            response.delay if delays else 0.0,
            _error(term, attrgetter("delay")) if delays else 0.0,
            "s",
        ),
    )


@dataclass(frozen=True)
class OperatingPoint:
    """A level at which a response is told, and by how much all modes decay faster there.

    Attributes
    ----------
    channel : str
        Whose level it is; empty where the response goes by none.
    level : float [unit of the channel]
    rate : float [1/s]
    """

    channel: str = ""
    level: float = 0.0
    rate: float = 0.0


def operating_points(model: Model, term: Term) -> tuple[OperatingPoint, ...]:
    """Where a term is told: at the level of its band, or at each at which heat is lost faster.

    Parameters
    ----------
    model : Model
    term : Term

    Returns
    -------
    tuple of OperatingPoint
        One without a channel where the term goes by no level.
    """
    tables = [
        (effect.channel, effect.table)
        for effect in model.effects
        if isinstance(effect, ConvectionState) and not effect.log and effect.table is not None
    ]
    if term.band is None:
        return tuple(
            OperatingPoint(channel, level, rate)
            for channel, table in tables[:1]
            for level, rate in zip(*table, strict=True)
        ) or (OperatingPoint(),)
    channel, level = term.band.channel, term.band.levels[term.band.index]
    rest = {d.channel: d.reference for d in model.drives}.get(channel, 0.0)
    at = level + (0.0 if isinstance(rest, str) else rest)
    rates = (float(np.interp(at, *table)) for own, table in tables if own == channel)
    return (OperatingPoint(channel, level, sum(rates)),)


def at_operating_points(model: Model) -> list[tuple[Term, OperatingPoint, Characteristics]]:
    """Characteristics of all terms at all their operating points.

    Without intervals where a rate acts at a level that the term has not been fitted at: that of
    the rate is not among the term's own.

    Parameters
    ----------
    model : Model
    """
    found = []
    for term in model.terms:
        for point in operating_points(model, term):
            found.append((term, point, characteristics(with_known_spread(term, point), point.rate)))
    return found


def with_known_spread(term: Term, point: OperatingPoint) -> Term:
    """The term, without its covariance where a rate acts at a level that it has no fit at.

    Parameters
    ----------
    term : Term
    point : OperatingPoint
    """
    return replace(term, covariance=None) if point.rate and term.band is None else term


def step_at_rate(response: Response, time: NDArray[Any], rate: float) -> NDArray[Any]:
    """Unit step response where all modes decay faster by a rate: ∫ h(τ) exp(−rτ) dτ.

    Parameters
    ----------
    response : Response
    time : ndarray, shape (n,) [s]
        From 0 on, so fine that a straight line joins the step response at them.
    rate : float [1/s]
    """
    step = np.asarray(response.step(time))
    if not rate:
        return step
    slowed = step * np.exp(-rate * time)
    areas = np.diff(time) * (slowed[1:] + slowed[:-1]) / 2
    return slowed + rate * np.append(0.0, np.cumsum(areas))


def deviations(term: Term, of: Callable[[Any], NDArray[Any]]) -> NDArray[Any]:
    """Derivatives of an array that a response gives, times the root of the parameters' covariance.

    Sums of squares over the last axis are variances, to first order.

    Parameters
    ----------
    term : Term
    of : callable
        Takes a response, gives an ndarray of shape (n,).

    Returns
    -------
    ndarray, shape (n, p)
        Without a covariance p is 0.
    """
    response: Any = term.response
    empty = np.asarray(of(response))[..., None][..., :0]
    if term.covariance is None or not term.covariance_names:
        return empty
    root = covariance_root(term.covariance)
    slopes = [_slope(response, name, of) for name in term.covariance_names]
    return np.asarray(np.stack(slopes, axis=-1) @ root)


def _slope(response: Any, name: str, of: Callable[[Any], NDArray[Any]]) -> NDArray[Any]:
    """Derivative in a parameter, by a central difference; one-sided at the end of its range."""
    value = getattr(response, name)
    # Far below the spread: parameters that are not identified one by one stay in their range.
    step = STEP * abs(value) or STEP
    ends = []
    for end in (value + step, value - step):
        try:
            ends.append((end, of(replace(response, **{name: end}))))
        except ModelError:
            ends.append((value, of(response)))
    (high, ahead), (low, behind) = ends
    return np.asarray((ahead - behind) / (high - low))


def _error(term: Term, of: Callable[[Any], float]) -> float:
    """Standard error of a number of a response; 0 without a covariance."""
    return float(np.linalg.norm(deviations(term, lambda response: np.array([of(response)]))))


def _positive(term: Term, of: Callable[[Any], float], unit: str) -> Estimate:
    value = of(term.response)
    return log_normal_estimate(value, _error(term, of) / value, unit)


def _slowest_first(found: Iterator[Estimate]) -> tuple[Estimate, ...]:
    return tuple(sorted(found, key=lambda each: -each.value))


def _time_constants(response: Any) -> Iterator[Callable[[Any], float]]:
    """What gives each time constant of a response."""
    if isinstance(response, LosingHeat):
        for of in _time_constants(response.before_loss):
            yield partial(_since_change, of)
    elif response.kind.startswith(("rational", "oscillation")):
        yield from (attrgetter(name) for name in response.searched if name.startswith("tau"))
    elif response.kind.endswith("deflection"):
        yield from (partial(_inverse, name) for name in response.searched)
    else:
        yield lambda each: float(each.slowest())


def _since_change(of: Callable[[Any], float], response: LosingHeat) -> float:
    """What a time constant has become where heat has come to be lost otherwise [s]."""
    return response.changed(of(response.before_loss))


def _oscillations(term: Term) -> Iterator[OscillatoryMode]:
    response, before = term.response, before_loss(term.response)
    names = [name for name in before.searched if name.startswith("omega")]
    for name in sorted(names, key=lambda each: float(getattr(before, each))):
        pair = partial(_pair, name)
        damping = normal_estimate(_damping(pair, response), _error(term, partial(_damping, pair)))
        yield OscillatoryMode(_positive(term, partial(_period, pair), "s"), damping)


def _pair(name: str, response: Any) -> tuple[float, float]:
    """Natural frequency [rad/s] and damping ratio of a pair of poles."""
    before = before_loss(response)
    omega = float(getattr(before, name))
    zeta = float(getattr(before, name.replace("omega", "zeta")))
    if before is response:
        return omega, zeta
    rate = 1.0 / response.changed(1.0 / (zeta * omega))
    frequency = float(np.hypot(rate, omega * np.sqrt(1.0 - zeta**2)))
    return frequency, rate / frequency


def _damping(pair: Callable[[Any], tuple[float, float]], response: Any) -> float:
    """Damping ratio of a pair of poles."""
    return pair(response)[1]


def _inverse(name: str, response: Any) -> float:
    """Time constant of a rate [s]."""
    return 1 / float(getattr(response, name))


def _period(pair: Callable[[Any], tuple[float, float]], response: Any) -> float:
    """Natural period of a pair of poles [s]."""
    return 2 * np.pi / pair(response)[0]


def _ends(estimate: Estimate) -> list[float]:
    return [estimate.value, estimate.low, estimate.high]
