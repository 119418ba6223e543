"""Faults at the stream and in files: kills, clocks, stalled readers and disks, endless inputs."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from stumbles_bench import PERIOD_S, ROWS, SAMPLES, Bench, FailedError, Stumble, last

ROOT = SAMPLES.parent
# Rate [um/s] and grid [um] of the set points in these streams: the machine moves as fast.
SLEW, STEP = 0.1, 0.5
# What one line may move: the rate over two periods, and the grid with its hysteresis [um].
MOST = 2 * SLEW * PERIOD_S + 1.25 * STEP
LIMITS = ("--slew", f"{SLEW}um/s", "--step", f"{STEP}um")
# A command that is refused says so within [s]; a pipe without a writer has its own time.
SOON, PATIENCE = 20.0, 60.0
ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
INJECTED = 1000


def log_lines(b: Bench) -> list[bytes]:
    """The machine's log, header first."""
    return b.log.read_bytes().splitlines(keepends=True)


def values(out: bytes | str) -> np.ndarray:
    """Set points of lines without a header [um]."""
    text = out.decode() if isinstance(out, bytes) else out
    return np.array([float(line.split(",")[1]) for line in text.splitlines()])


def moved(b: Bench, lines: list[bytes], *options: object) -> float:
    """The largest step of the set points from a line to the next, the safe line left out [um]."""
    call = ("compensate", b.design, "-", "-q", "--no-header", *LIMITS, *options)
    done = b.tool(*call, stdin=b"".join(lines))
    return float(np.max(np.abs(np.diff(values(done.out)[:-1]))))


def told(step: float) -> tuple[str, bool]:
    return f"steps to {step:.3g} um, {MOST:.3g} allowed", step <= MOST


def opened(b: Bench, *options: object, code: str = "", **how: object) -> subprocess.Popen[bytes]:
    """A stream that runs; `code` is done before it, in its interpreter."""
    start = f"{code}\nfrom thermaltool.cli import main; main()"
    call = [sys.executable, "-c", start, "compensate", str(b.design), "-", "-q", "--no-header",
            *LIMITS, *map(str, options)]  # fmt: skip
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    return subprocess.Popen(call, cwd=b.folder, env=os.environ | ENVIRONMENT, **{**pipes, **how})


def killed(b: Bench) -> tuple[str, bool]:
    """kill -9 at ten places, all lines in its pipe, and a restart that is given the rest."""
    lines, worst = log_lines(b), 0.0
    for k in range(10):
        state, stop = b.folder / f"killed{k}.json", 80 + 55 * k
        process = opened(b, "--checkpoint", state)
        assert process.stdin
        assert process.stdout
        feeder = threading.Thread(target=process.stdin.write, args=(b"".join(lines[:stop]),))
        feeder.start()
        feeder.join()
        process.stdin.flush()
        out = b""
        while out.count(b"\n") < stop - 40:
            out += os.read(process.stdout.fileno(), 65536)
        process.kill()
        out += process.stdout.read()
        process.stdin.close()
        process.wait()
        rest = b.tool("compensate", b.design, "-", "-q", "--no-header", *LIMITS, "--checkpoint",
                      state, stdin=b"".join([lines[0], *lines[stop : stop + 30]]))  # fmt: skip
        whole = out[: out.rfind(b"\n") + 1]
        both = np.concatenate([values(whole)[-1:], values(rest.out)[:-1]])
        worst = max(worst, float(np.max(np.abs(np.diff(both)))))
    return told(worst)


def restamped(b: Bench, change: Callable[[int, float], float | None]) -> list[bytes]:
    """The log with the stamps that `change` gives, by row."""
    header, *rows = log_lines(b)
    made = [header]
    for k, row in enumerate(rows):
        stamp, comma, rest = row.partition(b",")
        new = change(k, float(stamp))
        made.append(row if new is None else b"%.1f" % new + comma + rest)
    return made


def stamp_ahead(b: Bench) -> tuple[str, bool]:
    """One stamp two hours ahead, at each of ten places of a machine that has just begun to bend."""
    return told(max(moved(b, restamped(b, lambda k, t, at=at: t + 7200 if k == at else None))
                    for at in range(60, 160, 10)))  # fmt: skip


