"""Which rows to hold out so that chosen sensors hold at speeds that were not logged.

    python benchmarks/placement_rules.py

On the first 60 % of the measured spindle alone: sensors chosen and fitted up to several instants,
by blocks of the log (as `place`), by blocks and rows of other levels, by speeds, judged by the rows
behind up to 60 %. Geometric means of the three directions, beside as many principal components and
least squares on all sixteen. What holds at higher speeds would be better at most instants.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from placement import DIRECTIONS, LOG, MAP, SPINDLE, _missed, _pcr, problem_of, table

from thermaltool.fitting.data import training_data
from thermaltool.logs import read_log
from thermaltool.placement import sensor_choice
from thermaltool.placement.estimators import blocks_of
from thermaltool.placement.regression import Basis, RegressionProblem

HOURS, COUNTS = (5.0, 8.1, 9.0, 10.0, 11.0, 12.1, 14.0), range(2, 7)


def blocks(count):
    """So many blocks."""
    return lambda rises, speed: list(blocks_of(np.arange(len(speed)), count, len(speed)))


def levels(rises, speed):
    """Rows warmer than three quantiles of all, and rows colder than one."""
    parts = np.quantile(rises, [0.3, 0.5, 0.7, 0.85])
    return [rises < parts[0], *(rises > part for part in parts[1:])]


def speeds(rises, speed):
    """Each speed in turn."""
    return [speed == value for value in np.unique(speed)]


RULES = {
    "5 blocks, as `place`": (blocks(5),),
    "10 blocks": (blocks(10),),
    "20 blocks": (blocks(20),),
    "levels": (levels,),
    "10 blocks and levels": (blocks(10), levels),
    "20 blocks and levels": (blocks(20), levels),
    "levels and speeds": (levels, speeds),
}


def main():
    log = read_log(str(LOG), columns=str(MAP))
    whole = log.between(None, 0.6 * log.duration)
    full = [problem_of(whole, SPINDLE, output, ()) for output in DIRECTIONS]
    rows = {name: [] for name in (*RULES, "principal components", "all 16, least squares")}
    for hours in HOURS:
        fit = whole.time - whole.time[0] <= hours * 3600
        train = whole.between(None, hours * 3600)
        every = [_missed(p, p.fit(fit, "least-squares"), ~fit) for p in full]
        rows["all 16, least squares"].append([_mean(every) for _ in COUNTS])
        rows["principal components"].append(
            [_mean([min(_pcr(p, fit, k, s) for s in (True, False)) for p in full]) for k in COUNTS]
        )
        for name, rule in RULES.items():
            chosen = [_sets(train, output, rule) for output in DIRECTIONS]
            rows[name].append(
                [
                    _mean([_rest(whole, fit, *each) for each in sets])
                    for sets in zip(*chosen, strict=True)
                ]
            )
    print("RMS behind [µm], geometric mean of directions 1, 3 and 5, and of 2 to 6 sensors\n")
    table([["held out", *(f"up to {h:g} h" for h in HOURS), "all"], *(
        [name, *(f"{_mean(each):.1f}" for each in found), f"{_mean(np.ravel(found)):.2f}"]
        for name, found in rows.items())])  # fmt: skip


def _mean(values):
    return float(np.exp(np.mean(np.log(values))))


def _sets(train, output, rule):
    """The best sets of 2 to 6 sensors with the states that suit them, by a rule."""
    data, speed = training_data([train], SPINDLE, [output]), train.column("n_spindle_rpm")
    rises = np.mean([train.column(s) for s in SPINDLE], axis=0)
    held = [mask for part in rule for mask in part(rises, speed)]
    found, usual = [], sensor_choice.held_out_rows
    sensor_choice.held_out_rows = lambda problem: held
    try:
        for taus in sensor_choice.lag_forms(data):
            problem = RegressionProblem(data, Basis(SPINDLE, taus))
            scores = sensor_choice.HeldOutScores([problem])
            found.append(sensor_choice.choose_sensors(scores, max(COUNTS)))
    finally:
        sensor_choice.held_out_rows = usual
    best = [min(each, key=lambda one: one.score) for each in zip(*found, strict=True)]
    return [(each.sensors, output, each.time_constants) for each in best if len(each.sensors) > 1]


def _rest(whole, fit, sensors, output, taus):
    own = problem_of(whole, sensors, output, taus)
    return _missed(own, own.fit(fit, "ridge"), ~fit)


if __name__ == "__main__":
    main()
