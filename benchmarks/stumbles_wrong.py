"""Stumbles that were silently wrong: a number or a file, and exit code 0."""

from __future__ import annotations

import json
import re

import numpy as np
from stumbles_bench import AIR_DEGC, PERIOD_S, ROWS, Bench, Stumble, lag, last, said, steps


def in_millimetres(b: Bench, *options: object) -> tuple[np.ndarray, np.ndarray]:
    """Set points in mm of a machine whose deflection is logged in mm, and what they cancel."""
    columns = b.columns()
    columns["d_z_mm"] = np.round(columns.pop("d_z_um") / 1000, 6)
    log = b.write("millimetres.csv", **columns)
    design = b.folder / "millimetres.design.json"
    if not design.exists():
        b.calibrated(log, "millimetres.json")
        b.tool("regularize", "millimetres.json", "--noise", b.idle, "--form", "kalman",
               "-q", "-o", design)  # fmt: skip
    done = b.tool("compensate", design, log, "-q", *options, fails=True)
    moved = done.table["offset_z_mm"][:-1] if done.code == 0 else np.array([])
    return moved, -columns["d_z_mm"]


def zeros_for_ever(b: Bench) -> tuple[str, bool]:
    moved, wanted = in_millimetres(b)
    worst = 1000 * np.max(np.abs(moved - wanted))
    return f"set points to {1000 * np.min(moved):.0f} um, off by {worst:.2g} um", worst < 6


def steps_with_units(b: Bench) -> tuple[str, bool]:
    moved, _ = in_millimetres(b, "--step", "2um", "--slew", "0.1um/s")
    grid = np.max(np.abs(moved / 0.002 - np.round(moved / 0.002)))
    rate = np.max(np.abs(np.diff(moved))) / PERIOD_S * 1000
    return f"multiples of 2 um, at most {rate:.3g} um/s", bool(grid < 1e-6 and rate < 0.21)


def a_step_above_the_range(b: Bench) -> tuple[str, bool]:
    in_millimetres(b)
    done = b.tool("compensate", "millimetres.design.json", "millimetres.csv", "--step", "0.5",
                  fails=True)  # fmt: skip
    return f"refused: {said(done.err, 'a step of')[7:60]} ...", done.code == 2 and not done.out


FAULTS = {"85": 85.0, "-127": -127.0, "-180": -180.0}


def faulty(b: Bench, log: str) -> dict[str, np.ndarray]:
    """The machine's log with a sensor's known faults, a pair of spikes, and spikes in a burst."""
    columns = b.columns()
    head = columns["T_head_degC"]
    for k, value in enumerate(FAULTS.values()):
        head[120 + 60 * k : 123 + 60 * k] = value
    head[400:402] += 25.0
    for k in range(500, 512, 4):
        head[k] -= 30.0
    columns["d_z_um"][[250, 252]] += 400.0
    b.write(log, **columns)
    return columns


def faults_are_fitted(b: Bench) -> tuple[str, bool]:
    faulty(b, "faulty.csv")
    call = ("calibrate", "faulty.csv", "--drive", "Q_main_W", "--sensor", "T_head_degC",
            "--response", "T_head_degC=rational2", "--linear", "-q", "--json")  # fmt: skip
    fits = {}
    for name in ("omit", "keep"):
        done = b.tool(*call, "--faults", name, "-o", f"faulty.{name}.json")
        model = json.loads((b.folder / f"faulty.{name}.json").read_text())
        fits[name] = model["outputs"][0]["fit"]["fit_percent"], done.err
    told = "faults of sensors left out" in fits["omit"][1]
    return (f"fit {fits['omit'][0]:.1f} % ({fits['keep'][0]:.1f} % with --faults keep), "
            f"{'told' if told else 'not told'}"), fits["omit"][0] > 98 and told  # fmt: skip


def faults_are_seen(b: Bench) -> tuple[str, bool]:
    columns = faulty(b, "faulty.csv")
    done = b.tool("check", "faulty.csv", "--json")
    found = json.loads(done.out)
    text = json.dumps(found)
    lines = re.findall(r"\bT_head_degC", text)
    missed = [name for name in FAULTS if f"{float(name):g} degC" not in text]
    ok = done.code == 3 and not missed and len(columns) == 4
    return f"{len(lines) - 1} places named" if ok else f"not named: {', '.join(missed)}", ok


def values_in_a_map(b: Bench) -> tuple[str, bool]:
    columns = b.columns()
    columns["T_head_degC"][100], columns["T_head_degC"][200] = 31.25, 60.0
    b.write("mapped.csv", **columns)
    (b.folder / "valid.toml").write_text(
        "[columns]\nT_head_degC = { valid = [-40, 50], missing = [31.25] }\n"
    )
    b.tool("check", "mapped.csv", "--columns", "valid.toml", "-o", "valid.csv")
    cells = [line.split(",")[2] for line in (b.folder / "valid.csv").read_text().splitlines()]
    empty = [k for k, text in enumerate(cells) if not text]
    return f"rows {empty} have no value", empty == [101, 201]


