"""Transfer functions beside open peers, honest intervals, measured logs: Markdown tables.

``python benchmarks/identify.py speed`` (make bench), ``coverage`` and ``measured`` (make study).
Simulated fits are against the noise-free output, where the true system reaches 100 %. Peers that
are not installed are left out. Seeds are drawn fresh and printed; --seed repeats a run.
"""

from __future__ import annotations

import argparse
import os
import resource
import signal
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

# One core; before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from thermaltool.identification.transfer.choose import choose, first_that_fits, parted, started
from thermaltool.identification.transfer.data import Data, Stretch
from thermaltool.identification.transfer.identify import identify, orders_of

Array = NDArray[np.float64]
DATA = Path(__file__).parents[2] / "shared" / "data"
NOISE, LIMIT_S = 0.1, 60
PEER_SYSTEMS = 4
Truth = tuple[Array, Array, int]


def system(rng: np.random.Generator, k: int) -> Truth:
    """B, F, nk; every fourth is stiff (time constants 2.5 and 500 to 2000 samples)."""
    nk = int(rng.choice([1, 4, 7]))
    if k % 4 == 3:
        poles = np.exp(-1 / np.array([2.5, rng.uniform(500, 2000)]))
    elif k % 4 == 2:
        poles = np.exp(-1 / np.exp(rng.uniform(np.log(2), np.log(60), 2)))
    else:
        radius, angle = rng.uniform(0.6, 0.97), rng.uniform(0.05, 1.2)
        poles = radius * np.exp(1j * angle * np.array([1, -1]))
    F, B = np.poly(poles).real, rng.standard_normal(2)
    return B * rng.uniform(0.5, 3) * F.sum() / B.sum(), F, nk


