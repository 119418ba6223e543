"""One machine of the exam: calibrated, and its logs diagnosed, all by the command line.

Nothing is asked of the tool but what a user would: which columns are drives, sensors, deflections.
What is told is compared with the truth, and what is written with what it does.
"""

from __future__ import annotations

import contextlib
import csv
import json
import os
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from as_simulated import Agreements, compared, largest
from click.testing import CliRunner
from exam_scoring import Agreed, Named, Score, Trial
from hidden_scoring import FALSE, LARGEST_GROUP, Float
from machines.foreign import PLANTS
from machines.foreign.hide import Exercise, calibration, clean_log, hide
from machines.foreign.plant import Plant, Table, as_logged
from scipy.stats import norm

from thermaltool.cli import group as thermaltool
from thermaltool.errors import ThermalToolError

# ---------------------------------------------------------------- the command line


class _FailedError(Exception):
    """A command ended otherwise than it may."""


def call(*arguments: object, may: Sequence[int] = (0,)) -> str:
    """A command in this process: what it writes to stdout; `may` are its exit codes."""
    result = CliRunner().invoke(thermaltool, [str(each) for each in arguments])
    if result.exit_code in may:
        return result.stdout
    error, place = result.exception, ""
    if error is not None and not isinstance(error, SystemExit | ThermalToolError):
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f" at {Path(last.filename).name}:{last.lineno}: a traceback"
    what = f"{type(error).__name__}: {error}" if error else result.stderr.strip()[-300:]
    raise _FailedError(f"{arguments[0]}: exit {result.exit_code}: {what}{place}")


