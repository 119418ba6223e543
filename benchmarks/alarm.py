"""How often model and machine are said to have parted: on a machine that has changed, and on days.

The finite-element frame with three pairs of probes is calibrated on logs of its own, a model each.
Logs of 50 min and of 2.5 h come from a frame that loses heat half as fast again (its film
coefficient), days of 24 h from the frame as it was calibrated. Printed is for each model how many
logs and how many days end with an alarm; with `--change` of logs of 50 min, with the loss and
without, on how many the test of changes that `estimate` asks names a loss of heat, alarm or not.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, toeplitz
from smoothing import CALIBRATION_ROWS, Case, Noise, model_of

from thermaltool.errors import ModelError
from thermaltool.estimation.bands import gain_errors, model_errors
from thermaltool.estimation.changed_machine import likeliest_change
from thermaltool.estimation.innovation_test import InnovationTest, record_alarm
from thermaltool.estimation.lookahead import linear_kalman
from thermaltool.estimation.pipeline import EstimatorPipeline
from thermaltool.estimation.start import drive_levels
from thermaltool.model import Model
from thermaltool.plants.frame import FrameGeometry, build

Array = NDArray[np.float64]
PERIOD = 2.0
# Rows of the logs, of a day, and after which a step response stands still.
SHORT, LONG, DAY, SETTLED = 1500, 4500, 43200, 12000
# Rows of which the bound takes the mean.
THINNED = 5
PAIRS = ("dT_pair1_K", "dT_pair2_K", "dT_pair3_K")


def steps(film: float) -> Array:
    """Step responses of the frame, shape (DAY, 3, 1)."""
    heat = np.ones(SETTLED)
    probes = build(FrameGeometry(film_coefficient=film)).simulate(heat, 0 * heat, PERIOD)
    rise = np.stack([probes[name] for name in PAIRS], axis=1)
    return np.concatenate([rise, np.repeat(rise[-1:], DAY - SETTLED, axis=0)])[:, :, None]


def parted(
    case: Case, machine: Array, rows: int, model: Model, generator: np.random.Generator
) -> bool:
    """Whether a duty of `rows` rows on a machine ends with an alarm."""
    kalman = linear_kalman(EstimatorPipeline.of(model).estimator)
    readings = case.readings(machine, case.heat(rows, generator), generator)
    errors = model_errors(model, kalman), gain_errors(model, kalman)
    test = InnovationTest(kalman, PERIOD, *errors)
    return record_alarm(test, PERIOD * np.arange(rows), readings).row is not None


def loss_named(
    case: Case, machine: Array, model: Model, generator: np.random.Generator
) -> tuple[bool, bool]:
    """Whether a duty of 50 min is said to come from a machine that loses more; or an alarm."""
    kalman = linear_kalman(EstimatorPipeline.of(model).estimator)
    readings = case.readings(machine, case.heat(SHORT, generator), generator)
    errors, time = (
        (model_errors(model, kalman), gain_errors(model, kalman)),
        PERIOD * np.arange(SHORT),
    )
    found = likeliest_change(
        kalman, *errors, time, readings, "rest", drive_levels(model, kalman.drives)
    )
    named = found is not None and found.explains and found.kind == "loss"
    alarm = record_alarm(InnovationTest(kalman, PERIOD, *errors), time, readings).row is not None
    return named, named or alarm


def bound(case: Case, draws: int, generator: np.random.Generator) -> str:
    """The likelihood ratio of both machines, on means of `THINNED` rows."""
    rows, mean = SHORT, SHORT // THINNED
    walk = np.mean(np.diff(case.heat(40 * rows, generator), axis=0) ** 2)
    noise = case.noise.covariance(rows, PERIOD).reshape(mean, THINNED, mean, THINNED)
    white = np.kron(np.eye(len(PAIRS)), noise.mean(axis=(1, 3)))
    factors = []
    for machine in (case.calibrated, case.steps):
        # Readings after a change of the heat in each row.
        moved = [np.tril(toeplitz(machine[:rows, s, 0])) for s in range(len(PAIRS))]
        means = np.vstack([each.reshape(mean, THINNED, rows).mean(axis=1) for each in moved])
        factors.append(cho_factor(walk * means @ means.T + white))
    logs = [2 * np.sum(np.log(np.diag(each))) for each, _ in factors]
    ratios = []
    for _ in range(draws):
        read = case.readings(case.steps, case.heat(rows, generator), generator)
        y = read.reshape(mean, THINNED, -1).mean(axis=1).T.ravel()
        calibrated, lossy = (
            y @ cho_solve(factor, y) + log for factor, log in zip(factors, logs, strict=True)
        )
        ratios.append(0.5 * (calibrated - lossy))
    # A ratio of 1/p is exceeded without loss with a probability of p at most (Ville 1939).
    limit = np.log(DAY / rows / 0.01)
    found = np.sum(np.array(ratios) > limit)
    return (f"{found} of {draws} logs, least ratio {np.min(ratios):.1f} nats, median "
            f"{np.median(ratios):.1f}, limit {limit:.1f}")  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", type=int, default=8)
    parser.add_argument("--logs", type=int, default=12, help="of each length, for each model")
    parser.add_argument("--days", type=int, default=4, help="for each model")
    parser.add_argument("--bound", action="store_true", help="of a test that knows the loss")
    parser.add_argument("--change", action="store_true", help="what the test of changes names")
    parser.add_argument("--seed", type=int, help="drawn and printed if absent")
    options = parser.parse_args()
    seed = options.seed
    if seed is None:
        seed = int(np.random.SeedSequence().entropy % 2**32)
    print(f"seed {seed}", file=sys.stderr)
    case = Case("frame", steps(13.5), steps(20.25), 1.0, PERIOD, Noise(0.02, 0.008))
    if options.bound:
        print(bound(case, 300, np.random.default_rng(seed)))
        return 0
    heading = "50 min, loss + 50 % | 2.5 h, loss + 50 % | clean days"
    if options.change:
        heading = "loss + 50 %: named | named or alarm | clean: named | named or alarm"
    print(f"| responses | {heading} |\n|---|{'---|' * (heading.count('|') + 1)}")
    totals: dict[int, list[int]] = {}
    for number in range(options.models):
        generator = np.random.default_rng([seed, number])
        short = replace(case, calibrated=case.calibrated[:CALIBRATION_ROWS])
        try:
            model = model_of(short, generator).model
        except ModelError as error:
            print(error, file=sys.stderr)
            continue
        if options.change:
            counts = [options.logs] * 4
            told = [[loss_named(case, machine, model, generator) for _ in range(options.logs)]
                    for machine in (case.steps, case.calibrated)]  # fmt: skip
            found = [int(each) for machine in told for each in np.sum(machine, axis=0)]
        else:
            counts = [options.logs, options.logs, options.days]
            machines = case.steps, case.steps, case.calibrated
            asked = zip(machines, (SHORT, LONG, DAY), counts, strict=True)
            found = [
                sum(parted(case, machine, rows, model, generator) for _ in range(count))
                for machine, rows, count in asked
            ]
        kinds = ", ".join(term.response.kind for term in model.terms)
        pairs = list(zip(found, counts, strict=True))
        for k, pair in enumerate(pairs):
            totals[k] = [sum(each) for each in zip(totals.get(k, [0, 0]), pair, strict=True)]
        cells = " | ".join(f"{some} of {count}" for some, count in pairs)
        print(f"| {kinds} | {cells} |", flush=True)
    print(f"| all | {' | '.join(f'{some} of {count}' for some, count in totals.values())} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
