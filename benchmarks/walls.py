"""The flux into a wall from its other face, by the defaults of the tool.

Walls are drawn (thickness, conductivity, films of both faces) whose slowest time constant is 60 to
600 s and whose second one 3 to 60 s. Each is calibrated on one log of steps of a known flux, then a
flux that it has not seen, the steps of a re-entry profile, is estimated from the back face alone,
read with noise. Printed is the fit of the flux, 100 (1 − |error| / |flux − mean|) %: causal, with
`--smooth`, and with `--method tv`; the share of rows within the 95 % band of the smoothed flux, and
the response that `calibrate` has chosen. The walls are finite volumes; `--kind tile` has a layer of
insulation on a metal skin, `--kind block` a skin with a block behind it that carries the sensor.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import thermaltool as tt

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from machines.layered_wall import LayeredWall
from machines.wall import Wall, reentry

Array = NDArray[np.float64]
# Slowest and second time constant [s] of the walls that count, and their asked fit [%].
SLOWEST, SECOND, ASKED = (60.0, 600.0), (3.0, 60.0), 90.0
RISE = 250.0  # of the hot wall in its steady state [K]
DRIVE, SENSOR = "Q_front_W", "T_back_degC"


def drawn(generator: np.random.Generator) -> Wall:
    """A wall with time constants in the asked range."""
    while True:
        wall = Wall(
            thickness=generator.uniform(0.003, 0.04),
            conductivity=float(np.exp(generator.uniform(np.log(1.5), np.log(60.0)))),
            capacity=generator.uniform(1.0e6, 4.2e6),
            film=float(np.exp(generator.uniform(np.log(20.0), np.log(300.0)))),
            back_film=float(np.exp(generator.uniform(np.log(20.0), np.log(300.0)))),
        )
        slowest, second = wall.time_constants()[:2]
        if SLOWEST[0] < slowest < SLOWEST[1] and SECOND[0] < second < SECOND[1]:
            return wall


def layered(generator: np.random.Generator, kind: str) -> LayeredWall:
    """A tile on a metal skin, glued; or a skin with a block behind it that carries the sensor."""

    def between(low: float, high: float) -> float:
        return float(np.exp(generator.uniform(np.log(low), np.log(high))))

    while True:
        front = between(0.003, 0.02), between(1.0, 20.0), generator.uniform(1e6, 3e6)
        skin = between(0.001, 0.006), between(15.0, 150.0), generator.uniform(2e6, 4e6)
        block = generator.uniform(0.004, 0.012), 1e4, generator.uniform(2e6, 4e6)
        layers, cells = ((front, skin), (30, 8)) if kind == "tile" else ((skin, block), (12, 1))
        wall = LayeredWall(
            *zip(*layers, strict=True), (between(200.0, 5000.0),), between(20.0, 300.0),
            between(20.0, 300.0), cells,
        )  # fmt: skip
        slowest, second = wall.time_constants()[:2]
        if SLOWEST[0] < slowest < SLOWEST[1] and SECOND[0] < second < SECOND[1]:
            return wall


def described(wall: Wall | LayeredWall) -> str:
    """Thickness, conductivity and films."""
    if isinstance(wall, Wall):
        made = f"{1e3 * wall.thickness:.1f}, {wall.conductivity:.1f}"
    else:
        made = " + ".join(
            f"{1e3 * thick:.1f}, {conducts:.3g}"
            for thick, conducts in zip(wall.thickness, wall.conductivity, strict=True)
        )
        made += f"; joint {wall.joint[0]:.0f}"
    return f"{made}; {wall.film:.0f} and {wall.back_film:.0f}"


def log_of(
    wall: Wall | LayeredWall, flux: Array, dt: float, noise: float, generator: np.random.Generator
):
    read = 20.0 + wall.back_face(flux, dt) + noise * generator.normal(size=len(flux))
    return pd.DataFrame({"time_s": dt * np.arange(len(flux)), DRIVE: flux, SENSOR: read})


def calibration_flux(
    wall: Wall | LayeredWall, peak: float, dt: float, generator: np.random.Generator
) -> Array:
    """Steps that a lamp can make: two levels, each as long as the wall takes, then rests."""
    slowest = wall.time_constants()[0]
    time = np.arange(0.0, 9.0 * slowest, dt)
    edges = slowest * np.array([0.3, 2.8, 4.6, 5.4, 6.2]) * generator.uniform(0.9, 1.1, 5)
    levels = peak * np.array(
        [0.0, generator.uniform(0.5, 0.8), 0.0, 1.0, generator.uniform(0.2, 0.4), 0.0]
    )
    return levels[np.searchsorted(edges, time, side="right")]


def judged(
    wall: Wall | LayeredWall, options: argparse.Namespace, generator: np.random.Generator
) -> dict:
    dt, noise = options.period, options.noise
    # The largest flux heats the back by RISE in the long run.
    peak = RISE / wall.back_face(np.ones(round(10 * wall.time_constants()[0] / dt)), dt)[-1]
    flux = calibration_flux(wall, peak, dt, generator)
    fit = tt.calibrate(
        log_of(wall, flux, dt, noise, generator), DRIVE, sensors=SENSOR, initial="rest", warn=str
    )
    idle = log_of(wall, np.zeros(2000), dt, noise, generator)
    kind = fit.model.terms[0].response.kind
    delay = getattr(fit.model.terms[0].response, "delay", 0.0)
    found = {"kind": f"{kind} delay={delay:.3g}" if delay else kind}
    try:
        design = tt.regularize(fit, tt.noise(idle, warn=str), warn=str)
    except tt.errors.ThermalToolError as error:
        print(error, file=sys.stderr)
        return found
    found["form"] = design.model.design["form"]
    true = reentry(np.arange(0.0, 1300.0, dt), generator, peak)
    log = log_of(wall, true, dt, noise, generator)
    ways = {"causal": {}, "smoothed": {"smooth": True, "bands": True}, "tv": {"method": "tv"}}
    for name, how in ways.items():
        try:
            each = tt.estimate(design, log, warn=str, **how)
        except tt.errors.ThermalToolError as error:
            print(f"{name}: {error}", file=sys.stderr)
            continue
        found[name] = each.agreements[DRIVE].fit_percent
        if name == "smoothed":
            away = np.abs(each.columns[DRIVE] - true)
            found["band"] = 100 * np.mean(away < 1.96 * each.columns[f"sigma_{DRIVE}"])
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--walls", type=int, default=12)
    parser.add_argument("--kind", choices=["plain", "tile", "block"], default="plain")
    parser.add_argument("--noise", type=float, default=0.15, help="K")
    parser.add_argument("--period", type=float, default=1.0, help="s")
    parser.add_argument("--seed", type=int, help="drawn and printed if absent")
    options = parser.parse_args()
    seed = options.seed
    if seed is None:
        seed = int(np.random.SeedSequence().entropy % 2**32)
    print(
        f"seed {seed}, noise {options.noise:g} K, a row every {options.period:g} s", file=sys.stderr
    )
    heading = ["wall: mm, W/(m K), films W/(m² K)", "time constants, s", "response", "form"]
    heading += ["causal, %", "smoothed, %", "tv, %", "in 95 % band, %"]
    print(f"| {' | '.join(heading)} |\n|{'---|' * len(heading)}", flush=True)
    fits = []
    for number in range(options.walls):
        generator = np.random.default_rng([seed, number])
        wall = drawn(generator) if options.kind == "plain" else layered(generator, options.kind)
        found = judged(wall, options, generator)
        slow = ", ".join(f"{each:.3g}" for each in wall.time_constants()[:3])
        shown = [
            f"{found[name]:.1f}" if name in found else "–"
            for name in ("causal", "smoothed", "tv", "band")
        ]
        told = [described(wall), slow, found["kind"], found.get("form", "refused"), *shown]
        print(f"| {' | '.join(told)} |", flush=True)
        fits.append(found)
    for name in ("causal", "smoothed", "tv"):
        values = np.array([each.get(name, -np.inf) for each in fits])
        print(
            f"{name}: {np.sum(values >= ASKED)} of {len(values)} walls reach {ASKED:g} %, "
            f"median {np.median(values):.1f} %, least {np.min(values):.1f} %"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
