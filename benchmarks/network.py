"""Shared modes (``identify --structure network``): tables for ``benchmarks/identify.py``.

Speed, honest intervals, and the heating system with the nonlinearity of its drive in blocked
cross-validation.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from identify_cases import sampled
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar
from scipy.signal import lfilter

from thermaltool.effects.curve import DriveCurve
from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.network.identify import identify_network
from thermaltool.fitting.network.model import Network
from thermaltool.fitting.network.problem import NetworkProblem
from thermaltool.fitting.network.search import refine, search
from thermaltool.model.curves import Form, SearchedCurve
from thermaltool.record import Record
from thermaltool.signals.agreement import agreement

Array = NDArray[np.float64]
Curve = Callable[[Array], Array]
# Of records, modes and a dead time: the curve in front of the modes, and its exponent.
Drive = Callable[[TrainingData, int, float], tuple[Curve, float]]

PERIOD, NOISE = 5.0, 0.01
LAGS = np.array([1200.0, 200.0, 30.0])
WEIGHTS = np.array([[10.0, 4.0, -2.0], [1.0, 2.0, 1.0]])
NO_DELAY = ((0.0,), (0.0,))
# Exponents of the drive that are looked through; dead times of the lamp and plate [s].
EXPONENTS, DELAYS = (0.7, 3.0), (0.0, 2.0, 4.0, 6.0)


def plant(rng: np.random.Generator, rows: int) -> tuple[Array, Array]:
    """Power, and two outputs of three lags by filters that share no code with the modes."""
    u = np.repeat(rng.uniform(0, 2, rows // 60 + 1), 60)[:rows]
    u[:10] = 0.0
    poles = np.exp(-PERIOD / LAGS)
    modes = np.array([lfilter([0, 1 - z], [1, -z], u) for z in poles])
    return u, WEIGHTS @ modes


def records(u: Array, y: Array, at_rest: bool) -> TrainingData:
    record = sampled(("Q_W",), u, ("a", "b"), y, PERIOD, at_rest=at_rest)
    return TrainingData((record,), ("Q_W",), ("a", "b"), PERIOD)


def speed(seed: int) -> None:
    print("| rows | time s | largest error of a time constant % | MiB of the record |")
    print("|---|---|---|---|")
    for rows in (10**4, 10**5, 10**6):
        rng = np.random.default_rng([seed, rows])
        u, y = plant(rng, rows)
        y = y + NOISE * y.std(axis=1)[:, None] * rng.standard_normal(y.shape)
        begun = time.process_time()
        network = identify_network(records(u, y, False), 3, NO_DELAY)
        taken = time.process_time() - begun
        error = 100 * np.max(np.abs(network.time_constants / LAGS - 1))
        print(f"| {rows} | {taken:.2f} | {error:.3f} | {(u.nbytes + y.nbytes) / 2**20:.1f} |",
              flush=True)  # fmt: skip


def coverage(seed: int, repeats: int, rows: int = 1500) -> None:
    """Share of 95 % intervals that hold the truth, and bias in standard errors."""
    print("| start | noise | shown | covered %, least to most | all | bias / standard error |")
    print("|---|---|---|---|---|---|")
    u, clean = plant(np.random.default_rng([seed, 0]), rows)
    truth = np.concatenate([LAGS, *([*w, w.sum()] for w in WEIGHTS)])
    shown = {"time constants": slice(0, 3), "weights and gains": slice(3, None)}
    for at_rest in (True, False):
        for name, colour in (("white", ([1.0], [1.0])), ("AR(1) 0.8", ([0.6], [1.0, -0.8]))):
            inside, errors = [], []
            for repeat in range(repeats):
                e = np.random.default_rng([seed, 1, repeat]).standard_normal(clean.shape)
                e[1] = 0.6 * e[0] + 0.8 * e[1]
                y = clean + NOISE * clean.std(axis=1)[:, None] * lfilter(*colour, e, axis=1)
                data = records(u, y, at_rest)
                network = identify_network(data, 3, NO_DELAY)
                found = [*network.outputs[0].time_constant_estimates()]
                found += [e for s in network.outputs for e in (*s.weight_estimates(0), s.gain(0))]
                value, low, high = np.array([(e.value, e.low, e.high) for e in found]).T
                inside.append((low < truth) & (truth < high))
                errors.append((value - truth) / ((high - low) / 2 / 1.96))
            for what, part in shown.items():
                shares = 100 * np.mean(inside, axis=0)[part]
                bias = np.abs(np.mean(errors, axis=0)[part]).max()
                print(f"| {'rest' if at_rest else 'unknown'} | {name} | {what} | "
                      f"{shares.min():.1f} to {shares.max():.1f} | {shares.mean():.1f} | "
                      f"{bias:.2f} at most |", flush=True)  # fmt: skip
    ratios = [_narrower(seed, repeat, u, clean) for repeat in range(20)]
    text = ", ".join(f"{ratio:.2f}" for ratio in np.mean(ratios, axis=0))
    print(f"\nErrors that are independent: intervals of the time constants {text} times as wide as "
          "those of the better one of two separate fits.")  # fmt: skip


def _narrower(seed: int, repeat: int, u: Array, clean: Array) -> Array:
    """Widths of the intervals of shared time constants, of the least of separate fits."""
    e = np.random.default_rng([seed, 2, repeat]).standard_normal(clean.shape)
    data = records(u, clean + NOISE * clean.std(axis=1)[:, None] * e, True)
    found = [data, *(data.only(k) for k in range(2))]
    widths = []
    for each in found:
        share = identify_network(each, 3, NO_DELAY[: len(each.outputs)]).outputs[0]
        widths.append([np.log(e.high / e.low) for e in share.time_constant_estimates()])
    return np.asarray(widths[0] / np.min(widths[1:], axis=0))


def heating(path: Path) -> None:
    """The lamp's voltage through a power law, or a monotone curve, and shared modes."""
    t, u, y = np.genfromtxt(path, delimiter=",", skip_header=1).T
    print("\n| heating system | modes | drive | exponents | whole record % | held out, state from "
          "the block % | held out, carried on % |")  # fmt: skip
    print("|---|---|---|---|---|---|---|")
    for blocks in (5, 10):
        for modes in (1, 2):
            for name, fitted in DRIVES.items():
                # A curve of five numbers and two modes take minutes.
                if modes == 1 or fitted is not _monotone:
                    _row(name, fitted, blocks, modes, t, u, y)