def clock_put_back(b: Bench) -> tuple[str, bool]:
    """An hour back, and to another zone, in the middle."""
    return told(max(moved(b, restamped(b, lambda k, t, by=by: t + by if k >= 300 else None))
                    for by in (-3600.0, 3600.0, -7200.0)))  # fmt: skip


def header_lost(b: Bench) -> tuple[str, bool]:
    """A restart far from the safe set point, and a logger whose first line is lost."""
    header, *rows = log_lines(b)
    call = ("compensate", b.design, "-", "-q", "--no-header", *LIMITS, "--checkpoint", "lost.json")
    b.tool(*call, "--end", "hold", stdin=b"".join([header, *rows[:300]]))
    done = b.tool(*call, "--slew", "5um/s", "--end", "ramp", stdin=b"".join(rows[300:]), fails=True)
    time, value = np.array([line.split(",")[:2] for line in done.out.splitlines()], float).T
    room = 5.0 * np.diff(time) + 1.25 * STEP - np.abs(np.diff(value))
    refused = done.code == 1 and "no column T_head_degC" in done.err
    return (f"told; from {value[0]:g} to {value[-1]:g} um {'within' if min(room) > 0 else 'past'} "
            "the limit (`--end ramp`)"), refused and value[-1] == 0 and min(room) > 0  # fmt: skip


def flipped_stamps(b: Bench) -> tuple[str, bool]:
    """A bit of a stamp is another one, once in twenty lines."""
    header, *rows = log_lines(b)
    chance, made = np.random.default_rng(int.from_bytes(os.urandom(4))), [header]
    for row in rows:
        stamp, comma, rest = row.partition(b",")
        bits = bytearray(stamp)
        if chance.random() < 0.05:
            bits[chance.integers(len(bits))] ^= 1 << int(chance.integers(7))
        made.append(bytes(bits).replace(b"\n", b"?") + comma + rest)
    return told(moved(b, made))


def ends(process: subprocess.Popen[bytes], wait: float) -> tuple[bytes, float]:
    """What a stream still writes after SIGTERM, its reader asleep for `wait` [s]; how long."""
    assert process.stdout
    begin = time.monotonic()
    process.send_signal(signal.SIGTERM)
    time.sleep(wait)
    out = process.stdout.read()
    process.wait(SOON)
    return out, time.monotonic() - begin


def stalled_reader(b: Bench) -> tuple[str, bool]:
    """A reader that takes nothing until the pipe is full, and wakes half a second after SIGTERM."""
    header, *rows = log_lines(b)
    process = opened(b)
    assert process.stdin
    flood = b"".join([header, *rows]) + b"".join(
        b"%d.0," % (10 * (ROWS + k)) + rows[-1].partition(b",")[2] for k in range(20000)
    )
    feeder = threading.Thread(target=feed, args=(process, flood), daemon=True)
    feeder.start()
    time.sleep(3.0)
    out, seconds = ends(process, 0.5)
    final = values(out)[-1]
    return f"ends in {seconds:.1f} s, last line {final:g} um", bool(final == 0 and seconds < 5)


def feed(process: subprocess.Popen[bytes], data: bytes) -> None:
    """Write until nobody takes it."""
    try:
        process.stdin.write(data)
        process.stdin.flush()
    except (BrokenPipeError, ValueError):
        pass


def hanging_disk(b: Bench) -> tuple[str, bool]:
    """A checkpoint whose disk never answers again: lines go on, and the safe line leaves."""
    hangs = "import os, time\nos.fsync = lambda handle: time.sleep(600)"
    process = opened(b, "--checkpoint", b.folder / "hanging.json", code=hangs)
    assert process.stdin
    assert process.stdout
    feed(process, b"".join(log_lines(b)))
    out, begin = b"", time.monotonic()
    while out.count(b"\n") < ROWS and time.monotonic() < begin + SOON:
        out += os.read(process.stdout.fileno(), 65536)
    more, seconds = ends(process, 0.0)
    process.stdin.close()
    final = values(out + more)[-1]
    ok = out.count(b"\n") >= ROWS and final == 0 and seconds < 5
    return f"{out.count(10)} of {ROWS} lines; ends in {seconds:.1f} s at {final:g} um", ok


