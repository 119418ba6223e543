"""Heat from temperatures: causal, with look-ahead, smoothed, beside a smoother that knows all.

For each machine models are calibrated on logs of their own, the estimator is designed for the heat,
and duties are drawn with fresh noise. Printed are the root mean squared errors of the heat over its
level: of the causal estimate, with 20 s of look-ahead, smoothed over the whole record (walk and
noise by maximum likelihood from the record itself), and of the reference: the conditional mean of
the heat given all readings, for the true plant, the true noise and the true mean square of the
heat's steps, written out as one dense system. Then the share of rows within the 95 % band of each,
and of draws on which model and machine are said to have parted.

The machines are a finite-element frame and a rod and a wall of finite volumes; a step response of
each, convolved with the heat, gives the truth.
"""

from __future__ import annotations

import argparse
import sys
import time as wall_clock
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, toeplitz

import thermaltool as tt
from thermaltool.plants.frame import FrameGeometry, build

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from machines.heated_rod import HeatedRod
from machines.wall import Wall

Array = NDArray[np.float64]
ROWS, CALIBRATION_ROWS = 1500, 3000
LOOKAHEAD = 20.0


@dataclass(frozen=True)
class Noise:
    """White, and a stationary Ornstein-Uhlenbeck drift, of every sensor."""

    white: float
    drift: float = 0.0
    drift_time: float = 900.0

    def draw(self, shape: tuple[int, int], dt: float, generator: np.random.Generator) -> Array:
        noise = self.white * generator.standard_normal(shape)
        if self.drift:
            stays, slow = np.exp(-dt / self.drift_time), np.empty(shape)
            shocks = self.drift * generator.standard_normal(shape)
            slow[0] = shocks[0]
            for k in range(1, len(slow)):
                slow[k] = stays * slow[k - 1] + np.sqrt(1 - stays**2) * shocks[k]
            noise += slow
        return noise

    def covariance(self, rows: int, dt: float) -> Array:
        stays = np.exp(-dt * np.arange(rows) / self.drift_time)
        return self.white**2 * np.eye(rows) + self.drift**2 * toeplitz(stays)


@dataclass(frozen=True)
class Case:
    """A machine as it was calibrated, as it is now, and its sensors.

    ``calibrated`` and ``steps`` are step responses, shape (rows, sensors, drives).
    """

    name: str
    calibrated: Array
    steps: Array
    level: float
    dt: float
    noise: Noise
    block: tuple[float, float] = (60.0, 400.0)

    @property
    def drives(self) -> int:
        return self.steps.shape[2]

    def heat(self, rows: int, generator: np.random.Generator) -> Array:
        heat = np.zeros((rows, self.drives))
        for each in heat.T:
            k = round(generator.uniform(30.0, 120.0) / self.dt)
            while k < rows:
                stop = k + max(round(generator.uniform(*self.block) / self.dt), 1)
                each[k:stop] = self.level * generator.uniform() * (generator.uniform() < 0.75)
                k = stop
        return heat

    def readings(self, steps: Array, heat: Array, generator: np.random.Generator) -> Array:
        rows = len(heat)
        jumps = np.diff(heat, axis=0, prepend=0.0)
        clean = np.zeros((rows, steps.shape[1]))
        size = 2 * rows
        for sensor in range(steps.shape[1]):
            for drive in range(self.drives):
                product = np.fft.rfft(jumps[:, drive], size) * np.fft.rfft(
                    steps[:rows, sensor, drive], size
                )
                clean[:, sensor] += np.fft.irfft(product, size)[:rows]
        return clean + self.noise.draw(clean.shape, self.dt, generator)

    def log(self, steps: Array, heat: Array, generator: np.random.Generator) -> pd.DataFrame:
        read = self.readings(steps, heat, generator)
        columns = {"time_s": self.dt * np.arange(len(heat))}
        columns |= {f"Q_{'ab'[k]}_W": heat[:, k] for k in range(self.drives)}
        columns |= {f"dT_{k}_K": read[:, k] for k in range(read.shape[1])}
        return pd.DataFrame(columns)


