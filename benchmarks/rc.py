"""Networks of ``thermaltool rc`` on chains of lumped capacities: coverage, choice, speed.

``python benchmarks/rc.py coverage|choice|speed [--repeat N] [--seed N]``

- coverage: share of 95 % intervals that hold the truth, of each parameter of a chain of two nodes.
- choice: how often the likelihood ratio takes the right one of 1, 2 and 3 nodes; size of the tests.
- speed: seconds of one fit on an even clock and on one of jittered steps.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from machines.lumped import Chain, declaration, inputs

from thermaltool.fitting.rc.compare import SIGNIFICANCE, compare
from thermaltool.fitting.rc.declaration import load_network
from thermaltool.fitting.rc.fit import fit_network
from thermaltool.record import Record

CHAINS = {
    1: Chain((800.0,), (3.0,)),
    2: Chain((800.0, 4000.0), (5.0, 8.0)),
    3: Chain((400.0, 1500.0, 6000.0), (5.0, 8.0, 6.0)),
}
PERIOD = 10.0


def log(chain: Chain, rows: int, rng: np.random.Generator, jitter: float = 0.0) -> Record:
    clock, heat, room = inputs(rows, PERIOD, rng)
    clock = clock + jitter * PERIOD * rng.uniform(-0.5, 0.5, rows)
    readings = chain.run(clock, heat, room, rng)
    return Record(clock, {"Q_motor_W": heat, "T_room_degC": room, "T_motor_degC": readings})


def truth(chain: Chain) -> dict[str, float]:
    names = ["motor", "frame", "foot"][: len(chain.capacity)]
    ends = [*names[1:], "T_room_degC"]
    return {
        "nodes.motor.diffusion": chain.diffusion,
        "nodes.motor.noise": chain.noise,
        **{f"nodes.{n}.capacity": C for n, C in zip(names, chain.capacity, strict=True)},
        **{f"links.{a}-{b}.conductance": G
           for a, b, G in zip(names, ends, chain.conductance, strict=True)},
    }  # fmt: skip


def network(nodes: int):
    return load_network(declaration(nodes), str(nodes), "<benchmark>")


def coverage(repeat: int, rng: np.random.Generator, rows: int = 600) -> None:
    chain, held = CHAINS[2], dict.fromkeys(truth(CHAINS[2]), 0)
    for _ in range(repeat):
        fit = fit_network(network(2), [log(chain, rows, rng)])
        for name, value in truth(chain).items():
            held[name] += fit.estimates[name].low <= value <= fit.estimates[name].high
    print(f"{repeat} logs of {rows} rows: 95 % intervals that hold the truth")
    for name, count in held.items():
        print(f"  {name:<36} {100 * count / repeat:5.1f} %")
    print(f"  {'mean':<36} {100 * sum(held.values()) / repeat / len(held):5.1f} %")


def choice(repeat: int, rng: np.random.Generator, rows: int = 600) -> None:
    for nodes, chain in CHAINS.items():
        chosen, rejected = [], 0
        for _ in range(repeat):
            record = log(chain, rows, rng)
            fits = []
            for n in (1, 2, 3):
                known = fits[-1].values if fits else {}
                at_most = min((f.deviance for f in fits), default=np.inf)
                fits.append(fit_network(network(n), [record], known=known, at_most=at_most))
            found = compare(fits)
            chosen.append(len(found.sufficient.network.nodes))
            rejected += any(
                t.p_value < SIGNIFICANCE for t in found.tests
                if (t.smaller, t.larger) == (f"{nodes} nodes", f"{nodes + 1} nodes")
            )  # fmt: skip
        counts = {n: chosen.count(n) for n in (1, 2, 3)}
        size = f", refused for the next {100 * rejected / repeat:.1f} %" * (nodes < 3)
        print(f"truth {nodes}, {repeat} logs of {rows} rows: chosen {counts}{size}", flush=True)


def speed(repeat: int, rng: np.random.Generator) -> None:
    for rows in (1000, 10_000):
        for jitter in (0.0, 0.5):
            record = log(CHAINS[2], rows, rng, jitter)
            for n in (1, 2, 3):
                begin = time.perf_counter()
                fit_network(network(n), [record])
                seconds = time.perf_counter() - begin
                clock = "jittered" if jitter else "even"
                print(f"{rows} rows, {clock} clock, {n} nodes: {seconds:.1f} s", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["coverage", "choice", "speed"])
    parser.add_argument("--repeat", type=int, default=200)
    parser.add_argument("--seed", type=int, default=None)
    options = parser.parse_args()
    seed = np.random.SeedSequence(options.seed)
    print(f"seed {seed.entropy}")
    {"coverage": coverage, "choice": choice, "speed": speed}[options.what](
        options.repeat, np.random.default_rng(seed)
    )
