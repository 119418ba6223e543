"""Forecasts sample by sample beside padasip, filterpy, river and statsmodels, in one run.

    python benchmarks/streaming.py [--samples 20000] [--seed N]

A simulated ARMA(3,2), drawn fresh: CPU time per sample for the update and a 10-step forecast (with
intervals, here and for statsmodels; the parameter filters of padasip and filterpy are timed for
their update alone), medians of 5 passes; and the one-step error past the first 2000 samples over
that of the innovations. Then `forecast --stream` in a pipe: lines per second from its start to its
end. A peer that is not installed is left out. Exits with 3 when a requirement is missed.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator

import numpy as np
from scipy.signal import lfilter

from thermaltool.timeseries.recursive.arma import RecursiveArma

AR, MA = [1.2, -0.6, 0.1], [0.5, 0.2]
P, Q, STEPS, FORGETTING = 3, 2, 10, 0.999
TRANSIENT, PASSES = 2000, 5
LONGEST, LARGEST_RATIO, LEAST_RATE = 20e-6, 1.02, 40000.0
PIPE = f"""
from sys import stderr
from thermaltool.runtime.forecasts import GATE, Forecasts
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.settings import Settings
from thermaltool.runtime.stream import open_stream
from thermaltool.timeseries.recursive.arma import RecursiveArma
settings, messages = Settings(), Messages(lambda message: print(message, file=stderr))
model = RecursiveArma({P}, {Q}, gate=GATE)
process = Forecasts("e_um", model, settings, messages, {STEPS})
open_stream(process, settings, 0, 1, messages).run()
"""
Errors = Iterator[float]
Float = np.ndarray


def thermaltool(x: Float) -> Errors:
    model = RecursiveArma(P, Q, intercept=False, forgetting=FORGETTING)
    for value in x.tolist():
        yield model.update(value)
        if model.ready:
            model.forecast(STEPS)


def extended(x: Float, filtered: Callable[[Float, float], tuple[float, Float]]) -> Errors:
    """One-step errors of a parameter filter whose regressors are lags and its own residuals."""
    phi = np.zeros(P + Q)
    for value in x.tolist():
        error, theta = filtered(phi, value)
        after = value - float(theta @ phi)
        phi[1:P], phi[0] = phi[: P - 1].copy(), value
        phi[P + 1 :], phi[P] = phi[P:-1].copy(), after
        yield error


def padasip(x: Float) -> Errors:
    from padasip.filters import FilterRLS

    model = FilterRLS(n=P + Q, mu=FORGETTING, eps=0.1, w="zeros")

    def step(phi: Float, value: float) -> tuple[float, Float]:
        error = value - model.predict(phi)
        model.adapt(value, phi)
        return float(error), model.w

    return extended(x, step)


def filterpy(x: Float) -> Errors:
    from filterpy.kalman import KalmanFilter

    model = KalmanFilter(dim_x=P + Q, dim_z=1)
    model.x, model.P, model.R = np.zeros((P + Q, 1)), 10 * np.eye(P + Q), np.eye(1)
    model.F, model.Q = np.eye(P + Q), 1e-7 * np.eye(P + Q)

    def step(phi: Float, value: float) -> tuple[float, Float]:
        model.predict()
        model.update(value, H=phi[None, :])
        return float(model.y[0, 0]), model.x[:, 0]

    return extended(x, step)


def river(x: Float) -> Errors:
    from river.time_series import SNARIMAX

    model = SNARIMAX(p=P, d=0, q=Q)
    for k, value in enumerate(x.tolist()):
        ahead = model.forecast(horizon=STEPS)[0] if k > P + Q else 0.0
        model.learn_one(value)
        yield value - ahead


def statsmodels(x: Float) -> Errors:
    """Known parameters: only the filter runs."""
    from statsmodels.tsa.arima.model import ARIMA

    start = TRANSIENT
    model = ARIMA(x[:start], order=(P, 0, Q), trend="n")
    fitted = model.filter([*AR, *MA, 1.0])
    yield from [0.0] * start
    for k in range(start, min(start + 200, len(x))):
        ahead = fitted.get_forecast(STEPS)
        ahead.conf_int()
        yield float(x[k] - ahead.predicted_mean[0])
        fitted = fitted.extend(x[k : k + 1])


def judged(peer: Callable[[Float], Errors], x: Float, a: Float) -> tuple[float, float]:
    """Seconds per sample and error ratio, past the transient."""
    times = []
    for _ in range(PASSES):
        stream, errors = peer(x), []
        for _ in range(TRANSIENT):
            next(stream)
        begin = time.process_time()
        errors = list(stream)
        times.append((time.process_time() - begin) / len(errors))
    innovations = a[TRANSIENT : TRANSIENT + len(errors)]
    return statistics.median(times), float(
        np.sqrt(np.mean(np.square(errors)) / np.mean(innovations**2))
    )


def lines_per_second(x: Float) -> float:
    lines = b"time_s,e_um\n" + b"".join(
        b"%.4f,%.5f\n" % (0.0005 * k, value) for k, value in enumerate(x)
    )
    rates = []
    for _ in range(PASSES):
        begin = time.perf_counter()
        done = subprocess.run([sys.executable, "-c", PIPE], input=lines, capture_output=True)
        rates.append(len(x) / (time.perf_counter() - begin))
        if done.returncode or done.stdout.count(b"\n") < 0.99 * len(x):
            raise RuntimeError(done.stderr.decode())
    return statistics.median(rates)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=20000)
    parser.add_argument("--seed", type=int, help="entropy of an earlier run")
    options = parser.parse_args()
    seed = np.random.SeedSequence(options.seed)
    print(f"seed {seed.entropy}\n")
    a = np.random.default_rng(seed).standard_normal(options.samples + 500)
    x = lfilter([1, *MA], [1, *[-v for v in AR]], a)[500:]
    a = a[500:]
    missed = []
    print("| | per sample µs | one-step error over ideal |")
    print("|---|---|---|")
    for peer in (thermaltool, padasip, filterpy, river, statsmodels):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                seconds, ratio = judged(peer, x, a)
        except ImportError:
            print(f"| {peer.__name__} | not installed | |")
            continue
        print(f"| {peer.__name__} | {1e6 * seconds:.1f} | {ratio:.3f} |", flush=True)
        if peer is thermaltool and (seconds > LONGEST or ratio > LARGEST_RATIO):
            missed.append("in process")
    rate = lines_per_second(np.tile(x, max(100000 // len(x), 1)))
    print(f"\n`forecast --stream` in a pipe, start included: {rate:.0f} lines/s")
    if rate < LEAST_RATE:
        missed.append("in a pipe")
    if missed:
        print(f"missed: {', '.join(missed)}")
    return 3 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
