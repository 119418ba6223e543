"""Where sensors belong, and which regressions survive: a rod, an axis, machines, a spindle.

    python benchmarks/placement.py rod [--draws N] [--seed N]
    python benchmarks/placement.py axis|design [--seed N]
    python benchmarks/placement.py spindle|blocks [--held-out]

`rod`: the source's rod (tests/machines/expanding_rod.py, finite volumes): errors in other periods,
in the second hour and at other duty, over many draws of noise and random heat, of placed sensors,
of naive ones, of the best pair and of black boxes (scikit-learn, where it is installed). `axis`:
positions along an axis by the source's (18) with noise. `design`: placed sensors against exhaustive
search and against the rule of the modes on random machines, and the time for many candidates.
`spindle`: 2 to 6 sensors of 16 against principal components and least squares on later rows of the
first 60 % of the log, or with --held-out on the last 40 %. `blocks`: 5, 7 or 10 blocks held out in
turn, which have no part in choosing at most three sensors, beside least squares on all; over the
first 60 % or the whole log.
"""

from __future__ import annotations

import argparse
import itertools
import secrets
import sys
import time
import tomllib
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from machines.expanding_rod import (
    OUTPUT,
    PLACES,
    ROD,
    SENSORS,
    periodic_heat,
    random_heat,
    rod_columns,
)
from machines.warm_axis import axis_columns

from thermaltool import api
from thermaltool.errors import FitError
from thermaltool.fitting.data import training_data
from thermaltool.logs import read_log
from thermaltool.placement import exhaustive
from thermaltool.placement.candidates import Candidates, DutyCycle, deflection_errors
from thermaltool.placement.estimators import blocks_of
from thermaltool.placement.mode_rule import place_by_modes
from thermaltool.placement.optimal_design import CRITERIA, criterion_value, place_sensors
from thermaltool.placement.regression import Basis, RegressionProblem
from thermaltool.placement.sensor_choice import HeldOutScores, choose_sensors, lag_forms
from thermaltool.record import Record

ROOT = Path(__file__).parents[1]
DT, NOISE = 10.0, 0.02
LOG = ROOT / "../shared/data/cnc_spindle/spindle_first_28h.csv"
MAP = ROOT / "data_samples/maps/cnc_spindle.toml"
DIRECTIONS = ("d_ch1_um", "d_ch3_um", "d_ch5_um")
SPINDLE = tuple(f"T_t{k}_degC" for k in range(1, 17))


def record_of(columns):
    """The record of a machine."""
    return Record(columns["time_s"], {n: v for n, v in columns.items() if n != "time_s"})


def rod_log(*heat):
    """Temperatures and the expansion of the rod."""
    return record_of(rod_columns(*heat))


def table(rows):
    for k, row in enumerate(rows):
        print("| " + " | ".join(str(cell) for cell in row) + " |")
        if not k:
            print("|" + "---|" * len(row))


def fitted(record, sensors, taus=()):
    """A ridge on all rows."""
    data = training_data([record], sensors, [OUTPUT])
    problem = RegressionProblem(data, Basis(tuple(sensors), taus))
    return problem.fit(problem.every, "ridge")


def error(record, sensors, found, taus=(), start=0.0):
    """RMS and largest error over the range, of a regression on another log from a time on."""
    data = training_data([record], sensors, [OUTPUT])
    problem = RegressionProblem(data, Basis(tuple(sensors), taus))
    left = problem.measured - problem.computed(replace(found, offsets={}), problem.every)
    return _over_range(left[record.time >= start], problem.measured)


def _over_range(left, measured):
    size = np.ptp(measured)
    return float(np.sqrt(np.mean(left**2)) / size), float(np.max(np.abs(left)) / size)


