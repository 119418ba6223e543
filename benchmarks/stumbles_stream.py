"""Small things at the stream: how its lines look and how it ends; ISO 230-3; a slim install."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from importlib import metadata

import numpy as np
from stumbles_bench import ROWS, SAMPLES, Bench, Stumble

sys.path.append(str(SAMPLES.parent / "tests"))

from machines import nest

ROOT = SAMPLES.parent
# Rate of the set points at an end [um/s], and their grid [um].
SLEW, STEP = 5.0, 0.5
COVERED = 0.93, 0.97
LOGS = 20


def lines(b: Bench, *options: object, code: int = 0) -> list[str]:
    """What `compensate` writes of the machine's log."""
    done = b.tool("compensate", b.design, b.log, "-q", *options, fails=bool(code))
    return (done.out if done.code == code else done.err).splitlines()


def no_header(b: Bench) -> tuple[str, bool]:
    named, bare = lines(b), lines(b, "--no-header")
    return f"first line: {bare[0]}", named[1:] == bare and named[0].startswith("time_s")


def values_only(b: Bench) -> tuple[str, bool]:
    found = lines(b, "--to", "values")
    wanted = [line.split(",")[1] for line in lines(b, "--no-header")]
    return f"last but one line: {found[-2]}", found == wanted


def template(b: Bench) -> tuple[str, bool]:
    found = lines(b, "--template", "SET_GCODE_OFFSET Z={offset_z_mm:.4f} MOVE=1")
    wanted = [float(line.split(",")[1]) / 1000 for line in lines(b, "--no-header")]
    right = [f"SET_GCODE_OFFSET Z={value:.4f} MOVE=1" for value in wanted]
    return found[-2], found == right


def original_stamps(b: Bench) -> tuple[str, bool]:
    columns = b.columns()
    second = columns.pop("time_s").astype(int)
    stamps = [f"2026-03-14T{10 + k // 3600:02d}:{k // 60 % 60:02d}:{k % 60:02d}" for k in second]
    log = b.write("stamps.csv", time=np.array(stamps, object), **columns)
    done = b.tool("compensate", b.design, log, "-q", "--no-header")
    found = [line.split(",")[0] for line in done.out.splitlines()]
    return f"first {found[0]}, last {found[-1]}", found[:-1] == stamps


def status(b: Bench) -> tuple[str, bool]:
    """A sensor that is silent for half an hour: held, then safe, then on its way back."""
    columns = b.columns()
    columns["T_head_degC"][300:480] = np.nan
    b.write("silent.csv", **columns)
    done = b.tool("compensate", b.design, "silent.csv", "-q", "--no-header", "--also", "status")
    words = [line.split(",")[-1] for line in done.out.splitlines()][:-1]
    order = [word for k, word in enumerate(words) if k == 0 or words[k - 1] != word]
    ok = order[:3] == ["ok", "held", "safe"] and order[-1] == "ok" and len(words) == ROWS
    return " → ".join(order), ok and "settles" in order


def the_end(b: Bench) -> tuple[str, bool]:
    """The last lines of each end, on a machine that is far from its safe set point."""
    told, ok = [], True
    for end in ("safe", "ramp", "hold"):
        found = lines(b, "--no-header", "--end", end, "--slew", f"{SLEW:g}um/s")
        time, value = np.array([line.split(",")[:2] for line in found], float).T
        more, at = len(found) - ROWS, value[-1]
        room = SLEW * np.diff(time) + 1.25 * STEP - np.abs(np.diff(value))
        told.append(f"{end}: {more} lines more, {'within' if min(room) > 0 else 'past'} the limit")
        ok &= {"safe": at == 0 and more == 1, "hold": at != 0 and more == 0,
               "ramp": at == 0 and min(room) > 0}[end]  # fmt: skip
    return "; ".join(told), ok