def reference(case: Case, generator: np.random.Generator) -> Array:
    """The matrix that leads from all readings to the conditional mean of all heats."""
    many = case.heat(40 * ROWS, generator)
    walk = np.mean(np.diff(many, axis=0) ** 2)  # in a row
    rows = np.arange(ROWS)
    prior = walk * np.minimum.outer(rows, rows)
    impulse = np.diff(case.steps[:ROWS], axis=0, prepend=0.0)
    # Heat k acts from its row on: the first row that it reaches is k + 1.
    H = np.block([[np.tril(toeplitz(impulse[:, s, d])) for d in range(case.drives)]
                  for s in range(case.steps.shape[1])])  # fmt: skip
    Q = np.kron(np.eye(case.drives), prior)
    R = np.kron(np.eye(case.steps.shape[1]), case.noise.covariance(ROWS, case.dt))
    HQ = H @ Q
    factor = cho_factor(HQ @ H.T + R)
    return np.asarray(cho_solve(factor, HQ).T)


def model_of(case: Case, generator: np.random.Generator) -> tt.DesignReport:
    """The tool's own way: calibrate, noise, regularize."""
    rows = CALIBRATION_ROWS
    heat = np.zeros((rows, case.drives))
    for k, each in enumerate(heat.T):
        each[:] = case.heat(rows, generator)[:, k]
        each[round((0.02 + 0.05 * k) * rows) : round(0.4 * rows)] = case.level
        each[round(0.4 * rows) : round((0.65 + 0.1 * k) * rows)] = 0.0
    steps = case.calibrated
    log = case.log(steps, heat, generator)
    drives = [name for name in log if name.startswith("Q_")]
    sensors = [name for name in log if name.startswith("dT_")]
    fit = tt.calibrate(log, drives, sensors=sensors, initial="rest", warn=str)
    idle = case.log(steps, 0 * heat, generator)
    return tt.regularize(fit, tt.noise(idle, warn=str), form="kalman", warn=str)


def cases() -> list[Case]:
    rod, wall = HeatedRod(), Wall(film=65.0)
    lossy = HeatedRod(film=1.5 * rod.film)
    rows, dt = CALIBRATION_ROWS, 2.0

    def rod_steps(places: tuple[float, ...], drives: int, body: HeatedRod = rod) -> Array:
        return body.step_responses(places, dt, rows)[:, :, :drives]

    flux = np.ones(rows)
    back = wall.back_face(flux, 1.0)[:, None, None]
    frame = [build(FrameGeometry(film_coefficient=film)) for film in (13.5, 20.25)]
    pairs = ["dT_pair1_K", "dT_pair2_K", "dT_pair3_K"]
    probes = [each.simulate(flux, 0 * flux, dt) for each in frame]
    near, three, lost = (
        np.stack([probe[name] for name in names], axis=1)[:, :, None]
        for probe, names in ((probes[0], pairs[:1]), (probes[0], pairs), (probes[1], pairs))
    )
    frame_noise, rod_noise = Noise(0.02, 0.008), Noise(0.02, 0.01)
    near_rod, far_rod = rod_steps((0.15,), 1), rod_steps((0.7,), 1)
    both = rod_steps((0.15, 0.8), 2)
    two_probes = rod_steps((0.15, 0.5), 1)
    lossy_probes = rod_steps((0.15, 0.5), 1, lossy)
    return [
        Case("frame, one pair", near, near, 1.0, dt, frame_noise),
        Case("frame, three pairs", three, three, 1.0, dt, frame_noise),
        Case("frame, three pairs, loss + 50 %", three, lost, 1.0, dt, frame_noise),
        Case("rod", near_rod, near_rod, 20.0, dt, rod_noise),
        Case("rod, two sources", both, both, 20.0, dt, rod_noise),
        Case("rod, remote sensor", far_rod, far_rod, 20.0, dt, rod_noise),
        Case("rod, 10 x noise", near_rod, near_rod, 20.0, dt, Noise(0.2, 0.1)),
        Case("rod, AR(1) noise", near_rod, near_rod, 20.0, dt, Noise(0.02, 0.05, 30.0)),
        Case("rod, two probes, loss + 50 %", two_probes, lossy_probes, 20.0, dt, rod_noise),
        Case("wall, other face", back, back, 3e4, 1.0, Noise(0.15)),
    ]


