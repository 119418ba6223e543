"""Deconvolution: five parameter rules on classic problems, and heat of a wall beside the peers.

    python benchmarks/deconvolution.py rules [--draws 30] [--seed 1]
    python benchmarks/deconvolution.py wall [--rows 1000 10000 100000] [--seed 1]

``rules`` has the problems of Hansen's Regularization Tools (1994): Phillips, Shaw, deriv2, heat
and Baart, written here from their integral equations, n = 200, white noise of 1 and 0.1 % of the
data. Each rule's error over that of the best weight on the grid (the oracle), where the rule is not
refused. A path is of order 0, 1 or 2; "evidence" takes the order with the largest likelihood.

``wall`` has a wall of finite volumes, heated on one face and read on the other; its heat steps.
The peers are given the wall's own impulse response, and the rule of theirs that does best counts.
They run where they are installed (pylops, pytikhonov, CUQIpy); the dense ones at 1000 rows.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path as File

import numpy as np
from numpy.typing import NDArray

from thermaltool.estimation.deconvolution import DeconvolutionPlan, deconvolve
from thermaltool.estimation.estimator import KalmanEstimator, SensorNoise
from thermaltool.estimation.parameter_rules import RULES, Path, apply_rules
from thermaltool.responses.modes import Modes

sys.path.append(str(File(__file__).parents[1] / "tests"))

from machines.wall import Wall

Array = NDArray[np.float64]
SIZE = 200


def phillips(n: int) -> tuple[Array, Array]:
    h = 12 / n
    t = -6 + h * (np.arange(n) + 0.5)

    def bump(x: Array) -> Array:
        return np.where(np.abs(x) < 3, 1 + np.cos(x * np.pi / 3), 0.0)

    return h * bump(t[:, None] - t), bump(t)


def shaw(n: int) -> tuple[Array, Array]:
    h = np.pi / n
    t = -np.pi / 2 + h * (np.arange(n) + 0.5)
    u = np.sin(t[:, None]) + np.sin(t)
    K = (np.cos(t[:, None]) + np.cos(t)) ** 2 * np.sinc(u) ** 2
    return h * K, 2 * np.exp(-6 * (t - 0.8) ** 2) + np.exp(-2 * (t + 0.5) ** 2)


def deriv2(n: int) -> tuple[Array, Array]:
    t = (np.arange(n) + 0.5) / n
    s = t[:, None]
    return np.where(s < t, s * (t - 1), t * (s - 1)) / n, t


def heat(n: int) -> tuple[Array, Array]:
    t = (np.arange(n) + 0.5) / n
    kernel = t**-1.5 / (2 * np.sqrt(np.pi)) * np.exp(-1 / (4 * t)) / n
    lag = np.arange(n)[:, None] - np.arange(n)
    late = np.arange(1, n + 1) * 20 / n
    rise, cap = 0.75 * late**2 / 4, 0.75 + (late - 2) * (3 - late)
    fall = np.where(np.arange(1, n + 1) <= n // 2, 0.75 * np.exp(-2 * (late - 3)), 0.0)
    x = np.where(late < 2, rise, np.where(late < 3, cap, fall))
    return np.where(lag >= 0, kernel[np.clip(lag, 0, n - 1)], 0.0), x


def baart(n: int) -> tuple[Array, Array]:
    t = np.pi / n * (np.arange(n) + 0.5)
    return np.pi / n * np.exp(t[:, None] / 2 * np.cos(t)), np.sin(t)


PROBLEMS: tuple[Callable[[int], tuple[Array, Array]], ...] = (phillips, shaw, deriv2, heat, baart)


class DensePath:
    """Paths of a matrix: of one order, for many right-hand sides."""

    def __init__(self, A: Array, sigma: float, order: int) -> None:
        n = A.shape[1]
        L = np.eye(n)
        for _ in range(order):
            L = L - np.eye(n, k=-1) @ L
        self.sigma, self.n = sigma, n
        inverse = np.linalg.inv(L)
        self.U, self.s, V = np.linalg.svd(A @ inverse / sigma)
        self.V = inverse @ V.T
        weights = self.s[0] ** 2 * np.geomspace(10.0, 1e-14, 31)
        freedom = np.sum(self.s**2 / (self.s**2 + weights[:, None]), axis=1)
        self.weights = weights[(freedom > 0.2) & (freedom < 0.6 * n)]
        kept = self.s**2 + self.weights[:, None]
        self.filters = self.s**2 / kept
        self.variance = np.array([np.mean(np.sum(self.V**2 / each, axis=1)) for each in kept])

    def of(self, y: Array) -> tuple[Path, Array]:
        b = self.U.T @ (y / self.sigma)
        solution = self.filters * b / np.maximum(self.s, 1e-300)
        squares = np.sum((1 - self.filters) * b**2, axis=1)
        logs = -np.sum(np.log1p(-self.filters), axis=1)
        path = Path(
            self.weights,
            solution @ self.V.T,
            np.sum(((1 - self.filters) * b) ** 2, axis=1),
            self.n,
            np.sum(self.filters, axis=1),
            np.sum(solution**2, axis=1),
            -0.5 * (self.n * np.log(squares / self.n) + logs),
        )
        return path, self.variance * squares / self.n


def rules(draws: int, seed: int) -> None:
    """Errors over the oracle's of every rule on every problem."""
    generator = np.random.default_rng(seed)
    total: dict[str, list[float]] = {rule: [] for rule in (*RULES, "taken")}
    print("| problem | noise | order | " + " | ".join([*RULES, "taken"]) + " |")
    print("|---" * (len(RULES) + 4) + "|")
    for problem in PROBLEMS:
        A, x = problem(SIZE)
        clean = A @ x
        for noise in (1e-2, 1e-3):
            sigma = noise * float(np.sqrt(np.mean(clean**2)))
            dense = [DensePath(A, sigma, order) for order in range(3)]
            found: dict[tuple[str, str], list[float]] = {}
            for _ in range(draws):
                y = clean + sigma * generator.standard_normal(SIZE)
                paths = [each.of(y) for each in dense]
                likely = [float(np.max(path.log_likelihood)) for path, _ in paths]
                best = int(np.argmax(likely))
                reference, variance = paths[best]
                k = int(np.argmax(reference.log_likelihood))
                for name, order in (("0", 0), ("evidence", best)):
                    path = paths[order][0]
                    apart = np.mean((path.solutions - reference.solutions[k]) ** 2, axis=1)
                    expected = np.sqrt(variance[k] + apart)
                    errors = np.sqrt(np.mean((path.solutions - x) ** 2, axis=1))
                    path = replace(path, expected_error=expected)
                    choices = [c for c in apply_rules(path) if not c.reason]
                    places = {c.rule: c.place for c in choices}
                    if choices:
                        places["taken"] = min(choices, key=lambda c: c.expected_error).place
                    for rule in total:
                        ratio = np.nan
                        if rule in places:
                            at = np.interp(places[rule], np.arange(len(errors)), np.log(errors))
                            ratio = float(np.exp(at) / np.min(errors))
                        found.setdefault((name, rule), []).append(ratio)
            for name in ("0", "evidence"):
                cells = []
                for rule in total:
                    ratios = np.array(found[name, rule])
                    given = ratios[np.isfinite(ratios)]
                    if name == "evidence":
                        total[rule] += ratios.tolist()
                    cells.append(f"{np.median(given):.2f} ({np.max(given):.1f}) {len(given)}"
                                 if len(given) else "refused")  # fmt: skip
                print(f"| {problem.__name__} | {noise:g} | {name} | " + " | ".join(cells) + " |")
    print("\nmedian (largest) error over the oracle's, and of how many draws it is not refused")
    for rule, every in total.items():
        ratios = np.array(every)
        given = ratios[np.isfinite(ratios)]
        print(f"{rule}, by evidence: given in {len(given) / len(ratios):.0%}, of these within 1.2 "
              f"{np.mean(given <= 1.2):.0%}, within 2 {np.mean(given <= 2):.0%}, "
              f"largest {np.max(given):.1f}")  # fmt: skip