def early_signal(b: Bench) -> tuple[str, bool]:
    """SIGTERM at forty moments of the first half second of a restart far from the safe set point.

    Before Python runs the program nothing takes a signal: that time is found first.
    """
    data, state = log_lines(b), b.folder / "early.json"
    begin = time.monotonic()
    subprocess.run([sys.executable, "-c", "import click"], env=os.environ | ENVIRONMENT)
    loaded = time.monotonic() - begin
    without = []
    for k in range(40):
        process = opened(b, "--checkpoint", state, "--end", "hold")
        process.communicate(b"".join(data[:300]))
        process = opened(b, "--checkpoint", state)
        delay = 0.5 * k / 40
        time.sleep(delay)
        out, _ = ends(process, 0.0)
        process.stdin.close()
        without += [delay] if not len(values(out)) or values(out)[-1] != 0 else []
    return (f"{40 - len(without)} of 40 end with the safe line; the others by "
            f"{1000 * max(without, default=0):.0f} ms (Python starts in {1000 * loaded:.0f} ms)",
            max(without, default=0.0) <= loaded)  # fmt: skip


def endless(b: Bench) -> tuple[str, bool]:
    """/dev/zero and a line without an end, as log, model, map and noise."""
    _ = b.model, b.idle, b.log
    calls = ["check {}", "simulate {} log.csv", "simulate model.json {}", "plot {} -o x.png",
             "regularize model.json --noise {}", "check log.csv --columns {}"]  # fmt: skip
    refused, slowest = 0, 0.0
    for call in calls:
        begin = time.monotonic()
        done = b.tool(*call.replace("{}", "/dev/zero").split(), fails=True)
        slowest = max(slowest, time.monotonic() - begin)
        refused += done.code == 1 and "16 MiB" in done.err
    yes = f"yes 1234567 | tr -d '\\n' | {sys.executable} -m thermaltool check -"
    done = subprocess.run(["sh", "-c", yes], capture_output=True, text=True, timeout=120,
                          env=os.environ | ENVIRONMENT, cwd=b.folder)  # fmt: skip
    refused += done.returncode == 1 and "16 MiB" in done.stderr
    return f"{refused} of 7 refused, within {slowest:.1f} s", refused == 7 and slowest < SOON


def no_writer(b: Bench) -> tuple[str, bool]:
    fifo = b.folder / "nobody"
    os.mkfifo(fifo)
    begin = time.monotonic()
    done = b.tool("check", fifo, fails=True)
    seconds = time.monotonic() - begin
    return f"{last(done.err)[-52:]} (told before)", (
        done.code == 1 and "waits for who writes it" in done.err and seconds < PATIENCE + SOON
    )


def too_large(b: Bench) -> tuple[str, bool]:
    done = b.tool("--max-bytes", "10kB", "check", b.log, fails=True)
    return last(done.err)[-80:], done.code == 1 and "--max-bytes" in done.err


