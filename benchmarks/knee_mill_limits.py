"""What the departure of the knee mill leaves in temperatures: the best that any model could do.

``python benchmarks/knee_mill_limits.py``: no noise, the linear part exact (superposed steps of
Q = 1). Each form is fitted by least squares with a slight ridge to steps of Q = 0.5 and 2, and the
share of the largest departure that it removes is printed for the other runs, x / y in per cent:
of all, of the part that temperatures make, and of the part that forces of the contact make.

Laws of the level have a free function of time for each of two powers of Q. Contact temperatures are
those of all pairs of nodes on both sides, at once and through 1500 s; the ones that together say
most of the fitted steps are taken one after another. Bend and slip go by the temperature
difference z beside the source: z|z| at once and through 3000 s, beside the upper contact
temperature through 1500 s; a slip is z minus its play, which stays when z turns. Pairs of a source
and a sink are those of
Fraser (1997, 7.4.5 and 7.4.6): conduction from each to both probes by one function of distance,
heats that step with Q, deflections of the heats by four lags, heats of other runs by regularized
deconvolution.
"""

from __future__ import annotations

import argparse
import os

# One core; before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.optimize import least_squares
from scipy.signal import lfilter

from thermaltool.plants.jointed import JointedPlant
from thermaltool.plants.knee_mill import JOINT_PROBES, KneeMillGeometry, build
from thermaltool.responses import response_class

Array = NDArray[np.float64]
Run = dict[str, Array]
STEP, ROWS = 60.0, 151  # of a step: 9000 s
TABLE_LOAD = 4448.0  # 1000 lb [N]
FITTED = ("Q 0.5", "Q 2")
JUDGED = ("Q 1.5", "Q 2", "Q 3", "1000 lb, Q 1", "1000 lb, Q 2", "up and down", "random")
RIDGE = 1e-5
PARTS = {"all": (0, 1), "by temperatures": (0,), "by contact forces": (1,)}
# Half the width of a strip, by which a probe is beside a source [cm]; heights of two sources
# above the knee's lower edge [cm]; lags of deflections [s]; weight of the deconvolution's steps.
ASIDE, HEIGHTS, LAGS, SMOOTH = 4.0, (36.0, 10.0), (300.0, 1000.0, 3000.0, 8000.0), 0.1
PROBES = ("T_joint1_degC", "T_joint3_degC")
SLIPS = (2.0, 4.0)  # widths of the play [K]


def simulate(plant: JointedPlant, heat: Array, load: float) -> Run:
    """Temperatures of the pairs and of two probes, and both parts of the deflections."""
    run, bodies = plant.start(STEP, load), plant.bodies
    column, knee = bodies.sides
    first, rows = bodies.deflection_by_force @ run.contact.force, []
    for level in heat:
        by_force = bodies.deflection_by_force @ run.contact.force - first
        probes = [plant.rows[name] @ run.rise for name in PROBES]
        by_heat = bodies.deflection_by_heat @ run.rise
        near = [plant.rows["dT_main_K"] @ run.rise]
        pairs = run.rise[column], run.rise[knee]
        rows.append(np.concatenate([by_heat, by_force, probes, near, *pairs]))
        run.advance(float(level), 0.0)
    found = np.array(rows)
    return {
        "heat": heat,
        "deflection": found[:, :4],
        "probes": found[:, 4:6],
        "bent": bent_by(found[:, 6]),
        "pairs": found[:, 7:],
    }


def bent_by(z: Array) -> Array:
    """Bend and slips by a temperature, shape (n, 1 + slips)."""
    widths, place, slips = np.array(SLIPS), np.zeros(len(SLIPS)), []
    for value in z:
        place = np.clip(place, value - widths / 2, value + widths / 2)
        slips.append(value - place)
    return np.column_stack([z * np.abs(z), slips])


