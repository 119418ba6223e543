"""Inversion against known inverses.

Pairs from Davies & Martin, J. Comput. Phys. 33 (1979) 1, Duffy, ACM TOMS 19 (1993) 333 and
Abramowitz & Stegun, chapter 29; the ring source from the real integral that defines it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mpmath
import numpy as np
import pytest
from scipy import special
from scipy.integrate import quad

from thermaltool.errors import FitError
from thermaltool.laplace import METHODS, invert
from thermaltool.laplace.expression import ExpressionError, compile_expression

K, A_LOSS, ALPHA, R, R0 = 3.498, 0.01565, 0.1173, 5.12, 0.12  # linear structure, pair 1


@dataclass(frozen=True)
class Pair:
    """A transform F, its inverse f and how well that is known, and what f looks like."""

    transform: Callable
    inverse: Callable
    smooth: bool = True
    jump: float | None = None
    known_to: float = 1e-15


def ring_source(s):
    root = np.sqrt(A_LOSS + s / ALPHA)
    return K * special.iv(0, R0 * root) * special.kv(0, R * root) / s


def ring_source_step(t):
    """Unit-step response by quadrature; the steady part is a Bessel integral (GR 6.541)."""

    def transient(time):
        def integrand(b):
            decay = np.exp(-(A_LOSS + b * b) * ALPHA * time)
            return b / (b * b + A_LOSS) * special.j0(b * R) * special.j0(b * R0) * decay

        end = np.sqrt(40 / (ALPHA * time))
        return quad(integrand, 0, end, limit=400, epsabs=1e-13, epsrel=1e-12)[0]

    steady = special.iv(0, R0 * np.sqrt(A_LOSS)) * special.kv(0, R * np.sqrt(A_LOSS))
    return K * (steady - np.array([transient(time) for time in t]))


def two_lags(t, first=2.0, second=30.0):
    return 1 - (first * np.exp(-t / first) - second * np.exp(-t / second)) / (first - second)


def ring_down(t, omega=3.0, zeta=0.01):
    damped = omega * np.sqrt(1 - zeta**2)
    return np.exp(-zeta * omega * t) * np.sin(damped * t) / damped


CATALOGUE = {
    "1/(s+1)": Pair(lambda s: 1 / (s + 1), lambda t: np.exp(-t)),
    "1/s": Pair(lambda s: 1 / s, np.ones_like),
    "1/s^2": Pair(lambda s: 1 / s**2, lambda t: t),
    "s^-1/2": Pair(lambda s: s**-0.5, lambda t: 1 / np.sqrt(np.pi * t)),
    "s^-0.3": Pair(lambda s: s**-0.3, lambda t: t**-0.7 / special.gamma(0.3)),
    "erfc": Pair(lambda s: np.exp(-np.sqrt(s)) / s, lambda t: special.erfc(0.5 / np.sqrt(t))),
    "log": Pair(lambda s: np.log(s) / s, lambda t: -np.log(t) - np.euler_gamma),
    "two lags": Pair(lambda s: 1 / (s * (1 + 2 * s) * (1 + 30 * s)), two_lags, known_to=1e-14),
    "J0": Pair(lambda s: 1 / np.sqrt(s * s + 1), special.j0, smooth=False),
    "sin": Pair(lambda s: 1 / (s * s + 1), np.sin, smooth=False),
    "t cos": Pair(lambda s: (s * s - 1) / (s * s + 1) ** 2, lambda t: t * np.cos(t), smooth=False),
    "ring-down": Pair(lambda s: 1 / (s * s + 0.06 * s + 9), ring_down, smooth=False),
    "delay": Pair(lambda s: np.exp(-s) / s, lambda t: (t > 1) * 1.0, smooth=False, jump=1.0),
    "ring source": Pair(ring_source, ring_source_step, known_to=1e-12),
}

TIMES = {
    "decades": np.geomspace(0.05, 500, 67),
    "uniform": np.linspace(0.4, 40, 100),
    "short": np.array([0.003, 0.004]),
    "one": np.array([7.3]),
    "late": np.array([900.0]),
}


def true_error(pair: Pair, t: np.ndarray, values: np.ndarray) -> np.ndarray:
    return abs(values - pair.inverse(t))


@pytest.mark.parametrize("times", TIMES)
@pytest.mark.parametrize(
    ("name", "method"),
    [
        (name, method)
        for name, pair in CATALOGUE.items()
        for method in METHODS
        if pair.smooth or method != "stehfest"  # real s cannot see an oscillation
    ],
)
def test_the_error_estimate_is_honest(name, method, times):
    pair, t = CATALOGUE[name], TIMES[times]
    try:
        result = invert(pair.transform, t, method=method)
    except FitError:
        assert name == "delay"
        assert method in ("hyperbola", "talbot")  # e^(-s) overflows on their contours
        return
    answered = np.isfinite(result.error)
    error = true_error(pair, t, result.values)[answered]
    reference = pair.known_to + 1e-15 * abs(pair.inverse(t))[answered]
    assert (error <= 10 * result.error[answered] + reference).all()


@pytest.mark.parametrize("times", TIMES)
@pytest.mark.parametrize("name", CATALOGUE)
def test_auto_meets_the_tolerance_and_knows_it(name, times):
    pair, t = CATALOGUE[name], TIMES[times]
    result = invert(pair.transform, t, tol=1e-8, rtol=0)
    far = np.ones_like(t, bool) if pair.jump is None else abs(t / pair.jump - 1) > 0.2
    assert result.error[far].max() <= 1e-8
    assert true_error(pair, t, result.values)[far].max() <= 1e-8


@pytest.mark.parametrize(
    ("method", "digits"),
    [
        ("hyperbola", 1e-11),
        ("talbot", 1e-10),
        ("dehoog", 1e-11),
        ("euler", 1e-6),
        ("stehfest", 1e-3),
    ],
)
def test_the_estimate_is_not_absurdly_large(method, digits):
    t = TIMES["decades"]
    for name in ("1/(s+1)", "erfc", "ring source"):
        result = invert(CATALOGUE[name].transform, t, method=method, tol=1e-11)
        assert result.error.max() <= digits


def test_the_jump_is_reported():
    t = np.array([0.5, 0.999, 1.001, 1.5])
    result = invert(CATALOGUE["delay"].transform, t)
    assert (result.error[1:3] > 1e-4).all()
    assert (result.error[[0, 3]] < 1e-9).all()


def test_a_pole_outside_the_contour_is_reported():
    t = np.array([40.0, 60.0])
    for method in ("hyperbola", "talbot"):
        result = invert(CATALOGUE["sin"].transform, t, method=method)
        assert (result.error >= 0.1 * true_error(CATALOGUE["sin"], t, result.values)).all()
        assert result.error.max() > 0.1


def test_oscillation_too_fast_to_resolve_is_reported():
    def transform(s):
        return 1 / s + 0.01 * s / (s * s + 1e4)

    t = np.array([1.0, 1000.0])  # 16 periods, and 16 000
    result = invert(transform, t)
    assert abs(result.values[0] - 1 - 0.01 * np.cos(100)) < 1e-10
    assert result.error[0] < 1e-9
    assert 0.003 < result.error[1] < 0.05


def test_late_delay_is_no_resonance():
    t = np.linspace(200, 2000, 30)
    result = invert(lambda s: np.exp(-s) / s, t)
    np.testing.assert_allclose(result.values, 1, atol=1e-8)
    assert result.error.max() < 1e-7


@pytest.mark.parametrize("method", METHODS)
def test_unstable_transfer_with_its_abscissa(method):
    t = np.array([0.5, 3.0, 20.0])
    result = invert(lambda s: 1 / (s - 2), t, method=method, abscissa=2.0)
    relative = {"stehfest": 1e-6, "euler": 1e-7}.get(method, 1e-10)
    np.testing.assert_allclose(result.values, np.exp(2 * t), rtol=relative)
    assert (abs(result.values - np.exp(2 * t)) <= 10 * result.error).all()


@pytest.mark.slow
def test_against_an_independent_program():
    """A regularized inverse (5.59) with its ringing poles, over s, from 30-digit arithmetic."""
    rise, square, rate = 0.00644, 0.00135, 0.0859

    def inverse_over_s(s, sqrt, i0, k0):
        root = sqrt(A_LOSS + s / ALPHA)
        response = K * i0(R0 * root) * k0(R * root)
        regular = response + rise * s / (s + rate) ** 2 + 2 * square * s / (s + rate) ** 3
        return (1 / regular - (2 * rate / rise - 2 * square / rise**2) - s / rise) / s

    t = np.array([20.0, 300.0])
    result = invert(
        lambda s: inverse_over_s(
            s, np.sqrt, lambda z: special.iv(0, z), lambda z: special.kv(0, z)
        ),
        t,
    )
    with mpmath.workdps(30):
        exact = [
            mpmath.invertlaplace(
                lambda s: inverse_over_s(
                    s, mpmath.sqrt, lambda z: mpmath.besseli(0, z), lambda z: mpmath.besselk(0, z)
                ),
                time,
                method="dehoog",
                degree=18,
            )
            for time in t
        ]
    np.testing.assert_allclose(result.values, np.array(exact, dtype=float), rtol=0, atol=1e-8)
    assert "dehoog" in result.method


@pytest.mark.parametrize(
    ("transform", "original", "last"),
    [
        (  # damped, above what the first series resolves
            lambda s: -0.02265 * (s + 0.8649) / ((s + 0.8649) ** 2 + 21.94**2),
            lambda t: -0.02265 * np.exp(-0.8649 * t) * np.cos(21.94 * t),
            26.0,
        ),
        (  # beside a delayed term, which is no smoother
            lambda s: 0.0131 * 43.22 / (s**2 + 43.22**2) + 15 * np.exp(-1.255 * s) / s,
            lambda t: 0.0131 * np.sin(43.22 * t) + 15 * (t > 1.255),
            14.3,
        ),
    ],
)
def test_an_oscillation_faster_than_the_series_resolves_is_seen(transform, original, last):
    t = np.geomspace(last / 2.5, last, 12)
    result = invert(transform, t)
    error = abs(result.values - original(t))
    assert (error <= np.maximum(1.1 * result.error, 1e-13)).all()
    assert (error < 1e-8).all()


def test_more_terms_do_no_harm_where_the_transfer_is_rounded():
    """s + 1/s + s^-1/2 - s: the rounding of F grows with s, and with it the sum's."""
    t = np.geomspace(0.5, 2, 9)
    result = invert(
        lambda s: (1e6 * s + 1 / s + s**-0.5) - 1e6 * s, t, method="dehoog", abscissa=0.0
    )
    error = abs(result.values - 1 - 1 / np.sqrt(np.pi * t))
    assert (error <= 10 * result.error).all()
    assert result.error.max() < 1e-4