def warm_design(b: Bench) -> str:
    """A design that is driven by a temperature; its machine bends 4 um/K, 20 min late."""
    heat = steps()
    room = np.round(AIR_DEGC + 16 * lag(heat / 200, 3000.0), 3)
    grown = 4.0 * lag(room - AIR_DEGC, 1200.0) + 0.1 * b.noise.standard_normal(ROWS)
    b.write("room.csv", time_s=PERIOD_S * np.arange(ROWS), T_room_degC=room, d_z_um=grown)
    b.tool("calibrate", "room.csv", "--drive", "T_room_degC", "--deflection", "d_z_um",
           "--response", "d_z_um=rational1", "--linear", "-q", "-o", "room.json")  # fmt: skip
    b.tool("regularize", "room.json", "-q", "-o", "room.design.json")
    # Stands for an hour and more at 8 K above the calibration's start: 32 um.
    warm = np.round(28.0 + 0.02 * b.noise.standard_normal(ROWS), 3)
    b.write("warm.csv", time_s=PERIOD_S * np.arange(ROWS), T_room_degC=warm)
    return "room.design.json"


def a_warm_machine(b: Bench) -> tuple[str, bool]:
    done = b.tool("compensate", warm_design(b), "warm.csv")
    end = -done.table["offset_z_um"][-2]
    return f"ends at {end:.1f} um of 32", abs(end - 32) < 1


def settled(b: Bench) -> tuple[str, bool]:
    done = b.tool("compensate", "room.design.json", "warm.csv", "--initial", "settled",
                  "--slew", "100um/s")  # fmt: skip
    first = -done.table["offset_z_um"][1]
    return f'{first:.1f} um at the second line; "{said(done.err, "starts")[-60:]}"', (
        abs(first - 32) < 1 and "starts from" in done.err
    )


def rest_is_in_the_model(b: Bench) -> tuple[str, bool]:
    rest = json.loads((b.folder / "room.json").read_text())["drives"][0].get("rest")
    done = b.tool("compensate", "room.design.json", "warm.csv")
    told = "starts from rest" in done.err
    return f"rest = {rest:.4g} degC; {'told by the stream' if told else 'not told'}", (
        abs(rest - AIR_DEGC) < 0.1 and told
    )


def a_last_row(b: Bench) -> tuple[str, bool]:
    text = b.log.read_text().rstrip("\n")
    (b.folder / "cut.csv").write_text(text)
    rows = json.loads(b.tool("check", "cut.csv", "--json").out)["rows"]
    lines = len(b.streamed(log=b.folder / "cut.csv"))
    return f"{rows} rows of {ROWS} read, {lines} set points", rows == lines == ROWS


def the_safe_row(b: Bench) -> tuple[str, bool]:
    done = b.tool("compensate", b.design, b.log, "-q")
    (b.folder / "set.csv").write_text(done.out)
    b.tool("plot", "set.csv", "--against", b.log, "-o", "set.svg")
    # Text of an SVG figure is drawn as paths; the comments hold it.
    drawn = (b.folder / "set.svg").read_text()
    bands = [float(each) for each in re.findall(r"band (\d[\d.]*)", drawn)]
    measured = np.genfromtxt(b.log, delimiter=",", names=True)["d_z_um"]
    error = measured + done.table["offset_z_um"][:-1]
    true = float(np.ptp(error))
    drawn_band = min(bands, default=np.nan)
    return f"band {drawn_band:.3g} um drawn, {true:.3g} um true", abs(drawn_band - true) < 2.5


def a_name_of_another_unit(b: Bench) -> tuple[str, bool]:
    columns = b.columns()
    columns["T_chamber_degC"] = columns.pop("T_head_degC")
    b.write("chamber.csv", **columns)
    done = b.tool("calibrate", "chamber.csv", "--drive", "T_chamber_degF", "--deflection",
                  "d_z_um", "-o", "no.json", fails=True)  # fmt: skip
    return last(done.err)[-90:], done.code != 0 and "did you mean" not in done.err


def foreign_units(b: Bench) -> tuple[str, bool]:
    time = 1.7734833e9 + PERIOD_S * np.arange(4)
    right = []
    for unit, factor in (("s", 1.0), ("ms", 1e3), ("ns", 1e9)):
        rows = [f"{each * factor:.0f},68.0,1.5" for each in time]
        (b.folder / "units.csv").write_text("\n".join(["stamp,Bed,Probe", *rows, ""]))
        (b.folder / "units.toml").write_text(
            f'[time]\ncolumn = "stamp"\nunit = "{unit}"\n[columns]\n'
            'Bed = { name = "T_bed_degC", unit = "degF" }\n'
            'Probe = { name = "d_z_um", unit = "mm" }\n'
        )
        b.tool("check", "units.csv", "--columns", "units.toml", "-o", "read.csv")
        read = np.genfromtxt(b.folder / "read.csv", delimiter=",", names=True)
        values = np.allclose(read["T_bed_degC"], 20) and np.allclose(read["d_z_um"], 1500)
        right.append(values and np.allclose(np.diff(read["time_s"]), PERIOD_S))
    named = b.tool("check", "-", stdin="time_ms,T_bed_degC\n0,20\n1000,21\n2000,22\n")
    right.append("2 s" in named.out)
    return f"{sum(right)} of 4 read: s, ms, ns since 1970, time_ms; 68 degF = 20 degC", all(right)


