"""What faults of lines, files and ends do to the set points of `compensate`: one figure each.

Makes two designs of data_samples/ (one sensor, three), plays `duty` and `idle` as lines through the
command, does one thing wrong at a time, and prints how far the set points then are from those of
the clean stream (or how long an end takes). In `make study`.
"""

import argparse
import contextlib
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from functools import cached_property
from pathlib import Path

import numpy as np

TOOL = [sys.executable, "-m", "thermaltool"]
FAR, PAIRS = "dT_pair1_K", ("dT_pair1_K", "dT_pair2_K", "dT_pair3_K")
DEFLECTIONS = ("d_x_um", "d_y_um")
ROWS, AT = 6000, 4000
# A frame that is so much quicker plays its lines in real time: their period is then 0.01 s.
QUICKER, QUICK_PERIOD = 50.0, 0.01


class Bench:
    """Logs, designs and clean set points in a folder."""

    def __init__(self, folder: Path, samples: Path, quicker: float = 1.0) -> None:
        self.folder, self.samples = folder, samples
        for name in ("duty", "idle", "step100"):
            path = folder / f"{name}.csv"
            self.tool("check", samples / f"frame_{name}.parquet", "-o", path)
            header, *rows = path.read_text().splitlines(True)
            times = (row.partition(",") for row in rows)
            rows = [f"{float(time) / quicker:.9g},{rest}" for time, _, rest in times]
            path.write_text("".join([header, *rows]))
        self.tool("noise", folder / "idle.csv", "-o", folder / "noise.json")
        options = [f"--sensor={name}" for name in PAIRS]
        options += [f"--deflection={name}" for name in DEFLECTIONS]
        options += [f"--response={name}=conduction" for name in PAIRS]
        options += [f"--response={name}=deflection" for name in DEFLECTIONS]
        step = folder / "step100.csv"
        self.tool("calibrate", step, "--drive", "Q_main_1", *options, "-o", folder / "model.json")
        design = ["--noise", folder / "noise.json", "--form", "kalman", "-q"]
        for name, sensors in (("one", [f"--sensor={FAR}"]), ("three", [])):
            target = folder / f"{name}.json"
            self.tool("regularize", folder / "model.json", *design, *sensors, "-o", target)
        self.lines = (folder / "duty.csv").read_bytes().splitlines(True)[: ROWS + 1]
        self.idle = (folder / "idle.csv").read_bytes().splitlines(True)[:3600]
        self.clean = {name: self.setpoints(name, self.lines)[0] for name in ("one", "three")}

    @cached_property
    def quick(self) -> "Bench":
        """The same for a frame that is quicker."""
        folder = self.folder / "quick"
        folder.mkdir()
        return Bench(folder, self.samples, QUICKER)

    def tool(self, *arguments: object) -> None:
        call = [*TOOL, *map(str, arguments)]
        subprocess.run(call, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def setpoints(
        self, design: str, lines: list[bytes], *options: object
    ) -> tuple[np.ndarray, str, int]:
        """Set points (without the safe line of the end), messages, exit code."""
        call = [*TOOL, "compensate", str(self.folder / f"{design}.json"), *map(str, options)]
        done = subprocess.run(call, input=b"".join(lines), capture_output=True, timeout=300)
        rows = [line.split(",")[1:3] for line in done.stdout.decode().splitlines()[1:]]
        return np.array(rows[:-1], float).reshape(-1, 2), done.stderr.decode(), done.returncode

    def column(self, name: str) -> int:
        return self.lines[0].decode().strip().split(",").index(name)

    def changed(self, name: str, at: range, change) -> list[bytes]:
        lines, column = list(self.lines), self.column(name)
        for k in at:
            fields = lines[k].rstrip(b"\n").split(b",")
            fields[column] = change(fields[column])
            lines[k] = b",".join(fields) + b"\n"
        return lines

    def worst(self, design: str, lines: list[bytes], *options: object) -> float:
        """Largest distance from the clean stream, row by row as far as both go."""
        found = self.setpoints(design, lines, *options)[0]
        clean = self.clean[design]
        rows = min(len(found), len(clean))
        return float(np.max(np.abs(found[:rows] - clean[:rows])))


def plus(value: float):
    return lambda field: b"%.3f" % (float(field) + value)


def evening_and_morning(b: Bench) -> float:
    state = b.folder / "evening.json"
    b.setpoints("three", b.lines[:2500], "--checkpoint", state)
    kept = b.setpoints("three", b.idle, "--checkpoint", state)[0]
    clean = b.setpoints("three", b.idle)[0]
    return float(np.max(np.abs(kept - clean)))


def stamp_ahead(b: Bench) -> float:
    return b.worst(
        "one", b.changed("time_s", range(AT, AT + 1), lambda t: b"%g" % (float(t) + 7000))
    )


def killed_in_a_ramp(b: Bench) -> float:
    """The largest step over kills at ten places, flooded, with a checkpoint of 10 s."""
    worst = 0.0
    for k in range(10):
        state = b.folder / f"kill{k}.json"
        call = [*TOOL, "compensate", str(b.folder / "one.json"), "--checkpoint", str(state)]
        process = subprocess.Popen(
            call, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        stop = 600 + 500 * k
        feeder = threading.Thread(target=process.stdin.write, args=(b"".join(b.lines[:stop]),))
        feeder.start()
        out = b""
        # All but what a pipe and the reader still hold.
        while out.count(b"\n") < stop - 400:
            out += os.read(process.stdout.fileno(), 65536)
        process.kill()
        feeder.join()
        out += process.stdout.read()
        with contextlib.suppress(BrokenPipeError):
            process.stdin.close()
        process.wait()
        last = np.array(out.decode().splitlines()[-1].split(",")[1:3], float)
        after = b.setpoints("one", [b.lines[0], *b.lines[stop : stop + 20]], "--checkpoint", state)
        worst = max(worst, float(np.max(np.abs(after[0][0] - last))))
    return worst


def header_amid(b: Bench) -> float:
    names = b.lines[0].decode().strip().split(",")
    order = [names.index(n) for n in (*PAIRS[::-1], "time_s", *DEFLECTIONS)]
    turned = [
        b",".join(line.rstrip(b"\n").split(b",")[k] for k in order) + b"\n" for line in b.lines
    ]
    narrow = [k for k in range(len(names)) if names[k] in (*PAIRS, "time_s", *DEFLECTIONS)]
    plain = [
        b",".join(line.rstrip(b"\n").split(b",")[k] for k in narrow) + b"\n" for line in b.lines
    ]
    return b.worst("three", [*plain[:AT], turned[0], *turned[AT:]])


def flipped_design(b: Bench) -> float:
    content = (b.folder / "one.json").read_text()
    place = re.search(r'"walk_per_sqrt_s": \[\s*0\.0(\d)', content).start(1)
    bent = content[:place] + chr(ord(content[place]) ^ 2) + content[place + 1 :]
    (b.folder / "bent.json").write_text(bent)
    found, _, code = b.setpoints("bent", b.lines)
    return float(np.max(np.abs(found - b.clean["one"]))) if code == 0 else 0.0


def refused_model(b: Bench) -> float:
    (b.folder / "refused.json").write_bytes((b.folder / "one.json").read_bytes()[:-500])
    call = [*TOOL, "compensate", str(b.folder / "refused.json")]
    done = subprocess.run(call, input=b"".join(b.lines[:9]), capture_output=True)
    return float(done.stdout.count(b"\n"))


def other_fields(b: Bench) -> float:
    lines = list(b.lines)
    lines.insert(AT, b"%g,1\n" % (AT / 2 + 7000))
    found = b.setpoints("one", lines)[0]
    found = np.delete(found, AT - 1, axis=0)
    return float(np.max(np.abs(found - b.clean["one"])))


def sample(b: Bench) -> float:
    return b.worst("one", b.changed(FAR, range(AT, AT + 1), plus(6.0)))


def frozen(b: Bench) -> float:
    value = b.lines[AT].split(b",")[b.column(FAR)]
    return b.worst("three", b.changed(FAR, range(AT, ROWS), lambda field: value))


def lasting(b: Bench) -> float:
    return b.worst("three", b.changed(FAR, range(AT, ROWS), plus(5.0)))


def one_lost(b: Bench) -> float:
    return b.worst("three", b.changed(FAR, range(AT, ROWS), lambda field: b"nan"))


def detached(b: Bench) -> float:
    column, lines = b.column(FAR), list(b.lines)
    for k in range(AT, ROWS):
        fields = lines[k].rstrip(b"\n").split(b",")
        fields[column] = b"%.3f" % (float(fields[column]) * max(0.0, 1 - (k - AT) / 1200))
        lines[k] = b",".join(fields) + b"\n"
    return b.worst("three", lines)


def stalled_messages(b: Bench) -> float:
    """Seconds from SIGTERM to the end, stderr a full pipe, every line told; inf for never."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    try:
        while os.write(writer, b"x" * 4096):
            pass
    except BlockingIOError:
        os.set_blocking(writer, True)
    process = subprocess.Popen(
        [*TOOL, "compensate", str(b.folder / "one.json")],
        stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=writer,
    )  # fmt: skip
    process.stdin.write(b.lines[0] + b"".join(b"%d,x\n" % k for k in range(50)))
    process.stdin.flush()
    time.sleep(3)
    begin = time.monotonic()
    process.send_signal(signal.SIGTERM)
    try:
        process.wait(10)
        return time.monotonic() - begin
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return float("inf")
    finally:
        os.close(reader)
        os.close(writer)
        process.stdin.close()


def closed_stdout(b: Bench) -> float:
    call = ["sh", "-c", '"$@" >&-', "sh", *TOOL, "compensate", str(b.folder / "one.json")]
    begin = time.monotonic()
    process = subprocess.Popen(call, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL)
    try:
        process.wait(15)
        return time.monotonic() - begin
    except subprocess.TimeoutExpired:
        process.kill()
        subprocess.run(["pkill", "-f", str(b.folder / "one.json")], check=False)
        return float("inf")
    finally:
        process.stdin.close()


def two_at_once(b: Bench) -> float:
    """How many of two streams run on one checkpoint."""
    state = b.folder / "both.json"
    call = [*TOOL, "compensate", str(b.folder / "one.json"), "--checkpoint", str(state)]
    kept = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    both = [subprocess.Popen(call, **kept) for _ in range(2)]
    time.sleep(3)
    running = sum(process.poll() is None for process in both)
    for process in both:
        process.stdin.close()
        process.wait()
    return float(running)


def without_clock(keep):
    """Lines without a clock, in real time, of which some come; --period is that of all."""

    def fault(b: Bench) -> float:
        quick = b.quick
        kept, column = [k for k in range(1, ROWS + 1) if keep(k)], quick.column(FAR)
        call = [*TOOL, "compensate", str(quick.folder / "one.json"), f"--period={QUICK_PERIOD}"]
        process = subprocess.Popen(
            call, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        process.stdin.write(f"{FAR}\n".encode())
        process.stdin.flush()
        process.stdout.readline()
        begin = time.monotonic()
        for k in kept:
            time.sleep(max(begin + k * QUICK_PERIOD - time.monotonic(), 0.0))
            process.stdin.write(quick.lines[k].split(b",")[column].strip() + b"\n")
            process.stdin.flush()
        out, _ = process.communicate()
        rows = [line.split(b",")[1:3] for line in out.splitlines()][: len(kept)]
        clean = quick.clean["one"][np.array(kept) - 1]
        return float(np.max(np.abs(np.array(rows, float) - clean)))

    return fault


FAULTS = [
    ("1 stderr stalls: SIGTERM to the end", "s", stalled_messages),
    ("2 last evening's state on a cold machine", "um", evening_and_morning),
    ("3 one stamp two hours ahead", "um", stamp_ahead),
    ("4 killed in a flood: step at the restart", "um", killed_in_a_ramp),
    ("5 columns in another order behind a new header", "um", header_amid),
    ("6 a flipped bit in the design", "um", flipped_design),
    ("7 lines written where the model is refused", "", refused_model),
    ("9 stdout closed at the start: to the end", "s", closed_stdout),
    ("11 one sample + 6 K, one sensor", "um", sample),
    ("11 a frozen sensor of three", "um", frozen),
    ("11 a lasting step of 5 K, one sensor of three", "um", lasting),
    ("11 one sensor of three lost", "um", one_lost),
    ("11 one sensor of three comes off slowly", "um", detached),
    ("12 no clock, every fourth line lost", "um", without_clock(lambda k: k % 4)),
    ("12 no clock, lines half as often as --period says", "um", without_clock(lambda k: k % 2)),
    ("13 streams that run on one checkpoint", "", two_at_once),
    ("14 a short line with a stamp two hours ahead", "um", other_fields),
]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("samples", type=Path, nargs="?", default=Path("data_samples"))
    parser.add_argument("--only", default="", help="lines that begin so")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder), arguments.samples.absolute())
        print("| fault | figure | |\n|---|---|---|")
        for name, unit, fault in FAULTS:
            if name.startswith(arguments.only):
                print(f"| {name} | {fault(bench):.3g} | {unit} |", flush=True)


if __name__ == "__main__":
    main()