def rod(seed, draws):
    """What placed sensors, naive ones and black boxes miss in conditions that were not fitted."""
    rng, runs = np.random.default_rng(seed), []
    rule = _rule_of_the_rod()
    body = tomllib.loads((ROOT / "data_samples/bodies/rod.toml").read_text())
    body["points"] = {name: {"at": place} for name, place in zip(SENSORS, PLACES, strict=True)}
    declared = api.place_on_body(body, candidates=list(SENSORS), sensors=2).sets[-1].sensors
    print(f"rule of the modes: {_places(rule)}; place rod.toml: {_places(declared)}\n")
    for _ in range(draws):
        runs.append({})
        for name, train, tests in _rod_tests(rng):
            own = {**_placed(train), "`place rod.toml --sensors 2`": (declared, ()),
                   "rule of the modes": (rule, ()), "the two nearest": (SENSORS[:2], ()),
                   "all nine, ridge by the evidence": (SENSORS, ())}  # fmt: skip
            models = {label: (*each, fitted(train, *each)) for label, each in own.items()}
            pairs = [(p, (), fitted(train, p)) for p in itertools.combinations(SENSORS, 2)]
            boxes = _black_boxes(train)
            start = 3600.0 if name == "first hour" else 0.0
            for test, log in tests.items():
                found = {label: error(log, s, f, t, start) for label, (s, t, f) in models.items()}
                found["best pair of the test"] = min(
                    error(log, s, f, t, start) for s, t, f in pairs
                )
                for label, box in boxes.items():
                    left = (log.column(OUTPUT) - box(log))[log.time >= start]
                    found[label] = _over_range(left, log.column(OUTPUT))
                runs[-1][f"{name} → {test}"] = found
    _tables(runs)


def _rule_of_the_rod():
    modes = 20
    film = 2 * 20.0 / (ROD.radius * ROD.capacity)
    rates = film + (np.arange(modes) * np.pi) ** 2 * 60.5 / ROD.capacity
    shapes = np.cos(np.outer(PLACES, np.arange(modes)) * np.pi)
    weights = np.where(np.arange(modes), np.sqrt(2), 1) / rates
    return tuple(SENSORS[k] for k in place_by_modes(shapes, weights, np.array(PLACES)).sensors)


def _places(sensors):
    return ", ".join(f"{PLACES[SENSORS.index(s)]} m" for s in sensors)


def _placed(train):
    """Sets by what was logged: label to sensors and time constants."""
    found = {
        f"`place --sensors {k}{' --static' * static}`":
        api.place(train, OUTPUT, sensors=k, time_constants=() if static else None).sets[-1]
        for k, static in itertools.product((2, 3), (False, True))
    }  # fmt: skip
    found["`place --criterion I --sensors 2`"] = api.place(
        train, OUTPUT, sensors=2, criterion="I"
    ).sets[-1]
    return {name: (each.sensors, each.time_constants) for name, each in found.items()}


def _tables(runs):
    tests, labels = list(runs[0]), list(next(iter(runs[0].values())))

    def show(title, cell):
        print(f"\n{title}\n")
        table([["sensors", *tests], *(
            [label, *(cell(np.array([r[t][label] for r in runs]).T,
                           np.array([r[t]["best pair of the test"][0] for r in runs]))
                      for t in tests)] for label in labels)])  # fmt: skip

    def percents(values):
        return " / ".join(f"{100 * x:.2g}" for x in np.quantile(values, [0.5, 0.9, 1.0]))

    print(f"{len(runs)} draws")
    show("RMS, % of the range: median / nine of ten / worst", lambda e, b: percents(e[0]))
    show("draws with an RMS of at most 5 % of the range", lambda e, b: int(np.sum(e[0] <= 0.05)))
    show("largest error, % of the range: median / nine of ten / worst",
         lambda e, b: percents(e[1]))  # fmt: skip
    show("draws with an RMS of at most 1.05 times the best static pair's",
         lambda e, b: int(np.sum(e[0] <= 1.05 * b * (1 + 1e-9))))  # fmt: skip


def _rod_tests(rng):
    """Training log, and tests: name to log."""
    count = int(2 * 3600 / DT)
    minutes = int(60 / DT)

    def log(heat):
        return rod_log(heat, DT, rng, NOISE)

    random = log(random_heat(rng, count, 10 * minutes))
    duty = (20 / 35, 35 * minutes)
    yield (
        "20 min",
        log(periodic_heat(count, 20 * minutes)),
        {
            "10 min": log(periodic_heat(count, 10 * minutes)),
            "40 min": log(periodic_heat(count, 40 * minutes)),
        },
    )
    yield "first hour", random.between(None, 3600.0), {"second": random}
    yield (
        "20 on, 15 off",
        log(periodic_heat(count, duty[1], duty[0])),
        {
            "10 on": log(periodic_heat(count, 25 * minutes, 0.4)),
            "30 on": log(periodic_heat(count, 45 * minutes, 30 / 45)),
        },
    )


