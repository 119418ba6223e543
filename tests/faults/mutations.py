"""Valid files of every kind, spoiled at random; what a command may make of them.

A long run: ``python tests/faults/mutations.py --count 10000 [--seed N] [--keep FOLDER]``.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import random
import re
import signal
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).parents[1]))

# A command on these files takes some tenths of a second of the processor [s].
MAX_SECONDS = 10
# One that waits for what does not come takes none; others at work make a sound one slow [s].
MAX_WAIT = 120
EXIT_CODES = {0, 1, 2, 3, 4}


@dataclass(frozen=True)
class Outcome:
    """Exit code and what was written."""

    code: Any
    out: str
    err: str


@dataclass(frozen=True)
class Case:
    """A file that is spoiled, and a command that reads it (``{}`` in its arguments)."""

    file: Path
    arguments: tuple[str, ...]


class TooSlow(BaseException):
    """A command that does not end."""


def run(*arguments: str) -> Outcome:
    """A command through `main` in this process, ended after `MAX_SECONDS` or `MAX_WAIT`."""
    from thermaltool.cli import main

    streams = [io.TextIOWrapper(io.BytesIO(), encoding="utf-8") for _ in range(3)]
    before = sys.argv, sys.stdin, sys.stdout, sys.stderr
    handlers = {s: signal.getsignal(s) for s in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)}

    def stop(number: int, frame: Any) -> None:
        raise TooSlow

    previous = {s: signal.signal(s, stop) for s in (signal.SIGPROF, signal.SIGALRM)}
    code: Any = "no exit"
    # A stream writes its lines past Python's stdout.
    real, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        sys.argv = ["thermaltool", *arguments]
        sys.stdin, sys.stdout, sys.stderr = streams
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            signal.setitimer(signal.ITIMER_PROF, MAX_SECONDS)
            signal.alarm(MAX_WAIT)
            try:
                main()
            except SystemExit as end:
                code = end.code
            except TooSlow:
                code = "hang"
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0)
                signal.alarm(0)
    finally:
        os.dup2(real, 1)
        os.close(real)
        os.close(nowhere)
        sys.argv, sys.stdin, sys.stdout, sys.stderr = before
        for number, handler in (previous | handlers).items():
            signal.signal(number, handler)
    texts = []
    for stream in streams[1:]:
        stream.flush()
        texts.append(stream.buffer.getvalue().decode(errors="replace"))
    return Outcome(code, *texts)


def fault(outcome: Outcome) -> str | None:
    """What a user must not see, in a few words; None where all is well."""
    err = outcome.err
    if outcome.code not in EXIT_CODES:
        return f"exit code {outcome.code}"
    if "unexpected" in err:
        found = re.search(r"unexpected (\w+: .{0,70})", err)
        return f"unexpected {found[1] if found else err}"
    if "Traceback" in err:
        return "a traceback"
    if "encountered in" in err or "Warning" in err:
        return f"a warning of numpy: {err[:100]}"
    if outcome.code == 1 and not err.strip():
        return "an error without a word"
    last = err.rstrip("\n").splitlines()[-1:]
    if outcome.code == 1 and not (last and last[0].startswith("thermaltool ")):
        return f"an error of more than one line: {err[-200:]}"
    return None


# ---------------------------------------------------------------- how a file is spoiled

HUGE_INT = 10**400
NUMBERS = (0, -1, 1, 2, 1e300, -1e300, 1e160, 1e-300, 5e-324, 0.5, -0.0, 2**63, HUGE_INT)
OTHERS = (None, True, False, "", "x", "first", "nan", [], {}, [[]], [1], [[1.0, 2.0], [3.0]],
          [None], {"a": 1}, [[[[1]]]], float("nan"), float("inf"), -float("inf"))  # fmt: skip


def spoiled_bytes(data: bytes, rng: random.Random) -> bytes:
    """Bytes flipped, deleted, doubled, cut off or put in."""
    where = rng.randrange(len(data) + 1)
    until = min(len(data), where + rng.choice((1, 2, 5, 20, 200)))
    how = rng.randrange(6)
    if how == 0 and data:
        spoiled = bytearray(data)
        for _ in range(rng.choice((1, 1, 3, 10))):
            spoiled[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        return bytes(spoiled)
    if how == 1:
        return data[:where] + data[until:]
    if how == 2:
        return data[:until] + data[where:until] * rng.choice((1, 1, 50)) + data[until:]
    if how == 3:
        return data[:where]
    if how == 4:
        words = (b"\0", b"nan", b"inf", b"1e300", b"9" * 5000, b"\xff", b'"', b",", b"\n", b"{",
                 b"[" * 100_000, b'{"a":' * 50_000, b"-", b"e", b"1e999", b"_")  # fmt: skip
        return data[:where] + rng.choice(words) + data[where:]
    return _with_other_number(data, rng)


def _with_other_number(data: bytes, rng: random.Random) -> bytes:
    found = list(re.finditer(rb"-?\d+\.?\d*(e[-+]?\d+)?", data))
    if not found:
        return data
    other = rng.choice((b"nan", b"1e300", b"1e160", b"-1e300", b"1e-300", b"9" * 400, b"9" * 5000,
                        b"x", b"", b"[1]", b"inf", b"1e999", b"0", b"-1", b"1e20"))  # fmt: skip
    number = rng.choice(found)
    return data[: number.start()] + other + data[number.end() :]


def spoiled_json(data: bytes, rng: random.Random) -> bytes:
    """A value at a random place of a document changed, moved, nested, doubled or taken away."""
    document = json.loads(data)
    for _ in range(rng.choice((1, 1, 1, 2))):
        places = list(_places(document))
        if not places:
            break
        holder, key = rng.choice(places)
        how = rng.randrange(7)
        if how == 0:
            holder[key] = rng.choice(NUMBERS)
        elif how == 1:
            holder[key] = rng.choice(OTHERS)
        elif how == 2:
            del holder[key]
        elif how == 3:
            holder[key] = [holder[key]] * rng.choice((1, 2))
        elif how == 4:
            other, place = rng.choice(places)
            with contextlib.suppress(KeyError, IndexError):
                holder[key] = json.loads(json.dumps(other[place]))
        elif how == 5 and isinstance(holder, list):
            holder.insert(key, json.loads(json.dumps(holder[key])))
        else:
            value = holder[key]
            factor = rng.choice((-1, 0, 1e-9, 1e9, 1e200))
            holder[key] = value * factor if type(value) is float else str(value)
    return json.dumps(document).encode()


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, each in list(items):
        yield value, key
        if isinstance(each, dict | list):
            yield from _places(each)


def spoiled(data: bytes, name: str, rng: random.Random) -> bytes:
    """A file spoiled in one way or another."""
    by_place = name.endswith(".json") and rng.random() < 0.7
    return spoiled_json(data, rng) if by_place else spoiled_bytes(data, rng)


# ---------------------------------------------------------------- the files and the commands

LOG_ROWS = 60


def _log() -> dict[str, np.ndarray]:
    """A machine that warms up and cools down: 60 rows at 20 s."""
    from reference.fraser1997 import MAIN

    from thermaltool.responses.conduction import Conduction

    t = 20.0 * np.arange(LOG_ROWS)
    rng = np.random.default_rng(1)
    heat = np.where((t > 60) & (t < 800), 1.0, 0.2)
    changes = np.diff(heat, prepend=heat[0])
    since = np.maximum(t[:, None] - t, 0.0)
    warm = Conduction(**MAIN).step(since) @ changes
    bend = 40 * -np.expm1(-since / 300) @ changes
    return {
        "time_s": t,
        "Q_main_1": heat,
        "dT_pair1_K": warm + 0.01 * rng.standard_normal(LOG_ROWS),
        "d_x_um": bend + 0.1 * rng.standard_normal(LOG_ROWS),
    }


def _model() -> str:
    """The machine as a model; a calibration would take longer than a hundred spoiled files."""
    from reference.fraser1997 import MAIN

    from thermaltool.model import Drive, Model, Output, Term, dumps
    from thermaltool.responses.conduction import Conduction
    from thermaltool.responses.rational import Rational1

    covariance = np.diag([1e-2, 1e-6])
    return dumps(
        Model(
            drives=(Drive("Q_main_1", "zero", 0.0, (0.0, 1.0)),),
            outputs=(
                Output("dT_pair1_K", "sensor", 0.0, (0.0, 8.0), {"rmse": 0.01}),
                Output("d_x_um", "deflection", "first", (0.0, 40.0), {"rmse": 0.1}),
            ),
            terms=(
                Term("Q_main_1", "dT_pair1_K", Conduction(**MAIN)),
                Term("Q_main_1", "d_x_um", Rational1(40.0, 300.0), covariance, ("K1", "tau1")),
            ),
            sample_period=20.0,
            provenance={"logs": [{"name": "log.csv", "sha256": "0" * 64}]},
        )
    )


def _csv(columns: dict[str, np.ndarray]) -> str:
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    lines = [",".join(f"{value:.6g}" for value in row) for row in rows]
    return "\n".join([",".join(columns), *lines]) + "\n"


MAP = """separator = ","
missing = ["-999"]
unmapped = "drop"
[time]
column = "time_s"
unit = "s"
[columns]
Q_main_1 = "Q_main_1"
dT_pair1_K = { name = "dT_pair1_K", scale = 2.5, offset = 1.0 }
d_x_um = { name = "d_x1_um" }
[angles]
"""
CONFIG = '[check]\nmax-gap = 50.0\nfrom = "csv"\n'


def make_files(folder: Path) -> None:
    """A valid file of every kind that commands read."""
    from thermaltool.logs import write_table

    log = _log()
    (folder / "log.csv").write_text(_csv(log))
    for name in ("log.ndjson", "log.parquet"):
        write_table(log, str(folder / name), None)
    (folder / "map.toml").write_text(MAP)
    (folder / "config.toml").write_text(CONFIG)
    noise = {"white_sigma": 0.01, "drift": {"sigma": 0.02, "time_constant_s": 900.0},
             "resolution": 0.0001}  # fmt: skip
    channels = {"dT_pair1_K": noise, "d_x_um": {"white_sigma": 0.1, "drift": None}}
    document = {"format": "thermaltool-noise", "version": 1, "channels": channels}
    (folder / "noise.json").write_text(json.dumps(document))

    def make(*arguments: str) -> None:
        result = run(*(each.replace("@", f"{folder}/") for each in arguments))
        assert result.code == 0, f"{arguments}: {result}"

    (folder / "model.json").write_text(_model())
    design = ["regularize", "@model.json", "--noise", "@noise.json", "-q"]
    make(*design, "--form", "kalman", "--walk", "0.02", "-o", "@kalman.json")
    pinned = ["--regularization", "0.02", "1e-4", "0.2", "--cutoff", "0.02", "--delay", "10"]
    make(*design, "--form", "kernel", *pinned, "-o", "@kernel.json")
    make("regularize", "@model.json", "--measured", "Q_main_1", "-q", "-o", "@forward.json")
    make("correct", "@model.json", "@log.csv", "--curve", "polynomial", "-o", "@curve.json", "-q")
    make("schedule", "@model.json", "@model.json", "--by", "Q_main_1", "--levels", "0.5,1",
         "-o", "@schedule.json")  # fmt: skip
    make("fit", "@log.csv", "-C", "dT_pair1_K", "--order", "2,1", "-o", "@arma.json")
    make("compensate", "@kalman.json", "@log.csv", "-q", "--checkpoint", "@state.json")
    make("invert", "@kernel.json", "--json", "-o", "@inverse.json")
    make("noise", "@log.csv", "-o", "@measured.json")
    _with_effects(folder)


def _with_effects(folder: Path) -> None:
    """A model with each cause of the catalogue that acts in a simulation, and a log for it."""
    from effects.machine import AIR, BEARING, COOLANT, PART, columns, model, scene

    from thermaltool.effects import CATALOGUE, effect_class
    from thermaltool.model import dumps

    time_s, values = columns()
    short = {"time_s": time_s[:80], **{name: v[:80] for name, v in values.items()}}
    (folder / "effects.csv").write_text(_csv(short))
    place = scene(columns(0, (AIR, PART, BEARING, COOLANT)))
    for name in CATALOGUE:
        effect = next(iter(effect_class(name).probes(place)), None)
        if effect is not None and effect.parameters:
            (folder / f"effect_{name}.json").write_text(dumps(model(effect)))


def cases(folder: Path) -> list[tuple[float, Case]]:
    """Every file with every command that reads it, and how often it is tried."""
    f = folder

    def of(name: str, line: str, weight: float = 1.0) -> tuple[float, Case]:
        words = line.replace("@", f"{f}/").split()
        return weight, Case(f / name, tuple(words))

    found = [
        of("log.csv", "check {}", 2),
        of("log.csv", "noise {}", 2),
        of("log.csv", "simulate @model.json {}", 2),
        of("log.csv", "estimate @kalman.json {}", 2),
        of("log.csv", "estimate @kernel.json {}"),
        of("log.csv", "compensate @kalman.json {}"),
        of("log.csv", "forecast @arma.json {} --steps 3"),
        of("log.csv", "fit {} -C d_x_um --order 1"),
        of("log.csv", "correct @model.json {}"),
        of(
            "log.csv",
            "identify {} --input Q_main_1 --output d_x_um --orders 1,1,0 "
            "--structure arx -o @out.json",
        ),
        of("log.csv", "check {} -o @out.csv --resample 7"),
        of("log.ndjson", "check {}"),
        of("log.ndjson", "simulate @model.json {}"),
        of("log.ndjson", "compensate @kalman.json {}"),
        of("log.parquet", "check {}", 0.5),
        of("map.toml", "check @log.csv --columns {}", 3),
        of("map.toml", "simulate @model.json @log.csv --columns {}"),
        of("config.toml", "--config {} check @log.csv"),
        of("noise.json", "regularize @model.json --noise {} --form kalman --walk 0.02", 2),
        of("measured.json", "regularize @model.json --noise {} --form kalman --walk 0.02", 2),
        of("model.json", "simulate {} @log.csv", 3),
        of("model.json", "superpose {} -o @out.json"),
        of("model.json", "schedule {} @model.json --by Q_main_1 --levels 0.5,1 -o @out.json"),
        of("model.json", "correct {} @log.csv -o @out.json"),
        of("model.json", "regularize {} --noise @noise.json --form kalman --walk 0.02", 2),
        of("model.json", "regularize {} --measured Q_main_1"),
        of("model.json", "invert {} --regularization 0.01 1e-4 0.02"),
        of("model.json", "invert {} --filter 20 --sensor d_x_um"),
        of("kalman.json", "estimate {} @log.csv", 3),
        of("kalman.json", "compensate {} @log.csv", 2),
        of("kernel.json", "estimate {} @log.csv", 2),
        of("kernel.json", "compensate {} @log.csv", 2),
        of("kernel.json", "invert {}"),
        of("forward.json", "estimate {} @log.csv"),
        of("curve.json", "simulate {} @log.csv"),
        of("schedule.json", "simulate {} @log.csv"),
        of("arma.json", "forecast {} @log.csv", 3),
        of("arma.json", "forecast {} @log.csv --stream", 2),
        of("state.json", "compensate @kalman.json @log.csv --checkpoint {}", 2),
        of("inverse.json", "plot {} -o @out.png", 0.2),
        of("measured.json", "plot {} -o @out.png", 0.2),
        of("model.json", "plot {} -o @out.png", 0.2),
    ]
    for effect in sorted(f.glob("effect_*.json")):
        found.append(of(effect.name, "simulate {} @effects.csv", 0.3))
    return found


def spoil(
    folder: Path, count: int, seed: int, report: Callable[[int, Case, bytes, str, float], None]
) -> None:
    """Spoil `count` files made in `folder`, and report every fault, with its number."""
    make_files(folder)
    weights, every = zip(*cases(folder), strict=True)
    originals = {case.file: case.file.read_bytes() for case in every}
    for k in range(count):
        # Each has a seed of its own: any one can be made again alone.
        rng = random.Random(f"{seed}/{k}")
        case = rng.choices(every, weights)[0]
        data = spoiled(originals[case.file], case.file.name, rng)
        target = folder / f"spoiled{case.file.suffix}"
        target.write_bytes(data)
        start = time.process_time()
        outcome = run(*(each.replace("{}", str(target)) for each in case.arguments))
        found = fault(outcome)
        if found is not None:
            report(k, case, data, found, time.process_time() - start)


def main() -> None:
    """A long run, with a table of what was found."""
    import tempfile

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=int.from_bytes(os.urandom(4), "big"))
    parser.add_argument("--keep", type=Path, help="Where files that are not dealt with are kept.")
    arguments = parser.parse_args()
    print(f"seed {arguments.seed}")
    seen: Counter[str] = Counter()
    examples: dict[str, str] = {}

    def report(k: int, case: Case, data: bytes, found: str, seconds: float) -> None:
        words = " ".join(Path(each).name for each in case.arguments)
        kind = f"{case.file.name}: {found}"
        seen[kind] += 1
        examples.setdefault(kind, f"#{k}: {words} ({seconds:.1f} s)")
        if arguments.keep is not None:
            arguments.keep.mkdir(exist_ok=True)
            name = f"{arguments.seed}_{k}"
            (arguments.keep / f"{name}{case.file.suffix}").write_bytes(data)
            (arguments.keep / f"{name}.txt").write_text(f"{words}\n{found}\n")

    with tempfile.TemporaryDirectory() as folder:
        start = time.monotonic()
        spoil(Path(folder), arguments.count, arguments.seed, report)
    for kind, count in seen.most_common():
        print(f"{count:4d}  {kind}\n        {examples[kind]}")
    print(f"{sum(seen.values())} of {arguments.count} in {time.monotonic() - start:.0f} s")
    sys.exit(bool(seen))


if __name__ == "__main__":
    main()