def blocks(rows: int, generator: np.random.Generator) -> Array:
    """A heat that steps every 30 to 200 rows, and rests a quarter of the time."""
    heat, k = np.zeros(rows), int(generator.integers(20, 60))
    while k < rows:
        stop = k + int(generator.integers(30, 200))
        heat[k:stop] = 40e3 * generator.uniform(0.1, 1.0) * (generator.uniform() < 0.75)
        k = stop
    return heat


def impulse_of(wall: Wall, rows: int, dt: float) -> Array:
    unit = np.zeros(rows)
    unit[0] = 1.0
    return wall.back_face(unit, dt)


def estimator_of(wall: Wall, white: float) -> KalmanEstimator:
    """The model of the wall: its slowest modes, as `calibrate` would come near to at best."""
    A, b, c = wall.matrices()
    rates, vectors = np.linalg.eigh(A)
    weights = (c @ vectors) * (vectors.T @ b)
    slow = np.argsort(-rates)[:8]
    modes = Modes(rates[slow].astype(complex), weights[slow].astype(complex))
    return KalmanEstimator(("T_back_degC",), ("q_front_W",), (), ((0, 0, modes),), (), (1.0,),
                           (SensorNoise(white),))  # fmt: skip


def wall_beside_peers(sizes: list[int], white: float, seed: int) -> None:
    """Errors of the heat over its full scale, and times."""
    generator = np.random.default_rng(seed)
    wall, dt = Wall(thickness=0.006), 1.0
    kalman, level = estimator_of(wall, white), 40e3
    print(f"\nwall, noise {white:g} K\n| rows | method | rule | error, % of full scale | s |")
    print("|---|---|---|---|---|")
    for rows in sizes:
        truth = blocks(rows, generator)
        readings = wall.back_face(truth, dt) + white * generator.standard_normal(rows)

        def told(name: str, rule: str, found: Array, seconds: float) -> None:
            error = 100 * float(np.sqrt(np.mean((found - truth) ** 2))) / level  # noqa: B023
            print(f"| {rows} | {name} | {rule} | {error:.2f} | {seconds:.2f} |", flush=True)  # noqa: B023

        clock = dt * np.arange(rows)
        # What is imported late is no part of a time.
        deconvolve(kalman, clock[:200], readings[:200, None], level, DeconvolutionPlan("tikhonov1"))
        for method in ("tikhonov1", "tv", "beck"):
            plan = DeconvolutionPlan(method)
            begun = time.process_time()
            found = deconvolve(kalman, clock, readings[:, None], level, plan)
            seconds = time.process_time() - begun
            told(f"thermaltool {method}", str(found.chosen), found.heat, seconds)
        impulse = impulse_of(wall, min(rows, 4000), dt)
        for peer in (pytikhonov_peer, pylops_peer, cuqi_peer):
            package = {"pytikhonov_peer": "pytikhonov", "pylops_peer": "pylops"}.get(
                peer.__name__, "cuqi"
            )
            if importlib.util.find_spec(package):
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    peer(impulse, readings, truth, white, level, told)


