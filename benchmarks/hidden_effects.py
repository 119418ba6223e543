"""Known effects are hidden in logs of simulated machines: how often does `diagnose` find them?

    python benchmarks/hidden_effects.py [--logs 200] [--seed N] [--json FILE] [--figures FOLDER]

Every log has a machine of its own, calibrated without the effect, a duty of its own, and an effect
whose form, place, time, sign and noise are drawn; the effects of the catalogue take turns. The
plants share no code with the models. Seeds are drawn fresh and printed; ``--seed`` repeats a run.

Prints a Markdown table of asked and measured, shares with Wilson's 95 % interval, medians with one
by order statistics, then a table by effect. With ``--must`` it exits with 3 where one is missed.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path

# One core for each process. Before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from hidden_scoring import Score, Trial, score
from hidden_tables import NATURAL, SIZED, SIZES, draw_confusion, draw_power, requirements, tables
from machines.faults import VARIANTS

from thermaltool.documents import jsonable
from thermaltool.report.style import render

# Logs of every kind for each one of size 5.
LOGS_PER_SIZED = {1.0: 0.25, 2.0: 0.5, 3.0: 0.25, 5.0: 1.0, 8.0: 0.25}
CLEAN, PAIRS, NATURALS = 0.5, 0.2, 0.15
# One in so many logs of size 5 is diagnosed a second time for the held-out test.
HELD_OUT = 3


# ---------------------------------------------------------------- what is hidden


def draw(logs: int, sizes: Sequence[float], seed: int) -> list[Trial]:
    """All trials of a run: `logs` of size 5 and the others in proportion, effects in turn."""
    plan: list[tuple[str, float, float, tuple[str, ...]]] = [
        (f"size {size:g}", size, LOGS_PER_SIZED[size], SIZED) for size in sizes
    ]
    plan += [
        ("natural", 5.0, NATURALS, NATURAL),
        ("clean", 5.0, CLEAN, ()),
        ("pair", 5.0, PAIRS, SIZED),
    ]
    trials = []
    for (group, size, share, names), source in zip(
        plan, np.random.SeedSequence(seed).spawn(len(plan)), strict=True
    ):
        generator = np.random.default_rng(source)
        turns = in_turn(generator, names)
        for k in range(max(1, round(share * logs))):
            effects: list[str] = []
            while names and len(effects) < 1 + (group == "pair"):
                following = next(turns)
                effects += [following] if following not in effects else []
            forms = VARIANTS.get(effects[0], ()) if len(effects) == 1 else ()
            variant = (None, *forms)[generator.integers(1 + len(forms))]
            machine, duty = generator.integers(2**31, size=2).tolist()
            twice = group == "size 5" and k % HELD_OUT == 0
            trials.append(Trial(group, tuple(effects), variant, size, machine, duty, twice))
    return trials


def in_turn(generator: np.random.Generator, names: Sequence[str]) -> Iterator[str]:
    """Every name once in random order, and again."""
    while True:
        yield from generator.permutation(names).tolist()


def run(trials: Sequence[Trial], processes: int) -> list[Score]:
    """Scores in the order of the trials."""
    results: dict[int, Score] = {}
    with ProcessPoolExecutor(processes) as pool:
        waiting = {pool.submit(score, trial): k for k, trial in enumerate(trials)}
        for done in as_completed(waiting):
            results[waiting[done]] = result = done.result()
            if result.failure:
                print(f"\n{result.trial}: {result.failure}", file=sys.stderr)
            if sys.stderr.isatty() or len(results) % 50 == 0:
                end = "\r" if sys.stderr.isatty() else "\n"
                print(f"{len(results)} of {len(trials)} logs", end=end, file=sys.stderr, flush=True)
    return [results[k] for k in range(len(trials))]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=200, metavar="N",
                        help="of size 5; all others in proportion (200: 620 in all)")  # fmt: skip
    parser.add_argument("--seed", type=int, help="of machines, effects, noise; drawn if absent")
    parser.add_argument("--sizes", type=float, nargs="*", default=SIZES, choices=SIZES)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--json", type=Path, metavar="FILE", help="every log and its score")
    parser.add_argument("--figures", type=Path, metavar="FOLDER",
                        help="for hidden_confusion.png and hidden_power.png")  # fmt: skip
    parser.add_argument("--must", action="store_true", help="exit 3 where a requirement is missed")
    options = parser.parse_args()
    seed = options.seed
    if seed is None:
        seed = int(np.random.SeedSequence().generate_state(1)[0])
    print(f"seed {seed}", file=sys.stderr, flush=True)
    scores = run(draw(options.logs, options.sizes, seed), options.processes)
    lines = requirements(scores)
    print("\n".join(tables(scores, lines, seed)))
    if options.json:
        document = {"seed": seed, "requirements": [{**asdict(line), "reached": line.reached}
                    for line in lines], "logs": [asdict(s) for s in scores]}  # fmt: skip
        options.json.write_text(json.dumps(jsonable(document), indent=1, allow_nan=False) + "\n")
    if options.figures:
        options.figures.mkdir(parents=True, exist_ok=True)
        for name, figure in (("confusion", draw_confusion), ("power", draw_power)):
            picture = render(lambda figure=figure: figure(scores), "png")  # type: ignore[misc]
            (options.figures / f"hidden_{name}.png").write_bytes(picture)
    missed = [line.what for line in lines if not line.reached]
    for what in missed if options.must else ():
        print(f"missed: {what}", file=sys.stderr)
    return 3 if options.must and missed else 0


if __name__ == "__main__":
    sys.exit(main())
