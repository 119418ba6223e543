"""Deflection error bands on logs of the frame plant, beside the published ones and the bound.

For each input: the width of the error band (largest minus smallest error of the estimated
deflection against the plant's own, the wider of x and y), for models that were calibrated on the
Q = 1 step alone. The bound is the Kalman filter that knows the plant (reduced to a state space)
and the true noise, its random-walk rate chosen like the models' own, by the predicted band of a
Q = 1 step; on other inputs another rate may do better, so ratios below 1 occur. The lag (until
the heat estimate passes half of a step) and the settling time (until the deflection error stays
inside what noise leaves) are those that the design predicts for a Q = 1 step.

Prints a Markdown table. ``--repeat N`` adds N fresh draws of the sensors' noise for every input
and gives medians and the ratio to the bound. Exits with 3 when a design named by ``--must``
leaves a published band (where the bound itself is inside) or is more than `SLACK` above the bound.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from thermaltool.estimation.design import DesignPlan, design_estimator
from thermaltool.estimation.design_model import DesignModel
from thermaltool.estimation.estimator import Estimator, SensorNoise, load_estimator
from thermaltool.estimation.regularization import best_choice, design_kalman
from thermaltool.logs import Log, read_log
from thermaltool.model import Model, loads, relative
from thermaltool.plants import build
from thermaltool.plants.noise import Sensor, read_sensors
from thermaltool.responses.modes import Modes
from thermaltool.responses.sample_clock import uniform_spans

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from machines.reduction import reduce_frame

# Fraser 1997, ch. 6: range of the estimation error, µm.
PUBLISHED = {"step100": 6.0, "step050": 5.0, "step025": 3.5, "triangle": 4.0}
INPUTS = ("step100", "step050", "step025", "triangle", "duty")
WHITE, DRIFT, DRIFT_TIME = 0.02, 0.008, 900.0
SLACK = 0.15
DEFLECTIONS = ("d_x_um", "d_y_um")
# States of the reduced plant: far below anything that the sensors resolve (its error is printed).
ORDER = 24


def plant_modes() -> dict[str, Modes]:
    """Every output of the plant as modes of its reduced state space."""
    reduced = reduce_frame(build("frame"), ORDER)
    rates, vectors = np.linalg.eig(reduced.A)
    weights = (reduced.C @ vectors) * np.linalg.solve(vectors, reduced.B[:, 0])
    upper = rates.imag >= 0
    print(
        "reduced plant, largest error over frequency: "
        + ", ".join(f"{n} {e:.1e}" for n, e in zip(reduced.names, reduced.error, strict=True)),
        file=sys.stderr,
    )
    return {
        name: Modes(rates[upper].astype(complex), w[upper].astype(complex))
        for name, w in zip(reduced.names, weights, strict=True)
    }


def truth_of(modes: Modes, log: Log) -> np.ndarray:
    """A plant output for the heat in a log."""
    heat, x = log.column("Q_main_1")[:, None], None
    out = np.zeros(len(log))
    for rows, dt in uniform_spans(log.time):
        part, x = modes.discretize(dt).run(heat[rows], x)
        out[rows] = part[:, 0]
    return out


def noise(scale: float) -> SensorNoise:
    return SensorNoise(scale * WHITE, scale * DRIFT, DRIFT_TIME)


def redesigned(model: Model, scale: float) -> Model:
    """The model with its form of estimator designed anew, for another size of the noise."""
    design = model.estimator_design()
    machine = DesignModel.of(
        model, dict.fromkeys(design["sensors"], noise(scale)), model.sample_period
    )
    return design_estimator(model, machine, DesignPlan(design["form"])).model


def bound(plant: dict[str, Modes], sensors: tuple[str, ...], dt: float, scale: float) -> Estimator:
    """The Kalman filter that knows the plant and the noise."""
    machine = DesignModel(
        sensors=sensors,
        drives=("Q_main_1",),
        outputs=DEFLECTIONS,
        sensed=tuple((k, 0, plant[name]) for k, name in enumerate(sensors)),
        followed=tuple((k, 0, plant[name]) for k, name in enumerate(DEFLECTIONS)),
        level=(1.0,),
        noise=(noise(scale),) * len(sensors),
        dt=dt,
    )
    return best_choice(design_kalman(machine)).estimator


def band(estimates: np.ndarray, truth: dict[str, np.ndarray]) -> tuple[float, float]:
    """Widest band of the two deflections, and the larger mean error over the last tenth."""
    errors = [truth[name] - estimates[:, -2 + k] for k, name in enumerate(DEFLECTIONS)]
    tail = max(1, len(errors[0]) // 10)
    return max(map(np.ptp, errors)), max(abs(float(np.mean(e[-tail:]))) for e in errors)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("samples", type=Path, help="folder with frame_*.parquet")
    parser.add_argument("designs", nargs="+", type=Path, help="model files with a design")
    parser.add_argument("--repeat", type=int, default=0, help="fresh draws of the noise per input")
    parser.add_argument("--seed", type=int, help="of those draws; drawn and printed if absent")
    parser.add_argument(
        "--signal",
        type=float,
        metavar="K",
        help="noise as large beside the "
        "sensors' rise at Q = 1 as beside this one; designs are made anew",
    )
    parser.add_argument("--must", action="append", default=[], metavar="DESIGN")
    options = parser.parse_args()
    plant = plant_modes()
    models = {path.stem: loads(path.read_text(), str(path)) for path in options.designs}
    scale = 1.0
    if options.signal:
        rises = {c: plant[c].step(np.array(3600.0)) for m in models.values()
                 for c in m.estimator_design()["sensors"]}  # fmt: skip
        scale = float(min(rises.values())) / options.signal
        told = ", ".join(f"{c} {rise:.2f} K" for c, rise in rises.items())
        print(f"an hour after Q = 1: {told}; noise times {scale:.3g}", file=sys.stderr)
        models = {name: redesigned(model, scale) for name, model in models.items()}
    estimators = {name: load_estimator(dict(m.estimator_design())) for name, m in models.items()}
    rests = {n: {o.channel: o.offset for o in m.outputs} for n, m in models.items()}
    logs = {name: read_log(str(options.samples / f"frame_{name}.parquet")) for name in INPUTS}
    bounds = {
        sensors: bound(plant, sensors, logs["step100"].period, scale)
        for sensors in {e.sensors for e in estimators.values()}
    }
    seed = (
        options.seed if options.seed is not None else int(np.random.SeedSequence().entropy % 2**32)
    )
    if options.repeat:
        print(f"noise drawn anew {options.repeat} times, seed {seed}", file=sys.stderr)
    heading = [
        "input",
        "design",
        "published_µm",
        "bound_µm",
        "band_µm",
        "ratio",
        "steady_µm",
        "lag_s",
        "settled_s",
    ]
    print("| " + " | ".join(heading) + " |")
    print("|---" * len(heading) + "|")
    missed = []
    for name, log in logs.items():
        truth = {channel: truth_of(modes, log) for channel, modes in plant.items()}
        draws = [{c: log.column(c) for c in truth if c not in DEFLECTIONS}]
        for k in range(options.repeat):
            clean = {c: truth[c] for c in draws[0]}
            sensor = {"K": Sensor(scale * WHITE, scale * DRIFT, DRIFT_TIME)}
            draws.append(read_sensors(clean, sensor, log.period, seed + k))
        for design, estimator in estimators.items():
            rows = []
            for readings in draws[1:] or draws:
                known = [readings[s] for s in estimator.sensors]
                shifted = [
                    relative(r, rests[design][s])
                    for r, s in zip(known, estimator.sensors, strict=True)
                ]
                best = bounds[estimator.sensors].run(log.time, np.column_stack(known))
                ours = estimator.run(log.time, np.column_stack(shifted))
                (ideal, _), (reached, steady) = band(best, truth), band(ours, truth)
                rows.append((ideal, reached, reached / ideal, steady))
            ideal, reached, ratio, steady = np.median(np.array(rows), axis=0)
            outside = reached > PUBLISHED.get(name, np.inf) > ideal
            if design in options.must and (outside or ratio > 1 + SLACK):
                missed.append(f"{name} {design}: {reached:.2f} µm, {ratio:.2f} times the bound")
            design_says = models[design].design["predicted"]
            print(
                f"| {name} | {design} | {PUBLISHED.get(name, '–')} | {ideal:.2f} | {reached:.2f} "
                f"| {ratio:.2f} | {steady:.2f} | {design_says['lag']:.1f} "
                f"| {design_says['settling']:.0f} |"
            )

    for each in missed:
        print(f"missed: {each}", file=sys.stderr)
    return 3 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
