"""Logs on which `diagnose` and its peers are compared: measured ones, and simulated machines."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thermaltool.logs import read_log
from thermaltool.model import relative
from thermaltool.record import Record
from thermaltool.units import parse_channel

Float = NDArray[np.float64]
MAPS = Path(__file__).parent.parent / "data_samples" / "maps"


@dataclass(frozen=True)
class Case:
    """One question: a model, the log that it is wrong on, and rows that no fit has seen.

    Attributes
    ----------
    calibration, training, held_out : Record
        What the plain model is fitted to; the log under examination; the rows to predict, with
        what the drives did before them.
    begin : int
        First of the rows to predict.
    drives, extras, outputs : tuple of str
        Channels.
    cause : str
        What is known to be there.
    kinds, reference
        Of the plain model, see `Plan`.
    """

    name: str
    calibration: Record
    training: Record
    held_out: Record
    begin: int
    drives: tuple[str, ...]
    extras: tuple[str, ...]
    outputs: tuple[str, ...]
    cause: str
    kinds: Mapping[str, str] = field(default_factory=dict)
    reference: float | None = None

    @property
    def inputs(self) -> tuple[str, ...]:
        return (*self.drives, *self.extras)

    def level(self, record: Record, channel: str) -> Float:
        """A channel from its rest: the first row of a temperature or displacement."""
        if parse_channel(channel).dimension in ("temperature", "length", "angle"):
            return relative(record.columns[channel], "first")
        rest = self.reference if channel in self.drives and self.reference else 0.0
        return record.columns[channel] - rest

    def table(self, record: Record, channels: Sequence[str]) -> Float:
        return np.column_stack([self.level(record, c) for c in channels])


def gantry(data: Path) -> Case:
    """Morning run and evening run of one day, driven by the temperature of the frame."""
    runs = []
    for part in ("morning", "evening"):
        path = data / "gantry" / f"run_2021-06-13_{part}.csv"
        runs.append(read_log(str(path), columns=str(MAPS / "gantry.toml")))
    morning, evening = runs
    extras = ("T_bed_degC", "T_chamber_degC", "T_hotend_degC")
    cause = "second_source (bed, chamber)"
    drives, outputs = ("T_frame_degC",), ("d_z_um",)
    return Case("gantry", morning, morning, evening, 0, drives, extras, outputs, cause)


def heating_system(data: Path) -> Case:
    """Trained on 9, 4 and 8 V (the first 1000 s), judged on 3, 7 and 6 V."""
    path = str(data / "daisy" / "heating_system.csv")
    log = read_log(path, columns=str(MAPS / "heating_system.toml"))
    row = int(np.searchsorted(log.time, 1000.0))
    training = log.rows(slice(row))
    return Case(
        "heating_system",
        training,
        training,
        log,
        row,
        ("U_lamp_V",),
        (),
        ("T_plate_degC",),
        "drive_nonlinearity",
        {"T_plate_degC": "deflection"},
        6.0,
    )


def hidden(effect: str, size: float, seed: int) -> Case:
    """A simulated machine: calibrated before the effect, judged on the end of a log with it."""
    sys.path.append(str(Path(__file__).parents[1] / "tests"))
    from machines.hidden import hide

    found = hide([effect], size, seed, seed)
    row = int(0.6 * len(found.log["time_s"]))
    calibration, whole = (
        Record(table["time_s"], {k: v for k, v in table.items() if k != "time_s"}, digest=name)
        for name, table in (("before", found.calibration), ("with", found.log))
    )
    drives = ("Q_main_1",)
    outputs = ("dT_near_K", "dT_far_K", "T_column_degC", "d_x_um", "d_y_um")
    return Case(
        f"hidden {effect}",
        calibration,
        whole.rows(slice(row)),
        whole,
        row,
        drives,
        tuple(c for c in whole.columns if c not in (*drives, *outputs)),
        outputs,
        effect,
        dict.fromkeys(outputs, "deflection"),
    )
