"""What users missed when they looked: tables and figures of models, progress, pages."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from stumbles_bench import MAX_SECONDS, PERIOD_S, ROWS, SAMPLES, Bench, FailedError, Stumble, said

sys.path.append(str(SAMPLES.parent))

from thermaltool.responses import KINDS

ROOT = SAMPLES.parent
# Lines of a usual terminal.
SCREEN = 40
# Without a word, with the start of the program [s].
MOST_SILENCE = 4.0


def models(b: Bench) -> tuple[Path, Path]:
    """A model of both outputs, and one of the deflection alone with more lags than it has."""
    return b.model, b.calibrated(b.log, "lag.json", outputs="d")


def drawn(b: Bench, figure: str) -> str:
    """All texts of an SVG figure, which hold them as comments beside their outlines."""
    return "\n".join(re.findall(r"<!-- (.*?) -->", (b.folder / figure).read_text()))


def has(text: str, *words: str) -> tuple[str, bool]:
    """How many of these words a text holds."""
    missing = [word for word in words if word not in text]
    return ("all there" if not missing else f"not there: {', '.join(missing)}"), not missing


def presented(b: Bench) -> tuple[str, bool]:
    text = b.tool("present", b.model).out
    line = said(text, "Q_main_W  d_z_um")
    row = re.search(r"([\d.]+) µm/W +\(([\d.]+) to ([\d.]+)\) +([\d.]+) min \(", line)
    if not row:
        return line, False
    gain, low, high, tau = map(float, row.groups())
    ok = low < 0.5 < high and abs(tau - 25) < 0.5
    return f"{gain:.4g} µm/W ({low:.4g} to {high:.4g}), {tau:.3g} min; 0.5 and 25 true", ok


def presented_as_json(b: Bench) -> tuple[str, bool]:
    text = b.tool("present", b.model, "--json").out
    lines, model = text.splitlines(), json.loads(text)
    ok = len(lines) <= SCREEN and "covariance" not in text and len(model) == 1
    return f"{len(lines)} lines, no covariance", ok


def presented_delay(b: Bench) -> tuple[str, bool]:
    heat = b.columns(noise=False)["Q_main_W"]
    late = np.concatenate([np.zeros(12), b.columns()["d_z_um"][:-12]])
    b.write("late.csv", time_s=PERIOD_S * np.arange(ROWS), Q_main_W=heat, d_z_um=late)
    b.tool("identify", "late.csv", "--input", "Q_main_W", "--output", "d_z_um",
           "--structure", "oe", "-q", "-o", "late.json")  # fmt: skip
    response = json.loads(b.tool("present", "late.json", "--json").out)["late.json"]["responses"][0]
    told = "delay" in b.tool("present", "late.json").out
    return f"{response['delay_s']:g} s of 120 s", told and abs(response["delay_s"] - 120) <= 10


def compared(b: Bench) -> tuple[str, bool]:
    model, lag = models(b)
    done = b.tool("compare", lag, model, b.log, "--plot", "compare.svg", "--json")
    names = has(done.out, lag.name, model.name)
    return has(drawn(b, "compare.svg"), lag.name, model.name, "measured", "residual [µm]",
               "fit ") if names[1] else names  # fmt: skip


def residual(b: Bench) -> tuple[str, bool]:
    b.tool("plot", b.model, b.log, "-o", "residual.svg")
    return has(drawn(b, "residual.svg"), "auto-correlation", "cross-correlation", "95 % bound")


def responses(b: Bench) -> tuple[str, bool]:
    b.tool("plot", b.model, "-o", "responses.svg")
    return has(drawn(b, "responses.svg"), "Step response", "Frequency response", "95 %",
               "Poles and zeros", "zeros")  # fmt: skip


def series(b: Bench) -> tuple[Path, Path]:
    """A series that swings, and an AR model of it."""
    grown, chance = np.zeros(600), b.noise.standard_normal(600)
    for k in range(2, 600):
        grown[k] = 1.6 * grown[k - 1] - 0.8 * grown[k - 2] + 0.1 * chance[k]
    log = b.write("swings.csv", time_s=np.arange(600), e_tool_um=grown)
    b.tool("fit", log, "-C", "e_tool_um", "--order", "2,0", "-o", "swings.json")
    return log, b.folder / "swings.json"


def forecast_figure(b: Bench) -> tuple[str, bool]:
    log, model = series(b)
    b.tool("forecast", model, log, "-C", "e_tool_um", "--steps", "40", "-o", "ahead.csv")
    b.tool("plot", "ahead.csv", log, "-o", "ahead.svg")
    return has(drawn(b, "ahead.svg"), "measured", "forecast", "interval")


def other_figures(b: Bench) -> tuple[str, bool]:
    log, model = series(b)
    orders = b.tool("order", log, "-C", "e_tool_um", "--max-p", "4", "--max-q", "2", "--json")
    (b.folder / "order.json").write_text(orders.out)
    why = b.tool("diagnose", models(b)[1], b.log, "-q", "-o", "extended.json")
    (b.folder / "why.json").write_text(why.out)
    texts = ""
    for document in (model, "order.json", "why.json"):
        b.tool("plot", document, "-o", "other.svg")
        texts += drawn(b, "other.svg")
    return has(texts, "Spectral density", "Roots, inside the unit circle", "BIC", "decisive")


def eight_channels(b: Bench) -> tuple[str, bool]:
    names = [f"T_probe{k}_degC" for k in range(8)]
    still = {name: np.round(20 + 0.02 * b.noise.standard_normal(ROWS), 3) for name in names}
    b.write("eight.csv", time_s=PERIOD_S * np.arange(ROWS), **still)
    b.tool("noise", "eight.csv", "--plot", "eight.svg", "-o", "eight.json")
    return has(drawn(b, "eight.svg"), *names, "Allan deviation")


def worked_example(b: Bench) -> tuple[str, bool]:
    """The commands of the README, in a folder that has its sample logs."""
    text = (ROOT / "README.md").read_text()
    section = text.partition("## A worked example")[2].partition("\n## ")[0]
    place = b.folder / "readme"
    (place / "bin").mkdir(parents=True)
    (place / SAMPLES.name).symlink_to(SAMPLES)
    tool = place / "bin" / "thermaltool"
    tool.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m thermaltool "$@"\n')
    tool.chmod(0o755)
    path = os.pathsep.join([str(tool.parent), os.environ["PATH"]])
    blocks = re.findall(r"^```sh\n(.*?)^```", section, re.DOTALL | re.MULTILINE)
    for block in blocks:
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", block], cwd=place, capture_output=True, text=True,
            env=os.environ | {"PATH": path, "PYTHONPATH": str(ROOT)},
        )  # fmt: skip
        if done.returncode:
            raise FailedError(f"{block.split()[1]}: {said(done.stderr, 'Error')}")
    pictures = sorted(each.name for each in place.glob("*.png"))
    ok = bool(blocks) and "![" in section and "compare.png" in pictures
    return f"{len(blocks)} blocks run, {', '.join(pictures)} made", ok


def on_a_terminal(b: Bench, *arguments: object, **setting: str) -> str:
    """What a command says on a stderr that is a terminal."""
    leader, follower = pty.openpty()
    heard = bytearray()

    def listen() -> None:
        with contextlib.suppress(OSError):
            while data := os.read(leader, 4096):
                heard.extend(data)

    listener = threading.Thread(target=listen)
    listener.start()
    kept = {name: value for name, value in os.environ.items() if name != "NO_COLOR"}
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    subprocess.run(
        [sys.executable, "-m", "thermaltool", *map(str, arguments)], cwd=b.folder, stderr=follower,
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, timeout=MAX_SECONDS,
        env={**kept, **threads, "TERM": "xterm", "PYTHONPATH": str(ROOT), **setting},
    )  # fmt: skip
    os.close(follower)
    listener.join()
    os.close(leader)
    return heard.decode(errors="replace")


def long_commands(b: Bench) -> Iterator[tuple[object, ...]]:
    """Commands that take some seconds on a log of six pairs of sensor and deflection."""
    columns = b.columns()
    for k in range(5):
        more = b.columns(seed=40 + k)
        columns |= {f"T_p{k}_degC": more["T_head_degC"] + columns["T_head_degC"],
                    f"d_p{k}_um": more["d_z_um"] + columns["d_z_um"],
                    f"Q_p{k}_W": more["Q_main_W"]}  # fmt: skip
    log = b.write("large.csv", **columns)
    role = {"T": "sensor", "d": "deflection", "Q": "drive"}
    many = [f"--{role[name[0]]}={name}" for name in columns if name[0] in role]
    inputs = [f"--input={name}" for name in columns if name.startswith("Q")]
    yield "calibrate", log, *many[:6], "-o", "large.json"
    yield "identify", log, *inputs, "--output", "d_z_um", "-o", "large.identified.json"
    yield "diagnose", b.model, log, "-o", "large.extended.json"
    yield "regularize", "large.json", "--noise", b.idle, "-o", "large.design.json"
    yield "regress", log, "--output", "d_z_um", "-o", "large.regressed.json"
    yield "plant", "frame", "-o", "large.frame.csv"


def progress(b: Bench) -> tuple[str, bool]:
    told, silent = [], []
    for call in long_commands(b):
        begin = time.monotonic()
        seconds = re.findall(rf"{call[0]}, (\d+) s", on_a_terminal(b, *call))
        took = time.monotonic() - begin
        told.append(f"{call[0]} of {took:.0f} s {len(set(seconds))} times")
        # The program is loaded before it counts.
        if not seconds and took > MOST_SILENCE:
            silent.append(call[0])
    return f"told: {', '.join(told)}", not silent


def colours(b: Bench) -> tuple[str, bool]:
    red = "\x1b[31m"
    found = red in on_a_terminal(b, "check", "absent.csv")
    plain = red in on_a_terminal(b, "check", "absent.csv", NO_COLOR="1")
    return f"errors {'red' if found else 'plain'}; {'red' if plain else 'plain'} with NO_COLOR", (
        found and not plain
    )


def completion(b: Bench) -> tuple[str, bool]:
    scripts = [b.tool("completion", shell).out for shell in ("bash", "zsh", "fish")]
    page = (ROOT / "docs" / "reference" / "commands" / "completion.md").exists()
    named = "thermaltool completion" in (ROOT / "README.md").read_text()
    ok = all("_THERMALTOOL_COMPLETE" in each for each in scripts) and page and named
    return "bash, zsh, fish; a page, named by the README", ok


def dates(b: Bench) -> tuple[str, bool]:
    columns = b.columns()
    columns["time_s"] = columns["time_s"] + 1773483300
    b.write("epoch.csv", **columns)
    b.tool("plot", "epoch.csv", "-o", "epoch.svg")
    return has(drawn(b, "epoch.svg"), "2026-Mar-14", "10:30", "time, UTC")


def tutorials(b: Bench) -> tuple[str, bool]:
    """The test of the tutorials, and of all links, questions and pages."""
    del b
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-n", "0", "-p", "no:cacheprovider",
         "tests/test_docs.py"],
        cwd=ROOT, capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    folder = ROOT / "docs" / "tutorials"
    blocks = sum(page.read_text().count("\n```sh\n") for page in folder.glob("*.md"))
    words = f"{len([*folder.glob('*.md')])} tutorials, {blocks} blocks run"
    return f"{words}: {said(done.stdout, 'passed in')}", done.returncode == 0


def pages(b: Bench) -> tuple[str, bool]:
    del b
    parts = [ROOT / "docs" / name for name in ("tutorials", "how-to", "reference", "explanation")]
    count = [len([*part.rglob("*.md")]) for part in parts]
    ok = all(count) and (parts[3] / "glossary.md").exists()
    words = zip(count, parts, strict=True)
    return ", ".join(f"{n} of {part.name}" for n, part in words), ok


def drawings(b: Bench) -> tuple[str, bool]:
    """Each kind of response that a model file may hold is on the page, with a drawing."""
    del b
    page = (ROOT / "docs" / "explanation" / "responses.md").read_text()
    figures = re.findall(r"\]\(\.\./(figures/response_\w+\.png)\)", page)
    there = all((ROOT / "docs" / each).exists() for each in figures)
    families = sorted({kind.rstrip("0123456789") for kind in KINDS})
    told, ok = has("\n".join(re.findall(r"^## .*", page, re.MULTILINE)), *families)
    return f"{len(figures)} drawings; {', '.join(families)}: {told}", ok and there


def site(b: Bench) -> tuple[str, bool]:
    """`make docs` builds it where mkdocs is installed; else what it shows is counted."""
    tool = ROOT / ".venv-docs" / "bin" / "mkdocs"
    if not tool.exists() and not shutil.which("mkdocs"):
        shown = set(re.findall(r"[\w/-]+\.md", (ROOT / "mkdocs.yml").read_text()))
        return f"mkdocs.yml shows {len(shown)} pages (not built: no mkdocs here)", len(shown) > 30
    done = subprocess.run(
        [tool if tool.exists() else "mkdocs", "build", "--strict", "-q", "-d", b.folder / "site"],
        cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    built = len([*(b.folder / "site").rglob("index.html")])
    return f"{built} pages built, strict", done.returncode == 0


MISSED = "missed"
STUMBLES = [
    Stumble("3.1a", "what is in a model: gains, time constants, intervals, units",
            MISSED, presented),
    Stumble("3.1b", "the same as JSON, below a screen", MISSED, presented_as_json),
    Stumble("3.1c", "a dead time in it", MISSED, presented_delay),
    Stumble("3.2", "models side by side on a log, one figure", MISSED, compared),
    Stumble("3.3a", "residual: auto- and cross-correlation with bounds", MISSED, residual),
    Stumble("3.3b", "step and frequency response with bands, poles, zeros", MISSED, responses),
    Stumble("3.4a", "`forecast`: history, shaded interval", MISSED, forecast_figure),
    Stumble("3.4b", "`plot` of ARMA models, orders, `why.json`", MISSED, other_figures),
    Stumble("3.4c", "`noise` of eight channels on one page", MISSED, eight_channels),
    Stumble("3.4d", "the README's worked example ends with a picture", MISSED, worked_example),
    Stumble("3.5a", "a long command on a terminal", "up to 46 s of silence", progress),
    Stumble("3.5b", "colours, and none with NO_COLOR", MISSED, colours),
    Stumble("3.5c", "`thermaltool completion`", "not documented", completion),
    Stumble("3.5d", "clocks of seconds since 1970 in figures", MISSED, dates),
    Stumble("3.6a", "tutorials, links and questions, by their tests", MISSED, tutorials),
    Stumble("3.6b", "pages in four parts, a glossary", MISSED, pages),
    Stumble("3.6c", "each kind of response: a drawing of its parameters", MISSED, drawings),
    Stumble("3.6d", "pages as a site", MISSED, site),
]  # fmt: skip