def dense(impulse: Array, rows: int) -> Array:
    from scipy.linalg import toeplitz

    column = np.zeros(rows)
    column[: len(impulse)] = impulse[:rows]
    return np.asarray(np.tril(toeplitz(column)))


Told = Callable[[str, str, Array, float], None]


def pytikhonov_peer(
    impulse: Array, readings: Array, truth: Array, white: float, level: float, told: Told
) -> None:
    """Every rule of pytikhonov, order 1; dense."""
    import pytikhonov

    rows = len(readings)
    if rows > 1000:
        return
    A = dense(impulse, rows) * level
    L = np.eye(rows) - np.eye(rows, k=-1)
    begun = time.process_time()
    family = pytikhonov.TikhonovFamily(A, L, readings, noise_var=white**2)
    made = time.process_time() - begun
    for rule in ("gcvmin", "discrepancy_principle", "lcorner"):
        begun = time.process_time()
        try:
            found = getattr(pytikhonov, rule)(family)
            solution = next(v for k, v in found.items() if k.startswith("x"))
        except Exception as error:  # a peer's own errors are a result
            print(f"| {rows} | pytikhonov | {rule} | {type(error).__name__} | |")
            continue
        told("pytikhonov", rule, level * np.asarray(solution), made + time.process_time() - begun)