def test_times_come_back_in_their_order_with_duplicates():
    t = np.array([30.0, 0.1, 2.0, 2.0, 500.0])
    result = invert(CATALOGUE["erfc"].transform, t)
    np.testing.assert_array_equal(result.t, t)
    np.testing.assert_allclose(result.values, CATALOGUE["erfc"].inverse(t), atol=1e-12)


def test_few_evaluations_serve_many_times():
    result = invert(ring_source, np.arange(1, 1201.0), abscissa=0.0)
    assert result.method == "hyperbola"
    assert result.evaluations < 6000  # five for each time
    assert result.error.max() < 1e-11


def test_very_many_times():
    t = np.linspace(1, 10, 100_000)
    np.testing.assert_allclose(invert(lambda s: 1 / s**2, t).values, t, rtol=1e-10)


@dataclass(frozen=True)
class Unstable:
    """A transform with its rightmost singularity right of the imaginary axis, and its inverse."""

    transform: Callable
    inverse: Callable
    abscissa: float


UNSTABLE = {
    "small pole": Unstable(
        lambda s: 1 / (s + 1) + 1e-6 / (s - 0.3), lambda t: np.exp(-t) + 1e-6 * np.exp(0.3 * t), 0.3
    ),
    "tiny far pole": Unstable(
        lambda s: 1 / s + 1e-9 / (s - 5), lambda t: 1 + 1e-9 * np.exp(5 * t), 5.0
    ),
    "branch point": Unstable(
        lambda s: 1 / np.sqrt(s - 1), lambda t: np.exp(t) / np.sqrt(np.pi * t), 1.0
    ),
    "oscillation": Unstable(
        lambda s: 1 / ((s - 0.3) ** 2 + 100), lambda t: np.exp(0.3 * t) * np.sin(10 * t) / 10, 0.3
    ),
    "delayed": Unstable(
        lambda s: np.exp(-s) / (s - 0.7), lambda t: np.where(t > 1, np.exp(0.7 * (t - 1)), 0), 0.7
    ),
    "no growth": Unstable(lambda s: 1 / s**3, lambda t: t**2 / 2, 0.0),
}