def nested(b: Bench) -> tuple[str, bool]:
    """NDJSON, TOML and a model nested deep; integers of 5000 digits; wrong shapes inside."""
    deep, huge = 100_000, "9" * 5000
    noise = json.loads(b.idle.read_text())
    noise["channels"]["T_head_degC"]["white_sigma"] = [[1.0], [2.0]]
    arma = {**json.loads(series_model(b).read_text())}
    arma["ar"] = [[0.5, 0.1], [0.2]]
    model = b.model.read_text()
    files = {
        "deep.ndjson": '{"a":' * deep + "1" + "}" * deep + "\n",
        "deep.toml": "a = " + "[" * deep + "]" * deep + "\n",
        "deep.json": "[" * deep + "]" * deep,
        "huge.ndjson": f'{{"time_s": 0, "T_a_degC": {huge}}}\n' * 3,
        "huge.toml": f"[columns]\na = {{ name = 'T_a_degC', scale = {huge} }}\n",
        "huge.json": re.sub(r'"tau1": [\d.]+', f'"tau1": {huge}', model),
        "shape.noise.json": json.dumps(noise),
        "shape.arma.json": json.dumps(arma),
    }
    for name, text in files.items():
        (b.folder / name).write_text(text)
    calls = [
        ("check", "deep.ndjson"), ("check", b.log, "--columns", "deep.toml"),
        ("present", "deep.json"), ("check", "huge.ndjson"),
        ("check", b.log, "--columns", "huge.toml"), ("simulate", "huge.json", b.log),
        ("regularize", b.model, "--noise", "shape.noise.json"),
        ("forecast", "shape.arma.json", "swings.csv", "-C", "e_tool_um"),
    ]  # fmt: skip
    bad = []
    for call in calls:
        try:
            done = b.tool(*call, fails=True)
        except FailedError as error:
            bad.append(str(error))
            continue
        line = done.err.strip()
        named = any(Path(str(word)).name in line + done.out for word in call[1:])
        if not done.code or not named or "Warning" in line or line.count("\n") > 1:
            bad.append(f"{call[0]} {call[-1]}: {line[:60]}")
    return f"{len(calls) - len(bad)} of {len(calls)} have file and reason{': ' if bad else ''}" + (
        "; ".join(bad)
    ), not bad


def series_model(b: Bench) -> Path:
    """An AR model of a series."""
    grown = 0.1 * np.cumsum(b.noise.standard_normal(300))
    b.write("swings.csv", time_s=np.arange(300), e_tool_um=grown)
    b.tool("fit", "swings.csv", "-C", "e_tool_um", "--order", "2,0", "-o", "swings.json")
    return b.folder / "swings.json"


def injected(script: str) -> Callable[[Bench], tuple[str, bool]]:
    """A thousand faults that are drawn anew, by the script of the tests."""

    def look(b: Bench) -> tuple[str, bool]:
        del b
        done = subprocess.run(
            [sys.executable, ROOT / "tests" / "faults" / script, "--count", str(INJECTED)],
            capture_output=True, text=True, env=os.environ | ENVIRONMENT,
        )  # fmt: skip
        seed = re.search(r"seed (\d+)", done.stdout)
        failures = re.search(r"^(\d+) (?:failures|of)", done.stdout, re.MULTILINE)
        words = f"{failures[1] if failures else '?'} failures of {INJECTED}"
        return f"{words} (seed {seed[1] if seed else '?'})", done.returncode == 0

    return look


STUMBLES = [
    Stumble(
        "5.0a",
        "1000 injected faults of streams: steps, limits, ends",
        "steps past the limit",
        injected("streams.py"),
    ),
    Stumble(
        "5.0b",
        "1000 spoiled files: one line each, no hang",
        "60 of 2700 unexpected, 44 of 687 endless inputs hang",
        injected("mutations.py"),
    ),
    Stumble("5.1a", "kill -9, checkpoint, backlog: step at the restart", "up to 62 um", killed),
    Stumble("5.1b", "one stamp that leaps ahead", "48 um", stamp_ahead),
    Stumble("5.1c", "a clock put back, another zone", "25 to 34 um", clock_put_back),
    Stumble("5.1d", "a header that is lost at the start", "96 um", header_lost),
    Stumble("5.1e", "flipped bits in stamps", "55 um", flipped_stamps),
    Stumble("5.2a", "a reader that stalls: SIGTERM", "no safe line", stalled_reader),
    Stumble("5.2b", "a checkpoint disk that hangs: SIGTERM", "no safe line", hanging_disk),
    Stumble("5.2c", "SIGTERM in the first moments", "no safe line", early_signal),
    Stumble("5.3a", "/dev/zero, a line without an end", "hang, or fill the memory", endless),
    Stumble("5.3b", "a named pipe without a writer", "hangs", no_writer),
    Stumble("5.3c", "`--max-bytes`", "not there", too_large),
    Stumble("5.4", "nested deep, huge integers, wrong shapes", "unexpected error", nested),
]