def pylops_peer(
    impulse: Array, readings: Array, truth: Array, white: float, level: float, told: Told
) -> None:
    """Regularized inversion of order 1, its weight by bisected discrepancy; split Bregman."""
    import pylops

    rows = len(readings)
    A = pylops.signalprocessing.Convolve1D(rows, h=impulse * level, offset=0, method="fft")
    first = pylops.FirstDerivative(rows, kind="backward", edge=True)
    begun = time.process_time()
    low, high, solution = -6.0, 4.0, np.zeros(rows)
    for _ in range(10):
        middle = (low + high) / 2
        solution = pylops.optimization.leastsquares.regularized_inversion(
            A, readings, [first], epsRs=[10**middle], iter_lim=200
        )[0]
        above = np.mean((readings - A @ solution) ** 2) > white**2
        low, high = (low, middle) if above else (middle, high)
    told("pylops order 1", "discrepancy", level * solution, time.process_time() - begun)
    if rows > 10000:
        return
    # The best of nine weights, chosen by the truth: no rule is part of the package.
    best, seconds = None, 0.0
    for weight in np.geomspace(1e-3, 10.0, 9) * white**2 * 100:
        begun = time.process_time()
        found = pylops.optimization.sparsity.splitbregman(
            A, readings, [first], niter_outer=30, niter_inner=3, mu=1.0, epsRL1s=[weight],
            tol=1e-4, tau=1.0, iter_lim=30, damp=1e-10,
        )[0]  # fmt: skip
        seconds += time.process_time() - begun
        error = float(np.mean((level * found - truth) ** 2))
        if best is None or error < best[0]:
            best = error, found
    told("pylops split Bregman", "by the truth", level * best[1], seconds)


def cuqi_peer(
    impulse: Array, readings: Array, truth: Array, white: float, level: float, told: Told
) -> None:
    """The posterior mean of a Gaussian Markov field, its precision sampled beside it; dense."""
    rows = len(readings)
    if rows > 1000:
        return
    import contextlib
    import os

    from cuqi.distribution import GMRF, Gamma, Gaussian
    from cuqi.model import LinearModel
    from cuqi.problem import BayesianProblem

    begun = time.process_time()
    A = LinearModel(dense(impulse, rows) * level)
    precision = Gamma(1, 1e-4, name="d")
    x = GMRF(np.zeros(rows), lambda d: d, bc_type="zero", name="x")
    y = Gaussian(A @ x, white**2, name="y")
    with (
        open(os.devnull, "w") as nowhere,
        contextlib.redirect_stdout(nowhere),
        contextlib.redirect_stderr(nowhere),
    ):
        samples = BayesianProblem(y, x, precision).set_data(y=readings).sample_posterior(200)
    told("CUQIpy GMRF", "Gibbs", level * samples["x"].mean(), time.process_time() - begun)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", choices=("rules", "wall"))
    parser.add_argument("--draws", type=int, default=30)
    parser.add_argument("--rows", type=int, nargs="+", default=[1000, 10000, 100000])
    parser.add_argument("--noise", type=float, default=0.15, help="[K]")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    if options.part == "rules":
        rules(options.draws, options.seed)
    else:
        wall_beside_peers(options.rows, options.noise, options.seed)


if __name__ == "__main__":
    main()
