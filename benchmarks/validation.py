"""What ``identify`` prints as validation, beside ``simulate`` carried on: a Markdown table.

``python benchmarks/validation.py`` (in make study) takes the logs of ``make measured`` and of the
study, and two simulated processes that pause, lose rows and lack readings, each with several
structures, fitted to the first share of its rows. Of cnc_spindle only the first 16 h count: fitted
and judged within them, since its later rows are kept for other judgement. ``--seed`` repeats the
simulated ones.
The exit code is 1 where the two differ by more than half a point anywhere; --only names a log.
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

# One core; before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
import pandas as pd
from identify_process import names
from process_plants import PLANTS

import thermaltool as tt
from thermaltool.errors import ThermalToolError

SAMPLES = Path(__file__).parents[1] / "data_samples"
DATA = Path(__file__).parents[2] / "shared" / "data"
# What printed and simulated fit may differ by [points].
MAX_DIFFERENCE = 0.5
SPINDLE_STOP_S = 16 * 3600.0
MADE_ROWS = 1500
STRUCTURES: dict[str, dict[str, Any]] = {
    "defaults": {"real_poles": False},
    "oe, real poles": {"real_poles": True},
    "bj": {"structure": "bj", "orders": [(2, 2, 1)]},
    "arx": {"structure": "arx", "orders": [(2, 2, 1)]},
    "network": {"structure": "network"},
    "subspace": {"structure": "subspace"},
}


@dataclass(frozen=True)
class Case:
    """A log, what drives and follows in it, and how it is read."""

    path: Path
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    split: float = 0.6
    reading: dict[str, Any] = field(default_factory=dict)
    options: tuple[tuple[str, Any], ...] = ()


def cases() -> list[Case]:
    maps, heat = SAMPLES / "maps", ("Q_main_1",)
    bent = ("dT_pair1_K", "d_x_um")
    frames = [
        Case(SAMPLES / f"frame_{name}.parquet", heat, bent)
        for name in ("step100", "step050", "step025", "triangle", "duty")
    ]
    runs = sorted((DATA / "gantry").glob("run_*.csv"))
    printer = [
        Case(
            path,
            ("T_bed_degC",),
            ("T_frame_degC", "d_z_um"),
            reading={"columns": maps / "gantry.toml"},
        )
        for path in runs
    ]
    daisy, spindle = DATA / "daisy", DATA / "cnc_spindle/spindle_first_28h.csv"
    hairdryer, heating = daisy / "hairdryer_ljung.csv", daisy / "heating_system.csv"
    others = [
        Case(hairdryer, ("U_heater_V",), ("U_air_V",), 0.5,
             {"columns": maps / "hairdryer.toml"}),
        Case(heating, ("U_lamp_V",), ("T_plate_degC",), 0.5,
             {"columns": maps / "heating_system.toml"}),
        Case(spindle, ("T_t5_degC",), ("d_ch1_um", "d_ch3_um"),
             reading={"columns": maps / "cnc_spindle.toml"},
             options=(("stop", SPINDLE_STOP_S),)),
    ]  # fmt: skip
    return [*(case for case in (*others, *printer) if case.path.exists()), *frames]


def interrupted(folder: Path, seed: int) -> Iterator[Case]:
    """Processes of several outputs whose logs have pauses, lost rows, readings that are missing."""
    for name in ("evaporator, 3 inputs, 3 outputs", "wall, 2 inputs, 2 outputs"):
        rng = np.random.default_rng(seed)
        run = PLANTS[name](rng)
        rows = min(run.y.shape[1], MADE_ROWS)
        ins, outs = names(run)
        whole = pd.DataFrame(np.vstack([run.u, run.y])[:, :rows].T, columns=[*ins, *outs])
        whole.insert(0, "time_s", run.period * np.arange(rows))

        def without(*spans: tuple[float, float], whole=whole, rows=rows) -> pd.DataFrame:
            cut = [np.arange(int(a * rows), int(b * rows)) for a, b in spans]
            return whole.drop(index=np.concatenate(cut))

        paused = without((0.2, 0.28), (0.67, 0.73))
        lacking = paused.copy()
        lacking.loc[rng.choice(lacking.index, 60, replace=False), outs[0]] = np.nan
        made = {
            "pauses": paused,
            "pause at the split": without((0.58, 0.64)),
            "rows lost": whole.drop(index=rng.choice(rows, rows // 100, replace=False)),
            "pauses, readings missing": lacking,
        }
        for title, log in made.items():
            path = folder / f"{name.partition(',')[0]}, {title}.csv"
            log.to_csv(path, index=False)
            yield Case(path, tuple(ins), tuple(outs), reading={"nan_policy": "omit"})


def compared(case: Case, options: dict[str, Any]) -> list[tuple[str, float, float]]:
    """Output, printed fit and that of ``simulate`` for every held-out log [%].

    Raises
    ------
    ThermalToolError
        The structure has no model of the log, or the model no document.
    """
    read = case.reading
    found = tt.identify(case.path, case.inputs, case.outputs, split=case.split,
                        **read, **dict(case.options), **options)  # fmt: skip
    rows = []
    for fit in found.fits:
        assert fit.validation is not None
        for held in fit.validation.logs:
            run = tt.simulate(found.model, case.path, initial=held.initial, start=held.start,
                              stop=held.stop, **read)  # fmt: skip
            simulated = run.agreements[fit.model.target].fit_percent
            rows.append((fit.model.target, fit.validation.carried_on.fit_percent, simulated))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="part of the name of a log")
    parser.add_argument("--structure", choices=sorted(STRUCTURES), help="default: all")
    parser.add_argument("--seed", type=int, default=int(time.time()), help="of simulated logs")
    given = parser.parse_args()
    with TemporaryDirectory() as folder:
        made = list(interrupted(Path(folder), given.seed))
        worst = table([*cases(), *made], given)
    raise SystemExit(worst > MAX_DIFFERENCE)


def table(logs: list[Case], given: argparse.Namespace) -> float:
    """Prints it; the largest difference [points]."""
    kinds = {k: v for k, v in STRUCTURES.items() if given.structure in (None, k)}
    if not DATA.exists():
        print(f"measured logs left out, there is no {DATA} here\n")
    print("| log | structure | output | printed % | by simulate % | difference |")
    print("|---|---|---|---|---|---|")
    worst, count = 0.0, 0
    for case in logs:
        if given.only not in case.path.name:
            continue
        for title, options in kinds.items():
            begin = f"| {case.path.stem} | {title} |"
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    rows = compared(case, options)
            except ThermalToolError as error:
                print(f"{begin} | {error} | | |", flush=True)
                continue
            for output, printed, simulated in rows:
                off = abs(printed - simulated)
                worst, count = max(worst, off), count + 1
                print(f"{begin} {output} | {printed:.1f} | {simulated:.1f} | {off:.2g} |",
                      flush=True)  # fmt: skip
    print(
        f"\n{count} comparisons, the largest difference is {worst:.2g} points (seed {given.seed})"
    )
    return worst


if __name__ == "__main__":
    main()