@pytest.mark.parametrize("t", [np.array([2.0, 10.0, 50.0]), np.geomspace(0.12, 110, 40)])
@pytest.mark.parametrize("name", UNSTABLE)
def test_the_rightmost_singularity_is_found(name, t):
    case = UNSTABLE[name]
    result = invert(case.transform, t)
    exact = case.inverse(t)
    far = abs(t - 1) > 0.2 if name == "delayed" else np.ones_like(t, bool)
    assert result.abscissa >= 0
    assert abs(result.abscissa - case.abscissa) < 4 / t[-1]
    assert (abs(result.values - exact) <= 10 * result.error + 1e-15 * abs(exact))[far].all()
    reached = 1e-9 + 1e-5 * np.maximum.accumulate(abs(exact))
    assert (abs(result.values - exact) <= reached)[far].all()


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_stable_transform_is_not_shifted(name):
    for t in TIMES.values():
        assert invert(CATALOGUE[name].transform, t).abscissa == 0.0


def test_what_begins_before_zero_is_refused():
    with pytest.raises(FitError, match="begins at time zero"):
        invert(lambda s: np.exp(0.01 * s) / s, [1.0, 2.0])


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e12])
def test_the_tolerance_counts_in_what_the_function_has_reached(unit):
    t = np.geomspace(0.1, 30, 20)
    result = invert(lambda s: unit / (s + 1), t, tol=1e-30)
    assert (result.error <= result.wanted).all()
    np.testing.assert_allclose(result.wanted, 1e-9 * unit * np.exp(-0.1), rtol=1e-6)