def spindle_log(b: Bench, rng: np.random.Generator, drift: float, k: int) -> list[bool]:
    """One test of a spindle in its nest: which intervals hold the range without noise."""
    dt = 15.0
    time = np.arange(0.0, 9 * 3600.0, dt)
    speed = np.where(time < 1800, 0.0, np.where(time < 16200, 2500.0, 5000.0))
    true = nest.displacements(time, speed, rng)
    clean = dict(zip(nest.PROBES, true, strict=True))
    clean |= {"B": 10 * (true[1] - true[0]), "A": -10 * (true[3] - true[2])}
    named = dict(zip(("X1", "X2", "Y1", "Y2", "Z"), nest.PROBES, strict=True))
    idle = np.arange(0.0, 16 * 3600.0, dt)
    still = nest.readings(np.zeros((5, len(idle))), dt, rng, drift)
    b.write("nest_idle.csv", time_s=idle, **dict(zip(nest.PROBES, still, strict=True)))
    read = nest.readings(true, dt, rng, drift)
    log = b.write(f"nest{k}.csv", time_s=time, n_spindle_rpm=speed,
                  **dict(zip(nest.PROBES, read, strict=True)))  # fmt: skip
    b.tool("noise", "nest_idle.csv", "--start", "0", "-o", "nest_noise.json")
    probes = [f"--probe={name}={place}" for name, place in nest.PROBES.items()]
    done = b.tool("iso230", log, *probes, "--noise", "nest_noise.json", "--json")
    held = []
    for run in json.loads(done.out)["runs"]:
        for figure in run["figures"]:
            end = run["start_s"] + (figure["time_s"] or run["duration_s"])
            part = (run["start_s"] <= time) & (time <= end)
            name = named.get(figure["quantity"], figure["quantity"])
            held.append(figure["low"] <= np.ptp(clean[name][part]) <= figure["high"])
    return held


def iso230(drift: float):
    """Coverage over fresh draws: with drift of the probes, and without."""

    def look(b: Bench) -> tuple[str, bool]:
        seed = int.from_bytes(os.urandom(4))
        rng = np.random.default_rng(seed)
        held = [each for k in range(LOGS) for each in spindle_log(b, rng, drift, k)]
        share = float(np.mean(held))
        return (f"{100 * share:.1f} % of {len(held)} figures of {LOGS} logs (seed {seed})",
                COVERED[0] <= share <= COVERED[1])  # fmt: skip

    return look


def slim(b: Bench) -> tuple[str, bool]:
    """Which packages a stream imports, and how large they are on this disk."""
    _ = b.design, b.log
    code = ("import sys, sysconfig; from thermaltool.cli import group\n"
            "group(sys.argv[1:], standalone_mode=False)\n"
            "site = sysconfig.get_path('purelib')\n"
            "print(*{n.partition('.')[0] for n, m in list(sys.modules.items())\n"
            "        if str(getattr(m, '__file__', '') or '').startswith(site)},\n"
            "      file=sys.stderr)")  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", code, "compensate", "design.json", "log.csv", "-q"],
        cwd=b.folder, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    found = {name for name in done.stderr.split() if not name.startswith("_")}
    size = sum(metadata.distribution(name).locate_file(file).stat().st_size
               for name in found for file in metadata.files(name) or ()
               if metadata.distribution(name).locate_file(file).exists())  # fmt: skip
    own = sum(path.stat().st_size for path in (ROOT / "thermaltool").rglob("*.py"))
    return f"{', '.join(sorted(found))}: {(size + own) / 1e6:.0f} MB", found == {"numpy", "click"}


def extras(b: Bench) -> tuple[str, bool]:
    del b
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needs = sorted(re.split(r"\W", each)[0] for each in project["dependencies"])
    names = sorted(project["optional-dependencies"])
    lock = (ROOT / "requirements.lock").read_text()
    packages = {re.split(r"[^\w-]", each)[0] for name in ("plot", "plants", "batch", "formats")
                for each in project["optional-dependencies"][name]}  # fmt: skip
    locked = all(re.search(rf"^{name}==", lock, re.MULTILINE | re.IGNORECASE) for name in packages)
    ok = needs == ["click", "numpy"] and {"plot", "plants", "batch", "formats", "all"} <= {*names}
    return f"needs {', '.join(needs)}; extras {', '.join(names)}", ok and locked


MISSED = "missed"
STUMBLES = [
    Stumble("4.1a", "`--no-header`", MISSED, no_header),
    Stumble("4.1b", "values only", MISSED, values_only),
    Stumble("4.1c", "`--template` of G-code, in mm", MISSED, template),
    Stumble("4.1d", "ISO stamps of the log", "come out as relative seconds", original_stamps),
    Stumble("4.1e", "a status in each line", MISSED, status),
    Stumble("4.1f", "`--end`: the slew limit to the last line", "safe zero at once, past `--slew`",
            the_end),
    Stumble("4.2a", "`iso230`: 95 % intervals, probes that drift", MISSED, iso230(0.1)),
    Stumble("4.2b", "`iso230`: 95 % intervals, probes without drift", MISSED, iso230(0.0)),
    Stumble("4.3a", "what the stream alone loads", "680 MB", slim),
    Stumble("4.3b", "parts of the install; `make demo` has all", MISSED, extras),
]  # fmt: skip
