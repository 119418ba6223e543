"""Inverse of a rational transfer function: angle in, power out, behind a filter.

A response that falls off at high frequencies has an inverse that grows without bound. The filter
F(s) = Π 1/(τ_k s + 1) has one lag more than the response's relative degree, so that F/H falls off
too and is again a sum of lags (Mareš et al. identify γ⁻¹ from the same runs with their columns
exchanged). The poles of F/H are the zeros of H and those of F: stable where H has its zeros in the
left half-plane, and refused where not. As a model document what was an output drives what was a
drive.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import polynomial as poly

from thermaltool.errors import ModelError
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.responses.modes import Complex
from thermaltool.responses.rational import KINDS, Rational
from thermaltool.units import hold_of

# A leading coefficient below this share of what it is summed from is rounding.
ROUNDING = 1e-9
# A lag of the filter within this share of a zero of the response would make a double pole: it is
# shortened by this factor.
DOUBLE_POLE_TOLERANCE, MOVED_LAG = 1e-3, 0.99


@dataclass(frozen=True)
class RationalInverse:
    """F/H.

    Attributes
    ----------
    response : Rational
    filter_lags : tuple of float [s]
        τ_k, each half of the one before.
    zeros : tuple of complex [1/s]
        Of H, the poles of the exact inverse.
    """

    response: Rational
    filter_lags: tuple[float, ...]
    zeros: tuple[complex, ...]


def inverted(response: Rational, filter_time: float) -> RationalInverse:
    """The inverse of `response` behind a filter.

    Parameters
    ----------
    response : Rational
    filter_time : float [s]
        Slowest lag of the filter.

    Raises
    ------
    ModelError
        A delay, direct feedthrough, zeros that are not in the left half-plane (named), a response
        of zero, more poles than a kind holds.
    """
    if response.delay:
        raise ModelError(
            f"a response with a delay has no causal inverse: {response.delay:g} s of what is to be "
            "followed would have to be known ahead"
        )
    if response.direct:
        raise ModelError("a response with direct feedthrough has no inverse of this kind")
    poles, residues = response.partial_fractions()
    # In units of the middle pole: powers of seconds would leave no digits.
    scale = float(np.exp(np.mean(np.log(np.abs(poles)))))
    lead, zeros = _zeros(poles / scale, residues / scale)
    zeros = zeros * scale
    unstable = [z for z in zeros if z.real >= -ROUNDING * scale]
    if unstable:
        named = ", ".join(f"{z.real:.3g}" + (f"{z.imag:+.3g}j" if z.imag else "") for z in unstable)
        raise ModelError(f"the inverse is unstable: zeros at {named} 1/s in the right half-plane")
    degree = len(poles) - len(zeros)
    lags: list[float] = []
    for k in range(degree + 1):
        lag = filter_time / 2**k
        while np.any(np.abs(zeros * lag + 1) < DOUBLE_POLE_TOLERANCE):
            lag *= MOVED_LAG
        lags.append(lag)
    own = np.concatenate([zeros, -1 / np.array(lags)])
    over = [_product(p - poles, scale) / _product(p - np.delete(own, k), scale)
            for k, p in enumerate(own)]  # fmt: skip
    # H = lead Π(s − zeros)/Π(s − poles), F = Π 1/(τ_k (s + 1/τ_k)), all s in units of the scale.
    gain = 1 / (lead * np.prod(np.array(lags) * scale))
    weights = np.array(over) * gain * scale
    return RationalInverse(_of(own, weights), tuple(lags), tuple(complex(z) for z in zeros))


def _product(factors: Complex, scale: float) -> complex:
    return complex(np.prod(factors / scale))


def _zeros(poles: Complex, residues: Complex) -> tuple[float, Complex]:
    """Leading coefficient and roots of Σ residue_k Π_(j≠k) (s − pole_j)."""
    parts = [w * np.atleast_1d(poly.polyfromroots(np.delete(poles, k)))
             for k, w in enumerate(residues)]  # fmt: skip
    total, size = np.sum(parts, axis=0).real, np.sum(np.abs(parts), axis=0)
    there = np.flatnonzero(np.abs(total) > ROUNDING * size)
    if not len(there):
        raise ModelError("a response of zero has no inverse")
    kept = total[: there[-1] + 1]
    return float(kept[-1]), np.asarray(poly.polyroots(kept), complex)


def _of(poles: Complex, weights: Complex) -> Rational:
    """The kind that has these poles and residues."""
    real, pairs = poles.imag == 0, np.flatnonzero(poles.imag > 0)
    cls = KINDS.get((int(real.sum()), len(pairs)))
    if cls is None:
        raise ModelError(
            f"no kind of response has the {int(real.sum())} lags and {len(pairs)} oscillations of "
            "the inverse: take a lower order"
        )
    values: dict[str, float] = {}
    order = np.argsort(poles[real].real)[::-1]
    for k, (p, w) in enumerate(zip(poles[real][order], weights[real][order], strict=True)):
        values |= {f"tau{k + 1}": float(-1 / p.real), f"K{k + 1}": float(-w.real / p.real)}
    for j in pairs:
        p, w, size = poles[j], weights[j], float(abs(poles[j]))
        values |= {"omega": size, "zeta": float(-p.real / size), "D": float(2 * w.real / size),
                   "K": float(-2 * (w * np.conj(p)).real / size**2)}  # fmt: skip
    return cls(**values)


@dataclass(frozen=True)
class InverseModel:
    """The model document, and what its response is made of."""

    model: Model
    inverse: RationalInverse


def inverse_model(
    model: Model, filter_time: float, output: str | None = None, drive: str | None = None
) -> InverseModel:
    """The inverse of one transfer function of a model.

    Parameters
    ----------
    model : Model
    filter_time : float [s]
        As `inverted`.
    output, drive : str or None
        Which; None where there is one way only.

    Raises
    ------
    ModelError
        None or several ways to choose from, effects or schedules, a response that is not rational,
        and as `inverted`.
    """
    found = [t for t in model.terms if output in (None, t.output) and drive in (None, t.drive)]
    paths = list(dict.fromkeys(f"{t.drive} → {t.output}" for t in found or model.terms))
    if not found or len(paths) > 1:
        problem = "several ways" if found else "no such way"
        raise ModelError(f"{problem}: {', '.join(paths)}: choose with --drive and --sensor")
    term, (place,) = found[0], paths
    if term.band is not None or model.effects:
        what = "a schedule" if term.band is not None else f"the effect {model.effects[0].name}"
        raise ModelError(f"{place}: {what} has no inverse transfer function; compensate --heater "
                         "follows it")  # fmt: skip
    if len(found) > 1:
        raise ModelError(f"{place}: {len(found)} responses in sum, of which there is no inverse")
    if not isinstance(term.response, Rational):
        raise ModelError(
            f"{place}: {term.response.kind} is none of the rational kinds: use a kernel, --window"
        )
    source = next(o for o in model.outputs if o.channel == term.output)
    given = next(d for d in model.drives if d.channel == term.drive)
    try:
        inverse = inverted(term.response, filter_time)
    except ModelError as error:
        raise ModelError(f"{place}: {error}") from error
    inner = Model(
        (Drive(source.channel, hold_of(source.channel), source.offset, source.range),),
        (Output(given.channel, "sensor", given.reference, given.range),),
        (Term(source.channel, given.channel, inverse.response),),
        model.sample_period,
        {"inverse_of": dict(model.provenance), "filter_s": list(inverse.filter_lags)},
    )
    return InverseModel(inner, inverse)