def write_log(plant: Plant, table: Table, path: Path) -> None:
    columns = as_logged(plant, table)
    with open(path, "w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(zip(*([f"{x:.7g}" for x in c] for c in columns.values()), strict=True))


def write_map(plant: Plant, path: Path) -> None:
    """The column map of a logger with names and units of its own."""
    lines = []
    clock, scale, _ = plant.foreign.get("time_s", ("time_s", 1.0, 0.0))
    unit = {1.0: "s", 60.0: "min", 3600.0: "h"}[scale]
    lines += ["[time]", f'column = "{clock}"', f'unit = "{unit}"', "[columns]"]
    for name, (other, scale, offset) in plant.foreign.items():
        if name != "time_s":
            lines.append(
                f'"{other}" = {{ name = "{name}", scale = {scale!r}, offset = {offset!r} }}'
            )
    path.write_text("\n".join(lines) + "\n")


# ---------------------------------------------------------------- a machine and its logs


@dataclass(frozen=True)
class Calibrated:
    """A calibrated machine in its folder.

    Attributes
    ----------
    plant : Plant
    folder : Path
    options : list of str
        How its logs are read.
    residual : mapping of output to ndarray [unit of the output]
        What the model leaves of a clean log, about its mean; of a machine that may be warm when
        a log begins, about the start that fits best.
    seconds : float
        CPU time of the calibration.
    """

    plant: Plant
    folder: Path
    options: list[str]
    residual: Mapping[str, Float]
    seconds: float


def calibrated(plant: Plant, machine: int, folder: Path) -> Calibrated:
    """Calibrate with the default options."""
    options: list[str] = []
    if plant.foreign:
        write_map(plant, folder / "map.toml")
        options = ["--columns", str(folder / "map.toml")]
    write_log(plant, calibration(plant, machine), folder / "calibration.csv")
    roles = [f"--drive={name}" for name in plant.inputs]
    roles += [f"--sensor={name}" for name in plant.sensors]
    roles += [f"--deflection={name}" for name in plant.deflections]
    begin = time.process_time()
    call("calibrate", folder / "calibration.csv", *roles, *options, "-o", folder / "model.json")
    seconds = time.process_time() - begin
    write_log(plant, clean_log(plant, machine), folder / "clean.csv")
    call("simulate", folder / "model.json", folder / "clean.csv", *options,
         "-o", folder / "clean_simulated.csv", "-q")  # fmt: skip
    with open(folder / "clean_simulated.csv") as stream:
        rows = list(csv.DictReader(stream))
    residual = {}
    for name in plant.outputs:
        values = np.array([float(row[f"residual_{name}"]) for row in rows])
        residual[name] = _beside_start(plant, values)
    return Calibrated(plant, folder, options, residual, seconds)


def _beside_start(plant: Plant, course: Float) -> Float:
    """What of a course no start explains: its mean is free, that of a warm machine its decays."""
    return course - (_start(course) if plant.warm or plant.days else course.mean())


def _start(residual: Float) -> Float:
    """What a log that does not begin at rest brings along: decays and a level that fit best."""
    time = np.arange(len(residual)) / len(residual)
    decays = np.column_stack([np.exp(-time / tau) for tau in (1.0, 0.5, 0.25, 0.1, 0.05, 0.02)])
    columns = np.column_stack([np.ones(len(residual)), decays])
    return np.asarray(columns @ np.linalg.lstsq(columns, residual, rcond=1e-8)[0])


def score_machine(
    trials: Sequence[Trial], keep: Path | None = None, validate: bool = True
) -> list[Score]:
    """The logs of one machine, calibrated once.

    Parameters
    ----------
    trials : sequence of Trial
    keep : Path, optional
        Folder in which the files stay.
    validate : bool
        Whether `diagnose` is given the validation log; `simulate` is in any case.
    """
    name, machine = trials[0].plant, trials[0].machine
    plant = PLANTS[name](np.random.default_rng(machine))
    with contextlib.ExitStack() as stack:
        if keep is None:
            folder = Path(stack.enter_context(TemporaryDirectory()))
        else:
            folder = keep / f"{name}_{machine}"
            folder.mkdir(parents=True, exist_ok=True)
        # The tool looks for the calibration's logs from the folder of the call.
        home = os.getcwd()
        os.chdir(folder)
        stack.callback(os.chdir, home)
        try:
            known = calibrated(plant, machine, Path("."))
        except _FailedError as error:
            return [Score(trial, failure=str(error)) for trial in trials]
        return [score(trial, known, validate) for trial in trials]


def score(trial: Trial, known: Calibrated, validate: bool = True) -> Score:
    """Hide, diagnose, simulate, compare."""
    plant, folder = known.plant, known.folder
    level = {name: float(np.std(values)) for name, values in known.residual.items()}
    found = hide(plant, trial.kind, trial.size, trial.seed, level)
    assert found is not None, f"{trial.kind} does not apply to {plant.name}"
    stem = f"{trial.index}_{trial.kind.replace('/', '_') or 'clean'}"
    logs = {
        "diagnosed": folder / f"{stem}.csv",
        "validation": folder / f"{stem}_other.csv",
        "calibration": folder / "calibration.csv",
    }
    write_log(plant, found.log, logs["diagnosed"])
    write_log(plant, found.validation, logs["validation"])
    new = folder / f"{stem}_new.json"
    plain = Score(
        trial,
        found.size,
        max(level[name] / plant.noise[name].sigma for name in level),
        None if found.fault is None else found.fault.channel,
        None if found.fault is None else found.fault.begins,
        None if found.fault is None else found.fault.ends,
        float(found.log["time_s"][-1]),
        power=power_of_knowing_all(known, found),
    )
    begin = time.process_time()
    try:
        unseen = ["--validate", logs["validation"]] * validate
        said = call("diagnose", folder / "model.json", logs["diagnosed"], *unseen,
                    "-o", new, *known.options, may=(0, 3, 4))  # fmt: skip
        seconds = time.process_time() - begin
        (folder / f"{stem}.json").write_text(said)
        document = json.loads(said)
        refused = not new.exists()
        if refused and not document.get("spoiled"):
            raise _FailedError("diagnose: no model written, and no reason")
        after = folder / "model.json" if refused else new
        before = {n: _simulated(known, folder / "model.json", log) for n, log in logs.items()}
        written = {n: _simulated(known, after, log) for n, log in logs.items()}
    except _FailedError as error:
        return replace(plain, failure=str(error))
    return replace(
        plain,
        causes=tuple(_causes(document, trial, plant)),
        declared=tuple(sorted(declared(document))),
        adequate=document["adequate"],
        refused=refused,
        agreed=tuple(_agreed(plant, before, written)),
        told_off=_told_off(document, before, None if refused else written),
        seconds=seconds,
        notes=tuple(document["notes"]),
    )


def _simulated(known: Calibrated, model: Path, log: Path) -> Agreements:
    columns = known.folder / "simulated.csv"
    said = call("simulate", model, log, *known.options, "--json", "-o", columns)
    found: Agreements = json.loads(said)
    return found


def _causes(document: Mapping[str, Any], trial: Trial, plant: Plant) -> Iterator[Named]:
    for cause in document["causes"]:
        name, values = cause["name"], cause["parameters"]
        if name in plant.own and name != trial.kind:
            continue
        parameters = {key: value["value"] for key, value in values.items()}
        begins = parameters.get("start", parameters.get("time"))
        evidence, explained = cause["evidence"], cause.get("explained")
        yield Named(
            name,
            cause["channel"] or "",
            np.inf if evidence is None else evidence,
            np.nan if explained is None else explained,
            begins,
            parameters,
        )


def declared(document: Mapping[str, Any]) -> set[str]:
    """Names that the tool calls indistinguishable from its first cause, or suspects with none."""
    first = document["causes"][0]["name"] if document["causes"] else None
    kind = "indistinguishable" if first else "suspected"
    names: set[str] = set()
    for each in document["alternatives"]:
        group = set(each["names"])
        right = each["kind"] == kind and first in (None, each["names"][0])
        names |= group if right and len(group) <= LARGEST_GROUP else set()
    return names


def _agreed(
    plant: Plant, before: Mapping[str, Agreements], after: Mapping[str, Agreements]
) -> Iterator[Agreed]:
    for log in before:
        for output, old in before[log].items():
            new = after[log][output]
            yield Agreed(
                log,
                output,
                old["rmse"],
                new["rmse"],
                old["rmse_zero_free"],
                new["rmse_zero_free"],
                plant.noise[output].sigma,
            )


def _told_off(
    document: Mapping[str, Any],
    before: Mapping[str, Agreements],
    after: Mapping[str, Agreements] | None,
) -> float:
    """Largest relative difference of a told RMS from the simulated one, first and last step."""
    names = {}
    for key, log in (
        ("logs", "diagnosed"),
        ("validated_on", "validation"),
        ("sound", "validation"),
        ("calibrated_on", "calibration"),
    ):
        names |= {source["sha256"]: log for source in document.get(key, ())}

    def of(models: Mapping[str, Agreements]) -> Callable[[str], Agreements]:
        return lambda log: models[names[log]]

    # Without a cause the file is the one that came.
    return largest(compared(document["written"], of(before), None if after is None else of(after)))


def power_of_knowing_all(known: Calibrated, found: Exercise) -> float:
    """Power of a test that is told the whole effect, to the row, at `FALSE` false alarms.

    A matched filter: noise is what the model leaves of a clean log, taken for a first-order
    autoregression (Kay 1998, ch. 4). Of the change counts what no start of the log explains; what
    a gain of the drives' slow sum could say is not taken off.
    """
    if found.fault is None:
        return float("nan")
    square = 0.0
    for name, change in found.change.items():
        residual = known.residual[name]
        keep = min(float(residual[1:] @ residual[:-1] / (residual @ residual)), 0.9999)
        innovation = residual[1:] - keep * residual[:-1]
        centred = _beside_start(known.plant, change)
        white = centred[1:] - keep * centred[:-1]
        square += float(white @ white) / float(np.mean(innovation**2))
    return float(norm.cdf(np.sqrt(square) + norm.ppf(FALSE)))