def test_growth_beyond_all_numbers_is_no_answer():
    result = invert(lambda s: 1 / (s - 1), [1.0, 1000.0], abscissa=1.0)
    assert abs(result.values[0] - np.e) < 1e-10
    assert np.isnan(result.values[1])
    assert result.error[1] == np.inf


def test_evaluations_are_counted():
    seen = []

    def transfer(s):
        seen.append(s.size)
        return 1 / (s + 1)

    assert invert(transfer, [1.0, 50.0]).evaluations == sum(seen)


def test_stehfest_asks_for_real_s_only():
    def transfer(s):
        assert (s.imag == 0).all()
        return 1 / (s + 1)

    assert abs(invert(transfer, [1.0], method="stehfest").values[0] - np.exp(-1)) < 1e-4


def test_dehoog_stays_right_of_the_abscissa():
    def transfer(s):
        assert (s.real > 0.5).all()
        return 1 / (s - 0.5)

    result = invert(transfer, [2.0], method="dehoog", abscissa=0.5)
    assert abs(result.values[0] - np.e) < 1e-10


def test_linearity_and_time_scaling():
    t = np.geomspace(0.1, 100, 20)
    f, g = CATALOGUE["erfc"].transform, CATALOGUE["1/(s+1)"].transform
    both = invert(lambda s: 2 * f(s) - 3 * g(s), t).values
    np.testing.assert_allclose(both, 2 * invert(f, t).values - 3 * invert(g, t).values, atol=1e-11)
    slow = invert(lambda s: 10 * f(10 * s), 10 * t).values
    np.testing.assert_allclose(slow, invert(f, t).values, atol=1e-11)


def test_constant_transfer_and_no_times():
    assert abs(invert(lambda s: 1.0, [1.0]).values[0]) < 1e-9
    assert invert(lambda s: 1 / s, []).values.shape == (0,)


def test_the_transfer_function_keeps_its_array():
    kept = {}

    def cached(s):
        key = s.tobytes()
        if key not in kept:
            kept[key] = 1 / (s + 1)
            kept[key].setflags(write=False)
        return kept[key]

    assert abs(invert(cached, [1.0]).values[0] - np.exp(-1)) < 1e-12


def test_not_finite_names_the_place():
    with pytest.raises(FitError, match=r"not finite at s = .*j"):
        invert(lambda s: np.cosh(s) / np.sinh(s) / s, [1e-4])


@pytest.mark.parametrize("t", [[0.0], [-1.0], [np.nan], [np.inf], [[1.0]], 1.0])
def test_bad_times(t):
    with pytest.raises(ValueError, match="times must be"):
        invert(lambda s: 1 / s, t)


def test_bad_arguments():
    with pytest.raises(ValueError, match="one of auto, hyperbola"):
        invert(lambda s: 1 / s, [1.0], method="weeks")
    with pytest.raises(ValueError, match="tol"):
        invert(lambda s: 1 / s, [1.0], tol=0)
    with pytest.raises(ValueError, match="rtol"):
        invert(lambda s: 1 / s, [1.0], rtol=-1)
    with pytest.raises(ValueError, match="abscissa"):
        invert(lambda s: 1 / s, [1.0], abscissa=np.nan)
    with pytest.raises(ValueError, match="shape"):
        invert(lambda s: np.ones(3), [1.0])