def _black_boxes(train):
    """All nine sensors into forest, boosting and ridge; empty where scikit-learn is not there."""
    try:
        from sklearn.ensemble import GradientBoostingRegressor, RandomForestRegressor
        from sklearn.linear_model import Ridge
    except ImportError:
        print("scikit-learn is not installed: no black boxes", file=sys.stderr)
        return {}

    def rises(log):
        return np.column_stack([log.column(s) - 20 for s in SENSORS])

    models = {
        "all nine, forest": RandomForestRegressor(100, random_state=0),
        "all nine, boosting": GradientBoostingRegressor(random_state=0),
        "all nine, ridge of scikit-learn": Ridge(1.0),
    }
    own = {n: m.fit(rises(train), train.column(OUTPUT)) for n, m in models.items()}
    return {name: lambda log, m=model: m.predict(rises(log)) for name, model in own.items()}


def axis(seed, runs=100):
    rng = np.random.default_rng(seed)
    rows, degrees = [], []
    for _ in range(runs):
        train, test = map(record_of, axis_columns(rng))
        found = api.regress(train, "d_z_um", position="x_z_mm", validate=[test],
                            warn=lambda message: None)  # fmt: skip
        own = found.outputs[0]
        degrees.append(max(c.power for c in own.regression.columns))
        (missed,) = [e for t, e in own.errors["least-squares", "static"].items()
                     if t not in ("blocks", "time", "level")]  # fmt: skip
        rows.append((own.regression.rmse, missed))
    fit, verified = np.array(rows).T
    print(f"{runs} runs: 16 sets fitted, 8 verified, noise uniform within 0.5 um (0.289 um RMS)")
    print(f"highest power by evidence: {np.bincount(degrees).tolist()} runs with 0, 1, 2")
    print(f"RMS fitted {fit.mean():.3f} um, verified {verified.mean():.3f}, at most "
          f"{verified.max():.3f}")  # fmt: skip


def random_machine(rng, bodies=40):
    """Modes of bodies at random places that conduct to near ones and lose heat."""
    place = rng.uniform(0, 1, (bodies, 2))
    near = np.exp(-8 * np.linalg.norm(place[:, None] - place, axis=2))
    links = np.triu(near * rng.uniform(0, 1, near.shape), 1)
    links += links.T
    matrix = np.diag(links.sum(axis=1) + 0.02 * rng.uniform(0.2, 1, bodies)) - links
    rates, shapes = np.linalg.eigh(matrix)
    source = int(rng.integers(bodies))
    bends = rng.normal(size=(1, bodies)) * np.exp(-2 * place[:, :1].T)
    distance = np.linalg.norm(place - place[source], axis=1)
    return rates, shapes, shapes[source] / rates, bends @ shapes, distance


def design(seed):
    rng = np.random.default_rng(seed)
    ratios = {(c, form): [] for c in CRITERIA for form in ("place", "search alone")}
    for _ in range(100):
        r = 8
        readings = rng.normal(size=(16, r)) * np.geomspace(1, 0.05, r)
        candidates = Candidates.of([DutyCycle(readings, rng.normal(size=(2, r)))], 0.05)
        for criterion in CRITERIA:
            best = max(
                criterion_value(candidates, each, criterion)
                for each in itertools.combinations(range(16), 5)
            )
            for form, most in {"place": exhaustive.MAX_SETS, "search alone": 0}.items():
                with patch.object(exhaustive, "MAX_SETS", most):
                    found = place_sensors(candidates, 5, criterion, bounded=False).value
                scale = 5 if criterion == "D" else 1
                ratios[criterion, form].append(float(np.exp((found - best) / scale)))
    for (criterion, form), each in ratios.items():
        near = np.sum(np.array(each) > 0.98)
        print(f"C(16, 5), {criterion}, {form}: within 2 % of the best of all sets in {near} of "
              f"{len(each)}, at worst {min(each):.3f} of it")  # fmt: skip
    _random_machines(rng, 200)
    readings = rng.normal(size=(10_000, 30)) * np.geomspace(1, 0.01, 30)
    many = Candidates.of([DutyCycle(readings, rng.normal(size=(3, 30)))], 0.05)
    for criterion in CRITERIA:
        begin = time.process_time()
        found = place_sensors(many, 20, criterion)
        print(f"10000 candidates, 20 sensors, {criterion}: {time.process_time() - begin:.1f} s "
              f"CPU, at least {100 * found.efficiency:.0f} % of the best")  # fmt: skip