def every_run(plant: JointedPlant) -> dict[str, Run]:
    """Departures from the superposed response to Q = 1."""
    levels = np.repeat(np.random.default_rng(0).uniform(0.0, 2.5, 8), 25)
    inputs = {f"Q {q:g}": (np.full(ROWS, q), 0.0) for q in (0.5, 1.0, 1.5, 2.0, 3.0)}
    inputs |= {
        "1000 lb, Q 1": (np.ones(ROWS), TABLE_LOAD),
        "1000 lb, Q 2": (np.full(ROWS, 2.0), TABLE_LOAD),
        "up and down": (np.repeat([2.0, 0.0], [ROWS - 1, ROWS]), 0.0),
        "random": (levels, 0.0),
    }
    one = simulate(plant, np.ones(2 * ROWS), 0.0)
    found = {name: simulate(plant, *given) for name, given in inputs.items()}
    for run in found.values():
        for name in ("deflection", "probes", "bent", "pairs"):
            run[name] = run[name] - superposed(run["heat"], one[name])
    return found


def superposed(heat: Array, step: Array) -> Array:
    """Answer to a heat, from the step response, each shape (n, outputs)."""
    out = np.zeros((len(heat), step.shape[1]))
    for k, change in enumerate(np.diff(heat, prepend=0.0)):
        if change:
            out[k:] += change * step[: len(heat) - k]
    return out


def lag(x: Array, tau: float) -> Array:
    decay = np.exp(-STEP / tau)
    before = 1 - (1 - decay) * tau / STEP
    return np.asarray(lfilter([before, 1 - decay - before], [1, -decay], x, axis=0))


def solved(columns: Array, wanted: Array) -> Array:
    size = np.sqrt(np.mean(columns**2, axis=0)) + 1e-12
    scaled = columns / size
    normal = scaled.T @ scaled + RIDGE * len(scaled) * np.eye(scaled.shape[1])
    return np.asarray((np.linalg.solve(normal, scaled.T @ wanted).T / size).T)


def removed(left: Array, whole: Array) -> str:
    share = 100 * (1 - np.max(np.abs(left), axis=0) / np.max(np.abs(whole), axis=0))
    return " / ".join(f"{v:.0f}" for v in share)


def fit_line(signals: dict[str, Array], wanted: dict[str, Array]) -> str:
    gains = solved(*(np.vstack([each[name] for name in FITTED]) for each in (signals, wanted)))
    return " | ".join(removed(wanted[c] - signals[c] @ gains, wanted[c]) for c in JUDGED)


def law_line(powers: tuple[float, float], wanted: dict[str, Array]) -> str:
    """Steps alone: two powers of Q that vanish at Q = 1, each with a free function of time."""

    def forms(q: float) -> list[float]:
        return [q**p - q for p in powers]

    shapes = np.linalg.solve(
        [forms(0.5), forms(2.0)], np.stack([wanted[n] for n in FITTED]).reshape(2, -1)
    )
    cells = []
    for case in JUDGED:
        told = (
            (np.array(forms(float(case[2:]))) @ shapes).reshape(ROWS, -1)
            if case[0] == "Q"
            else None
        )
        cells.append("" if told is None else removed(wanted[case] - told, wanted[case]))
    return " | ".join(cells)


def pairs_lines(runs: dict[str, Run], wanted: dict[str, Array]) -> dict[str, str]:
    """One, two and four contact temperatures of all pairs."""
    whole = {
        name: np.stack([run["pairs"], lag(run["pairs"], 1500.0)]) for name, run in runs.items()
    }
    target = np.vstack([wanted[name] for name in FITTED])
    target = target / np.max(np.abs(target), axis=0)

    def signals(chosen: list[int]) -> dict[str, Array]:
        return {
            n: x[:, :, chosen].transpose(1, 0, 2).reshape(len(x[0]), -1) for n, x in whole.items()
        }

    def left(chosen: list[int]) -> float:
        of = signals(chosen)
        columns = np.vstack([of[name] for name in FITTED])
        return float(np.sum((target - columns @ solved(columns, target)) ** 2))

    chosen: list[int] = []
    lines = {}
    for count in range(1, 5):
        free = [k for k in range(whole[FITTED[0]].shape[2]) if k not in chosen]
        chosen.append(min(free, key=lambda k: left([*chosen, k])))
        if count in (1, 2, 4):
            lines[f"best {count} contact temperatures"] = fit_line(signals(chosen), wanted)
    return lines