def _row(name: str, fitted: Drive, blocks: int, modes: int, t: Array, u: Array, y: Array) -> None:
    """State from the block: it parts the record. Carried on: the rows around it give its state."""
    own, carried, exponents = np.full(len(y), np.nan), np.full(len(y), np.nan), []
    every = np.ones(len(y), bool)
    whole = _records(t, u, y, every)
    curve, network, _ = _bent(fitted, whole, modes)
    inside = network.fit(_through(whole, curve))[0].fit_percent
    for k in range(blocks):
        held = np.arange(len(y)) * blocks // len(y) == k
        curve, network, exponent = _bent(fitted, _records(t, u, y, ~held), modes)
        exponents.append(exponent)
        own[held] = network.run(_through(_records(t, u, y, held), curve))[0]
        if k:
            hidden = _records(t, u, np.where(held, np.nan, y), every)
            curve, network, _ = _bent(fitted, hidden, modes)
            carried[held] = network.run(_through(hidden, curve))[0][held]
    text = f"{min(exponents):.2f} to {max(exponents):.2f}" if np.isfinite(exponents).all() else ""
    print(f"| {blocks} blocks | {modes} | {name} | {text} | {inside:.1f} | "
          f"{agreement(y, own).fit_percent:.1f} | {agreement(y, carried).fit_percent:.1f} |",
          flush=True)  # fmt: skip


def _records(t: Array, u: Array, y: Array, rows: NDArray[np.bool_]) -> TrainingData:
    record = Record(t, {"u": np.where(rows, u, np.nan), "T": y})
    return TrainingData(tuple(record.pieces(["u"])), ("u",), ("T",), float(t[1] - t[0]))


def _through(data: TrainingData, curve: Curve) -> TrainingData:
    parts = (replace(r.with_columns({"u": curve(r.columns["u"])}), at_rest=False)
             for r in data.records)  # fmt: skip
    return replace(data, records=tuple(parts))


def _bent(fitted: Drive, data: TrainingData, modes: int) -> tuple[Curve, Network, float]:
    """The curve of largest likelihood over the dead times, and the network behind it."""
    tried = []
    for delay in DELAYS:
        curve, exponent = fitted(data, modes, delay)
        network = identify_network(_through(data, curve), modes, ((delay,),))
        tried.append((curve, network, exponent))
    return min(tried, key=lambda each: each[1].criteria.deviance)


def _criterion(data: TrainingData, modes: int, delay: float) -> Callable[[Curve], float]:
    """Of a curve, the time constants searched from where the last curve had them."""
    lags = [search(NetworkProblem(data, ((delay,),)), modes).time_constants]

    def value(curve: Curve) -> float:
        found = refine(NetworkProblem(_through(data, curve), ((delay,),)), lags[0])
        lags[0] = found.time_constants
        return found.criterion

    return value


def _linear(data: TrainingData, modes: int, delay: float) -> tuple[Curve, float]:
    return (lambda u: u), float("nan")


def _square(data: TrainingData, modes: int, delay: float) -> tuple[Curve, float]:
    return np.square, 2.0


def _power(data: TrainingData, modes: int, delay: float) -> tuple[Curve, float]:
    value = _criterion(data, modes, delay)
    found = minimize_scalar(lambda p: value(lambda u: np.abs(u) ** p), bounds=EXPONENTS,
                            method="bounded", options={"xatol": 0.01})  # fmt: skip
    p = float(found.x)
    return (lambda u: np.abs(u) ** p), p


def _monotone(data: TrainingData, modes: int, delay: float) -> tuple[Curve, float]:
    """The spline of ``correct`` with as stiff steps."""
    highest = max(float(np.max(u)) for u in data.u)
    place = SearchedCurve("u", DriveCurve, Form("spline", 6), 0.0, highest, True)
    value = _criterion(data, modes, delay)

    def price(p: Array) -> float:
        return value(place.curve(p).bent) + 0.5 * float(np.sum(place.roughness(p) ** 2))

    found = minimize(price, place.start(), method="L-BFGS-B", bounds=[(-6, 6)] * place.size,
                     options={"maxiter": 20, "eps": 1e-3})  # fmt: skip
    return place.curve(found.x).bent, float("nan")


DRIVES = {"linear": _linear, "square": _square, "power law": _power, "monotone curve": _monotone}