S = np.array([0.5 + 2j, 3.0 - 0.1j, 40.0 + 0j])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1/(s+1)", 1 / (S + 1)),
        ("-s**-0.3 + +2", -(S**-0.3) + 2),
        ("exp(-r*sqrt(a+s/alpha))/s", np.exp(-2 * np.sqrt(0.1 + S / 0.3)) / S),
        ("I0(s)*K0(2*s)", special.iv(0, S) * special.kv(0, 2 * S)),
        ("i0e(s)*k0e(2*s)*exp(-s)", special.iv(0, S) * special.kv(0, 2 * S)),
        ("i1e(s)*k1e(2*s)*exp(-s)", special.iv(1, S) * special.kv(1, 2 * S)),
        ("kv(1/3, s) + iv(0.5, s)", special.kv(1 / 3, S) + special.iv(0.5, S)),
        ("j0(s) + j1(s) - jv(2, s)", special.jv(0, S) + special.jv(1, S) - special.jv(2, S)),
        ("k1(s)*i1(s)", special.kv(1, S) * special.iv(1, S)),
        ("erfcx(s)", special.wofz(1j * S)),
        ("gamma(s)/exp(loggamma(s))", np.ones(3)),
        ("erf(s/9) + erfc(s/9)", np.ones(3)),
        ("cosh(s)**2 - sinh(s)**2 + tanh(1)", np.cosh(S) ** 2 - np.sinh(S) ** 2 + np.tanh(1)),
        ("sin(pi)/cos(0) + tan(0)*asinh(s) + log(e)", np.ones(3)),
        ("2", np.full(3, 2.0)),
    ],
)
def test_expression(text, expected):
    transfer = compile_expression(text, {"r": 2, "a": 0.1, "alpha": 0.3})
    np.testing.assert_allclose(transfer(S), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("1/(s+1", "column 3.*never closed"),
        ("s^2", r"column 2.*\*\*"),
        ("1 + expp(s)", "column 5.*unknown function 'expp'.*did you mean exp"),
        ("alfa*s", "column 1.*unknown name 'alfa'.*did you mean alpha"),
        ("sqrt(s, 2)", "column 1.*sqrt takes 1 argument"),
        ("kv(s)", "kv takes 2 arguments"),
        ("sqrt(z=s)", "takes 1 argument"),
        ("2j*s", "not a real number"),
        ("True*s", "not a real number"),
        ("'a'", "not a real number"),
        ("1" * 3000, "too large"),
        ("s.real", "not allowed"),
        ("s[0]", "not allowed"),
        ("(lambda: s)()", "not allowed"),
        ("sqrt(*s)", "column 6.*not allowed"),
        ("[s for s in s]", "not allowed"),
        ("s if s else s", "not allowed"),
        ("s < 1", "not allowed"),
        ("s // 2", "not allowed"),
        ("(x := 1)", "not allowed"),
        ("__import__('os').system('true')", "not allowed"),
        ("__import__('os')", "unknown function"),
        ("s; s", "column 2"),
        ("s\x00", "null"),
        ("s" + "+s" * 3000, "longer than"),
        ("-" * 3000 + "s", "too deeply"),
        ("(" * 500 + "s" + ")" * 500, "nested"),
        ("s" + "+1" * 400, "too deeply"),
    ],
)
def test_expression_errors(text, message):
    with pytest.raises(ExpressionError, match=message):
        compile_expression(text, {"alpha": 1.0})


@pytest.mark.parametrize("name", ["s", "pi", "e", "2x", ""])
def test_parameter_names(name):
    with pytest.raises(ExpressionError, match="parameter"):
        compile_expression("1/s", {name: 1.0})


def test_tower_of_powers_ends_at_once():
    with pytest.raises(FitError, match="not finite"):
        invert(compile_expression("9**9**9**9/s"), [1.0])


def test_scaled_bessel_functions_do_not_overflow():
    t = np.geomspace(1e-5, 1e-3, 5)
    root = "sqrt(s)"
    plain = compile_expression(f"i0({root})*k0(2*{root})")
    scaled = compile_expression(f"i0e({root})*k0e(2*{root})*exp(-{root})")
    with pytest.raises(FitError):
        invert(plain, t)
    # the ring source without loss: exp(-(r² + r0²)/4t)·I0(r·r0/2t)/2t (Carslaw & Jaeger 10.3)
    exact = np.exp(-1 / (4 * t)) * special.ive(0, 1 / t) / (2 * t)
    np.testing.assert_allclose(invert(scaled, t).values, exact, atol=1e-9)