def bends(runs: dict[str, Run]) -> dict[str, dict[str, Array]]:
    """Bend and upper contact temperature, alone and with a slip."""
    found: dict[str, dict[str, Array]] = {}
    for k, slip in enumerate(("", *(f", slip {width:g} K" for width in SLIPS))):
        found[f"bend, T_joint1{slip}"] = {
            name: np.column_stack(
                [
                    run["bent"][:, 0],
                    lag(run["bent"][:, 0], 3000.0),
                    lag(run["probes"][:, 0], 1500.0),
                    *([run["bent"][:, k]] if k else []),
                ]
            )
            for name, run in runs.items()
        }
    return found


def sources(runs: dict[str, Run]) -> tuple[dict[str, Array], float]:
    """Heats of two pairs of source and sink in every run, and the misfit of their temperatures."""
    kind = response_class("conduction")
    time = STEP * np.arange(ROWS)
    at = [100 * JOINT_PROBES[name] for name in PROBES]
    far = [[np.hypot(probe - source, ASIDE) for probe in at] for source in HEIGHTS]

    def steps(theta: Array) -> Array:
        a, alpha = np.exp(theta).reshape(2, 2)
        return np.array([[kind(K=1.0, a=a[i], alpha=alpha[i], r=r, r0=0.12).step(time)
                          for r in far[i]] for i in range(2)])  # fmt: skip

    def misfit(theta: Array) -> Array:
        columns, found = np.hstack(steps(theta)).T, []
        for name in FITTED:
            e = runs[name]["probes"].T.ravel()
            heats = np.linalg.lstsq(columns, e, rcond=None)[0]
            found.append((columns @ heats - e) / np.max(np.abs(e)))
        return np.concatenate(found)

    starts = [np.log([a, a, b, b]) for a in (1e-3, 1e-2, 0.1) for b in (0.01, 0.1, 0.5)]
    low, high = np.log([1e-6] * 2 + [1e-4] * 2), np.log([5.0] * 2 + [50.0] * 2)
    best = min((least_squares(misfit, x, bounds=(low, high)) for x in starts), key=lambda f: f.cost)
    unit = steps(best.x)

    def heats(e: Array) -> Array:
        n = len(e)

        def matrix(step: Array) -> Array:
            return np.tril(
                toeplitz(np.append(np.diff(step, prepend=0.0), np.zeros(max(n - ROWS, 0)))[:n])
            )

        system = np.block([[matrix(unit[i, j]) for i in range(2)] for j in range(2)])
        change = np.kron(np.eye(2), np.eye(n) - np.eye(n, k=-1))
        weight = SMOOTH * np.linalg.norm(system) / np.sqrt(2 * n)
        normal = system.T @ system + weight**2 * change.T @ change
        return np.asarray(np.linalg.solve(normal, system.T @ e.T.ravel()).reshape(2, n).T)

    return {n: heats(run["probes"]) for n, run in runs.items()}, float(
        np.max(np.abs(misfit(best.x)))
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--refinement", type=float, default=1.0)
    refinement = parser.parse_args().refinement
    runs = every_run(build(KneeMillGeometry(refinement=refinement)))
    heats, misfit = sources(runs)
    driven = {n: np.hstack([lag(q, tau) for tau in LAGS]) for n, q in heats.items()}
    rule = "|".join(["---"] * len(JUDGED))
    for part, which in PARTS.items():
        wanted = {
            name: sum(run["deflection"][:, 2 * k : 2 * k + 2] for k in which)
            for name, run in runs.items()
        }
        print(f"\n| {part} | {' | '.join(JUDGED)} |\n|---|{rule}|")
        for powers in ((2.0, 3.0), (0.0, 2.0), (0.5, 2.0)):
            name = f"Q^{powers[0]:g} and Q^{powers[1]:g}"
            print(f"| {name} | {law_line(powers, wanted)} |", flush=True)
        for name, line in pairs_lines(runs, wanted).items():
            print(f"| {name} | {line} |", flush=True)
        for name, signals in bends(runs).items():
            print(f"| {name} | {fit_line(signals, wanted)} |", flush=True)
        print(f"| two pairs of source and sink | {fit_line(driven, wanted)} |", flush=True)
    print(f"\nTemperatures of source and sink: off by up to {100 * misfit:.0f} % of the departure.")


if __name__ == "__main__":
    main()