def _random_machines(rng, count):
    """Sets by the I criterion and by the rule, beside the best of all sets, on random machines."""
    kept = dict.fromkeys(("better", "same", "worse", "rule is best", "beaten", "own is best"), 0)
    ratios, most, runs = [], 1.0, 0
    while runs < count:
        rates, shapes, weights, bends, distance = random_machine(rng)
        try:
            rule = place_by_modes(shapes, weights, distance).sensors
        except FitError as problem:
            print(problem)
            continue
        # A duty cycle: random switching heat; covariance of the modes in the steady state.
        drive = weights * rates
        cover = np.outer(drive, drive) / (rates[:, None] + rates)
        root = _root(cover)
        candidates = Candidates.of(
            [DutyCycle(shapes @ root, bends @ root)], 0.01 * np.sqrt(np.max(np.diag(cover)))
        )
        own = place_sensors(candidates, len(rule), "I", bounded=False)
        left, rules = (deflection_errors(candidates, s)[0] for s in (own.sensors, rule))
        best = _least_error(candidates, len(rule))
        kept["better"] += left < rules * (1 - 1e-9)
        kept["same"] += set(own.sensors) == set(rule)
        kept["worse"] += left > rules * (1 + 1e-9)
        kept["rule is best"] += (optimal := rules < best * (1 + 1e-6))
        kept["beaten"] += not optimal and left < rules * (1 - 1e-9)
        kept["own is best"] += left < best * (1 + 1e-6)
        ratios.append(left / rules)
        most = max(most, left / best)
        runs += 1
    rest = count - kept["rule is best"]
    print(f"random machines, {count}: the chosen set leaves less than the rule's in "
          f"{kept['better']}, is the same in {kept['same']}, worse in {kept['worse']}; median "
          f"ratio of errors {np.median(ratios):.2f}\nof all sets of as many (exhaustive): the "
          f"rule's is best in {kept['rule is best']}, so that none beats it; of the other {rest} "
          f"the chosen one beats it in {kept['beaten']} ({100 * kept['beaten'] / rest:.0f} %); the "
          f"chosen one is the best in {kept['own is best']}, and leaves at most {most:.3f} times "
          "the error of the best")  # fmt: skip


def _least_error(candidates, count):
    """The least error of all sets of so many sensors: conditional variance, in readings."""
    (cycle,) = candidates.cycles
    readings, (bend,) = candidates.scaled(cycle), cycle.deflections
    cover, cross, least = np.eye(len(readings)) + readings @ readings.T, readings @ bend, np.inf
    sets = itertools.combinations(range(len(readings)), count)
    while len(part := np.array(list(itertools.islice(sets, 100_000)), int)):
        own = cross[part]
        pull = np.linalg.solve(cover[part[:, :, None], part[:, None, :]], own[..., None])[..., 0]
        least = min(least, float(np.min(bend @ bend - np.sum(own * pull, axis=1))))
    return np.sqrt(least)


def _root(matrix):
    values, vectors = np.linalg.eigh(matrix)
    return vectors * np.sqrt(np.maximum(values, 0))


def spindle(held_out):
    log = read_log(str(LOG), columns=str(MAP))
    share = 0.6 * log.duration
    splits = [(share, None)] if held_out else [(h * 3600, share) for h in (8.1, 10.0, 12.1)]
    rows = [["fitted to [h]", "output", "k", "sensors", "chosen", "static", "for all three", "PCR",
             "all by LS"]]  # fmt: skip
    for end, stop in splits:
        whole = log if stop is None else log.between(None, stop)
        fit = whole.time - whole.time[0] <= end
        shared = api.place(whole.between(None, end), DIRECTIONS).sets
        for each in shared[1:]:
            print(f"fitted to {end / 3600:.1f} h, for all three: {named(each.sensors)}")
        for output in DIRECTIONS:
            sets = api.place(whole.between(None, end), output).sets
            every = problem_of(whole, SPINDLE, output, ())
            full = _missed(every, every.fit(fit, "least-squares"), ~fit)
            for each, common in zip(sets[1:], shared[1:], strict=True):
                k = len(each.sensors)
                errors = []
                for sensors, taus in (
                    (each.sensors, each.time_constants),
                    (each.sensors, ()),
                    (common.sensors, common.time_constants),
                ):
                    own = problem_of(whole, sensors, output, taus)
                    errors.append(_missed(own, own.fit(fit, "ridge"), ~fit))
                pcr = min(_pcr(every, fit, k, scaled) for scaled in (True, False))
                cells = [f"{e:.2f}" for e in (*errors, pcr, full)]
                rows.append([f"{end / 3600:.1f}", output, k, named(each.sensors), *cells])
    table(rows)
    print()
    table([["k", *rows[0][4:]], *(
        [k, *(f"{np.exp(np.mean([np.log(float(r[4 + n])) for r in rows[1:] if r[2] == k])):.2f}"
              for n in range(5))]
        for k in range(2, 7))])  # fmt: skip