def judged(case: Case, models: int, draws: int, generator: np.random.Generator) -> list[str]:
    """One line of the table."""
    gain = reference(case, generator)
    squares: dict[str, list[float]] = {}
    inside: dict[str, list[float]] = {}
    parted = []
    for draw in range(models * draws):
        if draw % draws == 0:
            design = model_of(case, generator)
        heat = case.heat(ROWS, generator)
        log = case.log(case.steps, heat, generator)
        drives = [name for name in log if name.startswith("Q_")]
        read = log.drop(columns=drives)
        found = {
            "causal": tt.estimate(design, read, bands=True, warn=str),
            "look-ahead": tt.estimate(design, read, lag=LOOKAHEAD, bands=True, warn=str),
            "smoothed": tt.estimate(design, read, smooth=True, bands=True, warn=str),
        }
        parted.append(found["smoothed"].found.alarm.row is not None)
        for name, each in found.items():
            error = np.stack([each.columns[q] for q in drives], axis=1) - heat
            squares.setdefault(name, []).append(float(np.mean(error**2)))
            sigma = np.stack([each.columns[f"sigma_{q}"] for q in drives], axis=1)
            within = float(np.mean(np.abs(error) < 1.96 * sigma))
            inside.setdefault(name, []).append(within)
        y = read.drop(columns="time_s").to_numpy().T.ravel()
        best = (gain @ y).reshape(case.drives, ROWS).T
        squares.setdefault("reference", []).append(float(np.mean((best - heat) ** 2)))
    rmse = {name: np.sqrt(np.mean(each)) / case.level for name, each in squares.items()}
    return [
        case.name,
        *(f"{rmse[name]:.4f}" for name in ("causal", "look-ahead", "smoothed", "reference")),
        f"{rmse['look-ahead'] / rmse['causal']:.2f}",
        f"{rmse['smoothed'] / rmse['causal']:.2f}",
        f"{rmse['smoothed'] / rmse['reference']:.2f}",
        " / ".join(f"{100 * np.mean(each):.1f}" for each in inside.values()),
        " / ".join(
            f"{100 * np.mean(np.reshape(each, (models, draws)), axis=1).min():.1f}"
            for each in inside.values()
        ),
        f"{100 * np.mean(parted):.0f}",
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", type=int, default=1, help="calibrations for each machine")
    parser.add_argument("--draws", type=int, default=10, help="duties for each model")
    parser.add_argument("--seed", type=int, help="drawn and printed if absent")
    parser.add_argument("--only", default="", help="cases whose name has this")
    options = parser.parse_args()
    seed = options.seed
    if seed is None:
        seed = int(np.random.SeedSequence().entropy % 2**32)
    print(
        f"seed {seed}, {options.models} models, {options.draws} draws of {ROWS} rows each",
        file=sys.stderr,
    )
    heading = ["machine", "causal", "20 s ahead", "smoothed", "reference", "20 s / causal"]
    heading += ["smoothed / causal", "smoothed / reference"]
    heading += ["in 95 % bands (causal / 20 s / smoothed), %", "of the model with least, %"]
    heading += ["parted, %"]
    print(f"| {' | '.join(heading)} |\n|{'---|' * len(heading)}", flush=True)
    for number, case in enumerate(cases()):
        if options.only in case.name:
            start = wall_clock.perf_counter()
            generator = np.random.default_rng([seed, number])
            print(
                f"| {' | '.join(judged(case, options.models, options.draws, generator))} |",
                flush=True,
            )
            print(f"{wall_clock.perf_counter() - start:.0f} s", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
