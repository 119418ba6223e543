"""Machines that the tool was not made for, known and unknown trouble in them: what does it say?

    python benchmarks/exam.py [--logs 36] [--plants rod ...] [--sizes 2 5 15] [--seed N]
        [--kinds loss_change ...] [--json FILE] [--keep FOLDER] [--only N ...] [--no-validate]

Thirteen kinds of machine (tests/machines/foreign) in numpy alone. Each is calibrated with the
default options of `calibrate`; its later logs have one thing wrong that is built into the machine,
of a kind that the catalogue has or has not, or nothing. `diagnose --validate -o` is asked, and what
it writes is run by `simulate` on the diagnosed, the validation and the calibration log. Seeds are
drawn fresh and printed; ``--seed`` repeats a run, ``--only`` some logs of it, ``--keep`` leaves
their files. With ``--kinds`` every log has one of these causes, in turn. Prints Markdown tables.
With ``--must`` it exits with 3 where a requirement is missed.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from itertools import groupby
from pathlib import Path

# One core for each process. Before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from exam_machine import PLANTS, score_machine
from exam_scoring import Score, Trial
from exam_tables import requirements, tables
from hidden_effects import in_turn
from machines.foreign.faults import CATALOGUE, NATURAL, SINCE
from machines.foreign.strangers import MAY_BE_KNOWN, NEVER_KNOWN

from thermaltool.documents import jsonable

SIZES = (2.0, 5.0, 15.0)
LOGS = 36  # of each plant: more than an hour on two cores
# Of the logs of a plant: clean, of every size, natural, unknown; the sizes of the unknown.
SHARES = {"clean": 0.15, 2.0: 0.14, 5.0: 0.28, 15.0: 0.17, "natural": 0.04, "unknown": 0.22}
UNKNOWN_SIZES = (5.0, 15.0)
# Logs of one machine, which share its calibration.
PER_MACHINE = 9
NOT_FOR = {
    "ambient_drift": ("printer", "mirror", "mill", "screw", "bench"),
    "part_temperature": (
        *("rod", "printer", "plate", "slab", "mirror", "tank"),
        *("bench", "bonder", "motor"),
    ),
    "radiation": ("motor",),  # in its jacket of water
}


def draw(
    logs: int,
    plants: Sequence[str],
    sizes: Sequence[float],
    seed: int,
    kinds: Sequence[str] = (),
) -> list[Trial]:
    """All trials of a run: `logs` of each plant, kinds in turn; only some where they are given."""
    trials: list[Trial] = []
    # A plant's logs are the same whichever others are asked for.
    for name, source in zip(PLANTS, np.random.SeedSequence(seed).spawn(len(PLANTS)), strict=True):
        if name not in plants:
            continue
        generator = np.random.default_rng(source)
        plan = [each for each in _plan(name, logs, generator, kinds) if _wanted(each, sizes)]
        machines = generator.integers(2**31, size=-(-len(plan) // PER_MACHINE)).tolist()
        for k, (group, kind, size) in enumerate(plan):
            machine, log = machines[k // PER_MACHINE], int(generator.integers(2**31))
            trials.append(Trial(len(trials), name, machine, group, kind, size, log))
    return trials


def _wanted(plan: tuple[str, str, float], sizes: Sequence[float]) -> bool:
    return not plan[0].startswith("size") or plan[2] in sizes


def _plan(
    plant: str, logs: int, generator: np.random.Generator, kinds: Sequence[str]
) -> Iterator[tuple[str, str, float]]:
    """Group, kind and size of the logs of a plant, shuffled."""
    apply = [kind for kind in kinds or CATALOGUE if plant not in NOT_FOR.get(kind, ())]
    strangers = in_turn(generator, [*MAY_BE_KNOWN, *NEVER_KNOWN])
    known, natural = in_turn(generator, apply), in_turn(generator, list(NATURAL))
    plan: list[tuple[str, str, float]] = []
    shares = {size: share for size, share in SHARES.items() if isinstance(size, float)}
    whole = sum(shares.values())
    asked = {size: share / whole for size, share in shares.items()} if kinds else SHARES
    for group, share in asked.items():
        for k in range(max(1, round(share * logs))):
            if group == "clean":
                plan.append(("clean", "", 0.0))
            elif group == "natural":
                plan.append(("natural", next(natural), 5.0))
            elif group == "unknown":
                size = UNKNOWN_SIZES[k % len(UNKNOWN_SIZES)]
                plan.append(("unknown", next(strangers), size))
            else:
                plan.append((f"size {group:g}", next(known), float(group)))
    for k in generator.permutation(len(plan)):
        yield plan[k]


def run(
    trials: Sequence[Trial],
    processes: int,
    keep: Path | None = None,
    validate: bool = True,
    save: Callable[[Sequence[Score]], None] = lambda scores: None,
) -> list[Score]:
    """Scores in the order of the trials; a machine is a task, after which `save` gets them all."""
    tasks = [
        list(own) for _, own in groupby(trials, key=lambda trial: (trial.plant, trial.machine))
    ]
    results: dict[int, Score] = {}
    begin = time.monotonic()
    with ProcessPoolExecutor(processes) as pool:
        waiting = [pool.submit(score_machine, task, keep, validate) for task in tasks]
        for done in as_completed(waiting):
            for result in done.result():
                results[result.trial.index] = result
                if result.failure:
                    print(f"{result.trial}: {result.failure}", file=sys.stderr)
            minutes = (time.monotonic() - begin) / 60
            print(f"{len(results)} of {len(trials)} logs, {minutes:.1f} min", file=sys.stderr,
                  flush=True)  # fmt: skip
            save([results[trial.index] for trial in trials if trial.index in results])
    return [results[trial.index] for trial in trials]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=LOGS, metavar="N",
                        help="of each plant (36: 455 in all)")  # fmt: skip
    parser.add_argument("--plants", nargs="*", default=list(PLANTS), choices=list(PLANTS))
    parser.add_argument("--kinds", nargs="*", default=(), choices=[*CATALOGUE, *SINCE])
    parser.add_argument("--sizes", type=float, nargs="*", default=SIZES, choices=SIZES)
    parser.add_argument("--seed", type=int, help="of machines, trouble, noise; drawn if absent")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="every log and its score, kept up as it goes"
    )
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="for logs, models, answers")
    parser.add_argument("--only", type=int, nargs="*", metavar="N", help="these logs of the run")
    parser.add_argument("--no-validate", action="store_true",
                        help="diagnose is not given the other log; simulate is")  # fmt: skip
    parser.add_argument("--must", action="store_true", help="exit 3 where a requirement is missed")
    options = parser.parse_args()
    seed = options.seed
    if seed is None:
        seed = int(np.random.SeedSequence().generate_state(1)[0])
    print(f"seed {seed}", file=sys.stderr, flush=True)
    trials = draw(options.logs, options.plants, options.sizes, seed, options.kinds)
    if options.only is not None:
        trials = [trial for trial in trials if trial.index in options.only]
    keep = options.keep and options.keep.resolve()

    def save(scores: Sequence[Score]) -> None:
        if options.json:
            logs = [asdict(s) | _verdict(s) for s in scores]
            text = json.dumps(jsonable({"seed": seed, "logs": logs}), indent=1, allow_nan=False)
            options.json.write_text(text + "\n")

    scores = run(trials, options.processes, keep, not options.no_validate, save)
    print("\n".join(tables(scores, options.sizes, seed)))
    missed = [what for what, _, _, reached in requirements(scores) if not reached]
    for what in missed if options.must else ():
        print(f"missed: {what}", file=sys.stderr)
    return 3 if options.must and missed else 0


def _verdict(s: Score) -> dict[str, bool]:
    names = ("first", "grouped", "silent", "wrong", "called", "located", "misnamed")
    worse = s.worse("diagnosed") or s.worse("validation")
    return {name: getattr(s, name) for name in names} | {"worse": worse}


if __name__ == "__main__":
    sys.exit(main())