def a_report_of_another_format(b: Bench) -> tuple[str, bool]:
    done = b.tool("diagnose", b.model, b.log, "--report", "why.html", "-o", "x.json", fails=True)
    made = b.folder / "why.html"
    page = made.exists() and "<html" in made.read_text()[:300].lower()
    return (f"refused: {last(done.err)[-70:]}" if done.code == 2 else "written as HTML"), (
        page if made.exists() else done.code == 2
    )


def a_stream_of_parquet(b: Bench) -> tuple[str, bool]:
    series = np.cumsum(b.noise.standard_normal(300)) * 0.1
    b.write("series.csv", time_s=np.arange(300), e_tool_um=series)
    b.tool("fit", "series.csv", "-C", "e_tool_um", "--order", "1,0", "-o", "arma.json")
    done = b.tool("forecast", "arma.json", "series.csv", "--stream", "--to", "parquet", fails=True)
    if done.code == 2:
        return f"refused: {last(done.err)[-80:]}", not done.out
    return "Parquet", done.out.startswith("PAR1") and done.out.rstrip().endswith("PAR1")


def laplace(b: Bench, expression: str, exact, *more: object) -> tuple[str, bool]:
    """Whether what is far off is told: the largest error, and the largest estimate."""
    done = b.tool("laplace", expression, "--times", "0.5:10:20", *more)
    table = done.table
    error = np.abs(table["value_1"] - exact(table["time_s"]))
    size = np.maximum.accumulate(np.abs(exact(table["time_s"])))
    unseen = bool(np.any(error > 10 * table["error_1"] + 1e-9 * size))
    return (f"off by {np.max(error / size):.1g} of the largest value, estimated "
            f"{np.max(table['error_1'] / size):.1g}, exit {done.code}"), not unseen  # fmt: skip


def a_pole_in_the_right_half(b: Bench) -> tuple[str, bool]:
    return laplace(b, "1/(s+1)+1/(s-2)", lambda t: np.exp(-t) + np.exp(2 * t))


def an_unstable_pair(b: Bench) -> tuple[str, bool]:
    return laplace(b, "1/((s-0.5)**2+100)", lambda t: np.exp(0.5 * t) * np.sin(10 * t) / 10)


def a_relative_tolerance(b: Bench) -> tuple[str, bool]:
    done = b.tool("laplace", "1/(s-2)", "--time", "12", "--rtol", "1e-6")
    value = done.table["value_1"]
    return f"{float(value):.5g} of {np.exp(24):.5g}, exit {done.code}", done.code == 0


STUMBLES = [
    Stumble("1.1a", "a deflection in mm: set points", "zeros for ever", zeros_for_ever),
    Stumble("1.1b", "`--step`, `--slew` with units, for mm", "count in mm", steps_with_units),
    Stumble("1.1c", "a step above the calibration's range", "taken", a_step_above_the_range),
    Stumble("1.2a", "85, -127, -180, pairs and bursts of spikes in a fit", "98.0 to 86.8 %",
            faults_are_fitted),
    Stumble("1.2b", "`check` of these", "fitted through, exit 0", faults_are_seen),
    Stumble("1.2c", "`valid`, `missing` by value in a map", "not there", values_in_a_map),
    Stumble("1.3a", "a temperature drives, a warm machine", "-8 um of 33", a_warm_machine),
    Stumble("1.3b", "the same, `--initial settled`", "does nothing", settled),
    Stumble("1.3c", "rest in the model, told by the stream", "nowhere", rest_is_in_the_model),
    Stumble("1.4a", "a last row without a newline", "lost", a_last_row),
    Stumble("1.4b", "`plot --against` and the safe row", "band 104 um of 44", the_safe_row),
    Stumble("1.5a", "a name in degF where the log has degC", "did you mean ..._degC?",
            a_name_of_another_unit),
    Stumble("1.5b", "degF, mm, s, ms, ns since 1970", "unknown units", foreign_units),
    Stumble("1.6a", "`--report x.html`", "Markdown in it", a_report_of_another_format),
    Stumble("1.6b", "`forecast --stream --to parquet`", "NDJSON", a_stream_of_parquet),
    Stumble("1.7a", "`laplace` beside a pole in the right half", "off by 9.9, estimate 1e-12",
            a_pole_in_the_right_half),
    Stumble("1.7b", "the same, a pair that swings", "not told", an_unstable_pair),
    Stumble("1.7c", "a tolerance relative to the result", "absolute alone", a_relative_tolerance),
]  # fmt: skip