def driven(rng: np.random.Generator, k: int, rows: int) -> Array:
    held = 50 if k % 4 == 3 else int(rng.choice([1, 5]))
    return np.repeat(rng.standard_normal(rows // held + 1), held)[:rows]


def response(truth: Truth, u: Array) -> Array:
    B, F, nk = truth
    return np.asarray(lfilter(np.concatenate([np.zeros(nk), B]), F, u))


def fit_percent(truth: Array, computed: Array) -> float:
    left = np.linalg.norm(truth - computed) / np.linalg.norm(truth - truth.mean())
    return 100 * (1 - float(left))


def ours(u: Array, y: Array, nk: tuple[int, ...]) -> tuple[Array, str]:
    data = Data((Stretch(u, y),), 1.0, tuple(f"u{i}" for i in range(len(u))))
    model = identify(data, "oe", orders_of("oe", (2,) * len(u), 2, nk))
    return model.respond(u), model.method


def sippy(method: str) -> Callable[[Array, Array, tuple[int, ...]], tuple[Array, str]]:
    def run(u: Array, y: Array, nk: tuple[int, ...]) -> tuple[Array, str]:
        from sippy_unipi import functionsetSIM, system_identification

        if method == "N4SID":
            found = system_identification(y[None], u, method, SS_fixed_order=1 + nk[0])
            x0 = np.zeros((found.A.shape[0], 1))
            _, simulated = functionsetSIM.SS_lsim_process_form(
                found.A, found.B, found.C, found.D, u, x0
            )
            return simulated[0], method
        # Its delay counts on top of the one sample that every model has.
        orders = {"OE_orders": [2, 2, nk[0] - 1], "ARX_orders": [2, 2, nk[0] - 1],
                  "ARMAX_orders": [2, 2, 2, nk[0] - 1]}  # fmt: skip
        found = system_identification(
            y, u[0], method, **{f"{method}_orders": orders[f"{method}_orders"]}
        )
        B = np.ravel(found.G.num[0][0])
        F = np.ravel(found.G.den[0][0])
        B = np.concatenate([np.zeros(len(F) - len(B)), B])
        return np.asarray(lfilter(B, F, u[0])), method

    return run


def sysidentpy(u: Array, y: Array, nk: tuple[int, ...]) -> tuple[Array, str]:
    """Linear polynomial NARX by FROLS, with the true lags offered."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    found = FROLS(order_selection=False, n_terms=4, xlag=list(range(1, nk[0] + 2)), ylag=[1, 2],
                  estimator=LeastSquares(), basis_function=Polynomial(degree=1))  # fmt: skip
    found.fit(X=u.T, y=y[:, None])
    return np.ravel(found.predict(X=u.T, y=y[:, None])), "FROLS"


def nfoursid(u: Array, y: Array, nk: tuple[int, ...]) -> tuple[Array, str]:
    import pandas as pd
    from nfoursid.nfoursid import NFourSID
    from nfoursid.state_space import StateSpace

    frame = pd.DataFrame({"y": y, "u": u[0]})
    method = NFourSID(frame, output_columns=["y"], input_columns=["u"], num_block_rows=10)
    method.subspace_identification()
    found, _ = method.system_identification(rank=2 + nk[0] - 1)
    run = StateSpace(found.a, found.b, found.c, found.d)
    for value in u[0]:
        run.step(np.array([[value]]))
    return np.ravel(np.array(run.ys)), "N4SID"


def control_era(u: Array, y: Array, nk: tuple[int, ...]) -> tuple[Array, str]:
    """Markov parameters by least squares, then the eigensystem realization."""
    import control

    markov = control.markov(y, u[0], m=80, dt=True)
    # The direct term and then the parameters, as the realization takes them.
    found, _ = control.eigensys_realization(np.ravel(markov), r=2 + nk[0] - 1, dt=True)
    return np.asarray(control.forced_response(found, U=u[0]).outputs), "ERA"


PEERS = {
    "SIPPY OE": sippy("OE"),
    "SIPPY ARX": sippy("ARX"),
    "SIPPY ARMAX": sippy("ARMAX"),
    "SIPPY N4SID": sippy("N4SID"),
    "SysIdentPy": sysidentpy,
    "nfoursid": nfoursid,
    "python-control ERA": control_era,
}


def timed(
    run: Callable[..., tuple[Array, str]], u: Array, y: Array, x: Array, nk: tuple[int, ...]
) -> tuple[float, float] | str:
    """Seconds and simulated fit [%], or why there are none."""

    def stop(*_: object) -> None:
        raise TimeoutError(f"more than {LIMIT_S} s")

    signal.signal(signal.SIGALRM, stop)
    signal.alarm(LIMIT_S)
    begun = time.process_time()
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            simulated, _ = run(u, y, nk)
        taken = time.process_time() - begun
        return taken, fit_percent(x, simulated - np.mean(simulated - x))
    except ImportError:
        return "not installed"
    except Exception as error:
        return f"{type(error).__name__}: {error}".splitlines()[0][:60]
    finally:
        signal.alarm(0)


def record(
    seed: int, k: int, rows: int, inputs: int = 1
) -> tuple[Array, Array, Array, list[Truth]]:
    """Inputs, output without and with noise, and the systems."""
    rng = np.random.default_rng([seed, k])
    truths = [system(rng, k + i) for i in range(inputs)]
    u = np.array([driven(rng, k + i, rows) for i in range(inputs)])
    x = np.sum([response(t, each) for t, each in zip(truths, u, strict=True)], axis=0)
    return u, x, x + NOISE * x.std() * rng.standard_normal(rows), truths


def speed(seed: int, systems: int) -> None:
    """Ours on every system and length; the peers on a few at the shortest."""
    print("| rows | inputs | systems | time s, median (worst) | simulated fit %, least | method |")
    print("|---|---|---|---|---|---|")
    for rows, inputs in ((10**4, 1), (10**5, 1), (10**6, 1), (10**4, 3)):
        times, fits, methods = [], [], []
        for k in range(systems):
            u, x, y, truths = record(seed, k, rows, inputs)
            begun = time.process_time()
            simulated, method = ours(u, y, tuple(t[2] for t in truths))
            times.append(time.process_time() - begun)
            fits.append(fit_percent(x, simulated))
            methods.append(method)
        told = ", ".join(f"{methods.count(m)} {m}" for m in dict.fromkeys(methods))
        print(f"| {rows} | {inputs} | {systems} | {np.median(times):.3f} ({max(times):.3f}) | "
              f"{min(fits):.2f} | {told} |", flush=True)  # fmt: skip
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"\nmemory at most {peak:.0f} MiB\n")
    print(f"Peers on {PEER_SYSTEMS} of the systems, 10⁴ rows, at most {LIMIT_S} s each:\n")
    print("| program | " + " | ".join(f"system {k}" for k in range(PEER_SYSTEMS)) + " |")
    print("|---|" + "---|" * PEER_SYSTEMS)
    for name, run in {"thermaltool": ours, **PEERS}.items():
        cells = []
        for k in range(PEER_SYSTEMS):
            u, x, y, truths = record(seed, k, 10**4)
            outcome = timed(run, u, y, x, (truths[0][2],))
            told = (
                outcome if isinstance(outcome, str) else f"{outcome[0]:.3f} s, {outcome[1]:.2f} %"
            )
            cells.append(told)
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


def coverage(seed: int, repeats: int) -> None:
    """Share of 95 % intervals that hold the truth, and bias in standard errors."""
    print("| system | noise | parameter | covered % | bias / standard error |")
    print("|---|---|---|---|---|")
    for k in (0, 2):
        truth = system(np.random.default_rng([seed, k]), k)
        u = driven(np.random.default_rng([seed, k, 1]), k, 3000)[None]
        x, known = response(truth, u[0]), np.concatenate([truth[1][1:], truth[0]])
        gain = truth[0].sum() / truth[1].sum()
        for name, colour in (("white", ([1.0], [1.0])), ("AR(1) 0.8", ([0.6], [1.0, -0.8]))):
            inside, errors, labels = [], [], []
            for repeat in range(repeats):
                e = np.random.default_rng([seed, k, 2, repeat]).standard_normal(3000)
                y = x + NOISE * x.std() * lfilter(*colour, e)
                data = Data((Stretch(u, y),), 1.0, ("u",))
                model = identify(data, "oe", orders_of("oe", (2,), 2, (truth[2],)))
                named = [*model.named(), ("gain", model.gain(0))]
                labels = [label for label, _ in named]
                values = np.array([each.value for _, each in named])
                low = np.array([each.low for _, each in named])
                high = np.array([each.high for _, each in named])
                goal = np.append(known, gain)
                inside.append((low < goal) & (goal < high))
                errors.append((values - goal) / ((high - low) / 2 / 1.96))
            for label, share, bias in zip(labels, np.mean(inside, axis=0),
                                          np.mean(errors, axis=0), strict=True):  # fmt: skip
                print(f"| {k} | {name} | {label} | {100 * share:.1f} | {bias:+.2f} |", flush=True)


def measured() -> None:
    """Free-run fits on the part of each measured log that was not fitted."""
    if not DATA.exists():
        print(f"left out, there is no {DATA} here (measured logs are not copied into the project)")
        return
    print("| log | output | inputs | poles | orders nb,nf,nk | training % | held out % |")
    print("|---|---|---|---|---|---|---|")
    hair = np.genfromtxt(DATA / "daisy/hairdryer_ljung.csv", delimiter=",", skip_header=1)
    heat = np.genfromtxt(DATA / "daisy/heating_system.csv", delimiter=",", skip_header=1)
    _measured("hairdryer", "y", ("u",), hair[:, 0], hair[:, 1], 0.08, 1, 0.5)
    _measured("heating_system", "T", ("u",), heat[:, 1], heat[:, 2], 2.0, 1, 0.5)
    power = heat[:, 1] ** 1.85
    _measured("heating_system", "T", ("u^1.85",), power, heat[:, 2], 2.0, 1, 0.5)
    lines = (DATA / "cnc_spindle/spindle_first_28h.csv").read_text().splitlines()
    names = lines[0].split(",")
    table = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    column = dict(zip(names, table.T, strict=True))
    for target in ("ch1_um", "ch3_um", "ch5_um"):
        for inputs in (("t1_C",), ("t5_C",), ("t9_C",), ("t1_C", "t9_C"), ("spindle_rpm",)):
            u = np.array([column[name] - column[name][0] for name in inputs])
            held = int(inputs == ("spindle_rpm",))
            _measured("cnc_spindle", target, inputs, u, column[target], 15.0, held, 0.6)


def _measured(
    log: str, target: str, inputs: tuple[str, ...], u: Array, y: Array, dt: float, least: int,
    share: float,
) -> None:  # fmt: skip
    data = Data((Stretch(np.atleast_2d(u), y),), dt, inputs, target)
    training, rest = parted(data, share)
    low = (least,) * len(inputs)
    training = started(training, low)
    for real in (False, True):
        choice = choose(training, "oe", low, real=real)
        fit = partial(identify, training, "oe", real=real)
        model = first_that_fits(choice, "oe", fit)
        o, poles = model.orders, "real" if real else "any"
        told = f"{o.nb[0]},{o.nf[0]},{'/'.join(map(str, o.nk))}"
        fits = model.fit(training).fit_percent, model.fit(rest).fit_percent
        print(f"| {log} | {target} | {', '.join(inputs)} | {poles} | {told} | "
              f"{fits[0]:.1f} | {fits[1]:.1f} |", flush=True)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["speed", "coverage", "measured"])
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--systems", type=int, default=24)
    parser.add_argument("--repeats", type=int, default=500)
    chosen = parser.parse_args()
    print(f"## Transfer functions: {chosen.what} (seed {chosen.seed})\n")
    if chosen.what == "speed":
        speed(chosen.seed, chosen.systems)
    elif chosen.what == "coverage":
        coverage(chosen.seed, chosen.repeats)
    else:
        measured()


if __name__ == "__main__":
    main()
