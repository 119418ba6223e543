"""A discrete transfer function as responses in continuous time, for the model document."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from thermaltool.errors import ModelError
from thermaltool.fitting.data import Array
from thermaltool.fitting.output_model import ContinuousTerm
from thermaltool.responses import Response
from thermaltool.responses.rational import oscillation_names, rational_kind
from thermaltool.signals.intervals import standard_error

if TYPE_CHECKING:
    from thermaltool.fitting.transfer.model import TransferModel

# The steps of both forms are compared over so many slowest time constants (settled to 3·10⁻⁴), and
# samples at most.
STEP_TIME_CONSTANTS, MAX_STEP_SAMPLES = 8, 20000
# Feedthrough of an input that runs on counts where it is so many standard errors from zero.
MIN_DIRECT_ERRORS = 3.0
# The step in continuous time differs from the discrete one by more than this share where it counts.
MAX_MISMATCH = 0.01
# Poles nearer to each other than this share of their size are one pole, twice; a pair with a
# smaller imaginary part than that is two or three real poles, to rounding.
DOUBLE_POLE_GAP, MIN_IMAGINARY_SHARE = 1e-3, 1e-2


def continuous_term(model: TransferModel, k: int) -> ContinuousTerm:
    """The response of input k: poles z → ln z/dt, gains by least squares on the step.

    A held input reaches the next sample first: of nk samples of delay one is the sampling's own;
    none is direct feedthrough. An input that runs on reaches the same sample in part: feedthrough
    of it is what that does not explain, where it may have any.

    Parameters
    ----------
    model : TransferModel
    k : int

    Raises
    ------
    ModelError
        A pole without an equivalent, or one that does not settle; more poles than a kind holds,
        no denominator.
    """
    place = f"{model.names[k]} → {model.target}"
    s = rates(model, k)
    searched = named_poles(s)
    real, pairs = s[s.imag == 0], s[s.imag > 0]
    time, u = unit_step(model, s)
    nk, hold = model.orders.nk[k], model.holds[k]
    plain = nk > 0 or hold == "first"
    may_be_direct = nk == 0 and model.names[k] not in model.lagging
    direct = may_be_direct and _kind(len(real), len(pairs), True, place)
    if plain:
        cls = _kind(len(real), len(pairs), False, place)
        known = searched | {"delay": max(nk - (hold == "zero"), 0) * model.dt}
        found, _ = response_of_step(cls, known, time, u, model, k)
        if not direct or found.mismatch <= MAX_MISMATCH:
            return found
    exact, weights = response_of_step(direct, searched, time, u, model, k)
    least = MIN_DIRECT_ERRORS * _error(model, k, weights, u)
    return found if plain and abs(feedthrough(exact.response)) < least else exact


def rates(model: TransferModel, k: int) -> NDArray[np.complex128]:
    """Poles of input k in continuous time, ln z/dt, double ones drawn apart, shape (n,) [1/s].

    Parameters
    ----------
    model : TransferModel
    k : int

    Raises
    ------
    ModelError
        A pole without an equivalent, or one that does not settle.
    """
    poles = model.poles(model.group_of(k))
    for z in poles:
        _continues(z, f"{model.names[k]} → {model.target}")
    return _apart(np.asarray(np.log(poles) / model.dt, complex))


def named_poles(s: NDArray[np.complex128]) -> dict[str, float]:
    """Poles as time constants [s], and as rates [rad/s] and dampings of pairs, by name.

    Parameters
    ----------
    s : ndarray, shape (n,) [1/s]
    """
    named = {f"tau{i + 1}": float(-1 / p) for i, p in enumerate(s[s.imag == 0].real)}
    for i, p in enumerate(s[s.imag > 0]):
        omega, zeta = oscillation_names(i + 1)[2:]
        named |= {omega: float(abs(p)), zeta: float(-p.real / abs(p))}
    return named


def unit_step(model: TransferModel, s: NDArray[np.complex128]) -> tuple[Array, Array]:
    """Clock and values of a step that is long enough for these poles, shape (n,) each.

    Parameters
    ----------
    model : TransferModel
    s : ndarray, shape (n,) [1/s]
    """
    settled = STEP_TIME_CONSTANTS * max(-1 / s.real) / model.dt + model.orders.first + 10
    samples = int(min(settled, MAX_STEP_SAMPLES))
    time, u = model.dt * np.arange(samples, dtype=float), np.ones(samples)
    u[0] = 0.0
    return time, u


def _kind(lags: int, pairs: int, direct: bool, place: str) -> Any:
    """The class of response; ModelError says where there is none."""
    try:
        return rational_kind(lags, pairs, direct)
    except ModelError as error:
        raise ModelError(f"{place}: {error}") from error


def feedthrough(response: Response) -> float:
    """What an output has of its input at once: the step response at its first instant."""
    return float(response.step(np.zeros(1))[0])


def _error(model: TransferModel, k: int, weights: Array, u: Array) -> float:
    """Standard error of the feedthrough, which takes these weights of the step, poles as found."""
    f, nb = model.denominator(k), model.orders.nb[k]
    before = np.zeros(len(u))
    slopes = []
    for j in range(nb):
        before[j:] = u[: len(u) - j]
        before[:j] = 0.0
        slopes.append(float(weights @ lfilter([1.0], f, before)))
    at = sum(model.orders.nf) + sum(model.orders.nb[:k])
    own = model.coefficient_covariance[at : at + nb, at : at + nb]
    return standard_error(np.array(slopes), own)


def response_of_step(
    cls: Any,
    known: dict[str, float],
    time: Array,
    u: Array,
    model: TransferModel,
    k: int,
) -> tuple[ContinuousTerm, Array]:
    """The response of a kind with these poles whose step is nearest to that of input k.

    And the weights with which its last gain takes the rows of that step.

    Parameters
    ----------
    cls : class of Response
    known : dict of str to float
        Its poles, and the delay.
    time, u : ndarray, shape (n,)
        As `unit_step` gives them.
    model : TransferModel
    k : int
    """
    wanted = _alone(model, k, u)
    shapes = []
    for name in cls.gains:
        gains = {other: float(other == name) for other in cls.gains}
        shapes.append(cls(**known, **gains).modes(model.dt).run(time, u, model.holds[k]))
    rows = np.array(shapes)
    inverse = np.linalg.pinv(rows.T, rcond=1e-12)
    gains_found = inverse @ wanted
    left = np.max(np.abs(wanted - gains_found @ rows)) / np.max(np.abs(wanted))
    named = {name: float(g) for name, g in zip(cls.gains, gains_found, strict=True)}
    return ContinuousTerm(cls(**known, **named), float(left)), inverse[-1]


def _continues(z: complex, place: str) -> None:
    """Refuse a pole that no response has (ModelError)."""
    value = f"{z.real:.4g}" if z.imag == 0 else f"{z.real:.4g} ± {abs(z.imag):.4g}j"
    if abs(z) >= 1:
        raise ModelError(
            f"{place}: a pole at z = {value} does not settle: the data look unstable or "
            "integrating, a model file needs a steady state"
        )
    if z.imag == 0 and z.real <= 0:
        raise ModelError(
            f"{place}: a pole at z = {value} has no equivalent in continuous time: take "
            "--real-poles, a lower order, or leave this input out"
        )


def oscillates(z: complex) -> bool:
    """Whether a pole is one of a pair; a pair to rounding is two real poles (`_apart`)."""
    return bool(z.imag != 0 and abs(np.log(z).imag) >= MIN_IMAGINARY_SHARE * abs(np.log(z)))


def _apart(s: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Poles with those drawn apart that are twice there: no kind has a double pole.

    Critical damping comes out of a search over real poles, to rounding as a pair or as one value.
    """
    parted = s.copy()
    for k in range(len(s) - 1):
        here, after = parted[k], parted[k + 1]
        gap, turned = abs(here - after) / abs(here), here.imag != 0 or after.imag != 0
        if gap < 2 * (MIN_IMAGINARY_SHARE if turned else DOUBLE_POLE_GAP):
            middle = float((here + after).real) / 2
            parted[k], parted[k + 1] = (
                middle * (1 - DOUBLE_POLE_GAP),
                middle * (1 + DOUBLE_POLE_GAP),
            )
    return parted


def _alone(model: TransferModel, k: int, u: Array) -> Array:
    inputs = np.zeros((len(model.names), len(u)))
    inputs[k] = u
    return model.respond(inputs)