def blocks(held_out):
    """Blocks held out in turn; what is left chooses sensors and time constants anew each time."""
    log = read_log(str(LOG), columns=str(MAP))
    whole = log if held_out else log.between(None, 0.6 * log.duration)
    rows = [["blocks", "output", "all by LS", "three, static", "three with states", "over all",
             "for all directions", "over all"]]  # fmt: skip
    for count in (5, 7, 10):
        squares = np.zeros((len(DIRECTIONS), 4))
        for held in blocks_of(np.arange(len(whole.time)), count, len(whole.time)):
            kept = [_chosen(whole, held, (o,)) for o in DIRECTIONS]
            common = _chosen(whole, held, DIRECTIONS)
            for n, output in enumerate(DIRECTIONS):
                sets = [
                    (SPINDLE, (), "least-squares"),
                    (*_chosen(whole, held, (output,), ((),)), "ridge"),
                    (*kept[n], "ridge"),
                    (*common, "ridge"),
                ]
                for m, (sensors, taus, method) in enumerate(sets):
                    own = problem_of(whole, sensors, output, taus)
                    squares[n, m] += _missed(own, own.fit(~held, method), held) ** 2 * held.sum()
        for output, each in zip(DIRECTIONS, np.sqrt(squares / len(whole.time)), strict=True):
            full, static, own, common = each
            rows.append([count, output, f"{full:.2f}", f"{static:.2f}", f"{own:.2f}",
                         f"{own / full:.2f}", f"{common:.2f}", f"{common / full:.2f}"])  # fmt: skip
    table(rows)


def _chosen(log, held, outputs, forms=None):
    """The best of the sets of one to three sensors by rows that are not held, with its states."""
    hidden = {o: np.where(held, np.nan, log.column(o)) for o in outputs}
    known = Record(log.time, {n: hidden.get(n, log.column(n)) for n in (*SPINDLE, *outputs)})
    data = training_data([known], SPINDLE, outputs)
    sets = []
    for taus in lag_forms(data) if forms is None else forms:
        basis = Basis(SPINDLE, taus)
        problems = [RegressionProblem(data.only(k), basis) for k in range(len(outputs))]
        sets += choose_sensors(HeldOutScores(problems), 3)
    best = min(sets, key=lambda each: each.score)
    return best.sensors, best.time_constants


def named(sensors):
    return " ".join(s.split("_")[1] for s in sensors)


def problem_of(log, sensors, output, taus):
    return RegressionProblem(training_data([log], sensors, [output]), Basis(tuple(sensors), taus))


def _missed(problem, found, rows):
    left = problem.measured[rows] - problem.computed(found, rows)
    return float(np.sqrt(np.mean(left**2)))


def _pcr(problem, fit, k, scaled):
    """Least squares on the first k principal components, of scaled columns or as they are."""
    x, y = problem.values[:, fit], problem.measured[fit]
    level, size = x.mean(axis=1, keepdims=True), x.std(axis=1, keepdims=True) if scaled else 1.0
    x = (x - level) / size
    turn = np.linalg.svd(x, full_matrices=False)[0][:, :k]
    weights = turn @ np.linalg.lstsq((turn.T @ x).T, y - y.mean(), rcond=None)[0]
    computed = weights @ ((problem.values[:, ~fit] - level) / size) + y.mean()
    return float(np.sqrt(np.mean((problem.measured[~fit] - computed) ** 2)))


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", choices=["rod", "axis", "design", "spindle", "blocks"])
    parser.add_argument("--seed", type=int)
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--held-out", action="store_true")
    given = parser.parse_args()
    if given.what in ("spindle", "blocks"):
        (spindle if given.what == "spindle" else blocks)(given.held_out)
        return
    seed = secrets.randbelow(2**31) if given.seed is None else given.seed
    print(f"seed {seed}\n")
    if given.what == "rod":
        rod(seed, given.draws)
        return
    {"axis": axis, "design": design}[given.what](seed)


if __name__ == "__main__":
    main()
