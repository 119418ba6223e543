"""Random transforms whose originals are known to 40 digits: is the error estimate right?

    python benchmarks/laplace.py [--count 500] [--seed N] [--show]

Each expression is a sum of one to three terms drawn from the families below, each with a weight
between 1e-3 and 1e3 and one in four with a delay; poles lie in both half planes. `thermaltool`
inverts it with its defaults at twelve times; mpmath has the original. Prints how often the true
error is within the estimate, and every transform that is told good and is not. Then the time for
one point of a smooth transform, beside mpmath's Talbot contour at the same digits.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import mpmath as mp
import numpy as np
from scipy import special

import thermaltool as tt
from thermaltool.laplace import invert

mp.mp.dps = 40
TIMES = 12
BULK = 10_000
# True error over estimate from which a result that is told good is wrong.
WRONG = 10.0

Original = Callable[[mp.mpf], mp.mpf]


@dataclass(frozen=True)
class Term:
    """A transform, as the command takes it, and its original."""

    family: str
    text: str
    original: Original
    growth: float  # largest real part of the singularities [1/s]


def _number(generator: np.random.Generator, low: float, high: float) -> float:
    return float(f"{np.exp(generator.uniform(np.log(low), np.log(high))):.4g}")


def _pole(g: np.random.Generator) -> Term:
    p, n = _number(g, 0.05, 5) * float(g.choice([-1, -1, 1])), int(g.integers(1, 4))
    p = p / 5 if p > 0 else p
    return Term("pole", f"1/(s - ({p!r}))**{n}",
                lambda t: t ** (n - 1) * mp.exp(p * t) / mp.factorial(n - 1), p)  # fmt: skip


def _pair(g: np.random.Generator) -> Term:
    a, w = _number(g, 0.01, 2) * float(g.choice([-1, -1, 1])), _number(g, 0.1, 30)
    a = a / 4 if a > 0 else a
    return Term("pair", f"(s - ({a!r}))/((s - ({a!r}))**2 + {w!r}**2)",
                lambda t: mp.exp(a * t) * mp.cos(w * t), a)  # fmt: skip


def _undamped(g: np.random.Generator) -> Term:
    w = _number(g, 0.1, 50)
    return Term("undamped", f"{w!r}/(s**2 + {w!r}**2)", lambda t: mp.sin(w * t), 0.0)


def _root(g: np.random.Generator) -> Term:
    a = _number(g, 0.05, 5) * float(g.choice([-1, 1]))
    a = a / 5 if a < 0 else a
    return Term("root", f"1/sqrt(s + ({a!r}))", lambda t: mp.exp(-a * t) / mp.sqrt(mp.pi * t), -a)


def _power(g: np.random.Generator) -> Term:
    v = _number(g, 0.2, 3)
    return Term("power", f"s**(-{v!r})", lambda t: t ** (mp.mpf(v) - 1) / mp.gamma(v), 0.0)


def _logarithm(g: np.random.Generator) -> Term:
    a, b = _number(g, 0.05, 5), _number(g, 0.05, 5)
    return Term("logarithm", f"log((s + {a!r})/(s + {b!r}))",
                lambda t: (mp.exp(-b * t) - mp.exp(-a * t)) / t, -min(a, b))  # fmt: skip


def _bessel_j(g: np.random.Generator) -> Term:
    a = _number(g, 0.1, 20)
    return Term("J0", f"1/sqrt(s + {a!r}*(0 - 1)**0.5)/sqrt(s - {a!r}*(0 - 1)**0.5)",
                lambda t: mp.besselj(0, a * t), 0.0)  # fmt: skip


def _bessel_i(g: np.random.Generator) -> Term:
    a = _number(g, 0.02, 1)
    return Term("I0", f"1/sqrt(s - {a!r})/sqrt(s + {a!r})", lambda t: mp.besseli(0, a * t), a)


def _bessel_k(g: np.random.Generator) -> Term:
    a = _number(g, 0.1, 3)
    return Term("K0", f"k0({a!r}*sqrt(s))", lambda t: mp.exp(-(a**2) / (4 * t)) / (2 * t), 0.0)


def _ring(g: np.random.Generator) -> Term:
    a, b = sorted((_number(g, 0.1, 2), _number(g, 0.1, 2)))
    return Term("I0*K0", f"i0e({a!r}*sqrt(s))*k0e({b!r}*sqrt(s))*exp(({a!r} - {b!r})*sqrt(s))",
                lambda t: mp.exp(-(a**2 + b**2) / (4 * t)) * mp.besseli(0, a * b / (2 * t))
                / (2 * t), 0.0)  # fmt: skip


def _diffusion(g: np.random.Generator) -> Term:
    a = _number(g, 0.05, 3)
    return Term("erfc", f"exp(-{a!r}*sqrt(s))/s", lambda t: mp.erfc(a / (2 * mp.sqrt(t))), 0.0)


def _flux(g: np.random.Generator) -> Term:
    a = _number(g, 0.05, 3)
    return Term("flux", f"exp(-{a!r}*sqrt(s))",
                lambda t: a / (2 * mp.sqrt(mp.pi) * t ** mp.mpf(1.5)) * mp.exp(-(a**2) / (4 * t)),
                0.0)  # fmt: skip


def _surface(g: np.random.Generator) -> Term:
    a = _number(g, 0.05, 3)
    return Term("erfcx", f"1/(sqrt(s)*(sqrt(s) + {a!r}))",
                lambda t: mp.exp(a**2 * t) * mp.erfc(a * mp.sqrt(t)), 0.0)  # fmt: skip


def _slab(g: np.random.Generator) -> Term:
    x = float(f"{g.uniform(0.1, 0.9):.3g}")
    text = (f"exp(({x!r} - 1)*sqrt(s))*(1 - exp(-2*{x!r}*sqrt(s)))"
            "/(1 - exp(-2*sqrt(s)))/s")  # fmt: skip

    def original(t: mp.mpf) -> mp.mpf:
        total, n = mp.mpf(x), 1
        while True:
            decay = mp.exp(-((n * mp.pi) ** 2) * t)
            if decay < mp.mpf(10) ** -42:
                return total
            total += 2 / mp.pi * (-1) ** n / mp.mpf(n) * mp.sin(n * mp.pi * x) * decay
            n += 1

    return Term("slab", text, original, 0.0)


def _essential(g: np.random.Generator) -> Term:
    a = _number(g, 0.1, 3)
    if g.random() < 0.5:
        return Term("essential", f"exp(-{a!r}/s)/sqrt(s)",
                    lambda t: mp.cos(2 * mp.sqrt(a * t)) / mp.sqrt(mp.pi * t), 0.0)  # fmt: skip
    return Term("essential", f"exp({a!r}/s)/sqrt(s)",
                lambda t: mp.cosh(2 * mp.sqrt(a * t)) / mp.sqrt(mp.pi * t), 0.0)  # fmt: skip


def _square(g: np.random.Generator) -> Term:
    h = _number(g, 0.3, 3)
    return Term("square", f"1/(s*(1 + exp(-{h!r}*s)))",
                lambda t: mp.mpf(1 - int(mp.floor(t / h)) % 2), 0.0)  # fmt: skip


FAMILIES = (
    _pole, _pair, _undamped, _root, _power, _logarithm, _bessel_j, _bessel_i, _bessel_k, _ring,
    _diffusion, _flux, _surface, _slab, _essential, _square,
)  # fmt: skip


def draw(generator: np.random.Generator) -> tuple[str, Original, list[Term]]:
    """An expression, its original and its terms."""
    terms, weights, delays = [], [], []
    for _ in range(int(generator.integers(1, 4))):
        terms.append(FAMILIES[generator.integers(len(FAMILIES))](generator))
        weights.append(_number(generator, 1e-3, 1e3) * float(generator.choice([-1, 1])))
        delays.append(_number(generator, 0.1, 3) if generator.random() < 0.25 else 0.0)
    text = " + ".join(
        f"({w!r})*{'' if not d else f'exp(-{d!r}*s)*'}({term.text})"
        for w, d, term in zip(weights, delays, terms, strict=True)
    )

    def original(t: mp.mpf) -> mp.mpf:
        return mp.fsum(
            w * term.original(t - mp.mpf(d))
            for w, d, term in zip(weights, delays, terms, strict=True)
            if t > d
        )

    return text, original, terms


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, help="drawn if absent")
    parser.add_argument("--show", action="store_true", help="every point beyond its estimate")
    options = parser.parse_args()
    seed = int(np.random.SeedSequence().entropy % 2**32) if options.seed is None else options.seed
    print(f"seed {seed}")
    generator = np.random.default_rng(seed)
    points = within = good = wrong = refused = 0
    beyond: Counter[str] = Counter()
    wrongly: list[str] = []
    for _ in range(options.count):
        text, original, terms = draw(generator)
        last = _number(generator, 1, 30)
        t = np.geomspace(last / _number(generator, 2, 300), last, TIMES)
        try:
            found = tt.invert_laplace(text, t).inversion
        except tt.errors.ThermalToolError as error:
            refused += 1
            if options.show:
                print("refused", text, error)
            continue
        exact = [original(mp.mpf(float(x))) for x in t]
        true = np.array([float(abs(mp.mpf(float(v)) - x)) if np.isfinite(v) else 0.0
                         for v, x in zip(found.values, exact, strict=True)])  # fmt: skip
        told_good = found.error <= found.wanted
        inside = true <= found.error
        bad = told_good & (true > WRONG * found.error)
        points, within = points + t.size, within + int(inside.sum())
        good, wrong = good + int(told_good.sum()), wrong + int(bad.sum())
        if not inside.all():
            beyond["+".join(sorted(term.family for term in terms))] += int((~inside).sum())
            if options.show:
                k = int(np.argmax(true / found.error))
                print(
                    f"{int((~inside).sum())} beyond, worst t={t[k]:.6g} true {true[k]:.3g} "
                    f"estimate {found.error[k]:.3g} wanted {found.wanted[k]:.3g} {text}"
                )
        if bad.any():
            wrongly.append(text)
    print(f"{options.count} expressions, {refused} refused with a message, {points} points")
    print(f"true error within the estimate: {100 * within / points:.2f} % of points (asked 99)")
    print(f"told good (error within what is wanted): {100 * good / points:.1f} %")
    print(
        f"told good, and off by more than {WRONG:g} x the estimate: {wrong} points of "
        f"{len(wrongly)} expressions (asked 0)"
    )
    for text in wrongly:
        print(f"  {text}")
    for families, count in beyond.most_common():
        print(f"  beyond: {count} {families}")
    speed()
    return 0


SMOOTH = {
    "1/((s + 1)*(s + 0.1))": (
        lambda s: 1 / ((s + 1) * (s + 0.1)),
        lambda s: 1 / ((s + 1) * (s + mp.mpf("0.1"))),
        lambda t: (mp.exp(-mp.mpf("0.1") * t) - mp.exp(-t)) / mp.mpf("0.9"),
    ),
    "exp(-sqrt(s))/s": (
        lambda s: np.exp(-np.sqrt(s)) / s,
        lambda s: mp.exp(-mp.sqrt(s)) / s,
        lambda t: mp.erfc(1 / (2 * mp.sqrt(t))),
    ),
    "k0(sqrt(s))": (
        lambda s: special.kv(0, np.sqrt(s)),
        lambda s: mp.besselk(0, mp.sqrt(s)),
        lambda t: mp.exp(-1 / (4 * t)) / (2 * t),
    ),
}


def speed() -> None:
    """Time for one point, of many in one call, beside mpmath's default at double precision."""
    t = np.linspace(0.1, 20, BULK)
    few = t[:: BULK // 10]
    print("| transform | us/point | largest error | mpmath us/point | its error | ratio |")
    print("|---|---|---|---|---|---|")
    for name, (transfer, precise, original) in SMOOTH.items():
        begin = time.perf_counter()
        found = invert(transfer, t)
        ours = (time.perf_counter() - begin) / t.size
        with mp.workdps(15):
            begin = time.perf_counter()
            theirs = [mp.invertlaplace(precise, x, method="talbot") for x in few]
            peer = (time.perf_counter() - begin) / few.size
        exact = [original(mp.mpf(float(x))) for x in few]
        error = max(abs(v - x) for v, x in zip(found.values[:: BULK // 10], exact, strict=True))
        its = max(abs(v - x) for v, x in zip(theirs, exact, strict=True))
        print(f"| {name} | {1e6 * ours:.1f} | {float(error):.1g} | {1e6 * peer:.0f} | "
              f"{float(its):.1g} | {peer / ours:.0f} |")  # fmt: skip


if __name__ == "__main__":
    raise SystemExit(main())
